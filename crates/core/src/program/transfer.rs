//! Transfer of a program to or from a drive's memory: the next step, and the processing of its reply. No requests, no
//! axis: the lane sends the steps.
//!
//! The drive's pointer verifies a block: it moves with every written word. So a lost message is
//! distinguished from a lost acknowledgement, and no word is sent twice. At the end the drive's checksum
//! verifies the piece.
//!
//! Why: TML-7.

use alloc::vec::Vec;

use super::{
    IdleCheck, MemoryKind, MemoryRules, TransferProgress, TransferStep, WORDS_MAX, checksum,
};
use crate::error::{Failure, Outcome, Unsupported};

/// Writes that go out before the drive's pointer is looked at. Permanent memory is written singly:
/// the drive answers when it is ready for the next.
const WRITES_MAX: usize = 4;
/// Times a chunk is written at most.
const ATTEMPTS_MAX: u8 = 3;
/// Words sent once more in one transfer at most.
const REPEATS_MAX: usize = 64;

/// Kind of a memory transfer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TransferKind {
    /// Written, and proven by its sum.
    Write,
    /// Data in volatile memory, written and proven as a program is. The motor may have power.
    WriteData,
    /// Compared by its sum, which changes nothing.
    Verify,
    /// Read.
    Read,
}

impl TransferKind {
    /// Returns whether it changes the memory.
    #[must_use]
    pub const fn writes(self) -> bool {
        matches!(self, Self::Write | Self::WriteData)
    }
}

/// Words that belong at addresses, one after the other.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct MemoryBlock {
    /// Address of the first word.
    pub start: u16,
    /// The words to write, or the words read.
    pub words: Vec<u16>,
}

impl MemoryBlock {
    /// The last address.
    fn end(&self) -> u16 {
        self.start.wrapping_add((self.words.len() - 1) as u16)
    }
}

/// A transfer under way, or the last one.
#[derive(Debug)]
pub struct MemoryTransfer {
    kind: TransferKind,
    rules: &'static MemoryRules,
    /// Conditions that must not be true before the first write.
    checks: &'static [IdleCheck],
    blocks: Vec<MemoryBlock>,
    stage: TransferStage,
    /// The piece at work, and how many of its words are proven or read.
    block: usize,
    offset: usize,
    /// Words of the chunk that were sent and not yet proven.
    sent: usize,
    attempts: u8,
    progress: TransferProgress,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum TransferStage {
    /// The drive's status must allow it.
    CheckIdle(usize),
    SetPointer,
    /// The pointer's move may be lost.
    ConfirmPointer,
    Write,
    /// Reads the memory pointer to verify the words.
    Verify,
    Read,
    Checksum,
}

impl MemoryTransfer {
    /// A transfer of these pieces.
    ///
    /// # Errors
    /// [`Unsupported`] for pieces that no memory holds, that are empty or too long.
    pub fn new(
        kind: TransferKind,
        rules: &'static MemoryRules,
        pieces: Vec<MemoryBlock>,
    ) -> Result<Self, Unsupported> {
        let total: usize = pieces.iter().map(|piece| piece.words.len()).sum();
        if total == 0 || total > WORDS_MAX || pieces.iter().any(|piece| piece.words.is_empty()) {
            return Err(Unsupported::BadArgument);
        }
        if !pieces.iter().all(|piece| rules.memory_at(piece.start, piece.words.len()).is_some()) {
            return Err(Unsupported::Forbidden(NO_MEMORY));
        }
        let is_permanent = |piece: &MemoryBlock| {
            rules.memory_at(piece.start, piece.words.len()) == Some(MemoryKind::Permanent)
        };
        if kind == TransferKind::WriteData && pieces.iter().any(is_permanent) {
            return Err(Unsupported::Forbidden(NO_DATA_MEMORY));
        }
        let checks = match kind {
            TransferKind::WriteData => rules.data_checks,
            _ => rules.idle_checks,
        };
        let (pieces, stage) = match kind {
            TransferKind::Write => (guard_autorun(pieces, rules), TransferStage::CheckIdle(0)),
            TransferKind::WriteData => (pieces, TransferStage::CheckIdle(0)),
            TransferKind::Verify => (pieces, TransferStage::Checksum),
            TransferKind::Read => (pieces, TransferStage::Read),
        };
        let total = pieces.iter().map(|piece| piece.words.len()).sum();
        let progress = TransferProgress { total, ..TransferProgress::default() };
        Ok(Self {
            kind,
            rules,
            checks,
            blocks: pieces,
            stage,
            block: 0,
            offset: 0,
            sent: 0,
            attempts: 0,
            progress,
        })
    }

