// Connections to a service, and calls with deadlines and retries.
#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>

#include <exception>
#include <functional>
#include <memory>

#include "convert.hpp"
#include "moldline/client.hpp"
#include "moldline/errors.hpp"
#include "moldline/v1/mesh_service.grpc.pb.h"
#include "moldline/v1/panel_service.grpc.pb.h"

namespace moldline::internal {

/// Deadline of an operation over all its calls, and its cancellation.
struct Budget {
  std::chrono::steady_clock::time_point end;
  std::optional<Cancellation> cancellation;
};

/// A channel, and calls over it.
class Caller {
 public:
  Caller(const std::string& address, const Options& options);

  /// Budget of an operation; `otherwise` is its timeout if the caller gives none.
  Budget budget(const CallOptions& options, Seconds otherwise) const;
  Budget budget(const CallOptions& options) const { return budget(options, options_.timeout); }

  /// Runs attempts until one succeeds; throws the error of the last one.
  void attempts(const Budget& budget, const std::function<grpc::Status(grpc::ClientContext&)>& attempt) const;

 protected:
  const std::shared_ptr<grpc::Channel>& channel() const { return channel_; }

 private:
  std::string address_;
  Options options_;
  std::shared_ptr<grpc::Channel> channel_;
};

/// Reads a stream to its end; an exception of `take` cancels the call and is kept in `thrown`.
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

/// Receiver of a stream of progress that ends with a result.
template <class Event, class Result>
class Outcome {
 public:
  Outcome(const Tell& tell, bool (Event::*has_result)() const, Result* (Event::*result)())
      : tell_(tell), has_result_(has_result), result_(result) {}

  void operator()(Event& event) {
    if ((event.*has_result_)()) {
      found_ = std::move(*(event.*result_)());
    } else if (tell_) {
      tell_(progress(event.progress()));
    }
  }

  /// The result; throws `InternalError` if the stream has ended without it.
  const Result& get() const {
    if (!found_) throw InternalError("the server ended without a result", {}, std::nullopt);
    return *found_;
  }

 private:
  const Tell& tell_;
  bool (Event::*has_result_)() const;
  Result* (Event::*result_)();
  std::optional<Result> found_;
};

/// A channel to a service, with its stub.
template <class Service>
class CallerOf : public Caller {
 public:
  using Stub = typename Service::Stub;

  CallerOf(const std::string& address, const Options& options)
      : Caller(address, options), stub_(Service::NewStub(channel())) {}

  /// A unary call.
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

  /// A call whose answer is a stream. `begin` is called before each attempt, `take` with each message; its exceptions cancel
  /// the call and are thrown.
  template <class Request, class Response, class Begin, class Take>
  void stream(
      std::unique_ptr<grpc::ClientReader<Response>> (Stub::*method)(grpc::ClientContext*, const Request&),
      const Request& request, const Budget& budget, const Begin& begin, const Take& take) const {
    std::exception_ptr thrown;
    attempts(budget, [&](grpc::ClientContext& context) {
      begin();
      const auto stream = (stub_.get()->*method)(&context, request);
      Response message;
      read_all(*stream, context, message, take, thrown);
      const grpc::Status status = stream->Finish();
      if (thrown) std::rethrow_exception(thrown);
      return status;
    });
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

/// A random request id.
std::string new_request_id();

}  // namespace moldline::internal
