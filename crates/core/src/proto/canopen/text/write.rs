//! Texts written.

use core::fmt::{self, Write};

use super::{BOUNDS, COMMANDS, NUMBERS, Said};
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::heartbeat::Heartbeat;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::{Command, State};
use crate::proto::canopen::sdo::{BlockSegment, Object, Reply, Request, Segment, Short};
use crate::proto::canopen::sync::Sync;
use crate::proto::canopen::time::TimeOfDay;

/// Which values have a sign.
pub type Signs<'a> = &'a dyn Fn(Object) -> bool;

const DAY_MS: u32 = 86_400_000;

struct Spelled(Object);

impl fmt::Display for Spelled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "0x{:04X}:{}", self.0.index, self.0.sub)
    }
}

/// Writes what is said. False where there are no words for it: then nothing is written.
///
/// # Errors
/// Those of `out`.
pub fn write(said: &Said, signs: Signs<'_>, out: &mut dyn Write) -> Result<bool, fmt::Error> {
    match *said {
        Said::Order(command, all) => order(command, all, out)?,
        Said::Sync(Sync { counter: None }) => out.write_str("sync")?,
        Said::Sync(Sync { counter: Some(counter) }) => write!(out, "sync {counter}")?,
        Said::Time(time) => time_of_day(time, out)?,
        Said::Emergency(emergency, short) => emergency_words(emergency, short, out)?,
        Said::State(heartbeat) => state(heartbeat, out)?,
        Said::Guard => out.write_str("guard")?,
        Said::Process { told, number, data, len } => {
            write!(out, "{}pdo{number}", if told { 't' } else { 'r' })?;
            bytes(&data[..usize::from(len.min(8))], out)?;
        }
        Said::AskProcess(number, len) => write!(out, "tpdo{number} remote {len}")?,
        Said::Request(Request::Other(_), _) | Said::Reply(Reply::Other(_), _) => return Ok(false),
        Said::Request(Request::WriteSegment(segment), _)
        | Said::Reply(Reply::ValueSegment(segment), _)
            if !is_clean(segment) =>
        {
            return Ok(false);
        }
        Said::Request(asked, len) => {
            request(asked, signs, out)?;
            dlc(len, out)?;
        }
        Said::Reply(told, len) => {
            reply(told, signs, out)?;
            dlc(len, out)?;
        }
        Said::Part(BlockSegment { number, last, data }, told) => {
            let verb = if told { "value" } else { "write" };
            write!(out, "{verb} block part {number}{}", if last { " last" } else { "" })?;
            bytes(&data, out)?;
        }
        Said::Lss(lss::Request::Other(_)) | Said::LssReply(lss::Reply::Other(_)) => {
            return Ok(false);
        }
        Said::Lss(request) => lss_request(request, out)?,
        Said::LssReply(reply) => lss_reply(reply, out)?,
        Said::Raw(frame) if frame.remote || frame.extended => return Ok(false),
        Said::Raw(frame) => {
            write!(out, "raw 0x{:03X}", frame.id)?;
            bytes(frame.bytes(), out)?;
        }
        // Frames are read as the requests that these begin with.
        Said::Write(..) | Said::Upload(..) | Said::Download(..) | Said::FastScan => {
            return Ok(false);
        }
    }
    Ok(true)
}

fn bytes(bytes: &[u8], out: &mut dyn Write) -> fmt::Result {
    bytes.iter().try_for_each(|byte| write!(out, " {byte:02X}"))
}

fn dlc(len: u8, out: &mut dyn Write) -> fmt::Result {
    if len == 8 { Ok(()) } else { write!(out, " dlc {len}") }
}

