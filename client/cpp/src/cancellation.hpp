// State shared by a cancellation and the calls that it ends.
#pragma once

#include <grpcpp/client_context.h>

#include <condition_variable>
#include <mutex>
#include <set>

#include "moldline/client.hpp"

namespace moldline {

struct Cancellation::State {
  std::mutex mutex;
  std::condition_variable changed;
  bool cancelled = false;
  /// Contexts of running attempts.
  std::set<grpc::ClientContext*> contexts;
};

namespace internal {

/// Registers an attempt with a cancellation, if any, that may end it.
class Cancellable {
 public:
  Cancellable(const std::optional<Cancellation>& cancellation, grpc::ClientContext& context);
  ~Cancellable();
  Cancellable(const Cancellable&) = delete;
  Cancellable& operator=(const Cancellable&) = delete;

 private:
  Cancellation::State* state_;
  grpc::ClientContext& context_;
};

/// Sleeps; throws `Cancelled` if cancelled meanwhile.
void sleep(Seconds pause, const std::optional<Cancellation>& cancellation);

}  // namespace internal
}  // namespace moldline
