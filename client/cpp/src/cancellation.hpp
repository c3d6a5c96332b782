// What a cancellation and the calls it ends share.
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
  /// Of the attempts under way.
  std::set<grpc::ClientContext*> contexts;
};

namespace internal {

/// An attempt that a cancellation, if there is one, may end.
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

/// Waits, unless it is cancelled before: then throws `Cancelled`.
void sleep(Seconds pause, const std::optional<Cancellation>& cancellation);

}  // namespace internal
}  // namespace moldline
