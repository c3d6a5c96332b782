//! The signals that request a shutdown or a reload, and the wait for what runs.

use std::{io, time::Duration};

use tokio::{signal, time};

/// SIGTERM, SIGHUP and Ctrl-C, caught as long as this value exists.
#[cfg(unix)]
pub struct Signals {
    interrupt: signal::unix::Signal,
    terminate: signal::unix::Signal,
    hang_up: signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    /// Starts to catch the signals.
    pub fn catch() -> io::Result<Self> {
        use signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: signal(SignalKind::hangup())?,
        })
    }

    /// Waits for a signal to stop; SIGHUP calls `reload`.
    pub async fn requested(&mut self, reload: impl Fn()) {
        loop {
            tokio::select! {
                _ = self.interrupt.recv() => return,
                _ = self.terminate.recv() => return,
                _ = self.hang_up.recv() => reload(),
            }
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
    pub async fn requested(&mut self, _: impl Fn()) {
        self.0.recv().await;
    }
}

/// Waits until `idle` has held for a moment.
pub async fn lasting(idle: impl Fn() -> bool) {
    const POLL: Duration = Duration::from_millis(20);
    const LINGER: Duration = Duration::from_secs(1);
    let mut quiet = Duration::ZERO;
    while quiet < LINGER {
        time::sleep(POLL).await;
        quiet = if idle() { quiet + POLL } else { Duration::ZERO };
    }
}
