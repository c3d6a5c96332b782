//! Whether anybody still waits for a piece of work.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// A flag that the engine polls. It is set when the caller's [`Interest`] is dropped.
#[derive(Clone, Debug, Default)]
pub struct Cancellation(Arc<AtomicBool>);

impl Cancellation {
    /// Whether the work may stop, since nobody waits for it.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Held by a caller while it waits. A transport drops the waiting future when its client goes away or the deadline
/// passes, and this with it.
#[derive(Debug, Default)]
pub struct Interest(Cancellation);

impl Interest {
    /// The flag to hand to the work.
    pub fn cancellation(&self) -> Cancellation {
        self.0.clone()
    }
}

impl Drop for Interest {
    fn drop(&mut self) {
        self.0.0.store(true, Ordering::Relaxed);
    }
}
