//! A capture read while it is played, a little ahead of it.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use polepair_capture::{Decoder, Event};

use super::choose::{Choice, Item};
use crate::capture::pieces;
use crate::problem::{Problem, Result};

/// Batches of a wire that wait to be played; one is what a piece of the file holds.
const BATCHES: usize = 4;

/// What is read, and how often.
pub struct Feed {
    pub path: PathBuf,
    pub choice: Choice,
    /// Makes a fresh decoder for each time.
    pub decoder: Box<dyn Fn() -> Decoder + Send>,
    /// `None` is without end.
    pub times: Option<u64>,
    /// From the beginning of one time to that of the next, ns.
    pub period: u64,
}

/// The frames of a wire, in order.
pub type Items = Receiver<Vec<Item>>;

impl Feed {
    /// Begins to read. The thread ends with the capture, or when a wire takes no more.
    pub fn start(self, wires: usize) -> (JoinHandle<Result<()>>, Vec<Items>) {
        let (senders, items) = (0..wires).map(|_| sync_channel(BATCHES)).unzip();
        (std::thread::spawn(move || self.run(senders)), items)
    }

    fn run(self, wires: Vec<SyncSender<Vec<Item>>>) -> Result<()> {
        let times = (0..).take_while(|time| self.times.is_none_or(|times| *time < times));
        for time in times {
            let begin = self.period.saturating_mul(time);
            match self.once(begin, &wires) {
                Ok(true) => {}
                // Whoever ended the playing says why.
                Ok(false) => return Ok(()),
                Err(problem) => return Err(problem),
            }
        }
        Ok(())
    }

    /// `false` when nobody takes frames any more.
    fn once(&self, begin: u64, wires: &[SyncSender<Vec<Item>>]) -> Result<bool> {
        let (mut decoder, mut choice) = ((self.decoder)(), self.choice.clone());
        let mut batches: Vec<Vec<Item>> = wires.iter().map(|_| Vec::new()).collect();
        let mut taken = true;
        let mut keep = |event: &Event<'_>, batches: &mut Vec<Vec<Item>>| {
            if let Ok(item) = choice.take(event) {
                batches[item.wire].push(Item { at: begin + item.at, ..item });
            }
        };
        let read = pieces(&self.path, false, &mut |piece| {
            decoder.feed(piece, &mut |event| keep(event, &mut batches));
            taken = hand_over(&mut batches, wires);
            if taken { Ok(()) } else { Err(Problem::interrupted()) }
        });
        if !taken {
            return Ok(false);
        }
        read?;
        decoder.finish(&mut |event| keep(event, &mut batches));
        Ok(hand_over(&mut batches, wires))
    }
}

fn hand_over(batches: &mut [Vec<Item>], wires: &[SyncSender<Vec<Item>>]) -> bool {
    let mut pairs = batches.iter_mut().zip(wires).filter(|(batch, _)| !batch.is_empty());
    pairs.all(|(batch, wire)| wire.send(std::mem::take(batch)).is_ok())
}