    /// Progress of the transfer.
    #[must_use]
    pub const fn progress(&self) -> TransferProgress {
        self.progress
    }

    /// The blocks of the transfer; after a read, the words read.
    #[must_use]
    pub fn blocks(&self) -> &[MemoryBlock] {
        &self.blocks
    }

    fn current_block(&self) -> (&MemoryBlock, MemoryKind) {
        // There is a piece as long as the job has not ended, and memory holds it.
        let piece = &self.blocks[self.block.min(self.blocks.len() - 1)];
        let memory = self.rules.memory_at(piece.start, piece.words.len());
        (piece, memory.unwrap_or(MemoryKind::Volatile))
    }

    fn address(&self) -> u16 {
        self.current_block().0.start.wrapping_add(self.offset as u16)
    }

    /// The step that comes next.
    #[must_use]
    pub fn current_step(&self) -> TransferStep {
        let (piece, memory) = self.current_block();
        match self.stage {
            TransferStage::CheckIdle(n) => TransferStep::ReadStatus(self.checks[n].address),
            TransferStage::SetPointer => TransferStep::SetPointer(self.address()),
            TransferStage::ConfirmPointer | TransferStage::Verify => TransferStep::ReadPointer,
            TransferStage::Write => {
                let words = &piece.words[self.offset + self.sent..];
                debug_assert!(!words.is_empty(), "the stage ends with the last word");
                TransferStep::Write(memory, words[0], words.get(1).copied())
            }
            TransferStage::Read => TransferStep::Read(memory, self.address()),
            TransferStage::Checksum => TransferStep::Checksum(memory, piece.start, piece.end()),
        }
    }

    /// The outcome if the transfer is ended now.
    #[must_use]
    pub fn abort_outcome(&self, failure: Failure) -> Outcome {
        let written = self.kind.writes() && !matches!(self.stage, TransferStage::CheckIdle(_));
        // From the first write on the memory holds half of it.
        if written { Outcome::Unknown(failure) } else { Outcome::NotDone(failure) }
    }

    fn fail(&self, failure: Failure) -> Option<Outcome> {
        Some(self.abort_outcome(failure))
    }

    /// Words of permanent memory that the present step writes; 0 for any other step.
    #[must_use]
    pub fn permanent_words(&self) -> u32 {
        match self.current_step() {
            TransferStep::Write(MemoryKind::Permanent, _, second) => {
                1 + u32::from(second.is_some())
            }
            _ => 0,
        }
    }

    /// Processes the reply to the present step. Returns the outcome of the transfer when it has ended.
    pub fn handle_reply(&mut self, raw: Result<i64, Failure>) -> Option<Outcome> {
        if self.stage == TransferStage::Write {
            return self.handle_written(raw);
        }
        match (self.stage, raw) {
            // Its acknowledgement may be all that was lost.
            (TransferStage::SetPointer, Err(Failure::Silent | Failure::Misbehaved)) => {
                self.stage = TransferStage::ConfirmPointer
            }
            (_, Err(failure)) => return self.fail(failure),
            (TransferStage::CheckIdle(n), Ok(raw)) => return self.handle_status(n, raw),
            (TransferStage::SetPointer, Ok(_)) => self.stage = TransferStage::Write,
            (TransferStage::ConfirmPointer, Ok(raw)) if raw as u16 == self.address() => {
                self.stage = TransferStage::Write
            }
            (TransferStage::ConfirmPointer, Ok(_)) => return self.retry_chunk(),
            (TransferStage::Read, Ok(raw)) => return self.handle_words(raw as u32),
            (TransferStage::Checksum, Ok(raw)) => return self.handle_checksum(raw as u16),
            (TransferStage::Verify | TransferStage::Write, Ok(raw)) => {
                return self.handle_pointer(raw as u16);
            }
        }
        None
    }

    fn handle_status(&mut self, n: usize, raw: i64) -> Option<Outcome> {
        let check = self.checks[n];
        if raw as u16 & check.mask != 0 {
            return Some(Outcome::NotDone(Failure::NotReady { hint: check.hint }));
        }
        self.stage = if n + 1 < self.checks.len() {
            TransferStage::CheckIdle(n + 1)
        } else {
            TransferStage::SetPointer
        };
        None
    }

    /// Processes the end of a write. The memory pointer shows whether the words arrived.
    fn handle_written(&mut self, raw: Result<i64, Failure>) -> Option<Outcome> {
        let (piece, memory) = self.current_block();
        let left = piece.words.len() - self.offset - self.sent;
        let count = left.min(2);
        let max = if memory == MemoryKind::Permanent { 2 } else { 2 * WRITES_MAX };
        match raw {
            Ok(_) | Err(Failure::Silent | Failure::Misbehaved) => {}
            Err(failure) => return self.fail(failure),
        }
        self.sent += count;
        // A few writes, then the pointer is read: a lost one is found while it is cheap to repeat.
        if self.sent >= max || count == left || raw.is_err() {
            self.stage = TransferStage::Verify;
        }
        None
    }

