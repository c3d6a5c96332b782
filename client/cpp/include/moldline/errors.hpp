/// \file
/// Exceptions, one class for each class of failure.
#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "moldline/model.hpp"

namespace moldline {

/// One fault of a request.
struct FieldViolation {
  /// Path of the field, such as `design[3]`.
  std::string field;
  /// The fault: index, value, limit and the remedy.
  std::string description;
};

/// Failure of a request. Only the classes below are thrown.
class Error : public std::runtime_error {
 public:
  Error(const std::string& message, std::vector<FieldViolation> violations, std::optional<Seconds> retry_after)
      : std::runtime_error(message), violations_(std::move(violations)), retry_after_(retry_after) {}

  /// Name of the class, such as `INVALID_ARGUMENT`; the same in the protocol and in all clients.
  virtual const char* code() const noexcept = 0;
  /// Faults of the request's fields, if any.
  const std::vector<FieldViolation>& violations() const noexcept { return violations_; }
  /// Delay after which a retry may succeed, if any.
  std::optional<Seconds> retry_after() const noexcept { return retry_after_; }

 private:
  std::vector<FieldViolation> violations_;
  std::optional<Seconds> retry_after_;
};

/// The request is invalid, whatever the state of the server.
class InvalidArgument : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "INVALID_ARGUMENT"; }
};

/// The caller can see nothing with this id, or the server no longer holds it.
class NotFound : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "NOT_FOUND"; }
};

/// An earlier request with other content had this request id.
class AlreadyExists : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "ALREADY_EXISTS"; }
};

/// A concurrent update won: the session has a generation other than expected. Read it again.
class Aborted : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "ABORTED"; }
};

/// The caller is not authenticated: the token is missing, unknown or expired.
class Unauthenticated : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "UNAUTHENTICATED"; }
};

/// The caller is authenticated, but lacks the permission.
class PermissionDenied : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "PERMISSION_DENIED"; }
};

/// The input is valid, but the method fails on it, such as a mesh that loses a seam or a wake that cuts the body.
class FailedPrecondition : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "FAILED_PRECONDITION"; }
};

/// The server or a quota is full; `retry_after` is set if a retry may succeed.
class ResourceExhausted : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "RESOURCE_EXHAUSTED"; }
};

/// A message exceeds the size limit of server or client.
class OutOfRange : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "OUT_OF_RANGE"; }
};

/// The call was cancelled.
class Cancelled : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "CANCELLED"; }
};

/// The call exceeded its timeout.
class DeadlineExceeded : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "DEADLINE_EXCEEDED"; }
};

/// The server cannot be reached, or is stopping.
class Unavailable : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "UNAVAILABLE"; }
};

/// A fault of the server, or a malformed answer.
class InternalError : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "INTERNAL"; }
};

}  // namespace moldline
