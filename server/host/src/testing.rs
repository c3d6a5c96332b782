//! Helpers of tests.
#![allow(clippy::expect_used, reason = "helpers of tests may panic")]

use std::time::Duration;

/// Waits until `condition` holds, 30 s at most.
pub async fn eventually(condition: impl Fn() -> bool) {
    let wait = async {
        while !condition() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(30), wait).await.expect("the condition never holds");
}
