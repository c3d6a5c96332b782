//! Waiting for a state that comes by itself.

use std::time::{Duration, Instant};

/// Pause between two attempts.
const PAUSE: Duration = Duration::from_millis(1);
/// Longest wait.
const LIMIT: Duration = Duration::from_secs(60);

/// Polls `attempt` until it gives a value.
///
/// # Panics
/// If there is no value within a minute; `what` says what was waited for.
pub async fn eventually<T>(what: &str, mut attempt: impl AsyncFnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + LIMIT;
    loop {
        if let Some(value) = attempt().await {
            return value;
        }
        assert!(Instant::now() < deadline, "no {what} within {LIMIT:?}");
        tokio::time::sleep(PAUSE).await;
    }
}
