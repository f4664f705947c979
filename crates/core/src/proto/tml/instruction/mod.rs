//! The language itself: text to instructions and back, from one table with a row an instruction.
//!
//! ```
//! use polepair_core::proto::tml::instruction::{LanguageScope, assemble, disassemble};
//!
//! // With a drive's profile, `scope` knows its variables too.
//! let scope = LanguageScope::default();
//! let stop = assemble("stop;", &scope).unwrap();
//! assert_eq!((stop.opcode, stop.data()), (0x01C4, &[][..]));
//! let mut text = String::new();
//! disassemble(&stop, &scope, &mut |piece| text.push_str(piece));
//! assert_eq!(text, "STOP");
//! ```
//!
//! Each row has its sources; a coding that is known only from the pattern of neighbours or from a single decompiler is
//! marked `inferred` \[I\].

mod assemble;
mod disassemble;
mod form;
mod reader;
mod registers;
mod table;
mod variable;

pub use assemble::assemble;
pub use disassemble::{disassemble, disassemble_word, form_of};
pub use form::{Category, CodingCertainty, CodingSource, Form, FormPiece};
pub use registers::{Register, RegisterField, find_register, registers};
pub use table::forms;
pub use variable::{Variable, VariableKind, at_address, find_by_name, name_at_address, symbol};

use super::wire::IdCode;
use crate::profile::Profile;
use crate::program::ProgramLabel;

/// Names for reading and writing texts.
#[derive(Clone, Copy, Debug, Default)]
pub struct LanguageScope<'l> {
    /// Names of variables; without it they are shown by their addresses.
    pub profile: Option<&'static Profile>,
    /// Addressee of replies to requests, or their sender, where the text does not name it.
    pub sender: IdCode,
    /// Names of addresses in the program that the text is of; one without a name is any.
    pub labels: &'l [ProgramLabel<'l>],
}

/// Number of data words after an opcode in a program. `None` for an opcode that the table does not have: the
/// start of the next instruction is then unknown.
#[must_use]
pub fn data_word_count(opcode: u16) -> Option<usize> {
    let mut known = forms().filter(|form| !form.alias && form.category != Category::Online);
    let form = known.find(|form| opcode & form.mask == form.opcode)?;
    Some(form.words_for(opcode).into())
}

/// Directive for words that the table does not have.
const RAW_DIRECTIVE: &str = ".word";

/// Memories as the language names them, in the order of their bits.
const MEMORIES: [&str; 3] = ["pm", "dm", "spi"];

/// Comparisons of a variable with zero, and their bits in a conditional jump.
const CONDITIONS: [(&str, u16); 6] =
    [("LT", 0x10), ("LEQ", 0x08), ("EQ", 0x40), ("NEQ", 0x20), ("GT", 0x04), ("GEQ", 0x02)];
