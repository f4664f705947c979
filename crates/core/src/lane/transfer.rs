//! A program on its way into a drive's memory or out of it: what its job asks next, and what an
//! answer makes of it.
//!
//! The drive's pointer proves a chunk: it moves with every word that was written, so a lost message is
//! told from a lost acknowledgement, and nothing is sent again that the drive has. Then the drive's
//! sum proves the piece.
//!
//! Why: TML-7.

use alloc::vec::Vec;

use super::execute::Next;
use super::job::Asked;
use super::slot::Slot;
use crate::error::{Failure, Outcome, Unsupported};
use crate::program::{Memory, MemoryRules, Progress, TransferStep, WORDS_MAX, sum};
use crate::station::Request;

/// Writes that go out before the drive's pointer is looked at. Permanent memory is written singly:
/// the drive answers when it is ready for the next.
const PUTS_MAX: usize = 4;
/// Times a chunk is written at most.
const ATTEMPTS_MAX: u8 = 3;
/// Words sent once more in one transfer at most.
const REPEATS_MAX: usize = 64;

/// What is done with the memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TransferKind {
    /// Written, and proven by its sum.
    Write,
    /// Compared by its sum, which changes nothing.
    Verify,
    /// Read.
    Read,
}

/// Words that belong at addresses, one after the other.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Piece {
    /// Where the first word lies.
    pub start: u16,
    /// The words; what is read takes their place.
    pub words: Vec<u16>,
}

impl Piece {
    /// The last address.
    fn end(&self) -> u16 {
        self.start.wrapping_add((self.words.len() - 1) as u16)
    }
}

/// A transfer under way, or the last one.
#[derive(Debug)]
pub struct Transfer {
    kind: TransferKind,
    rules: &'static MemoryRules,
    pieces: Vec<Piece>,
    stage: Stage,
    /// The piece at work, and how many of its words are proven or read.
    piece: usize,
    at: usize,
    /// Words of the chunk that were sent and not yet proven.
    sent: usize,
    attempts: u8,
    progress: Progress,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Stage {
    /// The drive's status must allow it.
    Check(usize),
    Aim,
    /// The pointer's move may be lost.
    Aimed,
    Put,
    /// How far the pointer is.
    Prove,
    Get,
    Sum,
}

impl Transfer {
    /// A transfer of these pieces.
    ///
    /// # Errors
    /// [`Unsupported`] for pieces that no memory holds, that are empty or too long.
    pub fn new(
        kind: TransferKind,
        rules: &'static MemoryRules,
        pieces: Vec<Piece>,
    ) -> Result<Self, Unsupported> {
        let total: usize = pieces.iter().map(|piece| piece.words.len()).sum();
        let lies = |piece: &Piece| rules.memory(piece.start, piece.words.len()).is_some();
        if total == 0 || total > WORDS_MAX || pieces.iter().any(|piece| piece.words.is_empty()) {
            return Err(Unsupported::BadArgument);
        }
        if !pieces.iter().all(lies) {
            return Err(Unsupported::Forbidden(NOWHERE));
        }
        let (pieces, stage) = match kind {
            TransferKind::Write => (guarded(pieces, rules), Stage::Check(0)),
            TransferKind::Verify => (pieces, Stage::Sum),
            TransferKind::Read => (pieces, Stage::Get),
        };
        let total = pieces.iter().map(|piece| piece.words.len()).sum();
        let progress = Progress { total, ..Progress::default() };
        Ok(Self { kind, rules, pieces, stage, piece: 0, at: 0, sent: 0, attempts: 0, progress })
    }

    /// How far it is.
    #[must_use]
    pub const fn progress(&self) -> Progress {
        self.progress
    }

    /// What it is about; of a transfer that reads, what was read.
    #[must_use]
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    fn current(&self) -> (&Piece, Memory) {
        // There is a piece as long as the job has not ended, and memory holds it.
        let piece = &self.pieces[self.piece.min(self.pieces.len() - 1)];
        let memory = self.rules.memory(piece.start, piece.words.len());
        (piece, memory.unwrap_or(Memory::Volatile))
    }

