//! Output of `decode` as lines: text or JSON.

use std::path::Path;

use polepair_capture::parallel::BatchConsumer;
use polepair_capture::{CaptureDecoder, DecodedFrame, FrameBatch, jsonl, text};

use crate::capture::{CaptureSource, EventSink, check_readable};
use crate::data_output::DataOutput;
use crate::problem::Result;

/// Writes a line a frame.
pub struct LineSink {
    out: DataOutput,
    text: Option<text::FrameTextWriter>,
    style: text::TextStyle,
}

/// Writes the lines of batches, for others to hand them on.
struct LineFormatter {
    text: Option<text::FrameTextWriter>,
    lines: Vec<u8>,
}

impl BatchConsumer for LineFormatter {
    fn consume(&mut self, batch: &FrameBatch) {
        let Self { text, lines } = self;
        match text {
            Some(text) => text.write_batch(batch, lines),
            None => batch.for_each_frame(&mut |event| jsonl::write_frame(event, lines)),
        }
    }
}

impl LineSink {
    /// One aligned line a frame.
    pub fn text(out: DataOutput, style: text::TextStyle) -> Self {
        Self { out, text: Some(text::FrameTextWriter::new(style)), style }
    }

    /// One JSON object a frame.
    pub fn jsonl(out: DataOutput) -> Self {
        Self { out, text: None, style: text::TextStyle::default() }
    }

    /// Writes a capture file, on several threads where no line hangs on those before.
    pub fn write_file(
        mut self,
        source: CaptureSource,
        path: &Path,
        jobs: usize,
    ) -> Result<CaptureDecoder> {
        let marks = self.style.colour || self.style.marks;
        // Lines of text have values on request alone, lines of JSON always.
        let with_signals = self.text.is_none() || self.style.notices == text::NoticeLevel::All;
        let source = if with_signals { source } else { source.without_signals() };
        let pen = || LineFormatter {
            text: self.text.as_ref().map(|_| text::FrameTextWriter::new(self.style)),
            lines: Vec::new(),
        };
        let mut pens: Vec<LineFormatter> =
            (0..if marks { 1 } else { jobs }).map(|_| pen()).collect();
        let out = &mut self.out;
        let mut decoder = source.decode_parallel(path, &mut pens, &mut |pen| {
            // The buffer that was written goes back to the pen, which spares an allocation.
            std::mem::swap(out.buffer(), &mut pen.lines);
            out.flush()
        })?;
        decoder.finish_sessions(&mut |event| self.handle_final(event));
        match check_readable(decoder.statistics()) {
            Ok(_) => self.finish()?,
            Err(_) => self.flush(true)?,
        }
        Ok(decoder)
    }
}

impl EventSink for LineSink {
    fn handle_event(&mut self, event: &DecodedFrame<'_>) {
        match &mut self.text {
            Some(text) => text.write(event, self.out.buffer()),
            None => jsonl::write_frame(event, self.out.buffer()),
        }
    }

    fn skip_event(&mut self, event: &DecodedFrame<'_>) {
        if let Some(text) = &mut self.text {
            text.skip_frame(event);
        }
    }

    fn handle_final(&mut self, event: &DecodedFrame<'_>) {
        if let Some(text) = &mut self.text {
            text.write_open_notices(event, self.out.buffer());
        }
    }

    fn flush(&mut self, now: bool) -> Result<()> {
        if now { self.out.flush() } else { self.out.flush_if_full() }
    }

    fn finish(&mut self) -> Result<()> {
        self.out.finish()
    }
}
