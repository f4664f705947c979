//! Names for what stands in messages: variables, and instructions in the language.

use crate::explain::TextError;
use crate::profile::{Parameter, Profile};
use crate::proto::tml::instruction::{self, Scope};
use crate::proto::tml::online::{Cell, Memory};
use crate::proto::tml::wire::{IdCode, Instruction};

/// What the profile calls a place.
pub(super) fn variable(
    cell: Cell,
    profile: Option<&'static Profile>,
) -> Option<&'static Parameter> {
    match cell.memory {
        Memory::Data => instruction::name_at(profile, cell.address, cell.long),
        _ => None,
    }
}

/// Shows an instruction in the language.
pub(super) fn disassemble(
    instruction: &Instruction,
    profile: Option<&'static Profile>,
    show: &mut dyn FnMut(&str),
) {
    instruction::disassemble(instruction, &Scope { profile, ..Scope::default() }, show);
}

/// The group that an instruction belongs to.
pub(super) fn category(instruction: &Instruction) -> &'static str {
    let form = instruction::form_of(instruction, &Scope::default());
    form.map_or("unknown instruction", |form| form.category.name())
}

/// Whether the language has instructions of this opcode.
pub(super) fn is_opcode(opcode: u16) -> bool {
    instruction::forms().any(|form| opcode & form.mask == form.opcode)
}

/// Reads an instruction in the language; `sender` is whom answers are for.
pub(super) fn assemble(
    text: &str,
    profile: Option<&'static Profile>,
    sender: IdCode,
) -> Result<Instruction, TextError> {
    instruction::assemble(text, &Scope { profile, sender })
}
