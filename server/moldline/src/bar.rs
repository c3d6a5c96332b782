//! A progress bar, where there is a terminal to see it.

use indicatif::{ProgressBar, ProgressStyle};
use moldline_service::Progress;

/// One bar that shows each stage in turn; nothing where standard error is no terminal.
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

    /// Shows how far work has come that is described by a message.
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
