//! The table of instructions, one file for each group.

mod arithmetic;
mod axes;
mod control;
mod event;
mod flow;
mod memory;
mod mode;
mod online;
mod output;

use super::form::{Category, CodingSource, Form, FormPiece, form};

/// Every form, special ones before the general ones that they are cases of.
pub fn forms() -> impl Iterator<Item = &'static Form> {
    let groups: [&'static [Form]; 9] = [
        control::FORMS,
        flow::FORMS,
        memory::FORMS,
        mode::FORMS,
        event::FORMS,
        output::FORMS,
        axes::FORMS,
        online::FORMS,
        arithmetic::FORMS,
    ];
    groups.into_iter().flatten()
}

/// An instruction without operand bits in its opcode.
const fn whole(opcode: u16, words: u8) -> (u16, u16, u8) {
    (opcode, 0xFFFF, words)
}

/// An instruction whose opcode names a variable: bits 8 to 0, and bit 9 for the page.
const fn short(opcode: u16, words: u8) -> (u16, u16, u8) {
    (opcode, 0xFC00, words)
}

/// An instruction that is one word, in text and on the wire.
const fn plain(
    category: Category,
    opcode: u16,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(category, whole(opcode, 0), text, source, about)
}
