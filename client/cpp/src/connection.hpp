// Calls, each in as many attempts as it takes.
#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>

#include <exception>
#include <functional>
#include <memory>

#include "moldline/client.hpp"
#include "moldline/v1/mesh_service.grpc.pb.h"
#include "moldline/v1/panel_service.grpc.pb.h"

namespace moldline::internal {

/// The time that an operation may take, over all its calls, and what may end it before.
struct Budget {
  std::chrono::steady_clock::time_point end;
  std::optional<Cancellation> cancellation;
};

/// A channel, and calls over it.
class Caller {
 public:
  Caller(const std::string& address, const Options& options);

  /// That of one operation, in which `otherwise` is the time where the caller names none.
  Budget budget(const CallOptions& options, Seconds otherwise) const;
  Budget budget(const CallOptions& options) const { return budget(options, options_.timeout); }

  /// Runs attempts until one succeeds. Throws what the last one failed with.
  void attempts(const Budget& budget, const std::function<grpc::Status(grpc::ClientContext&)>& attempt) const;

 protected:
  const std::shared_ptr<grpc::Channel>& channel() const { return channel_; }

 private:
  Options options_;
  std::shared_ptr<grpc::Channel> channel_;
};

/// The same to one service.
template <class Service>
class CallerOf : public Caller {
 public:
  using Stub = typename Service::Stub;

  CallerOf(const std::string& address, const Options& options)
      : Caller(address, options), stub_(Service::NewStub(channel())) {}

  /// One request, one answer.
  template <class Request, class Response>
  Response call(
      grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Response*), const Request& request,
      const Budget& budget) const {
    Response response;
    attempts(budget, [&](grpc::ClientContext& context) {
      response.Clear();
      return (stub_.get()->*method)(&context, request, &response);
    });
    return response;
  }

  Stub& stub() const { return *stub_; }

 private:
  std::unique_ptr<Stub> stub_;
};

class Connection : public CallerOf<v1::MeshService> {
 public:
  using CallerOf::CallerOf;
};

class PanelConnection : public CallerOf<v1::PanelService> {
 public:
  using CallerOf::CallerOf;
};

/// Reads a stream to its end and tells; an exception of `take` cancels the call, and goes on once it has ended.
template <class Stream, class Message, class Take>
void read_all(Stream& stream, grpc::ClientContext& context, Message& message, const Take& take, std::exception_ptr& thrown) {
  while (stream.Read(&message)) {
    if (thrown) continue;
    try {
      take(message);
    } catch (...) {
      thrown = std::current_exception();
      context.TryCancel();
    }
  }
}

/// A name for a request, which is unlike all others.
std::string new_request_id();

}  // namespace moldline::internal
