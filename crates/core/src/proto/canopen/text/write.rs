//! Writes texts.

use core::fmt::{self, Write};

use super::{BOUNDS, COMMANDS, NUMBERS, Statement};
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::heartbeat::Heartbeat;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::{NmtCommand, NmtState};
use crate::proto::canopen::sdo::{
    BlockSegment, ExpeditedData, ObjectIndex, SdoReply, SdoRequest, Segment,
};
use crate::proto::canopen::sync::SyncMessage;
use crate::proto::canopen::time::TimeOfDay;

/// Function that states whether an object's value has a sign.
pub type SignLookup<'a> = &'a dyn Fn(ObjectIndex) -> bool;

const DAY_MS: u32 = 86_400_000;

struct ObjectText(ObjectIndex);

impl fmt::Display for ObjectText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "0x{:04X}:{}", self.0.index, self.0.sub)
    }
}

/// Writes the text. False where the language has no words for it: then nothing is written.
///
/// # Errors
/// Those of `out`.
pub fn write(
    statement: &Statement,
    signs: SignLookup<'_>,
    out: &mut dyn Write,
) -> Result<bool, fmt::Error> {
    match *statement {
        Statement::Order(command, all) => write_nmt(command, all, out)?,
        Statement::Sync(SyncMessage { counter: None }) => out.write_str("sync")?,
        Statement::Sync(SyncMessage { counter: Some(counter) }) => write!(out, "sync {counter}")?,
        Statement::Time(time) => write_time_of_day(time, out)?,
        Statement::Emergency(emergency, short) => write_emergency(emergency, short, out)?,
        Statement::State(heartbeat) => write_state(heartbeat, out)?,
        Statement::Guard => out.write_str("guard")?,
        Statement::Process { from_node, number, data, len } => {
            write!(out, "{}pdo{number}", if from_node { 't' } else { 'r' })?;
            write_bytes(&data[..usize::from(len.min(8))], out)?;
        }
        Statement::RequestProcess(number, len) => write!(out, "tpdo{number} remote {len}")?,
        Statement::Request(SdoRequest::Other(_), _) | Statement::Reply(SdoReply::Other(_), _) => {
            return Ok(false);
        }
        Statement::Request(SdoRequest::WriteSegment(segment), _)
        | Statement::Reply(SdoReply::ValueSegment(segment), _)
            if !has_zero_padding(segment) =>
        {
            return Ok(false);
        }
        Statement::Request(sdo_request, len) => {
            write_request(sdo_request, signs, out)?;
            write_dlc(len, out)?;
        }
        Statement::Reply(sdo_reply, len) => {
            write_reply(sdo_reply, signs, out)?;
            write_dlc(len, out)?;
        }
        Statement::BlockSegment(BlockSegment { number, last, data }, reported) => {
            let verb = if reported { "value" } else { "write" };
            write!(out, "{verb} block part {number}{}", if last { " last" } else { "" })?;
            write_bytes(&data, out)?;
        }
        Statement::Lss(lss::LssRequest::Other(_))
        | Statement::LssReply(lss::LssReply::Other(_)) => {
            return Ok(false);
        }
        Statement::Lss(request) => write_lss_request(request, out)?,
        Statement::LssReply(reply) => write_lss_reply(reply, out)?,
        Statement::Raw(frame) if frame.remote || frame.extended => return Ok(false),
        Statement::Raw(frame) => {
            write!(out, "raw 0x{:03X}", frame.id)?;
            write_bytes(frame.bytes(), out)?;
        }
        // Frames are read as the requests that these begin with.
        Statement::Write(..)
        | Statement::Upload(..)
        | Statement::Download(..)
        | Statement::FastScan => {
            return Ok(false);
        }
    }
    Ok(true)
}

fn write_bytes(bytes: &[u8], out: &mut dyn Write) -> fmt::Result {
    bytes.iter().try_for_each(|byte| write!(out, " {byte:02X}"))
}

fn write_dlc(len: u8, out: &mut dyn Write) -> fmt::Result {
    if len == 8 { Ok(()) } else { write!(out, " dlc {len}") }
}

