//! Prints frames during a recording, on its own thread: a slow reader of stdout must not delay the
//! recording.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use polepair_capture::{CaptureDecoder, Record, Rules, text};

use crate::data_output::DataOutput;
use crate::problem::Result;
use crate::terminal;

/// Lines that wait for stdout, in bytes; further ones are not shown.
const WAITING_MAX: usize = 1 << 20;
/// Batches on their way to the thread.
const BATCHES: usize = 4;

/// The lines that are shown.
pub struct LivePrinter {
    decoder: CaptureDecoder,
    lines: text::FrameTextWriter,
    pending: Vec<u8>,
    skipped: u64,
    printer: Option<PrinterThread>,
}

struct PrinterThread {
    batches: SyncSender<Vec<u8>>,
    thread: JoinHandle<Result<()>>,
}

impl LivePrinter {
    /// Shows frames by these rules.
    pub fn new(rules: Rules) -> Self {
        let style =
            text::TextStyle { colour: terminal::colour_out(), ..text::TextStyle::default() };
        let (batches, receiver) = sync_channel(BATCHES);
        let thread = std::thread::spawn(|| print_batches(receiver));
        Self {
            decoder: CaptureDecoder::new(rules),
            lines: text::FrameTextWriter::new(style),
            pending: Vec::new(),
            skipped: 0,
            printer: Some(PrinterThread { batches, thread }),
        }
    }

    /// Explains a record.
    pub fn explain(&mut self, record: &Record<'_>) {
        if self.pending.len() >= WAITING_MAX {
            self.skipped += 1;
            return;
        }
        let (lines, waiting) = (&mut self.lines, &mut self.pending);
        self.decoder.decode_record(record, &mut |event| lines.write(event, waiting));
    }

    /// Hands over the explained frames, if the thread can take them.
    ///
    /// # Errors
    /// What ended the thread: stdout was closed.
    pub fn submit(&mut self) -> Result<()> {
        let Some(printer) = self.printer.as_ref().filter(|_| !self.pending.is_empty()) else {
            return Ok(());
        };
        match printer.batches.try_send(std::mem::take(&mut self.pending)) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(waiting)) => {
                self.pending = waiting;
                Ok(())
            }
            Err(TrySendError::Disconnected(_)) => self.join(),
        }
    }

    /// Waits until all is printed. Returns how many records were not.
    ///
    /// # Errors
    /// stdout was closed.
    pub fn finish(mut self) -> Result<u64> {
        if let Some(printer) = &self.printer {
            // One that is gone is met by the join.
            let _ = printer.batches.send(std::mem::take(&mut self.pending));
        }
        self.join()?;
        Ok(self.skipped)
    }

    fn join(&mut self) -> Result<()> {
        let Some(PrinterThread { batches, thread }) = self.printer.take() else { return Ok(()) };
        drop(batches);
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

fn print_batches(batches: Receiver<Vec<u8>>) -> Result<()> {
    let mut out = DataOutput::stdout();
    for batch in batches {
        *out.buffer() = batch;
        out.flush()?;
    }
    Ok(())
}
