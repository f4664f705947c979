//! The language of stand-alone programs: the requests of a host, and instructions for programs only.

use super::opcode::{Opcode, Status};
use super::text::{CommandFields, parse, write};
use super::wire::{Instruction, Request};
use crate::explain::TextError;
use crate::program::{InstructionBytes, InstructionFields, InstructionLanguage, InstructionRole};

/// Opcodes from here on are requests of a host, and no instructions.
const CONTROL: u8 = 128;
/// Instructions of the maker's larger modules.
const CAPACITY: usize = 2048;

/// The language.
#[derive(Clone, Copy, Debug)]
pub struct TmclInstructions;

impl InstructionLanguage for TmclInstructions {
    fn extension(&self) -> &'static str {
        "tmc"
    }

    fn capacity(&self) -> usize {
        CAPACITY
    }

    fn mnemonic(&self, n: usize) -> Option<&'static str> {
        let mut known = Opcode::NAMED.iter().filter(|opcode| opcode.number() < CONTROL);
        known.nth(n).map(|opcode| opcode.word())
    }

    fn fields(&self, mnemonic: &str) -> Option<InstructionFields> {
        let opcode = Opcode::of_word(mnemonic).filter(|opcode| opcode.number() < CONTROL)?;
        let shape = CommandFields::of(opcode);
        let count = [shape.kind, shape.motor, shape.value].iter().filter(|has| **has).count();
        Some(InstructionFields { count, words: shape.type_words })
    }

    fn parse(&self, line: &str) -> Result<InstructionBytes, TextError> {
        let Request { opcode, kind, motor, value, .. } = parse(line, 0)?;
        Ok(Instruction { opcode: opcode.number(), kind, motor, value }.bytes())
    }

    fn write(&self, instruction: InstructionBytes, show: &mut dyn FnMut(&str)) {
        let Instruction { opcode, kind, motor, value } = Instruction::from_bytes(instruction);
        write(&Request { address: 0, opcode: Opcode::from(opcode), kind, motor, value }, show);
    }

    fn role(&self, instruction: InstructionBytes) -> InstructionRole {
        use Opcode as O;
        let Instruction { opcode, value, .. } = Instruction::from_bytes(instruction);
        let opcode = O::from(opcode);
        let jumps =
            matches!(opcode, O::Jc | O::Ja | O::Csub | O::Call | O::Vect | O::Rst | O::Djnz);
        let stop = Instruction { opcode: O::Stop.number(), kind: 0, motor: 0, value: 0 }.bytes();
        InstructionRole {
            target: u16::try_from(value).ok().filter(|_| jumps),
            ends: matches!(opcode, O::Stop | O::Ja | O::Rsub | O::Reti | O::Rst),
            empty: matches!(opcode.number(), 0 | u8::MAX) || instruction == stop,
        }
    }

    fn stored_code(&self) -> u32 {
        Status::Loaded.number().into()
    }

    /// 0 stopped, 1 runs, 2 runs one instruction, 3 reset (TMCL reference, 135).
    fn is_running(&self, answer: i64) -> bool {
        matches!(answer, 1 | 2)
    }
}
