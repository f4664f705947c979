//! Decodes one capture on several threads. Each thread processes a piece completely: it finds the lines,
//! waits until the earlier pieces are decoded, decodes, formats, waits again, and outputs. So the state of
//! conversations passes through the capture in order, and everything else runs in parallel. A thread has
//! one piece at a time.
//!
//! Why: DEC-5.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use crate::batch::FrameBatch;
use crate::decoder::CaptureDecoder;
use crate::read::LineScan;

/// Threads that are of use: more would take more memory than they should.
pub const JOBS_MAX: usize = 8;

/// Makes something of batches.
pub trait BatchConsumer: Send {
    /// Bytes of one piece, nearly. What a thread makes of it should fit into its core's own cache:
    /// with longer pieces several threads took more processor time, likely for the cache they share.
    const CHUNK_BYTES: usize = 1 << 17;

    /// Takes a batch, whose turn to be handed over comes later.
    fn consume(&mut self, batch: &FrameBatch);
}

/// Appends up to this many bytes of the capture; none at its end.
pub type FillCallback<'a, E> = &'a mut (dyn FnMut(&mut Vec<u8>, usize) -> Result<(), E> + Send);
/// Hands over the output since the last call.
pub type OutputCallback<'a, M, E> = &'a mut (dyn FnMut(&mut M) -> Result<(), E> + Send);

/// Decodes a capture to its end, with a thread for each of `makers`. The order in which they hand
/// over is that of the capture, and the output depends only on how the capture is cut, which is
/// always the same.
///
/// # Errors
/// The first one of `fill` or `put`; nothing is read or handed over after it.
pub fn decode<M: BatchConsumer, E: Send>(
    decoder: &mut CaptureDecoder,
    makers: &mut [M],
    fill: FillCallback<'_, E>,
    put: OutputCallback<'_, M, E>,
) -> Result<(), E> {
    let Some((first, others)) = makers.split_first_mut() else { return Ok(()) };
    let hall = DecodePool {
        source: Mutex::new(ChunkSource { fill, rest: Vec::new(), next: 0, ended: false }),
        decoder: Sequencer::new(decoder),
        output: Sequencer::new(put),
        cancelled: AtomicBool::new(false),
        first_error: Mutex::new(None),
    };
    std::thread::scope(|scope| {
        for maker in others {
            scope.spawn(|| hall.run_worker(maker));
        }
        hall.run_worker(first);
    });
    let DecodePool { decoder, output: put, first_error: failed, .. } = hall;
    // A poisoned lock still holds the first error, which is the reason of the panic's neighbours.
    let mut failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    let (decoder, put) = (decoder.into_inner(), put.into_inner());
    if failed.is_none() {
        let (mut batch, mut error) = (FrameBatch::default(), None);
        let mut give = |batch: &mut FrameBatch| {
            first.consume(batch);
            error = error.take().or_else(|| put(first).err());
        };
        decoder.finish_batch(&mut batch, &mut give);
        give(&mut batch);
        failed = error;
    }
    failed.map_or(Ok(()), Err)
}

/// State shared by the threads.
struct DecodePool<'a, M, E> {
    source: Mutex<ChunkSource<'a, E>>,
    decoder: Sequencer<&'a mut CaptureDecoder>,
    output: Sequencer<OutputCallback<'a, M, E>>,
    /// Something failed: all go home.
    cancelled: AtomicBool,
    first_error: Mutex<Option<E>>,
}

/// The capture as it is cut.
struct ChunkSource<'a, E> {
    fill: FillCallback<'a, E>,
    /// Bytes behind the last end of a line.
    rest: Vec<u8>,
    /// The number of the next piece.
    next: u64,
    ended: bool,
}

/// Buffers of a thread.
#[derive(Default)]
struct WorkerBuffers {
    piece: Vec<u8>,
    scan: LineScan,
    batch: FrameBatch,
}

impl<E> ChunkSource<'_, E> {
    /// The next piece, which ends where a line does if it can, and its number.
    fn next_chunk(&mut self, piece: &mut Vec<u8>, max: usize) -> Result<Option<u64>, E> {
        piece.clear();
        piece.append(&mut self.rest);
        while piece.len() < max && !self.ended {
            let before = piece.len();
            (self.fill)(piece, max - before)?;
            // Nothing more is the end, as with `Read`.
            self.ended = piece.len() == before;
        }
        if let Some(newline) = memchr::memrchr(b'\n', piece).filter(|_| !self.ended) {
            debug_assert!(self.rest.is_empty());
            // Pieces end with a line, so that their lines can be found by several threads.
            self.rest.extend_from_slice(&piece[newline + 1..]);
            piece.truncate(newline + 1);
        }
        self.next += 1;
        Ok((!piece.is_empty()).then_some(self.next - 1))
    }
}

