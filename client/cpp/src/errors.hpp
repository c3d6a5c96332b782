// Failed calls as exceptions.
#pragma once

#include <grpcpp/support/status.h>

#include "moldline/errors.hpp"

namespace moldline::internal {

/// Code and details of a failed call.
struct Failure {
  grpc::StatusCode code;
  std::string message;
  std::vector<FieldViolation> violations;
  std::optional<Seconds> retry_after;
  /// Whether the server answered; if not, the error is that of this side, or of a proxy.
  bool answered = true;
  /// Whether the connection broke after the call was sent: the server may have carried it out, or died of it.
  bool lost = false;
  /// Whether another attempt may succeed.
  bool passes = false;
};

Failure failure(const grpc::Status& status);
[[noreturn]] void raise(const Failure& failure);

}  // namespace moldline::internal
