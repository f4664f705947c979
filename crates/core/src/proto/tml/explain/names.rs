//! Names for what stands in messages: variables, and instructions in the language.

use crate::explain::{Field, Sink, TextError, Value};
use crate::profile::{Parameter, Profile};
use crate::proto::tml::instruction::{self, Kind, Scope};
use crate::proto::tml::online::{Cell, Memory};
use crate::proto::tml::wire::{IdCode, Instruction, short_operand};

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
    instruction::assemble(text, &Scope { profile, sender, ..Scope::default() })
}

/// How a variable is reached: its address, the page of short addresses that it is on, its type, and
/// the opcodes that assign and ask for it.
pub(super) fn reach(variable: &Parameter, sink: &mut dyn Sink) {
    let Parameter { index: address, encoding, .. } = *variable;
    let kind = Kind::of(encoding);
    let long = u16::from(kind.is_long());
    let mut field = |name, value, meaning| {
        sink.field(Field { name, start: 0, end: 0, value, meaning });
    };
    field("address", Value::Hex(address.into(), 4), "");
    field("type", Value::Text(kind.name()), "");
    match short_operand(address) {
        Some(operand) => {
            let page = if address < 0x0800 { "0200-03FF" } else { "0800-09FF" };
            field("page", Value::Text(page), "short");
            let assign = 0x2000 | long << 10 | operand;
            field("opcode", Value::Hex(assign.into(), 4), "NAME = value");
            let ask = 0xA000 | long << 10 | operand;
            field("short request", Value::Hex(ask.into(), 4), "?TML NAME");
        }
        None => {
            field("page", Value::Text("none"), "whole addresses only");
            field("opcode", Value::Hex((0x9004 | long).into(), 4), "NAME,dm = value");
        }
    }
    field("request", Value::Hex((0xB004 | long).into(), 4), "?NAME");
}
