//! Shutdown: the signals that request it, and the wait for running requests.

use std::{io, time::Duration};

use tokio::{signal, time};

/// SIGTERM and Ctrl-C, caught as long as this value exists.
#[cfg(unix)]
pub struct Signals {
    interrupt: signal::unix::Signal,
    terminate: signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    /// Starts to catch the signals.
    pub fn catch() -> io::Result<Self> {
        use signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    /// Waits for a signal.
    pub async fn requested(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

/// Ctrl-C, caught as long as this value exists.
#[cfg(windows)]
pub struct Signals(signal::windows::CtrlC);

#[cfg(windows)]
impl Signals {
    /// Starts to catch the signal.
    pub fn catch() -> io::Result<Self> {
        Ok(Self(signal::windows::ctrl_c()?))
    }

    /// Waits for the signal.
    pub async fn requested(&mut self) {
        self.0.recv().await;
    }
}

/// Waits until no request computes and answers have had time to leave. Streams that are still open then are idle, such as a
/// health watch, and can be cut.
pub async fn idle(load: &(dyn Fn() -> usize + Send + Sync)) {
    const POLL: Duration = Duration::from_millis(20);
    const LINGER: Duration = Duration::from_secs(1);
    let mut quiet = Duration::ZERO;
    while quiet < LINGER {
        time::sleep(POLL).await;
        quiet = if load() == 0 { quiet + POLL } else { Duration::ZERO };
    }
}
