//! The end: who asks for it, and how long what runs may take.

use std::{future::pending, time::Duration};

use moldline_service::Service;
use tokio::{signal, time};

/// Waits for SIGTERM or Ctrl-C.
pub async fn requested() {
    let interrupt = async {
        if let Err(error) = signal::ctrl_c().await {
            tracing::error!(%error, "cannot listen for ctrl-c");
            pending::<()>().await;
        }
    };
    #[cfg(unix)]
    let terminate = async {
        match signal::unix::signal(signal::unix::SignalKind::terminate()) {
            Ok(mut stream) => {
                stream.recv().await;
            }
            Err(error) => {
                tracing::error!(%error, "cannot listen for SIGTERM");
                pending::<()>().await;
            }
        }
    };
    #[cfg(not(unix))]
    let terminate = pending::<()>();
    tokio::select! {
        () = interrupt => {}
        () = terminate => {}
    }
}

/// Waits until nothing computes and answers have had time to leave. What is then still open are idle streams, such as a
/// health watch, which nobody needs to wait for.
pub async fn idle(service: &Service) {
    const POLL: Duration = Duration::from_millis(20);
    const LINGER: Duration = Duration::from_secs(1);
    let mut quiet = Duration::ZERO;
    while quiet < LINGER {
        time::sleep(POLL).await;
        quiet = if service.load() == 0 { quiet + POLL } else { Duration::ZERO };
    }
}
