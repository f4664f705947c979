//! One capture on several threads. Each takes a piece of it and goes all the way with that: finds its
//! lines, waits until the pieces before are decoded, decodes its own, makes of it whatever is wanted,
//! waits again, and hands it over. So what conversations know goes through the capture in order, all
//! else side by side, and nobody has more than one piece in hand.
//!
//! Why: DEC-5.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use crate::batch::Batch;
use crate::decoder::Decoder;
use crate::read::Scan;

/// Threads that are of use: more would take more memory than they should.
pub const JOBS_MAX: usize = 8;

/// Makes something of batches.
pub trait Maker: Send {
    /// Bytes of one piece, nearly. What a thread makes of it should fit into its core's own cache:
    /// with longer pieces several threads took more processor time, likely for the cache they share.
    const PIECE: usize = 1 << 17;

    /// Takes a batch, whose turn to be handed over comes later.
    fn make(&mut self, batch: &Batch);
}

/// Appends up to so many bytes of the capture; none at its end.
pub type Fill<'a, E> = &'a mut (dyn FnMut(&mut Vec<u8>, usize) -> Result<(), E> + Send);
/// Hands over what was made since the last time.
pub type Put<'a, M, E> = &'a mut (dyn FnMut(&mut M) -> Result<(), E> + Send);

/// Decodes a capture to its end, with a thread for each of `makers`. The order in which they hand
/// over is that of the capture, and what they make hangs on how the capture is cut alone, which is
/// always the same.
///
/// # Errors
/// The first one of `fill` or `put`; nothing is read or handed over after it.
pub fn decode<M: Maker, E: Send>(
    decoder: &mut Decoder,
    makers: &mut [M],
    fill: Fill<'_, E>,
    put: Put<'_, M, E>,
) -> Result<(), E> {
    let Some((first, others)) = makers.split_first_mut() else { return Ok(()) };
    let hall = Hall {
        source: Mutex::new(Source { fill, rest: Vec::new(), next: 0, ended: false }),
        decoder: Turns::new(decoder),
        put: Turns::new(put),
        over: AtomicBool::new(false),
        failed: Mutex::new(None),
    };
    std::thread::scope(|scope| {
        for maker in others {
            scope.spawn(|| hall.work(maker));
        }
        hall.work(first);
    });
    let Hall { decoder, put, failed, .. } = hall;
    let mut failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    let (decoder, put) = (decoder.end(), put.end());
    if failed.is_none() {
        let (mut batch, mut error) = (Batch::default(), None);
        let mut give = |batch: &mut Batch| {
            first.make(batch);
            error = error.take().or_else(|| put(first).err());
        };
        decoder.gather_rest(&mut batch, &mut give);
        give(&mut batch);
        failed = error;
    }
    failed.map_or(Ok(()), Err)
}

/// Where the threads meet.
struct Hall<'a, M, E> {
    source: Mutex<Source<'a, E>>,
    decoder: Turns<&'a mut Decoder>,
    put: Turns<Put<'a, M, E>>,
    /// Something failed: all go home.
    over: AtomicBool,
    failed: Mutex<Option<E>>,
}

/// The capture as it is cut.
struct Source<'a, E> {
    fill: Fill<'a, E>,
    /// What follows the last end of a line.
    rest: Vec<u8>,
    /// The number of the next piece.
    next: u64,
    ended: bool,
}

/// What a thread has in hand.
#[derive(Default)]
struct Hand {
    piece: Vec<u8>,
    scan: Scan,
    batch: Batch,
}

impl<E> Source<'_, E> {
    /// The next piece, which ends where a line does if it can, and its number.
    fn next(&mut self, piece: &mut Vec<u8>, most: usize) -> Result<Option<u64>, E> {
        piece.clear();
        piece.append(&mut self.rest);
        while piece.len() < most && !self.ended {
            let before = piece.len();
            (self.fill)(piece, most - before)?;
            self.ended = piece.len() == before;
        }
        if let Some(newline) = memchr::memrchr(b'\n', piece).filter(|_| !self.ended) {
            self.rest.extend_from_slice(&piece[newline + 1..]);
            piece.truncate(newline + 1);
        }
        self.next += 1;
        Ok((!piece.is_empty()).then_some(self.next - 1))
    }
}

impl<M: Maker, E> Hall<'_, M, E> {
    /// Goes with piece after piece until there are no more.
    fn work(&self, maker: &mut M) {
        let mut hand = Hand::default();
        // Whoever falls must not leave the others waiting.
        let _careful = Careful(self);
        while self.go(&mut hand, maker).is_some() {}
    }

    /// Goes with one piece; `None` when there is none, or all is over.
    fn go(&self, Hand { piece, scan, batch }: &mut Hand, maker: &mut M) -> Option<()> {
        let read = self.source.lock().ok()?.next(piece, M::PIECE);
        let number = self.well(read)??;
        scan.read(piece);
        let mut decoder = self.decoder.wait(number, &self.over)?;
        let mut full = |batch: &mut Batch| {
            maker.make(batch);
            // Nobody behind is decoded yet, and those before need nothing for that.
            let put = self.put.wait(number, &self.over);
            if put.and_then(|mut put| self.well((put.1)(maker))).is_none() {
                batch.stop();
            }
        };
        decoder.1.gather_lines(piece, scan, batch, &mut full);
        self.decoder.pass(decoder);
        maker.make(batch);
        let mut put = self.put.wait(number, &self.over)?;
        self.well((put.1)(maker))?;
        self.put.pass(put);
        Some(())
    }

    /// What came out well; else all is over.
    fn well<T>(&self, result: Result<T, E>) -> Option<T> {
        let error = match result {
            Ok(value) => return Some(value),
            Err(error) => error,
        };
        self.failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        self.over.store(true, Ordering::SeqCst);
        None
    }

    /// Everybody looks up.
    fn call(&self) {
        self.over.store(true, Ordering::SeqCst);
        self.decoder.call();
        self.put.call();
    }
}

/// Calls the others when a thread ends otherwise than with the capture.
struct Careful<'a, 'b, M: Maker, E>(&'a Hall<'b, M, E>);

impl<M: Maker, E> Drop for Careful<'_, '_, M, E> {
    fn drop(&mut self) {
        if std::thread::panicking() || self.0.over.load(Ordering::SeqCst) {
            self.0.call();
        }
    }
}

/// Something that is used piece by piece, in the order of the pieces.
struct Turns<T> {
    /// Whose turn it is.
    turn: Mutex<(u64, T)>,
    passed: Condvar,
}

impl<T> Turns<T> {
    fn new(of: T) -> Self {
        Self { turn: Mutex::new((0, of)), passed: Condvar::new() }
    }

    /// Waits for the turn of a piece; `None` when all is over.
    fn wait(&self, number: u64, over: &AtomicBool) -> Option<MutexGuard<'_, (u64, T)>> {
        let turn = self.turn.lock().ok()?;
        let early = |turn: &mut (u64, T)| turn.0 != number && !over.load(Ordering::SeqCst);
        let turn = self.passed.wait_while(turn, early).ok()?;
        (turn.0 == number && !over.load(Ordering::SeqCst)).then_some(turn)
    }

    fn pass(&self, mut turn: MutexGuard<'_, (u64, T)>) {
        turn.0 += 1;
        drop(turn);
        self.passed.notify_all();
    }

    /// Wakes all who wait.
    fn call(&self) {
        drop(self.turn.lock());
        self.passed.notify_all();
    }

    fn end(self) -> T {
        self.turn.into_inner().unwrap_or_else(PoisonError::into_inner).1
    }
}

#[cfg(test)]
mod tests;
