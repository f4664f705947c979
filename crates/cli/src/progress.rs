//! How far long work is, on stderr, where a person looks and no data go.

use std::io::{self, IsTerminal as _};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use polepair_core::time::Instant;
use polepair_link::clock;

/// Work that takes no longer shows no bar.
const PATIENCE: Duration = Duration::from_millis(700);

/// How far a file was read.
pub struct Progress {
    bar: ProgressBar,
    began: Instant,
    /// The bar may be seen, and is not yet.
    waits: bool,
}

impl Progress {
    /// Of so many bytes; `None` is never shown.
    pub fn of(bytes: Option<u64>) -> Self {
        let bar = ProgressBar::with_draw_target(bytes, ProgressDrawTarget::hidden());
        let form = "{bar:30} {bytes} of {total_bytes}, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(form) {
            bar.set_style(style);
        }
        Self { bar, began: clock::now(), waits: bytes.is_some() && io::stderr().is_terminal() }
    }

    /// So many bytes more were read.
    pub fn add(&mut self, bytes: usize) {
        self.bar.inc(bytes as u64);
        if self.waits && clock::now().since(self.began) > PATIENCE {
            self.waits = false;
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
