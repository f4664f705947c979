//! Texts about frames in their conversation, added to their explanation.

use core::fmt::Write as _;

use polepair_core::explain::{Context, Dissector as _, ExplainSink as _};
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::CanopenDissector;
use polepair_core::proto::canopen::cia402::OperationMode;
use polepair_core::proto::canopen::cob::{SDO_REPLY, SDO_REQUEST};
use polepair_core::proto::canopen::explain::{explain_block_segment, meanings};
use polepair_core::proto::canopen::sdo::ObjectIndex;

use super::emcy::FaultText;
use super::pdo::Pdo;
use super::process_text::RemarkText;
use super::sdo::{SdoChannel, TransferPart};
use crate::explanation::Explanation;

/// Bytes of a long value that are shown.
const SHOWN: usize = 16;
/// Characters of a text that are shown.
const LETTERS: usize = 64;

/// Explains a frame as if it had the identifier that its service has by default.
pub(super) fn explain_as_default(
    bytes: &[u8],
    id: Option<u32>,
    profile: Option<&'static Profile>,
    explanation: &mut Explanation,
) {
    explanation.clear();
    CanopenDissector.explain(bytes, &Context { profile, id, ..Context::default() }, explanation);
}

/// Adds the part of its transfer to a frame's text. `moved` is true if its identifier is not the usual one.
pub(super) fn annotate_part(
    channel: &SdoChannel,
    part: TransferPart,
    bytes: &[u8],
    reply: bool,
    moved: bool,
    profile: Option<&'static Profile>,
    explanation: &mut Explanation,
) {
    let function = if reply { SDO_REPLY } else { SDO_REQUEST };
    let id = Some(u32::from(function | u16::from(channel.node)));
    if let TransferPart::BlockSegment(_) = part {
        explanation.clear();
        explain_block_segment(bytes, &Context { profile, id, ..Context::default() }, explanation);
    } else if moved {
        explain_as_default(bytes, id, profile, explanation);
    }
    let object = channel.object();
    let ObjectIndex { index, sub } = object;
    match part {
        TransferPart::Plain => {}
        TransferPart::Segment(number) | TransferPart::BlockSegment(number) => {
            let all = channel.segment_total().filter(|all| *all >= number);
            let mut text = format!("segment {number}");
            if let Some(all) = all {
                let _ = write!(text, " of {all}");
            }
            let _ = write!(text, " of 0x{index:04X}:{sub}");
            append_name(object, profile, &mut text);
            append_remark(&text, explanation);
        }
        TransferPart::Complete => annotate_whole(channel, profile, explanation),
    }
}

fn append_name(object: ObjectIndex, profile: Option<&'static Profile>, text: &mut String) {
    match meanings::object_name(object, profile) {
        "" => {}
        name => {
            let _ = write!(text, ", {name}");
        }
    }
}

/// Adds the value of a transfer of several frames.
fn annotate_whole(
    channel: &SdoChannel,
    profile: Option<&'static Profile>,
    explanation: &mut Explanation,
) {
    let (head, len, segments) = channel.value();
    if segments == 0 {
        return;
    }
    let object = channel.object();
    let mut text = format!("0x{:04X}:{}", object.index, object.sub);
    append_name(object, profile, &mut text);
    text.push_str(" = ");
    append_value(head, len, &mut text);
    let _ = write!(text, ", {len} bytes in {segments} segments");
    append_remark(&text, explanation);
}

/// A text, a number, or the first of its bytes.
fn append_value(head: &[u8], len: u32, text: &mut String) {
    let letters = head.strip_suffix(&[0]).unwrap_or(head);
    if !letters.is_empty() && letters.iter().all(|c| c.is_ascii_graphic() || *c == b' ') {
        let shown = letters.iter().take(LETTERS).map(|c| char::from(*c));
        text.push('"');
        text.extend(shown);
        text.push_str(if letters.len() > LETTERS || len as usize > head.len() {
            "…\""
        } else {
            "\""
        });
    } else if len <= 8 {
        let _ = write!(text, "{}", super::bytes_to_word(head));
    } else {
        head.iter().take(SHOWN).for_each(|byte| {
            let _ = write!(text, "{byte:02X} ");
        });
        text.push_str(if head.len() > SHOWN { "…" } else { "" });
    }
}

/// Appends parentheses, in which there are none.
fn append_remark(text: &str, explanation: &mut Explanation) {
    explanation.text.push_str(" (");
    let _ = RemarkText(&mut explanation.text).write_str(text);
    explanation.text.push(')');
}

/// Names the fault of an emergency's short form, in the words of the one drive that has it.
pub(super) fn annotate_inferred(words: &FaultText, explanation: &mut Explanation) {
    append_remark(&format!("inferred: {}", words.text.trim_end_matches('.')), explanation);
}

/// Explains process data, object by object; `id` is their identifier.
pub(super) fn explain_process_data(
    pdo: &mut Pdo,
    bytes: &[u8],
    id: Option<u32>,
    names: (Option<&'static Profile>, OperationMode),
    explanation: &mut Explanation,
) {
    let (profile, mode) = names;
    if explanation.is_values_only() {
        explanation.clear();
        explanation.axis(pdo.node.into());
        let _ = write!(explanation.kind, "{}", pdo.name());
        return;
    }
    explanation.clear();
    if pdo.explain(bytes, profile, mode, explanation) {
        return;
    }
    let usual = pdo.default_cob().map(|cob| u32::from(cob.id()));
    explain_as_default(bytes, usual, profile, explanation);
    if usual.is_none() || usual != id {
        explanation.error = None;
        explanation.axis(pdo.node.into());
        explanation.kind.clear();
        let _ = write!(explanation.kind, "{}", pdo.name());
    }
    if usual.is_none() {
        explain_further_pdo(pdo, bytes, explanation);
    }
}

/// A PDO beyond those of the predefined set, which has no words of its own.
fn explain_further_pdo(pdo: &Pdo, bytes: &[u8], explanation: &mut Explanation) {
    explanation.text.clear();
    let _ = write!(explanation.text, "{}", pdo.name());
    explanation.text.make_ascii_lowercase();
    bytes.iter().for_each(|byte| {
        let _ = write!(explanation.text, " {byte:02X}");
    });
}
