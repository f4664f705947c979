//! Programs in a drive's memory: words at addresses, assembled, written and verified.
//!
//! A `Transfer` is the third kind of job of a lane, besides plans and paths. A program is written in
//! blocks, and the drive verifies each block before the next. Each piece ends with the drive's checksum.
//! Permanent memory wears, so nothing is written twice unless the drive reports that it is missing, and
//! every word is counted.

mod transfer;

use core::ops::RangeInclusive;

use crate::explain::TextError;
use crate::profile::Profile;
pub use transfer::{MemoryBlock, MemoryTransfer, TransferKind};

/// Words that one transfer holds at most: a whole memory of 16-bit addresses.
pub const WORDS_MAX: usize = 1 << 16;
/// Labels of a program at most.
pub const LABELS_MAX: usize = 1024;

/// A name for an address.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ProgramLabel<'t> {
    /// Name as written in the text.
    pub name: &'t str,
    /// Address of the label.
    pub address: u16,
}

/// Size of an assembled program.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct AssemblySize {
    /// Words.
    pub words: usize,
    /// Labels.
    pub labels: usize,
}

/// Position and reason of an error in a source text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SourceError {
    /// Line, counted from 1.
    pub line: u32,
    /// Byte in the line, counted from 0.
    pub at: usize,
    /// The expected text.
    pub expected: &'static str,
}

/// Takes a listing: each instruction with its place, then its text in pieces.
pub trait ListingSink {
    /// The next instruction is this.
    fn instruction(&mut self, address: u16, words: &[u16]);
    /// A piece of its text.
    fn text(&mut self, piece: &str);
}

/// A language whose programs drives keep and run.
pub trait ProgramLanguage: Sync {
    /// Makes words of a program's text, to lie from `origin` on.
    ///
    /// # Errors
    /// The line, the place in it, and what should stand there.
    fn assemble<'t>(
        &self,
        text: &'t str,
        origin: u16,
        profile: Option<&'static Profile>,
        words: &mut [u16],
        labels: &mut [ProgramLabel<'t>],
    ) -> Result<AssemblySize, SourceError>;

    /// Makes text of words that lie from `origin` on, which assembles to the same words.
    fn disassemble(
        &self,
        origin: u16,
        words: &[u16],
        profile: Option<&'static Profile>,
        listing: &mut dyn ListingSink,
    );

    /// The memory that programs lie in.
    fn memory_rules(&self) -> &'static MemoryRules;
}

/// Bytes of an instruction, where memory holds instructions and not words.
pub const INSTRUCTION_BYTES: usize = 7;

/// An instruction in a drive's memory.
pub type InstructionBytes = [u8; INSTRUCTION_BYTES];

/// A language whose programs are instructions, one at each address: a request each.
pub trait InstructionLanguage: Sync {
    /// Extension of its source files: `tmc`.
    fn extension(&self) -> &'static str;

    /// Instructions of a program at most.
    fn capacity(&self) -> usize;

    /// The `n`th mnemonic; `None` behind the last.
    fn mnemonic(&self, n: usize) -> Option<&'static str>;

    /// The fields of a mnemonic; `None` for an unknown one.
    fn fields(&self, mnemonic: &str) -> Option<InstructionFields>;

    /// Parses one line, with numbers or words of the language as fields.
    ///
    /// # Errors
    /// The position, and the expected text.
    fn parse(&self, line: &str) -> Result<InstructionBytes, TextError>;

    /// Writes an instruction as such a line, in pieces: its address, where it jumps, is the last.
    fn write(&self, instruction: InstructionBytes, show: &mut dyn FnMut(&str));

    /// The role of an instruction in its program.
    fn role(&self, instruction: InstructionBytes) -> InstructionRole;

    /// The code by which a drive reports that it has stored the request.
    fn stored_code(&self) -> u32;

    /// Returns whether the reply to [`ProgramCommand::QueryProgram`] means that a program is running.
    fn is_running(&self, answer: i64) -> bool;
}

/// The fields of a mnemonic.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct InstructionFields {
    /// Number of fields.
    pub count: usize,
    /// Words for numbers in the first field.
    pub words: &'static [(u8, &'static str)],
}

/// The role of an instruction in its program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct InstructionRole {
    /// The address that it may go on at.
    pub target: Option<u16>,
    /// Execution does not continue to the next instruction.
    pub ends: bool,
    /// Memory that was never written, or a stop that does as well.
    pub empty: bool,
}

