//! Words for what frames mean in their conversation, behind what they say by themselves.

use core::fmt::Write as _;

use polepair_core::explain::{Context, Dissector as _, Sink as _};
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::CanopenDissector;
use polepair_core::proto::canopen::cob::{SDO_REPLY, SDO_REQUEST};
use polepair_core::proto::canopen::explain::{explain_part, say};
use polepair_core::proto::canopen::sdo::Object;

use super::emcy::Words;
use super::pdo::Pdo;
use super::sdo::{Channel, Part};
use super::wording::Clean;
use crate::explained::Explained;

/// Bytes of a long value that are shown.
const SHOWN: usize = 16;
/// Characters of a text that are shown.
const LETTERS: usize = 64;

/// Explains a frame as if it had the identifier that its service has by default.
pub(super) fn by_default(
    bytes: &[u8],
    id: Option<u32>,
    profile: Option<&'static Profile>,
    said: &mut Explained,
) {
    said.clear();
    CanopenDissector.explain(bytes, &Context { profile, id, ..Context::default() }, said);
}

/// Says what a frame is in its transfer. `moved` tells that its identifier is not the usual one.
pub(super) fn part(
    channel: &Channel,
    part: Part,
    bytes: &[u8],
    (reply, moved): (bool, bool),
    profile: Option<&'static Profile>,
    said: &mut Explained,
) {
    let function = if reply { SDO_REPLY } else { SDO_REQUEST };
    let id = Some(u32::from(function | u16::from(channel.node)));
    if let Part::BlockSegment(_) = part {
        said.clear();
        explain_part(bytes, &Context { profile, id, ..Context::default() }, said);
    } else if moved {
        by_default(bytes, id, profile, said);
    }
    let object = channel.object();
    let Object { index, sub } = object;
    match part {
        Part::Plain => {}
        Part::Segment(number) | Part::BlockSegment(number) => {
            let all = channel.segments_in_all().filter(|all| *all >= number);
            let mut text = format!("segment {number}");
            if let Some(all) = all {
                let _ = write!(text, " of {all}");
            }
            let _ = write!(text, " of 0x{index:04X}:{sub}");
            named(object, profile, &mut text);
            remark(&text, said);
        }
        Part::Whole => whole(channel, profile, said),
    }
}

fn named(object: Object, profile: Option<&'static Profile>, text: &mut String) {
    match say::name(object, profile) {
        "" => {}
        name => {
            let _ = write!(text, ", {name}");
        }
    }
}

/// What a transfer of several frames brought.
fn whole(channel: &Channel, profile: Option<&'static Profile>, said: &mut Explained) {
    let (head, len, segments) = channel.value();
    if segments == 0 {
        return;
    }
    let object = channel.object();
    let mut text = format!("0x{:04X}:{}", object.index, object.sub);
    named(object, profile, &mut text);
    text.push_str(" = ");
    value(head, len, &mut text);
    let _ = write!(text, ", {len} bytes in {segments} segments");
    remark(&text, said);
}

/// A text, a number, or the first of its bytes.
fn value(head: &[u8], len: u32, text: &mut String) {
    let letters = head.strip_suffix(&[0]).unwrap_or(head);
    let is_text = |c: &u8| c.is_ascii_graphic() || *c == b' ';
    if !letters.is_empty() && letters.iter().all(is_text) {
        let shown = letters.iter().take(LETTERS).map(|c| char::from(*c));
        text.push('"');
        text.extend(shown);
        text.push_str(if letters.len() > LETTERS || len as usize > head.len() {
            "…\""
        } else {
            "\""
        });
    } else if len <= 8 {
        let _ = write!(text, "{}", super::word(head));
    } else {
        head.iter().take(SHOWN).for_each(|byte| {
            let _ = write!(text, "{byte:02X} ");
        });
        text.push_str(if head.len() > SHOWN { "…" } else { "" });
    }
}

/// Appends parentheses, in which there are none.
fn remark(text: &str, said: &mut Explained) {
    said.text.push_str(" (");
    let _ = Clean(&mut said.text).write_str(text);
    said.text.push(')');
}

/// Says which fault the short form of an emergency is, in the words of the one drive that has it.
pub(super) fn inferred(words: &Words, said: &mut Explained) {
    remark(&format!("inferred: {}", words.text.trim_end_matches('.')), said);
}

/// Says what process data are, object by object; `id` is the identifier that they came with.
pub(super) fn process(
    pdo: &mut Pdo,
    bytes: &[u8],
    id: Option<u32>,
    profile: Option<&'static Profile>,
    said: &mut Explained,
) {
    if said.is_bare() {
        (said.error, said.axis) = (None, Some(pdo.node.into()));
        return;
    }
    said.clear();
    if pdo.say(bytes, profile, said) {
        return;
    }
    let usual = pdo.default_cob().map(|cob| u32::from(cob.id()));
    by_default(bytes, usual, profile, said);
    if usual.is_none() || usual != id {
        said.error = None;
        said.axis(pdo.node.into());
        said.kind.clear();
        let _ = write!(said.kind, "{}", pdo.name());
    }
    if usual.is_none() {
        further(pdo, bytes, said);
    }
}

/// A PDO beyond those of the predefined set, which has no words of its own.
fn further(pdo: &Pdo, bytes: &[u8], said: &mut Explained) {
    said.text.clear();
    let _ = write!(said.text, "{}", pdo.name());
    said.text.make_ascii_lowercase();
    bytes.iter().for_each(|byte| {
        let _ = write!(said.text, " {byte:02X}");
    });
}