impl<M: BatchConsumer, E> DecodePool<'_, M, E> {
    /// Goes with piece after piece until there are no more.
    fn run_worker(&self, maker: &mut M) {
        let mut worker_buffers = WorkerBuffers::default();
        // A thread that panics must not leave the others waiting.
        let _careful = AbortGuard(self);
        while self.process_next(&mut worker_buffers, maker).is_some() {}
    }

    /// Goes with one piece; `None` when there is none, or all is over.
    fn process_next(
        &self,
        WorkerBuffers { piece, scan, batch }: &mut WorkerBuffers,
        maker: &mut M,
    ) -> Option<()> {
        let read = self.source.lock().ok()?.next_chunk(piece, M::CHUNK_BYTES);
        let number = self.check_result(read)??;
        // Outside of the lock: finding the lines is half of the work.
        scan.scan(piece);
        let mut decoder = self.decoder.wait_turn(number, &self.cancelled)?;
        decoder.1.decode_scanned(piece, scan, batch, &mut |batch| {
            maker.consume(batch);
            // No later piece is decoded yet, and earlier ones do not need it.
            let put = self.output.wait_turn(number, &self.cancelled);
            if put.and_then(|mut put| self.check_result((put.1)(maker))).is_none() {
                batch.stop();
            }
        });
        // Before the text is made, which other threads can do at the same time.
        self.decoder.end_turn(decoder);
        maker.consume(batch);
        let mut put = self.output.wait_turn(number, &self.cancelled)?;
        self.check_result((put.1)(maker))?;
        self.output.end_turn(put);
        Some(())
    }

    /// The result without an error; an error ends all.
    fn check_result<T>(&self, result: Result<T, E>) -> Option<T> {
        let error = match result {
            Ok(value) => return Some(value),
            Err(error) => error,
        };
        // The first one: later errors come from the cancelling itself.
        self.first_error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        self.cancelled.store(true, Ordering::SeqCst);
        None
    }

    /// Everybody looks up.
    fn wake_all(&self) {
        self.cancelled.store(true, Ordering::SeqCst);
        self.decoder.wake_all();
        self.output.wake_all();
    }
}

/// Calls the others when a thread ends otherwise than with the capture.
struct AbortGuard<'a, 'b, M: BatchConsumer, E>(&'a DecodePool<'b, M, E>);

impl<M: BatchConsumer, E> Drop for AbortGuard<'_, '_, M, E> {
    fn drop(&mut self) {
        if std::thread::panicking() || self.0.cancelled.load(Ordering::SeqCst) {
            self.0.wake_all();
        }
    }
}

/// Something that is used piece by piece, in the order of the pieces.
struct Sequencer<T> {
    /// Number of the thread whose turn it is, and the shared value.
    turn: Mutex<(u64, T)>,
    turn_changed: Condvar,
}

impl<T> Sequencer<T> {
    fn new(of: T) -> Self {
        Self { turn: Mutex::new((0, of)), turn_changed: Condvar::new() }
    }

    /// Waits for the turn of a piece; `None` when all is over.
    fn wait_turn(&self, number: u64, over: &AtomicBool) -> Option<MutexGuard<'_, (u64, T)>> {
        let turn = self.turn.lock().ok()?;
        let turn = self
            .turn_changed
            .wait_while(turn, |turn| turn.0 != number && !over.load(Ordering::SeqCst))
            .ok()?;
        (turn.0 == number && !over.load(Ordering::SeqCst)).then_some(turn)
    }

    fn end_turn(&self, mut turn: MutexGuard<'_, (u64, T)>) {
        turn.0 += 1;
        drop(turn);
        self.turn_changed.notify_all();
    }

    /// Wakes all who wait.
    fn wake_all(&self) {
        // Taken and given back: a thread between its test and its wait would otherwise miss the call.
        drop(self.turn.lock());
        self.turn_changed.notify_all();
    }

    fn into_inner(self) -> T {
        self.turn.into_inner().unwrap_or_else(PoisonError::into_inner).1
    }
}

#[cfg(test)]
mod tests;
