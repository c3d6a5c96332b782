#include "connection.hpp"

#include <grpc/grpc.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/support/channel_arguments.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <limits>
#include <random>
#include <stdexcept>

#include "cancellation.hpp"
#include "errors.hpp"

namespace moldline::internal {

namespace {

using Clock = std::chrono::steady_clock;

std::string content(const std::filesystem::path& file) {
  if (file.empty()) return {};
  std::ifstream stream(file, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!stream) throw std::invalid_argument("cannot read " + file.string());
  return text;
}

std::shared_ptr<grpc::ChannelCredentials> credentials(const std::optional<Tls>& tls) {
  if (!tls) return grpc::InsecureChannelCredentials();
  if (tls->certificate.empty() != tls->key.empty()) {
    throw std::invalid_argument("a certificate needs its key, and a key its certificate");
  }
  grpc::SslCredentialsOptions files;
  files.pem_root_certs = content(tls->authorities);
  files.pem_cert_chain = content(tls->certificate);
  files.pem_private_key = content(tls->key);
  return grpc::SslCredentials(files);
}

grpc::ChannelArguments arguments(const std::optional<Tls>& tls) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(512 << 20);
  arguments.SetMaxSendMessageSize(512 << 20);
  // Clients of one process do not share connections.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  // Reconnects to a restarted server within seconds instead of minutes.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 2000);
  // Detects a server that has vanished while a long call waits for it.
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 60'000);
  if (tls && !tls->server_name.empty()) arguments.SetSslTargetNameOverride(tls->server_name);
  return arguments;
}

std::mt19937_64& generator() {
  thread_local std::mt19937_64 generator{std::random_device{}()};
  return generator;
}

/// How long a call without a timeout is repeated.
constexpr std::chrono::minutes patience{10};
/// Pause before a call is repeated whose connection broke, in first pauses.
constexpr double after_loss = 10.0;

/// The error, saying what was tried where.
Failure told(Failure failure, const std::string& address, int failed, int lost) {
  const std::string times = failed == 1 ? "once" : std::to_string(failed) + " times";
  std::string what = "called " + times;
  if (lost > 0) {
    const std::string under = lost == 1 ? "the call" : std::to_string(lost) + " of the calls";
    what += ", and the connection broke under " + under + ", which the server may have died of";
  } else if (failed == 1 && failure.answered) {
    return failure;
  }
  failure.message += " (" + address + ": " + what + ")";
  return failure;
}

}  // namespace

Caller::Caller(const std::string& address, const Options& options)
    : address_(address),
      options_(options),
      channel_(grpc::CreateCustomChannel(address, credentials(options.tls), arguments(options.tls))) {}

Budget Caller::budget(const CallOptions& options, Seconds otherwise) const {
  const Seconds timeout = options.timeout.value_or(otherwise);
  // More than a century is no limit: it might overflow the clock.
  const bool limited = timeout < std::chrono::hours(24 * 365 * 100);
  return {
      limited ? Clock::now() + std::chrono::duration_cast<Clock::duration>(timeout) : Clock::time_point::max(),
      options.cancellation};
}

void Caller::attempts(
    const Budget& budget, const std::function<grpc::Status(grpc::ClientContext&)>& attempt) const {
  const Retry& retry = options_.retry;
  const Clock::time_point end = budget.end == Clock::time_point::max() ? Clock::now() + patience : budget.end;
  Seconds longest = retry.first_pause;
  int lost = 0;
  for (int failed = 1;; ++failed) {
    grpc::ClientContext context;
    if (!options_.token.empty()) context.AddMetadata("authorization", "Bearer " + options_.token);
    if (budget.end != Clock::time_point::max()) {
      context.set_deadline(std::chrono::system_clock::now() + (budget.end - Clock::now()));
    }
    grpc::Status status;
    {
      const Cancellable cancellable(budget.cancellation, context);
      status = attempt(context);
    }
    if (status.ok()) return;
    Failure failed_with = failure(status);
    if (failed_with.code == grpc::StatusCode::CANCELLED && Clock::now() >= budget.end) {
      // A server may report the deadline as a cancellation.
      failed_with.code = grpc::StatusCode::DEADLINE_EXCEEDED;
    }
    lost += failed_with.lost;
    std::uniform_real_distribution<double> share(0.0, 1.0);
    Seconds pause = failed_with.retry_after.value_or(Seconds(0.0)) + share(generator()) * longest;
    if (failed_with.lost) pause += after_loss * retry.first_pause;
    longest = std::min(2.0 * longest, retry.longest_pause);
    const bool again = failed_with.passes && failed < retry.attempts && lost <= retry.losses;
    if (!again || pause >= end - Clock::now()) raise(told(failed_with, address_, failed, lost));
    sleep(pause, budget.cancellation);
  }
}

std::string new_request_id() {
  static constexpr char digits[] = "0123456789abcdef";
  std::random_device random;
  std::string id(32, '0');
  for (char& digit : id) digit = digits[random() % 16];
  return id;
}

}  // namespace moldline::internal
