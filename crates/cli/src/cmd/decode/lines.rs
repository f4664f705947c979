//! Frames as lines: text for people, JSON for programs.

use std::path::Path;

use polepair_capture::parallel::Maker;
use polepair_capture::{Batch, Decoder, Event, jsonl, text};

use crate::capture::{Sink, Source};
use crate::problem::Result;
use crate::terminal::{self, Output};

/// Writes a line a frame.
pub struct Lines {
    out: Output,
    text: Option<text::Text>,
    style: text::Style,
}

/// Writes the lines of batches, for others to hand them on.
struct Pen {
    text: Option<text::Text>,
    lines: Vec<u8>,
}

impl Maker for Pen {
    fn make(&mut self, batch: &Batch) {
        let Self { text, lines } = self;
        match text {
            Some(text) => text.write_batch(batch, lines),
            None => batch.each(&mut |event| jsonl::write(event, lines)),
        }
    }
}

impl Lines {
    /// One aligned line a frame. `style` says all but whether there are colours.
    pub fn text(path: Option<&Path>, style: text::Style) -> Result<Self> {
        let colour = path.is_none() && terminal::colour_out();
        let style = text::Style { colour, ..style };
        Ok(Self { out: Output::to(path)?, text: Some(text::Text::new(style)), style })
    }

    /// One JSON object a frame.
    pub fn jsonl(path: Option<&Path>) -> Result<Self> {
        Ok(Self { out: Output::to(path)?, text: None, style: text::Style::default() })
    }

    /// Writes a capture file, on several threads where no line hangs on those before.
    pub fn write(mut self, source: Source, path: &Path, jobs: usize) -> Result<Decoder> {
        let marks = self.style.colour || self.style.marks;
        let pen = || Pen {
            text: self.text.as_ref().map(|_| text::Text::new(self.style)),
            lines: Vec::new(),
        };
        let mut pens: Vec<Pen> = (0..if marks { 1 } else { jobs }).map(|_| pen()).collect();
        let out = &mut self.out;
        let mut decoder = source.read_by(path, &mut pens, &mut |pen| {
            // What is written leaves its room to the pen.
            std::mem::swap(out.buffer(), &mut pen.lines);
            out.flush()
        })?;
        decoder.ending(&mut |event| self.ending(event));
        self.finish()?;
        Ok(decoder)
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