    fn handle_pointer(&mut self, pointer: u16) -> Option<Outcome> {
        // The drive's own pointer shows what it took, whatever was acknowledged.
        let moved = usize::from(pointer.wrapping_sub(self.address()));
        if self.offset + moved > self.current_block().0.words.len() {
            // Something was taken twice, and words behind the piece are spoiled.
            return self.fail(Failure::Misbehaved);
        }
        if moved != self.sent {
            return self.retry_chunk();
        }
        self.offset += self.sent;
        self.progress.done += self.sent;
        (self.sent, self.attempts) = (0, 0);
        self.stage = if self.offset < self.current_block().0.words.len() {
            TransferStage::Write
        } else {
            TransferStage::Checksum
        };
        None
    }

    /// The chunk did not arrive, or not all of it: from its beginning, if not too often.
    fn retry_chunk(&mut self) -> Option<Outcome> {
        self.attempts += 1;
        self.progress.repeated += self.sent;
        if self.attempts >= ATTEMPTS_MAX || self.progress.repeated > REPEATS_MAX {
            return self.fail(Failure::Silent);
        }
        (self.sent, self.stage) = (0, TransferStage::SetPointer);
        None
    }

    fn handle_words(&mut self, value: u32) -> Option<Outcome> {
        let at = self.offset;
        let words = &mut self.blocks[self.block].words;
        let halves = [value as u16, (value >> 16) as u16];
        debug_assert!(at < words.len());
        let count = (words.len() - at).min(2);
        words[at..at + count].copy_from_slice(&halves[..count]);
        self.offset += count;
        self.progress.done += count;
        if self.offset < self.blocks[self.block].words.len() { None } else { self.next_block() }
    }

    fn handle_checksum(&mut self, found: u16) -> Option<Outcome> {
        let (piece, _) = self.current_block();
        if checksum(&piece.words) != found {
            let (start, end) = (piece.start.into(), piece.end().into());
            return self.fail(Failure::Differs { start, end });
        }
        if self.kind == TransferKind::Verify {
            self.progress.done += self.current_block().0.words.len();
        }
        self.next_block()
    }

    /// On to the next piece.
    fn next_block(&mut self) -> Option<Outcome> {
        (self.block, self.offset) = (self.block + 1, 0);
        if self.block == self.blocks.len() {
            return Some(Outcome::Done(self.progress.done as i64));
        }
        if self.kind.writes() {
            self.stage = TransferStage::SetPointer;
        }
        None
    }
}

const NO_MEMORY: &str = "no memory for programs is there: the EEPROM is 0x4000 to 0x7FFF, RAM begins at \
                       0x8270";

const NO_DATA_MEMORY: &str = "data goes to RAM, from 0x8270 on: the EEPROM keeps it, and wears";

/// While permanent memory is written, the program that starts by itself is one that ends at once: its
/// true beginning is written last, when all else is proven. A transfer that is cut short leaves
/// nothing that would run by itself.
fn guard_autorun(pieces: Vec<MemoryBlock>, rules: &MemoryRules) -> Vec<MemoryBlock> {
    let (autorun, harmless) = rules.autorun;
    let mut parts: Vec<MemoryBlock> = Vec::with_capacity(pieces.len() + 3);
    let mut first = None;
    for piece in pieces {
        let within = usize::from(autorun.wrapping_sub(piece.start));
        match piece.words.get(within) {
            Some(word) if autorun >= piece.start => {
                first = Some(*word);
                let halves = [(piece.start, &piece.words[..within])];
                let behind = (autorun.wrapping_add(1), &piece.words[within + 1..]);
                let halves = halves.into_iter().chain([behind]).filter(|(_, w)| !w.is_empty());
                parts.extend(
                    halves.map(|(start, words)| MemoryBlock { start, words: words.to_vec() }),
                );
            }
            _ => parts.push(piece),
        }
    }
    let Some(first) = first else { return parts };
    // The word that starts the program at power-up goes first as a harmless one, and is written last: a
    // download that breaks off leaves no program that starts by itself.
    parts.insert(0, autorun_block(harmless, autorun));
    if first != harmless {
        parts.push(autorun_block(first, autorun));
    }
    parts
}

fn autorun_block(word: u16, autorun: u16) -> MemoryBlock {
    MemoryBlock { start: autorun, words: Vec::from([word]) }
}