fn word_for<T: PartialEq>(known: &[(&'static str, T)], wanted: &T) -> &'static str {
    known.iter().find(|(_, value)| value == wanted).map_or("", |(name, _)| name)
}

fn write_nmt(command: NmtCommand, all: bool, out: &mut dyn Write) -> fmt::Result {
    match command {
        NmtCommand::Other(specifier) => write!(out, "nmt 0x{specifier:02X}")?,
        command => write!(out, "nmt {}", word_for(&COMMANDS, &command))?,
    }
    out.write_str(if all { " all" } else { "" })
}

fn write_time_of_day(time: TimeOfDay, out: &mut dyn Write) -> fmt::Result {
    let TimeOfDay { days, ms } = time;
    if ms >= DAY_MS {
        return write!(out, "time day {days} ms {ms}");
    }
    let (year, month, day) = date_of_days(days);
    write!(out, "time {year:04}-{month:02}-{day:02} ")?;
    let (seconds, ms) = (ms / 1000, ms % 1000);
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    write!(out, "{hours:02}:{minutes:02}:{seconds:02}.{ms:03}")
}

pub(super) const fn year_days(year: u32) -> u32 {
    let century = year.is_multiple_of(100);
    let leap = year.is_multiple_of(if century { 400 } else { 4 });
    if leap { 366 } else { 365 }
}

pub(super) const fn month_days(year: u32, month: u32) -> u32 {
    match month {
        2 => year_days(year) - 337,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

/// Year, month and day of a number of days since 1984-01-01.
fn date_of_days(days: u16) -> (u32, u32, u32) {
    let (mut rest, mut year, mut month) = (u32::from(days), 1984, 1);
    while rest >= year_days(year) {
        rest -= year_days(year);
        year += 1;
    }
    while rest >= month_days(year, month) {
        rest -= month_days(year, month);
        month += 1;
    }
    (year, month, rest + 1)
}

fn write_emergency(emergency: Emergency, short: bool, out: &mut dyn Write) -> fmt::Result {
    let Emergency { code, register, vendor } = emergency;
    write!(out, "emcy 0x{code:04X}")?;
    if short {
        return out.write_str(" short");
    }
    write!(out, " register 0x{register:02X}")?;
    if vendor == [0; 5] {
        return Ok(());
    }
    out.write_str(" vendor")?;
    write_bytes(&vendor, out)
}

fn write_state(heartbeat: Heartbeat, out: &mut dyn Write) -> fmt::Result {
    match heartbeat.state {
        NmtState::BootUp => out.write_str("boot-up")?,
        NmtState::Other(number) => write!(out, "heartbeat 0x{number:02X}")?,
        state => write!(out, "heartbeat {}", state.name())?,
    }
    out.write_str(if heartbeat.toggle { " toggled" } else { "" })
}

fn write_request(request: SdoRequest, signs: SignLookup<'_>, out: &mut dyn Write) -> fmt::Result {
    match request {
        SdoRequest::Write(object, short) => {
            write!(out, "write {}", ObjectText(object))?;
            write_expedited(short, signs(object), out)
        }
        SdoRequest::WriteLong(object, size) => {
            write!(out, "write {}", ObjectText(object))?;
            write_long_size(size, out)
        }
        SdoRequest::WriteSegment(segment) => write_segment("write", segment, out),
        SdoRequest::Read(object) => write!(out, "read {}", ObjectText(object)),
        SdoRequest::ReadSegment(toggle) => write!(out, "read segment {}", u8::from(toggle)),
        SdoRequest::WriteBlock { object, crc, size } => {
            write!(out, "write block {}{}", ObjectText(object), crc_word(crc))?;
            size.map_or(Ok(()), |size| write!(out, " size {size}"))
        }
        SdoRequest::WriteBlockEnd { unused, crc } => {
            write!(out, "write block end unused {unused} crc 0x{crc:04X}")
        }
        SdoRequest::ReadBlock { object, crc, segments, threshold } => {
            let crc = crc_word(crc);
            write!(out, "read block {}{crc} segments {segments}", ObjectText(object))?;
            if threshold == 0 { Ok(()) } else { write!(out, " threshold {threshold}") }
        }
        SdoRequest::ReadBlockStart => out.write_str("read block start"),
        SdoRequest::ReadBlockAck { arrived, segments } => {
            write!(out, "read block ack {arrived} segments {segments}")
        }
        SdoRequest::ReadBlockEnd => out.write_str("read block end"),
        SdoRequest::Abort(object, abort) => {
            write!(out, "abort {} 0x{:08X}", ObjectText(object), abort.0)
        }
        SdoRequest::Other(_) => Ok(()),
    }
}

fn write_reply(reply: SdoReply, signs: SignLookup<'_>, out: &mut dyn Write) -> fmt::Result {
    match reply {
        SdoReply::Written(object, echo) => {
            write!(out, "written {}", ObjectText(object))?;
            if echo == 0 { Ok(()) } else { write!(out, " echo 0x{echo:08X}") }
        }
        SdoReply::WrittenSegment(toggle) => write!(out, "written segment {}", u8::from(toggle)),
        SdoReply::Value(object, short) => {
            write!(out, "value {}", ObjectText(object))?;
            write_expedited(short, signs(object), out)
        }
        SdoReply::ValueLong(object, size) => {
            write!(out, "value {}", ObjectText(object))?;
            write_long_size(size, out)
        }
        SdoReply::ValueSegment(segment) => write_segment("value", segment, out),
        SdoReply::WriteBlockReady { object, crc, segments } => {
            let crc = crc_word(crc);
            write!(out, "written block {}{crc} segments {segments}", ObjectText(object))
        }
        SdoReply::WriteBlockAck { arrived, segments } => {
            write!(out, "written block ack {arrived} segments {segments}")
        }
        SdoReply::WriteBlockDone => out.write_str("written block done"),
        SdoReply::ReadBlockReady { object, crc, size } => {
            write!(out, "value block {}{}", ObjectText(object), crc_word(crc))?;
            size.map_or(Ok(()), |size| write!(out, " size {size}"))
        }
        SdoReply::ReadBlockEnd { unused, crc } => {
            write!(out, "value block end unused {unused} crc 0x{crc:04X}")
        }
        SdoReply::Abort(object, abort) => {
            write!(out, "refused {} 0x{:08X}", ObjectText(object), abort.0)
        }
        SdoReply::Other(_) => Ok(()),
    }
}

fn write_long_size(size: Option<u32>, out: &mut dyn Write) -> fmt::Result {
    match size {
        None => out.write_str(" long"),
        Some(size) => write!(out, " size {size}"),
    }
}

const fn crc_word(crc: bool) -> &'static str {
    if crc { " crc" } else { "" }
}

/// A type and a value; `wide` where bytes beyond the type's are not zero.
fn write_expedited(short: ExpeditedData, signed: bool, out: &mut dyn Write) -> fmt::Result {
    let ExpeditedData { bits, len } = short;
    let (width, letter) = (8 * u32::from(len), if signed { 'i' } else { 'u' });
    match len {
        0 => write!(out, " unsized 0x{bits:08X}"),
        1..=3 if bits >> width != 0 => write!(out, " u{width} wide 0x{bits:08X}"),
        _ if signed => {
            let rest = 32 - width;
            write!(out, " {letter}{width} {}", (bits << rest).cast_signed() >> rest)
        }
        _ => write!(out, " {letter}{width} 0x{bits:0digits$X}", digits = 2 * usize::from(len)),
    }
}

/// Returns whether unused bytes are zero, so that the text is complete.
fn has_zero_padding(segment: Segment) -> bool {
    segment.data.iter().skip(segment.len.into()).all(|byte| *byte == 0)
}

fn write_segment(verb: &str, segment: Segment, out: &mut dyn Write) -> fmt::Result {
    let last = if segment.last { " last" } else { "" };
    write!(out, "{verb} segment {}{last}", u8::from(segment.toggle))?;
    write_bytes(segment.bytes(), out)
}

fn write_lss_request(request: lss::LssRequest, out: &mut dyn Write) -> fmt::Result {
    use lss::LssRequest;
    out.write_str("lss ")?;
    match request {
        LssRequest::SwitchGlobal(true) => out.write_str("configuration"),
        LssRequest::SwitchGlobal(false) => out.write_str("waiting"),
        LssRequest::SwitchSelective(number, value) => {
            write!(out, "select {} 0x{value:08X}", word_for(&NUMBERS, &number))
        }
        LssRequest::SetNode(node) => write!(out, "node {node}"),
        LssRequest::SetBitTiming(table, index) => write!(out, "bit-timing {table} {index}"),
        LssRequest::ActivateBitTiming(ms) => write!(out, "activate {ms}"),
        LssRequest::Store => out.write_str("store"),
        LssRequest::Inquire(number) => write!(out, "inquire {}", word_for(&NUMBERS, &number)),
        LssRequest::InquireNode => out.write_str("inquire node"),
        LssRequest::Identify(bound, value) => {
            write!(out, "identify {} 0x{value:08X}", word_for(&BOUNDS, &bound))
        }
        LssRequest::IdentifyUnconfigured => out.write_str("unconfigured"),
        LssRequest::FastScan { number, bit, sub, next } => {
            let (sub, next) = (word_for(&NUMBERS, &sub), word_for(&NUMBERS, &next));
            write!(out, "scan {sub} 0x{number:08X} bit {bit} next {next}")
        }
        LssRequest::Other(_) => Ok(()),
    }
}

fn write_lss_reply(reply: lss::LssReply, out: &mut dyn Write) -> fmt::Result {
    use lss::LssReply;
    out.write_str("lss reply ")?;
    match reply {
        LssReply::Selected => out.write_str("selected"),
        LssReply::SetNode(error, own) => write!(out, "node {error} {own}"),
        LssReply::SetBitTiming(error, own) => write!(out, "bit-timing {error} {own}"),
        LssReply::Store(error, own) => write!(out, "store {error} {own}"),
        LssReply::Number(number, value) => {
            write!(out, "{} 0x{value:08X}", word_for(&NUMBERS, &number))
        }
        LssReply::Node(node) => write!(out, "node-id {node}"),
        LssReply::Identified => out.write_str("identified"),
        LssReply::Unconfigured => out.write_str("unconfigured"),
        LssReply::Other(_) => Ok(()),
    }
}
