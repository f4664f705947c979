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
    /// One aligned line a frame. `style` says all but whether there are colours.
    pub fn text(path: Option<&Path>, style: text::Style) -> Result<Self> {
        let colour = path.is_none() && terminal::colour_out();
        let style = text::Style { colour, ..style };
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

    fn skip(&mut self, event: &Event<'_>) {
        if let Some(text) = &mut self.text {
            text.skip(event);
        }
    }

    fn ending(&mut self, event: &Event<'_>) {
        if let Some(text) = &mut self.text {
            text.ending(event, self.out.buffer());
        }
    }

    fn settle(&mut self, now: bool) -> Result<()> {
        if now { self.out.flush() } else { self.out.spill() }
    }
}
