//! Helpers of tests.

use std::time::{Duration, Instant};

/// Polls `attempt` until it returns a value, for a minute at most; `what` is the value waited for.
pub async fn eventually<T>(what: &str, mut attempt: impl AsyncFnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(value) = attempt().await {
            return value;
        }
        assert!(start.elapsed() < Duration::from_secs(60), "no {what} within a minute");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}
