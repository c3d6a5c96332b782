//! The end: who asks for it, and how long what runs may take.

use std::{io, time::Duration};

use tokio::{signal, time};

/// SIGTERM and Ctrl-C, caught from the moment this exists.
#[cfg(unix)]
pub struct Signals {
    interrupt: signal::unix::Signal,
    terminate: signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    /// Catches them.
    pub fn catch() -> io::Result<Self> {
        use signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    /// Waits for either.
    pub async fn requested(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

/// Ctrl-C, caught from the moment this exists.
#[cfg(windows)]
pub struct Signals(signal::windows::CtrlC);

#[cfg(windows)]
impl Signals {
    /// Catches it.
    pub fn catch() -> io::Result<Self> {
        Ok(Self(signal::windows::ctrl_c()?))
    }

    /// Waits for it.
    pub async fn requested(&mut self) {
        self.0.recv().await;
    }
}

/// Waits until nothing computes and answers have had time to leave. What is then still open are idle streams, such as a
/// health watch, which nobody needs to wait for.
pub async fn idle(load: &(dyn Fn() -> usize + Send + Sync)) {
    const POLL: Duration = Duration::from_millis(20);
    const LINGER: Duration = Duration::from_secs(1);
    let mut quiet = Duration::ZERO;
    while quiet < LINGER {
        time::sleep(POLL).await;
        quiet = if load() == 0 { quiet + POLL } else { Duration::ZERO };
    }
}