/// Rules of the memory for programs.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct MemoryRules {
    /// Addresses that keep their words without power.
    pub permanent: RangeInclusive<u16>,
    /// Addresses that lose them.
    pub volatile: RangeInclusive<u16>,
    /// Address of the program that runs at power-up, and the instruction that ends it at once. That
    /// instruction is there while the rest is written.
    pub autorun: (u16, u16),
    /// Conditions that must not be true while memory is written.
    pub idle_checks: &'static [IdleCheck],
    /// Conditions that must not be true while data is written to volatile memory. The motor may have power.
    pub data_checks: &'static [IdleCheck],
    /// Address and bits that show that a called routine is running.
    pub call_flag: (u16, u16),
}

/// A word of the drive's status that must have bits clear.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct IdleCheck {
    /// Address to read.
    pub address: u16,
    /// The bits.
    pub mask: u16,
    /// Remedy when one is set.
    pub hint: &'static str,
}

/// A kind of memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MemoryKind {
    /// Loses its words with the power.
    Volatile,
    /// Keeps them, and wears when it is written.
    Permanent,
}

impl MemoryRules {
    /// Memory that holds `count` words from `start` on; `None` if none holds all of them.
    #[must_use]
    pub fn memory_at(&self, start: u16, count: usize) -> Option<MemoryKind> {
        let last = u16::try_from(usize::from(start) + count.max(1) - 1).ok()?;
        match (
            contains_both(&self.permanent, start, last),
            contains_both(&self.volatile, start, last),
        ) {
            (true, _) => Some(MemoryKind::Permanent),
            (_, true) => Some(MemoryKind::Volatile),
            _ => None,
        }
    }
}

fn contains_both(range: &RangeInclusive<u16>, start: u16, last: u16) -> bool {
    range.contains(&start) && range.contains(&last)
}

/// A request that a transfer needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TransferStep {
    /// Reads a word of the drive's status.
    ReadStatus(u16),
    /// Points where the next words go.
    SetPointer(u16),
    /// Writes one word, or two, where it points, which moves on.
    Write(MemoryKind, u16, Option<u16>),
    /// Reads the pointer.
    ReadPointer,
    /// Reads two words.
    Read(MemoryKind, u16),
    /// The sum of the words from the first address to the last, both counted, modulo 65536.
    Checksum(MemoryKind, u16, u16),
}

/// A command about programs, and about motors beside those of the axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ProgramCommand {
    /// Stop the motor of that number behind the drive's address, counted from 0. A drive refuses the
    /// number of a motor that it has not.
    StopMotor(u8),
    /// Continues there, whatever is running now.
    Goto(u16),
    /// Call the routine there, so that it can be given up.
    Call(u16),
    /// Give up the routine that was called so.
    Abort,
    /// Run no program any more.
    End,
    /// Report whether a program of the drive runs; [`ProgramDriver::is_program_running`] reads the answer.
    ///
    /// [`ProgramDriver::is_program_running`]: crate::axis::ProgramDriver::is_program_running
    QueryProgram,
    /// Reads whether a called routine is running: see [`MemoryRules::call_flag`].
    QueryCall,
    /// Store what follows from this place on, up to [`EndStore`](Self::EndStore), and do not execute it.
    BeginStore(u16),
    /// Store these bytes of an instruction. A drive that stores it refuses it as a command; one that
    /// does not refuse it has executed it.
    Store(InstructionBytes),
    /// Execute requests again.
    EndStore,
    /// Report the instruction at this place: its bytes are the low seven of the answer.
    ReadInstruction(u16),
    /// Execute one instruction of the program.
    Step,
    /// Go on from where the program is.
    Resume,
    /// Report where the program is.
    QueryCounter,
    /// Report the speed of the motor of that number behind the drive's address, counted from 0.
    QuerySpeed(u8),
    /// Set the program to its first instruction.
    Reset,
}

/// Progress of a transfer.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct TransferProgress {
    /// Words that the drive has proven to have, or that were read.
    pub done: usize,
    /// Words in all.
    pub total: usize,
    /// Words sent once more because the drive did not have them.
    pub repeated: usize,
}

/// The sum that drives compute, modulo 65536.
#[must_use]
pub fn checksum(words: &[u16]) -> u16 {
    words.iter().fold(0, |sum, word| sum.wrapping_add(*word))
}
