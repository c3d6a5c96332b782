//! Cancellation of work whose caller has gone.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use crate::error::{Code, ServiceError};

/// A flag that the engine polls. It is set when the caller's [`Interest`] is dropped.
#[derive(Clone, Debug, Default)]
pub struct Cancellation(Arc<AtomicBool>);

impl Cancellation {
    /// Whether the work should stop, since its caller no longer waits for it.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Ends work between its steps.
    ///
    /// # Errors
    /// `Cancelled` if it should stop.
    pub fn check(&self) -> Result<(), ServiceError> {
        if self.requested() { Err(ServiceError::new(Code::Cancelled, "cancelled")) } else { Ok(()) }
    }
}

/// A caller's interest in work, held while it waits. A transport drops the waiting future, and this with it, when its client
/// disconnects or the deadline passes.
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
