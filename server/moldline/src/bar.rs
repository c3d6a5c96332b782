//! A progress bar on the terminal.

use indicatif::{ProgressBar, ProgressStyle};
use moldline_host::Progress;

/// A progress bar that shows one stage after the other; hidden if standard error is not a terminal.
pub struct Bar(ProgressBar);

impl Bar {
    /// Shows the bar.
    pub fn new() -> Self {
        /// Steps of a full bar.
        const STEPS: u64 = 100;
        let bar = ProgressBar::new(STEPS);
        if let Ok(style) = ProgressStyle::with_template("{msg:<50} {percent:>3}% {bar:30} {elapsed}") {
            bar.set_style(style);
        }
        Self(bar)
    }

    /// Shows a step.
    pub fn show(&self, progress: &Progress) {
        self.tell(progress.message.clone(), progress.fraction);
    }

    /// Shows a message and the completed fraction.
    pub fn tell(&self, message: String, fraction: f64) {
        self.0.set_message(message);
        self.0.set_position((fraction * 100.0) as u64);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