    fn address(&self) -> u16 {
        self.current().0.start.wrapping_add(self.at as u16)
    }

    /// The step that comes next.
    fn step(&self) -> TransferStep {
        let (piece, memory) = self.current();
        match self.stage {
            Stage::Check(n) => TransferStep::Status(self.rules.idle[n].address),
            Stage::Aim => TransferStep::Aim(self.address()),
            Stage::Aimed | Stage::Prove => TransferStep::Where,
            Stage::Put => {
                let mut words = piece.words[self.at + self.sent..].iter().copied();
                TransferStep::Put(memory, words.next().unwrap_or(0), words.next())
            }
            Stage::Get => TransferStep::Get(memory, self.address()),
            Stage::Sum => TransferStep::Sum(memory, piece.start, piece.end()),
        }
    }

    /// The request that comes next.
    pub fn next<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &mut Slot<R, A>,
    ) -> Result<(R, Asked), Next> {
        match slot.driver.transfer(self.step()) {
            Some(Ok(request)) => Ok((request, Asked::Send(request.class()))),
            Some(Err(reason)) => Err(self.fail(Failure::Impossible(reason))),
            None => Err(self.fail(Failure::Impossible(Unsupported::NoPlan))),
        }
    }

    /// How it ends when something ends it now.
    pub fn cut_short(&self, failure: Failure) -> Outcome {
        let written = self.kind == TransferKind::Write && !matches!(self.stage, Stage::Check(_));
        if written { Outcome::Unknown(failure) } else { Outcome::NotDone(failure) }
    }

    fn fail(&self, failure: Failure) -> Next {
        Next::End(self.cut_short(failure))
    }

