//! Programs: converts text of many lines to words at addresses, and back.
//!
//! A line holds instructions, separated by `;`, and a comment after `//`. `name:` before an instruction is
//! a label; `GOTO`, `CALL`, `CALLS` and `.word` accept it as an address. Upper and lower case are equal.
//! On-line requests and replies are not allowed in programs (help page on program execution).

use super::host_request::give_me_data;
use super::instruction::{
    LanguageScope, assemble, data_word_count, disassemble, disassemble_word, find_by_name,
};
use super::wire::{IdCode, Instruction};
use crate::profile::Profile;
use crate::program::{
    AssemblySize, IdleCheck, ListingSink, MemoryKind, MemoryRules, ProgramCommand, ProgramLabel,
    ProgramLanguage, SourceError, TransferStep,
};
use crate::station::RequestClass;

/// TML.
#[derive(Debug)]
pub struct TmlLanguage;

/// Address at which the vendor's TML_LIB_light keeps its EEPROM write pointer.
pub const EEPROM_POINTER: u16 = 0x032B;
const SRL: u16 = super::host_request::SRL;
const SRH: u16 = 0x090F;
const END_OPCODE: u16 = 0x0001;

/// Source: help pages on the memory map (EEPROM 4000h to 7FFFh; RAM from 8000h, of which the firmware with
/// names FAxx uses 270h words itself) and on the status register; TML_LIB_light for END at 4000h. The end of
/// RAM differs: the sum shows where there is none.
pub static RULES: MemoryRules = MemoryRules {
    permanent: 0x4000..=0x7FFF,
    volatile: 0x8270..=0xFFFF,
    autorun: (0x4000, END_OPCODE),
    idle_checks: &[
        IdleCheck {
            address: SRL,
            mask: 0x8000,
            hint: "the motor has power, and what it does could change while its program is \
                   written: `polepair disable` first",
        },
        IdleCheck {
            address: SRL,
            mask: 0x0100,
            hint: "a routine of its program runs: `polepair program stop` first",
        },
        IdleCheck {
            address: SRH,
            mask: 0x0020,
            hint: "the program that it starts by itself runs (AUTORUN): `polepair program stop` \
                   first",
        },
    ],
    data_checks: &[
        IdleCheck {
            address: SRL,
            mask: 0x0100,
            hint: "a routine of its program runs, and may lie where the data would: `polepair program \
                   stop` first",
        },
        IdleCheck {
            address: SRH,
            mask: 0x0020,
            hint: "the program that it starts by itself runs, and may lie where the data would: \
                   `polepair program stop` first",
        },
        IdleCheck {
            address: SRH,
            mask: 0x4000,
            hint: "it follows a cam, whose table may lie where the data would: stop it first",
        },
    ],
    call_flag: (SRL, 0x0100),
};

impl ProgramLanguage for TmlLanguage {
    fn assemble<'t>(
        &self,
        text: &'t str,
        origin: u16,
        profile: Option<&'static Profile>,
        words: &mut [u16],
        labels: &mut [ProgramLabel<'t>],
    ) -> Result<AssemblySize, SourceError> {
        let blank = LanguageScope { profile, sender: IdCode::BROADCAST, labels: &[] };
        let mut count = 0;
        let mut at = origin;
        // First where everything lies: how long an instruction is does not depend on its labels.
        visit_statements(text, &mut |statement| match statement {
            SourceStatement::Label(location, name) => {
                count += 1;
                let taken = find_by_name(profile, name).map(|_| EXPECTED_NO_VARIABLE);
                let declared = declare_label(labels, count, ProgramLabel { name, address: at });
                taken.map_or(declared, Err).map_err(|expected| location.source_error(expected))
            }
            SourceStatement::Code(location, text) => {
                let (size, _) = location
                    .assemble_statement(text, &LanguageScope { labels: ANY_LABEL, ..blank })?;
                at = at.checked_add(size).ok_or(location.source_error(EXPECTED_SHORTER))?;
                Ok(())
            }
        })?;
        let scope = LanguageScope { labels: &labels[..count], ..blank };
        let mut len = 0;
        visit_statements(text, &mut |statement| {
            let SourceStatement::Code(location, text) = statement else { return Ok(()) };
            let (size, instruction) = location.assemble_statement(text, &scope)?;
            let whole = [&[instruction.opcode], instruction.data()];
            let space = words
                .get_mut(len..len + usize::from(size))
                .ok_or(location.source_error(EXPECTED_SHORTER))?;
            space.iter_mut().zip(whole.into_iter().flatten()).for_each(|(to, word)| *to = *word);
            len += usize::from(size);
            Ok(())
        })?;
        Ok(AssemblySize { words: len, labels: count })
    }

