//! Digital inputs and outputs: the first data word has a bit for each line.

use super::super::form::FormPiece::{Line, Lines, Number, Sign, Var16, Word};
use super::{Category, CodingSource, Form, FormPiece, form, whole};
use CodingSource::{Labels, Library, Pattern};

const fn with(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::InputOutput, whole(opcode, words), text, source, about)
}

const IS: FormPiece = Sign(" = ");

pub(super) const FORMS: &[Form] = &[
    with(0xE800, 2, &[Var16(1), IS, Word("IN"), Lines(0)], Labels, "reads inputs"),
    with(0xE800, 2, &[Var16(1), IS, Word("IN"), Sign("#"), Line(0)], Pattern, "reads an input")
        .alias(),
    with(0xEC00, 2, &[Word("OUT"), Lines(0), IS, Number(1)], Library, "sets outputs"),
    with(0xED00, 2, &[Word("OUT"), Lines(0), IS, Var16(1)], Labels, "sets outputs by a variable"),
    with(0xEE00, 1, &[Word("SetAsInput"), Lines(0)], Labels, "makes lines inputs"),
    with(0xEF00, 1, &[Word("SetAsOutput"), Lines(0)], Labels, "makes lines outputs"),
];
