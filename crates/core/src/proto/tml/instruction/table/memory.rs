//! Memory by address or pointer. In the low byte bit 0 is 32 bits, bits 3 and 2 the memory, bit 4 a
//! variable as source, bit 5 a pointer, bit 7 that the pointer stays.

use super::super::form::FormPiece::{
    Hex, Long, Memory, MemoryHigh, Narrow, Number, Pointer, Sign, Step, Var16, Var32, Wide, Word,
};
use super::{Category, CodingSource, Form, FormPiece, form, whole};
use CodingSource::{Decompiler, Labels, Library};

const fn direct(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Memory, whole(opcode, words), text, source, about)
}

/// Memory and step of the pointer stand in the opcode.
const fn pointed(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Memory, (opcode, 0xFF73, words), text, source, about)
}

/// A sum over memory, whose space is in bits 6 and 5.
const fn sum(
    opcode: u16,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Memory, (opcode, 0xFF9F, 3), text, source, about)
}

const DM: FormPiece = Sign(",dm = ");
const OPEN: FormPiece = Sign("(");
const CLOSE: FormPiece = Sign("),");
const IS: FormPiece = Sign(" = ");
const COMMA: FormPiece = Sign(", ");

pub(super) const FORMS: &[Form] = &[
    direct(0x9004, 2, &[Var16(0), DM, Number(1)], Library, "16 bits of data become a number"),
    direct(0x9005, 3, &[Var32(0), DM, Long(1)], Library, "32 bits of data become a number"),
    direct(0x9014, 2, &[Var16(0), DM, Var16(1)], Labels, "16 bits of data become a variable's"),
    direct(0x9015, 2, &[Var32(0), DM, Var32(1)], Labels, "32 bits of data become a variable's"),
    pointed(
        0x9020,
        2,
        &[OPEN, Pointer(0), Step, CLOSE, Memory, IS, Narrow(1)],
        Labels,
        "writes 16 bits where the pointer points",
    ),
    pointed(
        0x9021,
        3,
        &[OPEN, Pointer(0), Step, CLOSE, Memory, IS, Wide(1)],
        Labels,
        "writes 32 bits where the pointer points",
    ),
    pointed(
        0x9030,
        2,
        &[OPEN, Pointer(0), Step, CLOSE, Memory, IS, Var16(1)],
        Labels,
        "writes a 16-bit variable where the pointer points",
    ),
    pointed(
        0x9031,
        2,
        &[OPEN, Pointer(0), Step, CLOSE, Memory, IS, Var32(1)],
        Labels,
        "writes a 32-bit variable where the pointer points",
    ),
    pointed(
        0x9100,
        2,
        &[Var16(1), Sign(" = ("), Pointer(0), Step, CLOSE, Memory],
        Labels,
        "reads 16 bits from where the pointer points",
    ),
    pointed(
        0x9101,
        2,
        &[Var32(1), Sign(" = ("), Pointer(0), Step, CLOSE, Memory],
        Labels,
        "reads 32 bits from where the pointer points",
    ),
    sum(
        0xDB10,
        &[
            Word("CHECKSUM"),
            Sign(","),
            MemoryHigh,
            Sign(" "),
            Hex(1),
            COMMA,
            Hex(2),
            COMMA,
            Var16(0),
        ],
        Library,
        "sums words of a memory into a variable",
    ),
    sum(
        0xDB90,
        &[
            Word("CHECKSUM"),
            Sign(","),
            MemoryHigh,
            Sign(" "),
            Var16(1),
            COMMA,
            Var16(2),
            COMMA,
            Var16(0),
        ],
        Decompiler,
        "the same from and to where variables point",
    ),
];
