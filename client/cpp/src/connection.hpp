// Calls, each in as many attempts as it takes.
#pragma once

#include <grpcpp/client_context.h>

#include <functional>
#include <memory>

#include "moldline/client.hpp"
#include "moldline/v1/mesh_service.grpc.pb.h"

namespace moldline::internal {

/// The time that an operation may take, over all its calls, and what may end it before.
struct Budget {
  std::chrono::steady_clock::time_point end;
  std::optional<Cancellation> cancellation;
};

class Connection {
 public:
  using Stub = v1::MeshService::Stub;

  Connection(const std::string& address, const Options& options);

  /// That of one operation, in which `otherwise` is the time where the caller names none.
  Budget budget(const CallOptions& options, Seconds otherwise) const;
  Budget budget(const CallOptions& options) const { return budget(options, options_.timeout); }

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

  /// Runs attempts until one succeeds. Throws what the last one failed with.
  void attempts(const Budget& budget, const std::function<grpc::Status(grpc::ClientContext&)>& attempt) const;

  Stub& stub() const { return *stub_; }

 private:
  Options options_;
  std::unique_ptr<Stub> stub_;
};

/// A name for a request, which is unlike all others.
std::string new_request_id();

}  // namespace moldline::internal