    /// What an answer makes of it.
    pub fn answered<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &mut Slot<R, A>,
        raw: Result<i64, Failure>,
    ) -> Next {
        if self.stage == Stage::Put {
            return self.put(slot, raw);
        }
        match (self.stage, raw) {
            // Its acknowledgement may be all that was lost.
            (Stage::Aim, Err(Failure::Silent | Failure::Misbehaved)) => self.stage = Stage::Aimed,
            (_, Err(failure)) => return self.fail(failure),
            (Stage::Check(n), Ok(raw)) => return self.checked(n, raw),
            (Stage::Aim, Ok(_)) => self.stage = Stage::Put,
            (Stage::Aimed, Ok(raw)) if raw as u16 == self.address() => self.stage = Stage::Put,
            (Stage::Aimed, Ok(_)) => return self.again(),
            (Stage::Get, Ok(raw)) => return self.got(raw as u32),
            (Stage::Sum, Ok(raw)) => return self.summed(raw as u16),
            (Stage::Prove | Stage::Put, Ok(raw)) => return self.proven(raw as u16),
        }
        Next::Go
    }

    fn checked(&mut self, n: usize, raw: i64) -> Next {
        let check = self.rules.idle[n];
        if raw as u16 & check.mask != 0 {
            return Next::End(Outcome::NotDone(Failure::NotReady { hint: check.hint }));
        }
        self.stage = match n + 1 < self.rules.idle.len() {
            true => Stage::Check(n + 1),
            false => Stage::Aim,
        };
        Next::Go
    }

    /// Words went out; whether they arrived, the pointer tells.
    fn put<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &mut Slot<R, A>,
        raw: Result<i64, Failure>,
    ) -> Next {
        let (piece, memory) = self.current();
        let left = piece.words.len() - self.at - self.sent;
        let count = left.min(2);
        let most = if memory == Memory::Permanent { 2 } else { 2 * PUTS_MAX };
        match raw {
            Ok(_) | Err(Failure::Silent | Failure::Misbehaved) => {}
            Err(failure) => return self.fail(failure),
        }
        if memory == Memory::Permanent {
            slot.state.flash_writes += count as u32;
        }
        self.sent += count;
        if self.sent >= most || count == left || raw.is_err() {
            self.stage = Stage::Prove;
        }
        Next::Go
    }

    fn proven(&mut self, pointer: u16) -> Next {
        let moved = usize::from(pointer.wrapping_sub(self.address()));
        if self.at + moved > self.current().0.words.len() {
            // Something was taken twice, and words behind the piece are spoiled.
            return self.fail(Failure::Misbehaved);
        }
        if moved != self.sent {
            return self.again();
        }
        self.at += self.sent;
        self.progress.done += self.sent;
        (self.sent, self.attempts) = (0, 0);
        self.stage = match self.at < self.current().0.words.len() {
            true => Stage::Put,
            false => Stage::Sum,
        };
        Next::Go
    }

    /// The chunk did not arrive, or not all of it: from its beginning, if not too often.
    fn again(&mut self) -> Next {
        self.attempts += 1;
        self.progress.repeated += self.sent;
        if self.attempts >= ATTEMPTS_MAX || self.progress.repeated > REPEATS_MAX {
            return self.fail(Failure::Silent);
        }
        (self.sent, self.stage) = (0, Stage::Aim);
        Next::Go
    }

    fn got(&mut self, value: u32) -> Next {
        let at = self.at;
        let words = &mut self.pieces[self.piece].words;
        let halves = [value as u16, (value >> 16) as u16];
        let count = (words.len() - at).min(2);
        words[at..at + count].copy_from_slice(&halves[..count]);
        self.at += count;
        self.progress.done += count;
        if self.at < self.pieces[self.piece].words.len() { Next::Go } else { self.onward() }
    }

    fn summed(&mut self, found: u16) -> Next {
        let (piece, _) = self.current();
        if sum(&piece.words) != found {
            let (start, end) = (piece.start.into(), piece.end().into());
            return self.fail(Failure::Differs { start, end });
        }
        if self.kind == TransferKind::Verify {
            self.progress.done += self.current().0.words.len();
        }
        self.onward()
    }

    /// On to the next piece.
    fn onward(&mut self) -> Next {
        (self.piece, self.at) = (self.piece + 1, 0);
        if self.piece == self.pieces.len() {
            return Next::End(Outcome::Done(self.progress.done as i64));
        }
        if self.kind == TransferKind::Write {
            self.stage = Stage::Aim;
        }
        Next::Go
    }
}

const NOWHERE: &str = "no memory for programs is there: the EEPROM is 0x4000 to 0x7FFF, RAM begins at \
                       0x8270";

/// While permanent memory is written, the program that starts by itself is one that ends at once: its
/// true beginning is written last, when all else is proven. A transfer that is cut short leaves
/// nothing that would run by itself.
fn guarded(pieces: Vec<Piece>, rules: &MemoryRules) -> Vec<Piece> {
    let (autorun, harmless) = rules.autorun;
    let mut parts: Vec<Piece> = Vec::with_capacity(pieces.len() + 3);
    let mut first = None;
    for piece in pieces {
        let within = usize::from(autorun.wrapping_sub(piece.start));
        match piece.words.get(within) {
            Some(word) if autorun >= piece.start => {
                first = Some(*word);
                let halves = [(piece.start, &piece.words[..within])];
                let behind = (autorun.wrapping_add(1), &piece.words[within + 1..]);
                let halves = halves.into_iter().chain([behind]).filter(|(_, w)| !w.is_empty());
                parts.extend(halves.map(|(start, words)| Piece { start, words: words.to_vec() }));
            }
            _ => parts.push(piece),
        }
    }
    let Some(first) = first else { return parts };
    let word = |word| Piece { start: autorun, words: Vec::from([word]) };
    parts.insert(0, word(harmless));
    if first != harmless {
        parts.push(word(first));
    }
    parts
}
