//! Assignments, sums, products and shifts.

use super::super::form::FormPiece::{
    Count, Far16, Far32, Hex, Long, Near16, Near32, Number, Sign, Var16, Var32, Word,
};
use super::{Category, CodingSource, Form, FormPiece, form, short, whole};
use CodingSource::{Labels, Library, Manual};

const fn near(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Arithmetic, short(opcode, words), text, source, about)
}

const fn with(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Arithmetic, whole(opcode, words), text, source, about)
}

/// A shift by up to 15 bits, whose number is in the opcode.
const fn shift(opcode: u16, words: u8, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Arithmetic, (opcode, 0xFFF0, words), text, Labels, about)
}

const IS: FormPiece = Sign(" = ");
const MINUS: FormPiece = Sign(" = -");
const ADD: FormPiece = Sign(" += ");
const SUBTRACT: FormPiece = Sign(" -= ");
const COMMA: FormPiece = Sign(", ");
const UP: FormPiece = Sign(" <<= ");
const DOWN: FormPiece = Sign(" >>= ");
const TIMES: FormPiece = Sign(" * ");
const BY: FormPiece = Count(4, 15);

pub(super) const FORMS: &[Form] = &[
    with(0x2CB2, 1, &[Word("STA")], Library, "makes the actual position the target")
        .with(&[0x0228]),
    near(0x2000, 1, &[Near16, IS, Number(0)], Manual, "16 bits become a number"),
    near(0x2400, 2, &[Near32, IS, Long(0)], Library, "32 bits become a number"),
    near(0x2800, 1, &[Near16, IS, Var16(0)], Labels, "16 bits become another variable's"),
    near(0x2C00, 1, &[Near32, IS, Var32(0)], Labels, "32 bits become another variable's"),
    near(0x3000, 1, &[Near16, MINUS, Var16(0)], Labels, "16 bits become minus another's"),
    near(0x3400, 1, &[Near32, MINUS, Var32(0)], Labels, "32 bits become minus another's"),
    near(0x3800, 1, &[Near16, ADD, Number(0)], Labels, "adds a number to 16 bits"),
    near(0x3C00, 2, &[Near32, ADD, Long(0)], Labels, "adds a number to 32 bits"),
    near(0x4000, 1, &[Near16, ADD, Var16(0)], Labels, "adds a variable to 16 bits"),
    near(0x4400, 1, &[Near32, ADD, Var32(0)], Labels, "adds a variable to 32 bits"),
    near(0x4800, 1, &[Near16, SUBTRACT, Number(0)], Labels, "takes a number from 16 bits"),
    near(0x4C00, 2, &[Near32, SUBTRACT, Long(0)], Labels, "takes a number from 32 bits"),
    near(0x5000, 1, &[Near16, SUBTRACT, Var16(0)], Labels, "takes a variable from 16 bits"),
    near(0x5400, 1, &[Near32, SUBTRACT, Var32(0)], Labels, "takes a variable from 32 bits"),
    near(
        0x5800,
        2,
        &[Word("SRB"), Near16, COMMA, Hex(0), COMMA, Hex(1)],
        Library,
        "keeps the bits of the first mask, sets those of the second",
    ),
    with(
        0x5C00,
        3,
        &[Word("SRBL"), Var16(0), COMMA, Hex(1), COMMA, Hex(2)],
        Library,
        "the same for a variable anywhere",
    ),
    with(
        0x5C00,
        3,
        &[Word("SRB"), Far16(0), COMMA, Hex(1), COMMA, Hex(2)],
        Library,
        "the same for a variable anywhere",
    )
    .alias(),
    with(0x8400, 2, &[Word("SAP"), Long(0)], Labels, "makes a number the actual position"),
    near(0x8000, 0, &[Word("SAP"), Near32], Labels, "makes a variable the actual position"),
    with(0xDC01, 2, &[Var32(0), Sign(" /= "), Var16(1)], Labels, "divides 32 bits by 16"),
    shift(0x8880, 0, &[Word("PROD"), DOWN, BY], "shifts the product right"),
    shift(0x88A0, 0, &[Word("PROD"), UP, BY], "shifts the product left"),
    shift(0x8800, 1, &[Var16(0), DOWN, BY], "shifts 16 bits right"),
    shift(0x8820, 1, &[Var16(0), UP, BY], "shifts 16 bits left"),
    shift(0x8900, 1, &[Var32(0), DOWN, BY], "shifts 32 bits right"),
    shift(0x8920, 1, &[Var32(0), UP, BY], "shifts 32 bits left"),
    form(
        Category::Arithmetic,
        (0x8960, 0xFFE0, 2),
        &[Var32(0), IS, Var16(1), Sign(" << "), Count(5, 16)],
        Labels,
        "32 bits become 16, shifted left",
    ),
    shift(
        0x8C00,
        2,
        &[Var16(0), TIMES, Number(1), Sign(" >> "), BY],
        "multiplies into PROD, shifted right",
    ),
    shift(
        0x8C20,
        2,
        &[Var16(0), TIMES, Number(1), Sign(" << "), BY],
        "multiplies into PROD, shifted left",
    ),
    shift(
        0x8C80,
        2,
        &[Var16(0), TIMES, Var16(1), Sign(" >> "), BY],
        "multiplies into PROD, shifted right",
    ),
    shift(
        0x8CA0,
        2,
        &[Var16(0), TIMES, Var16(1), Sign(" << "), BY],
        "multiplies into PROD, shifted left",
    ),
    shift(
        0x8D00,
        2,
        &[Var32(0), TIMES, Number(1), Sign(" >> "), BY],
        "multiplies into PROD, shifted right",
    ),
    shift(
        0x8D20,
        2,
        &[Var32(0), TIMES, Number(1), Sign(" << "), BY],
        "multiplies into PROD, shifted left",
    ),
    shift(
        0x8D80,
        2,
        &[Var32(0), TIMES, Var16(1), Sign(" >> "), BY],
        "multiplies into PROD, shifted right",
    ),
    shift(
        0x8DA0,
        2,
        &[Var32(0), TIMES, Var16(1), Sign(" << "), BY],
        "multiplies into PROD, shifted left",
    ),
    with(0x9004, 2, &[Far16(0), IS, Number(1)], Library, "the same beyond the short pages").alias(),
    with(0x9005, 3, &[Far32(0), IS, Long(1)], Library, "the same beyond the short pages").alias(),
    with(0x9014, 2, &[Far16(0), IS, Var16(1)], Labels, "the same beyond the short pages").alias(),
    with(0x9015, 2, &[Far32(0), IS, Var32(1)], Labels, "the same beyond the short pages").alias(),
];
