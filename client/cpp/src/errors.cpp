#include "errors.hpp"

#include <algorithm>
#include <cctype>
#include <initializer_list>
#include <string_view>

#include "moldline/client/error_details.pb.h"

namespace moldline::internal {

namespace {

/// Reads `any` if it is a `google.rpc.NAME`.
template <class Message>
std::optional<Message> unpacked(const google::protobuf::Any& any, const std::string& name) {
  Message message;
  if (any.type_url() == "type.googleapis.com/google.rpc." + name && message.ParseFromString(any.value())) return message;
  return std::nullopt;
}

/// Whether a message contains one of the texts, whatever their case.
bool contains(std::string message, std::initializer_list<std::string_view> texts) {
  std::transform(message.begin(), message.end(), message.begin(), [](unsigned char c) { return std::tolower(c); });
  return std::any_of(texts.begin(), texts.end(), [&](std::string_view text) {
    return message.find(text) != std::string::npos;
  });
}

/// Whether gRPC says that a call was never sent; in case of doubt it was.
bool never_sent(const std::string& message) {
  return contains(
      message, {"failed to connect to all addresses", "connections to all backends failing", "name resolution", "dns",
                "empty address list", "connection refused", "failed to connect to remote host", "refused stream",
                "stream refused", "channel closed"});
}

/// Whether the class of an error is one that may pass.
bool may_pass(const Failure& failure) {
  switch (failure.code) {
    case grpc::StatusCode::UNAVAILABLE:
      return failure.answered || !contains(failure.message, {"certificate_verify_failed"});
    case grpc::StatusCode::RESOURCE_EXHAUSTED: return failure.retry_after.has_value();
    default: return false;
  }
}

void read_details(const std::string& details, Failure& failure) {
  client::Status rich;
  if (!rich.ParseFromString(details)) return;
  for (const auto& detail : rich.details()) {
    if (const auto bad_request = unpacked<client::BadRequest>(detail, "BadRequest")) {
      for (const auto& fault : bad_request->field_violations()) {
        failure.violations.push_back({fault.field(), fault.description()});
      }
    } else if (const auto retry = unpacked<client::RetryInfo>(detail, "RetryInfo")) {
      const auto& delay = retry->retry_delay();
      failure.retry_after = Seconds(static_cast<double>(delay.seconds()) + 1e-9 * delay.nanos());
    }
  }
}

}  // namespace

Failure failure(const grpc::Status& status) {
  Failure failure{status.error_code(), status.error_message(), {}, std::nullopt};
  read_details(status.error_details(), failure);
  // A server sends details with every error.
  failure.answered = !status.error_details().empty();
  failure.lost =
      failure.code == grpc::StatusCode::UNAVAILABLE && !failure.answered && !never_sent(failure.message);
  failure.passes = may_pass(failure);
  return failure;
}

namespace {

template <class Kind>
[[noreturn]] void raise_as(const Failure& failure) {
  throw Kind(failure.message, failure.violations, failure.retry_after);
}

}  // namespace

void raise(const Failure& failure) {
  switch (failure.code) {
    case grpc::StatusCode::INVALID_ARGUMENT: raise_as<InvalidArgument>(failure);
    case grpc::StatusCode::NOT_FOUND: raise_as<NotFound>(failure);
    case grpc::StatusCode::ALREADY_EXISTS: raise_as<AlreadyExists>(failure);
    case grpc::StatusCode::ABORTED: raise_as<Aborted>(failure);
    case grpc::StatusCode::UNAUTHENTICATED: raise_as<Unauthenticated>(failure);
    case grpc::StatusCode::PERMISSION_DENIED: raise_as<PermissionDenied>(failure);
    case grpc::StatusCode::FAILED_PRECONDITION: raise_as<FailedPrecondition>(failure);
    case grpc::StatusCode::RESOURCE_EXHAUSTED: raise_as<ResourceExhausted>(failure);
    case grpc::StatusCode::OUT_OF_RANGE: raise_as<OutOfRange>(failure);
    case grpc::StatusCode::CANCELLED: raise_as<Cancelled>(failure);
    case grpc::StatusCode::DEADLINE_EXCEEDED: raise_as<DeadlineExceeded>(failure);
    case grpc::StatusCode::UNAVAILABLE: raise_as<Unavailable>(failure);
    default: raise_as<InternalError>(failure);
  }
}

}  // namespace moldline::internal