    fn disassemble(
        &self,
        origin: u16,
        image: &[u16],
        profile: Option<&'static Profile>,
        listing: &mut dyn ListingSink,
    ) {
        let scope = LanguageScope { profile, ..LanguageScope::default() };
        let mut rest = image;
        let mut address = origin;
        while let Some((opcode, behind)) = rest.split_first() {
            let whole =
                data_word_count(*opcode).and_then(|n| Instruction::new(*opcode, behind.get(..n)?));
            let instruction = whole.unwrap_or(Instruction::of(*opcode, []));
            let (leased, left) = rest.split_at(1 + instruction.data().len());
            listing.instruction(address, leased);
            let out = &mut |piece: &str| listing.text(piece);
            match whole {
                Some(_) => disassemble(&instruction, &scope, out),
                None => disassemble_word(*opcode, out),
            }
            (rest, address) = (left, address.wrapping_add(leased.len() as u16));
        }
    }

    fn memory_rules(&self) -> &'static MemoryRules {
        &RULES
    }
}

const EXPECTED_SHORTER: &str = "a shorter program: it runs beyond the end of memory";
const EXPECTED_OTHER_LABEL: &str = "another name: this label is there twice";
const EXPECTED_NO_VARIABLE: &str = "another name: a variable is called so";
const EXPECTED_FEWER_LABELS: &str = "fewer labels: at most 1024";
const EXPECTED_PROGRAM_INSTRUCTION: &str =
    "an instruction that a program can hold: requests and answers go on-line";

