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
};

Failure failure(const grpc::Status& status);
[[noreturn]] void raise(const Failure& failure);

}  // namespace moldline::internal
