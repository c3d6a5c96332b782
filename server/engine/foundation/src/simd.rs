//! Dispatch to the widest vector instructions of the processor.

use pulp::{Arch, NullaryFnOnce};

/// Runs an operation marked `#[inline(always)]` with the widest vector instructions of the processor.
///
/// The operation is called through `FnMut`: the `call_once` of a closure is a function of its own, which is not inlined and
/// would be compiled without these instructions.
#[inline(always)]
pub fn widest(operation: impl FnMut()) {
    struct Widest<F>(F);
    impl<F: FnMut()> NullaryFnOnce for Widest<F> {
        type Output = ();

        #[inline(always)]
        fn call(mut self) {
            (self.0)();
        }
    }
    Arch::new().dispatch(Widest(operation));
}
