//! Messages in their conversation: who speaks, what is owed, which values are told.

use super::layout::Said;
use super::{names, say};
use crate::explain::{Awaits, Direction, Effect, Label, Owed, Place, Reading, Sink, Turn, What};
use crate::profile::{Encoding, Profile};
use crate::proto::tml::ask::{assigned, class};
use crate::proto::tml::online::{Cell, Memory, Online, PvtPoint};
use crate::proto::tml::rules;

pub(super) fn turn(said: &Said, serial: bool, direction: Option<Direction>) -> Turn {
    let online = Online::parse(&said.instruction);
    let answer = online.as_ref().is_some_and(is_answer);
    match (direction, answer) {
        (Some(Direction::ToDrive), _) | (None, false) => Turn::Asks(awaits(said, serial)),
        (_, true) if matches!(online, Some(Online::TakeData2 { .. })) => Turn::Tells,
        (_, true) => Turn::Answers,
        (Some(Direction::ToHost), false) => Turn::Aside,
    }
}

/// On RS-232 the connected drive acknowledges whatever is sent, on RS-485 only what goes to it
/// alone; nothing in a frame tells which of the two it is.
fn awaits(said: &Said, serial: bool) -> Awaits {
    let many = said.to.is_none_or(|to| to.group || to.id == 0);
    let opcode = said.instruction.opcode;
    let one = if many { Owed::Perhaps } else { Owed::Exactly(1) };
    Awaits {
        acks: match serial {
            false => Owed::Nothing,
            true if rules::leaves(opcode) => Owed::Perhaps,
            true => one,
        },
        answers: if rules::is_request(opcode) { one } else { Owed::Nothing },
    }
}

/// SAVE, and whatever writes to the EEPROM (memory 2 in the bits of an instruction that writes).
pub(super) fn effect(said: &Said) -> Effect {
    const SAVE: u16 = 0x1C08;
    let opcode = said.instruction.opcode;
    let writes = opcode & 0xFC00 == 0x9000 && opcode >> 2 & 3 == 2;
    match Online::parse(&said.instruction) {
        Some(online) if is_answer(&online) => Effect::NOTHING,
        _ if opcode == SAVE || writes => Effect::KEEPS,
        _ => Effect::of_class(class(&said.instruction)),
    }
}

const fn is_answer(online: &Online) -> bool {
    online.answered_by().is_some()
        || matches!(online, Online::TakeVersion { .. } | Online::TakeChecksum { .. })
}

/// Points of a path count up; whoever sets the mode begins another path.
pub(super) fn place(said: &Said) -> Option<Place> {
    let after = u32::from(PvtPoint::COUNTER_MAX) + 1;
    match Online::parse(&said.instruction) {
        Some(Online::Pvt(point)) => Some(Place::Counts(point.counter.into(), after)),
        Some(Online::Pt(point)) => Some(Place::Counts(point.counter.into(), after)),
        Some(_) => None,
        None if rules::sets_mode(said.instruction.opcode) => Some(Place::Begins),
        None => None,
    }
}

/// The value that a message carries.
pub(super) fn value(said: &Said, profile: Option<&'static Profile>, sink: &mut dyn Sink) {
    let data = |address, long| Cell { memory: Memory::Data, address, long };
    match Online::parse(&said.instruction) {
        Some(Online::TakeData { cell, value, .. }) => tell(cell, value, false, profile, sink),
        Some(
            Online::TakeData2 { address, long, value, .. }
            | Online::GotData { address, long, value, .. },
        ) => tell(data(address, long), value, false, profile, sink),
        Some(Online::Pvt(PvtPoint { position, .. })) => {
            point("path position", position.into(), sink);
        }
        Some(Online::Pt(online)) => point("path position", online.position.into(), sink),
        Some(_) => {}
        None => {
            if let Some((address, value, long)) = assigned(&said.instruction) {
                tell(data(address, long), value, true, profile, sink);
            }
        }
    }
}

fn point(name: &str, raw: i64, sink: &mut dyn Sink) {
    sink.reading(Reading { what: What::Named(name), raw, written: true, part: 0 });
}

fn tell(
    cell: Cell,
    value: u32,
    written: bool,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let variable = names::variable(cell, profile);
    let raw = match (variable.map(|variable| variable.encoding), cell.long) {
        (Some(Encoding::U16), false) => i64::from(value as u16),
        (Some(Encoding::U32), true) => i64::from(value),
        (_, true) => i64::from(value.cast_signed()),
        (_, false) => i64::from((value as u16).cast_signed()),
    };
    let label = Label::of(say::place(cell, None));
    let what = variable.map_or(What::Named(label.as_str()), What::Parameter);
    sink.reading(Reading { what, raw, written, part: 0 });
}
