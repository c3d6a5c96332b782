#include "cancellation.hpp"

#include <thread>

#include "moldline/errors.hpp"

namespace moldline {

Cancellation::Cancellation() : state_(std::make_shared<State>()) {}

void Cancellation::cancel() const {
  const std::lock_guard lock(state_->mutex);
  state_->cancelled = true;
  for (grpc::ClientContext* context : state_->contexts) context->TryCancel();
  state_->changed.notify_all();
}

namespace internal {

Cancellable::Cancellable(const std::optional<Cancellation>& cancellation, grpc::ClientContext& context)
    : state_(cancellation ? cancellation->state().get() : nullptr), context_(context) {
  if (state_ == nullptr) return;
  const std::lock_guard lock(state_->mutex);
  state_->contexts.insert(&context_);
  // Cancelling a context before its call starts ends the call immediately.
  if (state_->cancelled) context_.TryCancel();
}

Cancellable::~Cancellable() {
  if (state_ == nullptr) return;
  const std::lock_guard lock(state_->mutex);
  state_->contexts.erase(&context_);
}

void sleep(Seconds pause, const std::optional<Cancellation>& cancellation) {
  if (!cancellation) {
    std::this_thread::sleep_for(pause);
    return;
  }
  Cancellation::State& state = *cancellation->state();
  std::unique_lock lock(state.mutex);
  if (state.changed.wait_for(lock, pause, [&] { return state.cancelled; })) {
    throw Cancelled("the call was cancelled before it was tried again", {}, std::nullopt);
  }
}

}  // namespace internal
}  // namespace moldline
