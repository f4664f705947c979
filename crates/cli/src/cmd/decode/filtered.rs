//! Frames that a filter wants, and no others.

use polepair_capture::{Event, Filter};

use crate::capture::Sink;
use crate::problem::Result;

/// Passes on what its filter wants.
pub struct Filtered<'a> {
    filter: Filter,
    inner: Box<dyn Sink + 'a>,
}

impl<'a> Filtered<'a> {
    /// In front of `inner`.
    pub fn new(filter: Filter, inner: Box<dyn Sink + 'a>) -> Self {
        Self { filter, inner }
    }
}

impl Sink for Filtered<'_> {
    fn take(&mut self, event: &Event<'_>) {
        if self.filter.wants(event) {
            self.inner.take(event);
        } else {
            self.inner.skip(event);
        }
    }

    fn settle(&mut self, now: bool) -> Result<()> {
        self.inner.settle(now)
    }

    fn finish(&mut self) -> Result<()> {
        self.inner.finish()
    }

    fn ending(&mut self, event: &Event<'_>) {
        if self.filter.wants(event) {
            self.inner.ending(event);
        }
    }
}