/// Placeholder for labels that are not known yet: every name is one.
const ANY_LABEL: &[ProgramLabel<'static>] = &[ProgramLabel { name: "", address: 0 }];

/// Position of a statement.
#[derive(Clone, Copy)]
struct StatementLocation {
    line: u32,
    at: usize,
}

/// A piece of a line.
enum SourceStatement<'t> {
    Label(StatementLocation, &'t str),
    Code(StatementLocation, &'t str),
}

impl StatementLocation {
    const fn source_error(self, expected: &'static str) -> SourceError {
        SourceError { line: self.line, at: self.at, expected }
    }

    /// The instruction, and its words.
    fn assemble_statement(
        self,
        text: &str,
        scope: &LanguageScope<'_>,
    ) -> Result<(u16, Instruction), SourceError> {
        let instruction = assemble(text, scope).map_err(|error| SourceError {
            line: self.line,
            at: self.at + error.at,
            expected: error.expected,
        })?;
        let size = instruction.data().len();
        let raw = text.trim_start().starts_with('.');
        if !raw && data_word_count(instruction.opcode) != Some(size) {
            return Err(self.source_error(EXPECTED_PROGRAM_INSTRUCTION));
        }
        Ok((1 + size as u16, instruction))
    }
}

/// Shows each label and instruction of a text.
fn visit_statements<'t>(
    text: &'t str,
    show: &mut dyn FnMut(SourceStatement<'t>) -> Result<(), SourceError>,
) -> Result<(), SourceError> {
    for (line, text) in (1..).zip(text.lines()) {
        let code = text.split_once("//").map_or(text, |(code, _)| code);
        let mut at = 0;
        while at < code.len() {
            let len = statement_len(&code[at..]);
            let mut piece = &code[at..at + len];
            let mut location = StatementLocation { line, at };
            while let Some((name, behind)) = split_label(piece) {
                let before = piece.len() - piece.trim_start().len();
                show(SourceStatement::Label(
                    StatementLocation { at: location.at + before, ..location },
                    name,
                ))?;
                location.at += piece.len() - behind.len();
                piece = behind;
            }
            let before = piece.len() - piece.trim_start().len();
            if !piece.trim().is_empty() {
                location.at += before;
                show(SourceStatement::Code(location, piece.trim()))?;
            }
            at += len + 1;
        }
    }
    Ok(())
}

/// Length of the first instruction of a line: up to a `;` outside of braces.
fn statement_len(line: &str) -> usize {
    let mut depth = 0_u32;
    let end = line.bytes().position(|byte| {
        match byte {
            b'{' => depth += 1,
            b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        byte == b';' && depth == 0
    });
    end.unwrap_or(line.len())
}

/// `name:` at the start of a piece, and the text after it.
fn split_label(piece: &str) -> Option<(&str, &str)> {
    let (name, behind) = piece.split_once(':')?;
    let name = name.trim();
    let first = name.bytes().next()?;
    (!first.is_ascii_digit()
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_'))
    .then_some((name, behind))
}

/// Notes the label of that number, counted from 1.
fn declare_label<'t>(
    labels: &mut [ProgramLabel<'t>],
    number: usize,
    label: ProgramLabel<'t>,
) -> Result<(), &'static str> {
    let (before, space) = labels.split_at_mut_checked(number - 1).ok_or(EXPECTED_FEWER_LABELS)?;
    if before.iter().any(|known| known.name.eq_ignore_ascii_case(label.name)) {
        return Err(EXPECTED_OTHER_LABEL);
    }
    *space.first_mut().ok_or(EXPECTED_FEWER_LABELS)? = label;
    Ok(())
}

/// The instruction of a transfer's step, and the class of its request.
///
/// Source: TML_LIB_light: a variable points, `(POINTER+),spi = w` writes and moves on, the variable is
/// read until it has, for a drive answers when its EEPROM is ready. Program memory is written by
/// the same form with other memory bits. Two words at once: the 32-bit form.
pub(super) fn transfer_instruction(step: TransferStep) -> (Instruction, RequestClass) {
    match step {
        TransferStep::ReadStatus(address) => {
            (give_me_data(address, false), RequestClass::Idempotent)
        }
        TransferStep::ReadPointer => {
            (give_me_data(EEPROM_POINTER, false), RequestClass::Idempotent)
        }
        TransferStep::SetPointer(address) => (
            super::host_request::assign_instruction(EEPROM_POINTER, address.into(), false),
            RequestClass::ReadBack,
        ),
        TransferStep::Write(memory, word, None) => (
            Instruction::of(0x9020 | memory_bits(memory) << 2, [EEPROM_POINTER, word]),
            RequestClass::NoRetry,
        ),
        TransferStep::Write(memory, low, Some(high)) => (
            Instruction::of(0x9021 | memory_bits(memory) << 2, [EEPROM_POINTER, low, high]),
            RequestClass::NoRetry,
        ),
        TransferStep::Read(memory, address) => (
            Instruction::of(0xB001 | memory_bits(memory) << 2, [0, address]),
            RequestClass::Idempotent,
        ),
        TransferStep::Checksum(memory, start, end) => (
            Instruction::of(0xDA10 | memory_bits(memory) << 5, [0, start, end]),
            RequestClass::Idempotent,
        ),
    }
}

/// The instruction of a command, and its class; `None` for motors, of which an axis ID is one, and for what
/// TML has no instruction for.
pub(super) fn order_instruction(command: ProgramCommand) -> Option<(Instruction, RequestClass)> {
    Some(match command {
        ProgramCommand::Goto(address) => {
            (Instruction::of(0x7400, [address]), RequestClass::NoRetry)
        }
        ProgramCommand::Call(address) => {
            (Instruction::of(0x1C01, [address]), RequestClass::NoRetry)
        }
        ProgramCommand::Abort => (Instruction::of(0x1C02, []), RequestClass::Stop),
        ProgramCommand::End => (Instruction::of(END_OPCODE, []), RequestClass::Stop),
        ProgramCommand::QueryCall => {
            (give_me_data(RULES.call_flag.0, false), RequestClass::Idempotent)
        }
        // No variable or bit of the status shows a running program; a memory of words has no steps.
        _ => return None,
    })
}

/// Program memory holds RAM, SPI memory is the EEPROM.
const fn memory_bits(memory: MemoryKind) -> u16 {
    match memory {
        MemoryKind::Volatile => 0,
        MemoryKind::Permanent => 2,
    }
}
