//! Jumps, calls, functions, interrupts and waiting.

use super::super::form::FormPiece::{Condition, Count, Long, Sign, Target, Var16, Var32, Word};
use super::{Category, CodingSource, Form, FormPiece, form, whole};
use CodingSource::{Decompiler, Labels, Library};

const fn with(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Flow, whole(opcode, words), text, source, about)
}

/// A jump on the comparison of a variable with zero: its bits stand in the opcode.
const fn conditional(opcode: u16, text: &'static [FormPiece], source: CodingSource) -> Form {
    form(Category::Flow, (opcode, 0xFF81, 2), text, source, "the same if the variable is so")
}

pub(super) const FORMS: &[Form] = &[
    with(0x0404, 0, &[Word("RET")], Labels, "returns from a function"),
    with(0x0504, 0, &[Word("RETI")], Labels, "returns from an interrupt"),
    with(0x0410, 0, &[Word("DINT")], Labels, "disables interrupts"),
    with(0x0510, 0, &[Word("EINT")], Labels, "enables interrupts"),
    with(0x0408, 0, &[Word("WAIT"), Sign("!")], Labels, "waits for the event"),
    with(
        0x0608,
        2,
        &[Word("WAIT"), Sign("! "), Long(0)],
        Labels,
        "waits for the event, at most so many slow loops",
    ),
    with(0x7400, 1, &[Word("GOTO"), Target(0)], Labels, "goes on elsewhere"),
    with(0x7600, 1, &[Word("GOTO"), Var16(0)], Labels, "goes on where the variable points"),
    with(0x7401, 1, &[Word("CALL"), Target(0)], Library, "calls a function"),
    with(0x7601, 1, &[Word("CALL"), Var16(0)], Library, "calls where the variable points"),
    conditional(0x7480, &[Word("GOTO"), Target(1), COMMA, Var16(0), COMMA, Condition], Labels),
    conditional(0x7580, &[Word("GOTO"), Target(1), COMMA, Var32(0), COMMA, Condition], Labels),
    conditional(0x7481, &[Word("CALL"), Target(1), COMMA, Var16(0), COMMA, Condition], Labels),
    conditional(0x7581, &[Word("CALL"), Target(1), COMMA, Var32(0), COMMA, Condition], Labels),
    conditional(0x7680, &[Word("GOTO"), Var16(1), COMMA, Var16(0), COMMA, Condition], Decompiler),
    conditional(0x7780, &[Word("GOTO"), Var16(1), COMMA, Var32(0), COMMA, Condition], Decompiler),
    conditional(0x7681, &[Word("CALL"), Var16(1), COMMA, Var16(0), COMMA, Condition], Decompiler),
    conditional(0x7781, &[Word("CALL"), Var16(1), COMMA, Var32(0), COMMA, Condition], Decompiler),
    with(0x1C01, 1, &[Word("CALLS"), Target(0)], Library, "calls a function that ABORT ends"),
    with(0x1E01, 1, &[Word("CALLS"), Var16(0)], Library, "the same where the variable points"),
    with(0x1C02, 0, &[Word("ABORT")], Labels, "ends the function that CALLS began"),
    form(
        Category::Flow,
        (0x1C80, 0xFFF0, 0),
        &[Word("FUNCTION"), Count(4, 15)],
        Library,
        "calls a function of the function table",
    ),
    form(
        Category::Flow,
        (0xEA00, 0xFFC0, 0),
        &[Word("HOMING"), Count(6, 63)],
        Decompiler,
        "runs a homing routine",
    ),
];

const COMMA: FormPiece = Sign(", ");
