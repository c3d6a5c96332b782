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
  /// What is wrong with it: index, value, limit and the way out.
  std::string description;
};

/// A request failed. What is thrown is always one of the classes below.
class Error : public std::runtime_error {
 public:
  Error(const std::string& message, std::vector<FieldViolation> violations, std::optional<Seconds> retry_after)
      : std::runtime_error(message), violations_(std::move(violations)), retry_after_(retry_after) {}

  /// The class as a word, the same on the wire and in all languages, such as `INVALID_ARGUMENT`.
  virtual const char* code() const noexcept = 0;
  /// The faults of the request, if it is the request's fault.
  const std::vector<FieldViolation>& violations() const noexcept { return violations_; }
  /// After which trying again may help, if it may.
  std::optional<Seconds> retry_after() const noexcept { return retry_after_; }

 private:
  std::vector<FieldViolation> violations_;
  std::optional<Seconds> retry_after_;
};

/// The request is wrong whatever the state of the server.
class InvalidArgument : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "INVALID_ARGUMENT"; }
};

/// There is no set-up or session of that id that the caller may see, or no linearisation any more for a bare id.
class NotFound : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "NOT_FOUND"; }
};

/// The request id named a request with other content before.
class AlreadyExists : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "ALREADY_EXISTS"; }
};

/// Somebody else was faster: the session has another generation than was expected. Read it again.
class Aborted : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "ABORTED"; }
};

/// The server does not know who this is: the token is missing, unknown or has expired.
class Unauthenticated : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "UNAUTHENTICATED"; }
};

/// The server knows who this is, and that this is not theirs to do.
class PermissionDenied : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "PERMISSION_DENIED"; }
};

/// The design is valid, but the mesh cannot follow it: a seam is lost, or a projection does not converge.
class FailedPrecondition : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "FAILED_PRECONDITION"; }
};

/// The server is full, or a quota is; where trying again may help, `retry_after` says when.
class ResourceExhausted : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "RESOURCE_EXHAUSTED"; }
};

/// A message is larger than the server or the client accepts.
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

/// The call took longer than its timeout.
class DeadlineExceeded : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "DEADLINE_EXCEEDED"; }
};

/// The server cannot be reached, or is about to stop.
class Unavailable : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "UNAVAILABLE"; }
};

/// A fault of the server, or an answer that cannot be understood.
class InternalError : public Error {
 public:
  using Error::Error;
  const char* code() const noexcept override { return "INTERNAL"; }
};

}  // namespace moldline
