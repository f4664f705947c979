//! Frames as lines: text for people, JSON for programs.

use std::path::Path;

use polepair_capture::{Event, jsonl, text};

use crate::capture::Sink;
use crate::problem::Result;
use crate::terminal::{self, Output};

/// Writes a line a frame.
pub struct Lines {
    out: Output,
    text: Option<text::Text>,
}

impl Lines {
    /// One aligned line a frame.
    pub fn text(path: Option<&Path>) -> Result<Self> {
        let style = text::Style { colour: path.is_none() && terminal::colour_out() };
        Ok(Self { out: Output::to(path)?, text: Some(text::Text::new(style)) })
    }

    /// One JSON object a frame.
    pub fn jsonl(path: Option<&Path>) -> Result<Self> {
        Ok(Self { out: Output::to(path)?, text: None })
    }
}

impl Sink for Lines {
    fn take(&mut self, event: &Event<'_>) {
        match &mut self.text {
            Some(text) => text.write(event, self.out.buffer()),
            None => jsonl::write(event, self.out.buffer()),
        }
    }

    fn settle(&mut self, now: bool) -> Result<()> {
        if now { self.out.flush() } else { self.out.spill() }
    }
}
