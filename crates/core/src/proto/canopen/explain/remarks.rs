//! Explains a message in a line.

use core::fmt::Write as _;

use super::fields;
use super::meanings::{self, SinkWriter};
use crate::explain::{Context, ExplainSink, NumberPlace, NumberStyle};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::proto::canopen::cob::Cob;
use crate::proto::canopen::sdo::{ExpeditedData, ObjectIndex, SdoReply, SdoRequest};
use crate::proto::canopen::text::{self, Statement};
use crate::proto::canopen::{emcy, lss};

/// The message in its language, and a remark in parentheses.
pub(super) fn write_meaning(
    statement: &Statement,
    frame: &Frame,
    node: u8,
    context: &Context<'_>,
    sink: &mut dyn ExplainSink,
) {
    let signs = |object| meanings::is_signed(object, context.profile);
    let again = statement.frame(node);
    // A request for a state has any length.
    let same = frame.remote || again.bytes() == frame.bytes();
    if let Statement::Reply(SdoReply::Value(object, short), 8) = *statement
        && same
        && let Some(place) = meanings::number_place(object, short, context.profile)
    {
        return write_number(object, short, place, context.profile, sink);
    }
    let mut pieces = SinkWriter(sink);
    let written = same && text::write(statement, &signs, &mut pieces).unwrap_or(false);
    if !written {
        let _ = text::write(&Statement::Raw(*frame), &signs, &mut pieces);
    }
    write_remark(statement, frame, context, sink);
}

/// Writes the answer to a read, `value 0x6064:0 i32 53910 (position actual = 53910)`, with the places of its numbers.
fn write_number(
    object: ObjectIndex,
    short: ExpeditedData,
    place: NumberPlace,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let raw = meanings::decode_number(object, short.bits, short.len, profile);
    sink.text("value ");
    write_digits(object.index.into(), NumberStyle::Hex(4), sink);
    sink.text(":");
    write_digits(object.sub.into(), NumberStyle::Whole, sink);
    let (letter, style) = if place.is_signed {
        (" i", NumberStyle::Whole)
    } else {
        (" u", NumberStyle::Hex(2 * short.len))
    };
    sink.text(letter);
    write_digits(8 * i64::from(short.len), NumberStyle::Whole, sink);
    sink.text(" ");
    sink.number(raw, style, place);
    let mut remark = RemarkWriter { sink, open: false };
    let _ = meanings::write_label(object, profile, &mut remark);
    remark.open();
    remark.sink.number(raw, NumberStyle::Whole, place);
    let _ = meanings::write_meaning(object, raw, profile, &mut remark);
    sink.text(")");
}

fn write_digits(number: i64, style: NumberStyle, sink: &mut dyn ExplainSink) {
    if let Some(digits) = style.text_of(number) {
        sink.text(digits.as_str());
    }
}

/// Remark beyond the language, in parentheses.
fn write_remark(
    statement: &Statement,
    frame: &Frame,
    context: &Context<'_>,
    sink: &mut dyn ExplainSink,
) {
    let mut out = RemarkWriter { sink, open: false };
    let _ = write_remarks(statement, frame, context, &mut out);
    if out.open {
        sink.text(")");
    }
}

/// Parentheses that open with the first piece.
struct RemarkWriter<'a> {
    sink: &'a mut dyn ExplainSink,
    open: bool,
}

impl RemarkWriter<'_> {
    fn open(&mut self) {
        if !self.open {
            self.sink.text(" (");
            self.open = true;
        }
    }
}

impl core::fmt::Write for RemarkWriter<'_> {
    fn write_str(&mut self, piece: &str) -> core::fmt::Result {
        if !piece.is_empty() {
            self.open();
        }
        // A parenthesis would end the remark, a semicolon the instruction.
        if !piece.bytes().any(|byte| matches!(byte, b';' | b'(' | b')')) {
            self.sink.text(piece);
            return Ok(());
        }
        for (at, part) in piece.split(';').enumerate() {
            self.sink.text(if at > 0 { "," } else { "" });
            part.split(['(', ')']).for_each(|part| self.sink.text(part));
        }
        Ok(())
    }
}

