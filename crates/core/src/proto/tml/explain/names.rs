//! Names for what stands in messages: variables, and instructions as their words.

use core::fmt::Write as _;

use super::say::Text;
use crate::explain::{Sink, TextError};
use crate::profile::{Encoding, Parameter, Profile};
use crate::proto::tml::online::{Cell, Memory};
use crate::proto::tml::wire::Instruction;

/// What the profile calls a place.
pub(super) fn variable(
    cell: Cell,
    profile: Option<&'static Profile>,
) -> Option<&'static Parameter> {
    if cell.memory != Memory::Data {
        return None;
    }
    let wide = |p: &Parameter| !matches!(p.encoding, Encoding::U16 | Encoding::I16 | Encoding::Bit);
    let mut parameters = profile?.parameters.iter();
    parameters.find(|p| p.index == cell.address && wide(p) == cell.long)
}

/// Shows an instruction as its words.
pub(super) fn disassemble(instruction: &Instruction, sink: &mut dyn Sink) {
    let _ = write!(Text(sink), "{instruction:?}");
}

/// Reads an instruction written as its words: `205E 1234`.
pub(super) fn assemble(text: &str) -> Result<Instruction, TextError> {
    let expected = "an opcode and at most four data words, as four hexadecimal digits each";
    let mut words = [0; 5];
    let mut count = 0;
    for word in text.split_whitespace() {
        let at = word.as_ptr() as usize - text.as_ptr() as usize;
        let place = words.get_mut(count).ok_or(TextError { at, expected })?;
        *place = u16::from_str_radix(word, 16).map_err(|_| TextError { at, expected })?;
        count += 1;
    }
    let data = words.get(1..count).ok_or(TextError { at: 0, expected })?;
    Instruction::new(words[0], data).ok_or(TextError { at: 0, expected })
}
