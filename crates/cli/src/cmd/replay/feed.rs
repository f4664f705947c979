//! Reads a capture a little ahead of its replay.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use polepair_capture::{CaptureDecoder, DecodedFrame};

use super::selector::{FrameSelector, ReplayFrame};
use crate::capture::read_pieces;
use crate::problem::{Problem, Result};

/// Batches of a wire that wait to be played; one is what a piece of the file holds.
const BATCHES: usize = 4;

/// Capture to read, and the number of passes.
pub struct CaptureFeed {
    pub path: PathBuf,
    pub selector: FrameSelector,
    /// Makes a fresh decoder for each time.
    pub make_decoder: Box<dyn Fn() -> CaptureDecoder + Send>,
    /// `None` is without end.
    pub times: Option<u64>,
    /// From the beginning of one time to that of the next, ns.
    pub period: u64,
}

/// The frames of a wire, in order.
pub type FrameBatches = Receiver<Vec<ReplayFrame>>;

impl CaptureFeed {
    /// Begins to read. The thread ends with the capture, or when a wire takes no more.
    pub fn start(self, wires: usize) -> (JoinHandle<Result<()>>, Vec<FrameBatches>) {
        let (senders, items) = (0..wires).map(|_| sync_channel(BATCHES)).unzip();
        (std::thread::spawn(move || self.read_all(senders)), items)
    }

    fn read_all(self, wires: Vec<SyncSender<Vec<ReplayFrame>>>) -> Result<()> {
        let times = (0..).take_while(|time| self.times.is_none_or(|times| *time < times));
        for time in times {
            let begin = self.period.saturating_mul(time);
            match self.read_once(begin, &wires) {
                Ok(true) => {}
                // The player that ended it has the reason.
                Ok(false) => return Ok(()),
                Err(problem) => return Err(problem),
            }
        }
        Ok(())
    }

    /// Reads the capture once; `false` if no wire takes frames any more.
    fn read_once(&self, begin: u64, wires: &[SyncSender<Vec<ReplayFrame>>]) -> Result<bool> {
        let (mut decoder, mut choice) = ((self.make_decoder)(), self.selector.clone());
        let mut batches: Vec<Vec<ReplayFrame>> = wires.iter().map(|_| Vec::new()).collect();
        let mut accepted = true;
        let mut keep = |event: &DecodedFrame<'_>, batches: &mut Vec<Vec<ReplayFrame>>| {
            if let Ok(item) = choice.select(event) {
                batches[item.wire].push(ReplayFrame { at: begin + item.at, ..item });
            }
        };
        let read = read_pieces(&self.path, false, &mut |piece| {
            decoder.feed(piece, &mut |event| keep(event, &mut batches));
            accepted = send_batches(&mut batches, wires);
            if accepted { Ok(()) } else { Err(Problem::interrupted()) }
        });
        if !accepted {
            return Ok(false);
        }
        read?;
        decoder.finish(&mut |event| keep(event, &mut batches));
        Ok(send_batches(&mut batches, wires))
    }
}

fn send_batches(batches: &mut [Vec<ReplayFrame>], wires: &[SyncSender<Vec<ReplayFrame>>]) -> bool {
    let mut pairs = batches.iter_mut().zip(wires).filter(|(batch, _)| !batch.is_empty());
    pairs.all(|(batch, wire)| wire.send(std::mem::take(batch)).is_ok())
}
