//! How far long work is, on stderr, where a person looks and no data go.

use std::io::{self, IsTerminal as _};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use polepair_core::time::Instant;
use polepair_link::clock;

/// Work that takes no longer shows no bar.
const BAR_DELAY: Duration = Duration::from_millis(700);

/// How far a file was read.
pub struct ReadProgress {
    bar: ProgressBar,
    started_at: Instant,
    /// The bar may be seen, and is not yet.
    is_hidden: bool,
}

impl ReadProgress {
    /// Of so many bytes; `None` is never shown.
    pub fn of_bytes(bytes: Option<u64>) -> Self {
        let bar = ProgressBar::with_draw_target(bytes, ProgressDrawTarget::hidden());
        let form = "{bar:30} {bytes} of {total_bytes}, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(form) {
            bar.set_style(style);
        }
        Self {
            bar,
            started_at: clock::now(),
            is_hidden: bytes.is_some() && io::stderr().is_terminal(),
        }
    }

    /// So many bytes more were read.
    pub fn add(&mut self, bytes: usize) {
        self.bar.inc(bytes as u64);
        if self.is_hidden && clock::now().since(self.started_at) > BAR_DELAY {
            self.is_hidden = false;
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
    }
}

impl Drop for ReadProgress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// How many bytes were transferred, of a number that may not be known.
pub struct DataProgress {
    bar: ProgressBar,
    started_at: Instant,
    is_hidden: bool,
}

impl DataProgress {
    /// `verb` says what is done with the bytes: `read`, `written`.
    pub fn new(verb: &str) -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        let form = format!("{{spinner}} {{bytes}} {verb}, {{bytes_per_sec}}");
        if let Ok(style) = ProgressStyle::with_template(&form) {
            bar.set_style(style);
        }
        Self { bar, started_at: clock::now(), is_hidden: io::stderr().is_terminal() }
    }

    /// So many bytes in all.
    pub fn set(&mut self, bytes: usize) {
        self.bar.set_position(bytes as u64);
        if self.is_hidden && clock::now().since(self.started_at) > BAR_DELAY {
            self.is_hidden = false;
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
    }
}

impl Drop for DataProgress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
