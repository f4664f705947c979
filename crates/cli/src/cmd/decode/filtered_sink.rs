//! A sink that passes on only the frames that match a filter.

use polepair_capture::{DecodedFrame, FrameFilter};

use crate::capture::EventSink;
use crate::problem::Result;

/// Passes on what its filter wants.
pub struct FilteredSink<'a> {
    filter: FrameFilter,
    inner: Box<dyn EventSink + 'a>,
}

impl<'a> FilteredSink<'a> {
    /// Creates a filter in front of `inner`.
    pub fn new(filter: FrameFilter, inner: Box<dyn EventSink + 'a>) -> Self {
        Self { filter, inner }
    }
}

impl EventSink for FilteredSink<'_> {
    fn handle_event(&mut self, event: &DecodedFrame<'_>) {
        if self.filter.matches(event) {
            self.inner.handle_event(event);
        } else {
            self.inner.skip_event(event);
        }
    }

    fn flush(&mut self, now: bool) -> Result<()> {
        self.inner.flush(now)
    }

    fn finish(&mut self) -> Result<()> {
        self.inner.finish()
    }

    fn handle_final(&mut self, event: &DecodedFrame<'_>) {
        if self.filter.matches(event) {
            self.inner.handle_final(event);
        }
    }
}