fn write_remarks(
    statement: &Statement,
    frame: &Frame,
    context: &Context<'_>,
    out: &mut RemarkWriter<'_>,
) -> core::fmt::Result {
    let profile = context.profile;
    match *statement {
        Statement::Request(SdoRequest::Write(object, short), _)
        | Statement::Reply(SdoReply::Value(object, short), _)
            if meanings::is_part_of_word(object, short.len) && short.bits <= 0xFF =>
        {
            meanings::write_label(object, profile, out)?;
            write!(out, "{}; one byte of two, so no state", short.bits)?;
        }
        Statement::Request(SdoRequest::Write(object, short), _)
        | Statement::Reply(SdoReply::Value(object, short), _) => {
            meanings::write_value(
                object,
                meanings::decode_number(object, short.bits, short.len, profile),
                profile,
                out,
            )?;
            if matches!(short.len, 1..=3) && short.bits >> (8 * short.len) != 0 {
                let len = meanings::value_len(object, short.bits, short.len, profile);
                out.write_str(if len > short.len {
                    "; the command's size is too small for it"
                } else {
                    "; the unused bytes are not zero"
                })?;
            }
        }
        Statement::Reply(SdoReply::Written(object, echo), _) => {
            out.write_str(meanings::object_name(object, profile))?;
            if echo != 0 {
                out.write_str(if out.open { "; " } else { "" })?;
                out.write_str("repeats the data, which the standard leaves zero")?;
            }
        }
        Statement::Request(SdoRequest::Abort(_, abort), _)
        | Statement::Reply(SdoReply::Abort(_, abort), _) => {
            out.write_str(meanings::abort_text(abort))?;
            let name = statement.object().map(|object| meanings::object_name(object, profile));
            if let Some(name) = name.filter(|name| !name.is_empty()) {
                write!(out, ": {name}")?;
            }
        }
        Statement::Emergency(emergency, short) => {
            write_emergency_remark(emergency.code, short, profile, out)?
        }
        Statement::Process { len, .. } => write_process_remark(frame, len, profile, out)?,
        Statement::LssReply(
            lss::LssReply::SetNode(error @ 1.., _)
            | lss::LssReply::SetBitTiming(error @ 1.., _)
            | lss::LssReply::Store(error @ 1.., _),
        ) => write!(out, "refused, error {error}")?,
        Statement::Lss(lss::LssRequest::SetBitTiming(0, index)) => {
            match lss::KBIT_PER_S.get(usize::from(index)) {
                Some(rate @ 1..) => write!(out, "{rate} kbit/s")?,
                _ => out.write_str("no bit rate of the standard's table")?,
            }
        }
        Statement::State(heartbeat) if heartbeat.toggle => out.write_str("answer to guarding")?,
        Statement::Guard => out.write_str("asks for the state")?,
        _ => {
            let object =
                statement.object().map_or("", |object| meanings::object_name(object, profile));
            out.write_str(object)?;
        }
    }
    if matches!(statement, Statement::Request(_, 7) | Statement::Reply(_, 7)) {
        let join = if out.open { "; " } else { "" };
        write!(out, "{join}7 of 8 bytes, which the standard ignores and the TS drive takes")?;
    }
    Ok(())
}

fn write_emergency_remark(
    code: u16,
    short: bool,
    profile: Option<&'static Profile>,
    out: &mut RemarkWriter<'_>,
) -> core::fmt::Result {
    let known = meanings::canopen_profile(profile)
        .and_then(|p| p.faults.iter().find(|f| f.code == u32::from(code)));
    match (known, meanings::panel_characters(code).filter(|_| short)) {
        (Some(fault), _) => write!(out, "{}: {}", fault.name, fault.text.trim_end_matches('.')),
        (None, Some([a, b])) => write!(out, "two bytes, as a TS drive that shows {a}{b}"),
        (None, None) => out.write_str(emcy::class_text(code)),
    }
}

/// Process data by the mapping that drives have from the factory, if their length is its.
fn write_process_remark(
    frame: &Frame,
    len: u8,
    profile: Option<&'static Profile>,
    out: &mut RemarkWriter<'_>,
) -> core::fmt::Result {
    let cob = Cob::of(frame.id as u16);
    let Some(map) = fields::default_mapping(cob, len) else {
        let (object, number) = match cob {
            Cob::Rpdo(number, _) => (0x1600, number),
            Cob::Tpdo(number, _) => (0x1A00, number),
            _ => return Ok(()),
        };
        return write!(out, "by its mapping, 0x{:04X}", object + u16::from(number) - 1);
    };
    out.write_str("if mapped as usual:")?;
    let data = u64::from_le_bytes(frame.data);
    let mut join = " ";
    for (entry, field) in map.fields() {
        let raw = if meanings::is_signed(entry.object, profile) {
            field.signed(data)
        } else {
            field.unsigned(data).cast_signed()
        };
        out.write_str(join)?;
        meanings::write_value(entry.object, raw, profile, out)?;
        join = "; ";
    }
    Ok(())
}
