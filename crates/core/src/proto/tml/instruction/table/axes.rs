//! Instructions between drives: the first data word is the other drive.

use super::super::form::FormPiece::{
    Axis, Inner, Memory, Near16, Near32, Pointer, Sign, Step, Var16, Var32, Word,
};
use super::{Category, CodingSource, Form, FormPiece, form, short, whole};
use CodingSource::{Decompiler, Labels};

const fn near(opcode: u16, words: u8, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Axes, short(opcode, words), text, Labels, about)
}

const fn direct(opcode: u16, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Axes, whole(opcode, 3), text, Labels, about)
}

/// Memory and step of the pointer stand in the opcode.
const fn pointed(opcode: u16, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Axes, (opcode, 0xFF73, 3), text, Labels, about)
}

const OPEN: FormPiece = Sign("[");
const CLOSE: FormPiece = Sign("] ");
const FROM: FormPiece = Sign(" = [");
const IS: FormPiece = Sign(" = ");

pub(super) const FORMS: &[Form] = &[
    form(
        Category::Axes,
        (0x9400, 0xFFFC, 2),
        &[OPEN, Axis(0), CLOSE, Sign("{"), Inner(1), Sign("}")],
        Labels,
        "has others carry out an instruction",
    ),
    near(0xB800, 2, &[OPEN, Axis(0), CLOSE, Near16, IS, Var16(1)], "sends 16 bits to others"),
    near(0xBC00, 2, &[OPEN, Axis(0), CLOSE, Near32, IS, Var32(1)], "sends 32 bits to others"),
    direct(
        0x9814,
        &[OPEN, Axis(0), CLOSE, Var16(1), Sign(",dm = "), Var16(2)],
        "sends 16 bits to others",
    ),
    direct(
        0x9815,
        &[OPEN, Axis(0), CLOSE, Var32(1), Sign(",dm = "), Var32(2)],
        "sends 32 bits to others",
    ),
    pointed(
        0x9830,
        &[OPEN, Axis(0), CLOSE, Sign("("), Pointer(1), Step, Sign("),"), Memory, IS, Var16(2)],
        "sends 16 bits to where the others' pointer points",
    ),
    pointed(
        0x9831,
        &[OPEN, Axis(0), CLOSE, Sign("("), Pointer(1), Step, Sign("),"), Memory, IS, Var32(2)],
        "sends 32 bits to where the others' pointer points",
    ),
    direct(
        0x9C04,
        &[Var16(2), FROM, Axis(0), CLOSE, Var16(1), Sign(",dm")],
        "fetches 16 bits from another",
    ),
    direct(
        0x9C05,
        &[Var32(2), FROM, Axis(0), CLOSE, Var32(1), Sign(",dm")],
        "fetches 32 bits from another",
    ),
    pointed(
        0x9D00,
        &[Var16(2), FROM, Axis(0), CLOSE, Sign("("), Pointer(1), Step, Sign("),"), Memory],
        "fetches 16 bits from where another's pointer points",
    ),
    pointed(
        0x9D01,
        &[Var32(2), FROM, Axis(0), CLOSE, Sign("("), Pointer(1), Step, Sign("),"), Memory],
        "fetches 32 bits from where another's pointer points",
    ),
    near(0xE000, 2, &[Var16(1), FROM, Axis(0), CLOSE, Near16], "fetches 16 bits from another"),
    near(0xE400, 2, &[Var32(1), FROM, Axis(0), CLOSE, Near32], "fetches 32 bits from another"),
    form(
        Category::Axes,
        short(0xC000, 0),
        &[Word("SEND"), Near16],
        Decompiler,
        "sends 16 bits to the host of MASTERID",
    ),
    form(
        Category::Axes,
        short(0xC400, 0),
        &[Word("SEND"), Near32],
        Decompiler,
        "sends 32 bits to the host of MASTERID",
    ),
];
