//! Requests and answers on the line: `?` asks with GiveMeData, `??` with GiveMeData2, `?TML` with
//! GetTMLData, and `==` answers.

use super::super::form::FormPiece::{
    AxisNumber, From, FromAxis, Hex, Long, MemoryHigh, Near16, Near32, Number, Sign, Var16, Var32,
    Version, Word,
};
use super::{Category, CodingSource, Form, FormPiece, form, short, whole};
use CodingSource::{Labels, Library, Manual, Pattern};

const fn with(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Online, whole(opcode, words), text, source, about)
}

const fn near(opcode: u16, words: u8, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Online, short(opcode, words), text, Labels, about)
}

/// A message with the sender's axis ID in the opcode.
const fn signed(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Online, (opcode, 0xFF00, words), text, source, about)
}

/// A sum over memory, whose space is in bits 6 and 5.
const fn sum(words: u8, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Online, (0xDA10, 0xFF9F, words), text, Labels, about)
}

/// `?NAME`, `?NAME,spi`, `?NAME,pm`: the same of each memory.
macro_rules! requests {
    ($ask:literal, $code:literal, $name:literal) => {
        [
            with($code | 4, 2, &[Sign($ask), Var16(1), From(0)], Manual, $name),
            with($code | 5, 2, &[Sign($ask), Var32(1), From(0)], Manual, $name),
            with($code, 2, &[Sign($ask), Var16(1), Sign(",pm"), From(0)], Pattern, $name),
            with($code | 1, 2, &[Sign($ask), Var32(1), Sign(",pm"), From(0)], Pattern, $name),
            with($code | 8, 2, &[Sign($ask), Var16(1), Sign(",spi"), From(0)], Library, $name),
            with($code | 9, 2, &[Sign($ask), Var32(1), Sign(",spi"), From(0)], Library, $name),
        ]
    };
}

const ONE: [Form; 6] = requests!("?", 0xB000, "GiveMeData: asks one axis");
const MANY: [Form; 6] = requests!("??", 0xB200, "GiveMeData2: asks axes or groups");
const EQUALS: FormPiece = Sign(" == ");
const COMMA: FormPiece = Sign(", ");

pub(super) const FORMS: &[Form] = &[
    near(0xA000, 1, &[Sign("?"), Word("TML"), Near16, From(0)], "GetTMLData: asks for 16 bits"),
    near(0xA400, 1, &[Sign("?"), Word("TML"), Near32, From(0)], "GetTMLData: asks for 32 bits"),
    near(0xA800, 2, &[Word("TML"), Near16, EQUALS, Number(1), From(0)], "TakeTMLData: answers"),
    near(0xAC00, 3, &[Word("TML"), Near32, EQUALS, Long(1), From(0)], "TakeTMLData: answers"),
    sum(
        3,
        &[
            Sign("?"),
            Word("CHECKSUM"),
            Sign(","),
            MemoryHigh,
            Sign(" "),
            Hex(1),
            COMMA,
            Hex(2),
            From(0),
        ],
        "asks for the sum of a memory's words",
    ),
    sum(1, &[Word("CHECKSUM"), Sign(","), MemoryHigh, EQUALS, Hex(0)], "answers with the sum"),
    with(0xD801, 1, &[Word("GETVERSION"), From(0)], Labels, "asks for the firmware's version"),
    with(0xD801, 2, &[Word("VERSION"), EQUALS, Version(0)], Labels, "answers with the version"),
    with(0xD600, 2, &[Word("PING"), Hex(1), From(0)], Labels, "asks who is there"),
    signed(0xD600, 2, &[Word("PONG"), AxisNumber, EQUALS, Version(0)], Labels, "answers PING"),
    ONE[0],
    ONE[1],
    ONE[2],
    ONE[3],
    ONE[4],
    ONE[5],
    signed(
        0xD400,
        2,
        &[Sign("??"), Var16(0), EQUALS, Number(1), FromAxis],
        Manual,
        "TakeData2: answers GiveMeData2, or comes unasked",
    ),
    signed(
        0xD500,
        3,
        &[Sign("??"), Var32(0), EQUALS, Long(1), FromAxis],
        Manual,
        "TakeData2: answers GiveMeData2, or comes unasked",
    ),
    MANY[0],
    MANY[1],
    MANY[2],
    MANY[3],
    MANY[4],
    MANY[5],
    with(
        0xB404,
        3,
        &[Var16(1), EQUALS, Number(2), From(0)],
        Manual,
        "TakeData: answers GiveMeData",
    ),
    with(0xB405, 4, &[Var32(1), EQUALS, Long(2), From(0)], Manual, "TakeData: answers GiveMeData"),
    with(
        0xB400,
        3,
        &[Var16(1), Sign(",pm == "), Number(2), From(0)],
        Pattern,
        "TakeData: answers GiveMeData",
    ),
    with(
        0xB401,
        4,
        &[Var32(1), Sign(",pm == "), Long(2), From(0)],
        Pattern,
        "TakeData: answers GiveMeData",
    ),
    with(
        0xB408,
        3,
        &[Var16(1), Sign(",spi == "), Number(2), From(0)],
        Library,
        "TakeData: answers GiveMeData",
    ),
    with(
        0xB409,
        4,
        &[Var32(1), Sign(",spi == "), Long(2), From(0)],
        Library,
        "TakeData: answers GiveMeData",
    ),
];
