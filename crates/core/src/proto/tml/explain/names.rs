//! Names in messages: variables, and instructions of the language.

use crate::explain::{ExplainSink, Field, FieldValue, TextError};
use crate::profile::{Parameter, Profile};
use crate::proto::tml::instruction::{self, LanguageScope, VariableKind};
use crate::proto::tml::online::{Cell, MemorySpace};
use crate::proto::tml::wire::{IdCode, Instruction, short_operand};

/// Variable of the profile at an address.
pub(super) fn find_variable(
    cell: Cell,
    profile: Option<&'static Profile>,
) -> Option<&'static Parameter> {
    match cell.memory {
        MemorySpace::Data => instruction::name_at_address(profile, cell.address, cell.long),
        _ => None,
    }
}

/// Shows an instruction in the language.
pub(super) fn disassemble(
    instruction: &Instruction,
    profile: Option<&'static Profile>,
    show: &mut dyn FnMut(&str),
) {
    instruction::disassemble(
        instruction,
        &LanguageScope { profile, ..LanguageScope::default() },
        show,
    );
}

/// The group that an instruction belongs to.
pub(super) fn category(instruction: &Instruction) -> &'static str {
    let form = instruction::form_of(instruction, &LanguageScope::default());
    form.map_or("unknown instruction", |form| form.category.name())
}

/// Returns whether the language has such an instruction.
pub(super) fn is_known(instruction: &Instruction) -> bool {
    instruction::form_of(instruction, &LanguageScope::default()).is_some()
}

/// Returns whether the language has instructions of this opcode.
pub(super) fn is_opcode(opcode: u16) -> bool {
    instruction::forms().any(|form| opcode & form.mask == form.opcode)
}

/// Reads an instruction in the language; `sender` is whom answers are for.
pub(super) fn assemble(
    text: &str,
    profile: Option<&'static Profile>,
    sender: IdCode,
) -> Result<Instruction, TextError> {
    instruction::assemble(text, &LanguageScope { profile, sender, ..LanguageScope::default() })
}

/// Explains the access to a variable: its address, its page of short addresses, its type, and the opcodes that assign
/// and read it.
pub(in crate::proto::tml) fn explain_reach(variable: &Parameter, sink: &mut dyn ExplainSink) {
    let Parameter { index, encoding, .. } = *variable;
    let kind = VariableKind::of(encoding);
    let long = u16::from(kind.is_long());
    let mut field = |name, value, meaning| {
        sink.field(Field { name, start: 0, end: 0, value, meaning });
    };
    field("address", FieldValue::Hex(index.into(), 4), "");
    field("type", FieldValue::Text(kind.name()), "");
    match short_operand(index) {
        Some(operand) => {
            let page = if index < 0x0800 { "0200-03FF" } else { "0800-09FF" };
            field("page", FieldValue::Text(page), "short");
            let assign = 0x2000 | long << 10 | operand;
            field("opcode", FieldValue::Hex(assign.into(), 4), "NAME = value");
            let query = 0xA000 | long << 10 | operand;
            field("short request", FieldValue::Hex(query.into(), 4), "?TML NAME");
        }
        None => {
            field("page", FieldValue::Text("none"), "whole addresses only");
            field("opcode", FieldValue::Hex((0x9004 | long).into(), 4), "NAME,dm = value");
        }
    }
    field("request", FieldValue::Hex((0xB004 | long).into(), 4), "?NAME");
}
