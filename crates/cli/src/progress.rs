//! Progress bars on stderr, only on a terminal.

use std::io::{self, IsTerminal as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use polepair_core::time::Instant;
use polepair_link::clock;

use crate::terminal;

/// Work that takes no longer shows no bar.
const BAR_DELAY: Duration = Duration::from_millis(700);

/// A progress bar. It is shown on a terminal, where work takes longer, and not with `--quiet`; it is
/// cleared when it is dropped.
pub struct Progress {
    bar: ProgressBar,
    started_at: Instant,
    /// The bar may be seen, and is not yet.
    is_hidden: AtomicBool,
}

impl Progress {
    /// Progress in a file of `bytes` bytes.
    pub fn of_file(bytes: u64) -> Self {
        Self::new(Some(bytes), "{bar:30} {bytes} of {total_bytes}, {eta} left")
    }

    /// Progress of a transfer of unknown size. `verb` names the action on its bytes: `read`, `written`.
    pub fn of_transfer(verb: &str) -> Self {
        Self::new(None, &format!("{{spinner}} {{bytes}} {verb}, {{bytes_per_sec}}"))
    }

    /// Progress of `count` things, whose name is in the plural: `addresses`, `words`.
    pub fn of_count(count: usize, things: &str) -> Self {
        let form = format!("{{bar:30}} {{pos}} of {{len}} {things}, {{eta}} left");
        Self::new(Some(count as u64), &form)
    }

    /// A hidden bar.
    pub fn hidden() -> Self {
        Self {
            bar: ProgressBar::hidden(),
            started_at: clock::now(),
            is_hidden: AtomicBool::new(false),
        }
    }

    fn new(length: Option<u64>, form: &str) -> Self {
        let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::hidden());
        if let Ok(style) = ProgressStyle::with_template(form) {
            bar.set_style(style);
        }
        let is_hidden = AtomicBool::new(io::stderr().is_terminal() && !terminal::is_quiet());
        Self { bar, started_at: clock::now(), is_hidden }
    }

    /// Adds `more` to the progress.
    pub fn add(&self, more: usize) {
        self.bar.inc(more as u64);
        self.show_after_delay();
    }

    /// Sets the progress.
    pub fn set(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.show_after_delay();
    }

    /// Sets the progress and the total.
    pub fn set_of(&self, done: usize, of: usize) {
        self.bar.set_length(of as u64);
        self.set(done);
    }

    /// Prints something else meanwhile.
    #[cfg(feature = "tables")]
    pub fn suspend(&self, print: impl FnOnce()) {
        self.bar.suspend(print);
    }

    fn show_after_delay(&self) {
        let is_late = clock::now().since(self.started_at) > BAR_DELAY;
        if is_late && self.is_hidden.swap(false, Ordering::Relaxed) {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