fn word<T: PartialEq>(known: &[(&'static str, T)], wanted: &T) -> &'static str {
    known.iter().find(|(_, value)| value == wanted).map_or("", |(name, _)| name)
}

fn order(command: Command, all: bool, out: &mut dyn Write) -> fmt::Result {
    match command {
        Command::Other(specifier) => write!(out, "nmt 0x{specifier:02X}")?,
        command => write!(out, "nmt {}", word(&COMMANDS, &command))?,
    }
    out.write_str(if all { " all" } else { "" })
}

fn time_of_day(time: TimeOfDay, out: &mut dyn Write) -> fmt::Result {
    let TimeOfDay { days, ms } = time;
    if ms >= DAY_MS {
        return write!(out, "time day {days} ms {ms}");
    }
    let (year, month, day) = date(days);
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
fn date(days: u16) -> (u32, u32, u32) {
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

fn emergency_words(emergency: Emergency, short: bool, out: &mut dyn Write) -> fmt::Result {
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
    bytes(&vendor, out)
}

fn state(heartbeat: Heartbeat, out: &mut dyn Write) -> fmt::Result {
    match heartbeat.state {
        State::BootUp => out.write_str("boot-up")?,
        State::Other(number) => write!(out, "heartbeat 0x{number:02X}")?,
        state => write!(out, "heartbeat {}", state.name())?,
    }
    out.write_str(if heartbeat.toggle { " toggled" } else { "" })
}

fn request(request: Request, signs: Signs<'_>, out: &mut dyn Write) -> fmt::Result {
    match request {
        Request::Write(object, short) => {
            write!(out, "write {}", Spelled(object))?;
            short_words(short, signs(object), out)
        }
        Request::WriteLong(object, size) => {
            write!(out, "write {}", Spelled(object))?;
            long(size, out)
        }
        Request::WriteSegment(segment) => segment_words("write", segment, out),
        Request::Read(object) => write!(out, "read {}", Spelled(object)),
        Request::ReadSegment(toggle) => write!(out, "read segment {}", u8::from(toggle)),
        Request::WriteBlock { object, crc, size } => {
            write!(out, "write block {}{}", Spelled(object), crc_word(crc))?;
            size.map_or(Ok(()), |size| write!(out, " size {size}"))
        }
        Request::WriteBlockEnd { unused, crc } => {
            write!(out, "write block end unused {unused} crc 0x{crc:04X}")
        }
        Request::ReadBlock { object, crc, segments, threshold } => {
            let crc = crc_word(crc);
            write!(out, "read block {}{crc} segments {segments}", Spelled(object))?;
            if threshold == 0 { Ok(()) } else { write!(out, " threshold {threshold}") }
        }
        Request::ReadBlockStart => out.write_str("read block start"),
        Request::ReadBlockAck { arrived, segments } => {
            write!(out, "read block ack {arrived} segments {segments}")
        }
        Request::ReadBlockEnd => out.write_str("read block end"),
        Request::Abort(object, abort) => {
            write!(out, "abort {} 0x{:08X}", Spelled(object), abort.0)
        }
        Request::Other(_) => Ok(()),
    }
}

fn reply(reply: Reply, signs: Signs<'_>, out: &mut dyn Write) -> fmt::Result {
    match reply {
        Reply::Written(object, echo) => {
            write!(out, "written {}", Spelled(object))?;
            if echo == 0 { Ok(()) } else { write!(out, " echo 0x{echo:08X}") }
        }
        Reply::WrittenSegment(toggle) => write!(out, "written segment {}", u8::from(toggle)),
        Reply::Value(object, short) => {
            write!(out, "value {}", Spelled(object))?;
            short_words(short, signs(object), out)
        }
        Reply::ValueLong(object, size) => {
            write!(out, "value {}", Spelled(object))?;
            long(size, out)
        }
        Reply::ValueSegment(segment) => segment_words("value", segment, out),
        Reply::WriteBlockReady { object, crc, segments } => {
            let crc = crc_word(crc);
            write!(out, "written block {}{crc} segments {segments}", Spelled(object))
        }
        Reply::WriteBlockAck { arrived, segments } => {
            write!(out, "written block ack {arrived} segments {segments}")
        }
        Reply::WriteBlockDone => out.write_str("written block done"),
        Reply::ReadBlockReady { object, crc, size } => {
            write!(out, "value block {}{}", Spelled(object), crc_word(crc))?;
            size.map_or(Ok(()), |size| write!(out, " size {size}"))
        }
        Reply::ReadBlockEnd { unused, crc } => {
            write!(out, "value block end unused {unused} crc 0x{crc:04X}")
        }
        Reply::Abort(object, abort) => {
            write!(out, "refused {} 0x{:08X}", Spelled(object), abort.0)
        }
        Reply::Other(_) => Ok(()),
    }
}

fn long(size: Option<u32>, out: &mut dyn Write) -> fmt::Result {
    match size {
        None => out.write_str(" long"),
        Some(size) => write!(out, " size {size}"),
    }
}

const fn crc_word(crc: bool) -> &'static str {
    if crc { " crc" } else { "" }
}

/// A type and a value; `wide` where bytes beyond the type's are not zero.
fn short_words(short: Short, signed: bool, out: &mut dyn Write) -> fmt::Result {
    let Short { bits, len } = short;
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

/// Whether bytes that do not count are zero, so that words say all of it.
fn is_clean(segment: Segment) -> bool {
    segment.data.iter().skip(segment.len.into()).all(|byte| *byte == 0)
}

fn segment_words(verb: &str, segment: Segment, out: &mut dyn Write) -> fmt::Result {
    let last = if segment.last { " last" } else { "" };
    write!(out, "{verb} segment {}{last}", u8::from(segment.toggle))?;
    bytes(segment.bytes(), out)
}

fn lss_request(request: lss::Request, out: &mut dyn Write) -> fmt::Result {
    use lss::Request;
    out.write_str("lss ")?;
    match request {
        Request::SwitchGlobal(true) => out.write_str("configuration"),
        Request::SwitchGlobal(false) => out.write_str("waiting"),
        Request::SwitchSelective(number, value) => {
            write!(out, "select {} 0x{value:08X}", word(&NUMBERS, &number))
        }
        Request::SetNode(node) => write!(out, "node {node}"),
        Request::SetBitTiming(table, index) => write!(out, "bit-timing {table} {index}"),
        Request::ActivateBitTiming(ms) => write!(out, "activate {ms}"),
        Request::Store => out.write_str("store"),
        Request::Inquire(number) => write!(out, "inquire {}", word(&NUMBERS, &number)),
        Request::InquireNode => out.write_str("inquire node"),
        Request::Identify(bound, value) => {
            write!(out, "identify {} 0x{value:08X}", word(&BOUNDS, &bound))
        }
        Request::IdentifyUnconfigured => out.write_str("unconfigured"),
        Request::FastScan { number, bit, sub, next } => {
            let (sub, next) = (word(&NUMBERS, &sub), word(&NUMBERS, &next));
            write!(out, "scan {sub} 0x{number:08X} bit {bit} next {next}")
        }
        Request::Other(_) => Ok(()),
    }
}

fn lss_reply(reply: lss::Reply, out: &mut dyn Write) -> fmt::Result {
    use lss::Reply;
    out.write_str("lss reply ")?;
    match reply {
        Reply::Selected => out.write_str("selected"),
        Reply::SetNode(error, own) => write!(out, "node {error} {own}"),
        Reply::SetBitTiming(error, own) => write!(out, "bit-timing {error} {own}"),
        Reply::Store(error, own) => write!(out, "store {error} {own}"),
        Reply::Number(number, value) => write!(out, "{} 0x{value:08X}", word(&NUMBERS, &number)),
        Reply::Node(node) => write!(out, "node-id {node}"),
        Reply::Identified => out.write_str("identified"),
        Reply::Unconfigured => out.write_str("unconfigured"),
        Reply::Other(_) => Ok(()),
    }
}
