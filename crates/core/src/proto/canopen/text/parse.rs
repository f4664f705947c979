//! Parses texts.

use super::{BOUNDS, COMMANDS, NUMBERS, Statement, TYPES, padded};
use crate::explain::TextError;
use crate::medium::Frame;
use crate::profile::{Parameter, Profile};
use crate::proto::canopen::driver::encoding_width;
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::heartbeat::Heartbeat;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::NmtState;
use crate::proto::canopen::sdo::{
    AbortCode, BlockSegment, ExpeditedData, ObjectIndex, SEGMENT, SdoReply, SdoRequest, Segment,
};
use crate::proto::canopen::sync::SyncMessage;
use crate::proto::canopen::time::TimeOfDay;

const EXPECTED_VERB: &str = "read, write, nmt, sync, time, emcy, heartbeat, guard, rpdo1, tpdo1, lss, abort \
                    or raw";
const EXPECTED_OBJECT: &str =
    "an object such as 0x6040:0, or a parameter's name of the profile given";

type Result<T> = core::result::Result<T, TextError>;

/// Reads a text.
///
/// # Errors
/// [`TextError`] with the place and the expected words.
pub fn parse(text: &str, profile: Option<&'static Profile>) -> Result<Statement> {
    let mut words = Tokenizer { text, at: 0, profile };
    let statement = parse_statement(&mut words)?;
    let statement = match statement {
        Statement::Request(request, _) if words.accept_word("dlc") => {
            Statement::Request(request, words.read_dlc()?)
        }
        Statement::Reply(reply, _) if words.accept_word("dlc") => {
            Statement::Reply(reply, words.read_dlc()?)
        }
        Statement::Write(object, bits, len @ 0..=4) if words.accept_word("dlc") => {
            let short = ExpeditedData { bits: bits as u32, len };
            Statement::Request(SdoRequest::Write(object, short), words.read_dlc()?)
        }
        statement => statement,
    };
    match words.next() {
        None => Ok(statement),
        Some((at, _)) => Err(TextError { at, expected: "the end" }),
    }
}

/// The parameter that a person means by `name`, as an object.
#[must_use]
pub fn named_object(name: &str, profile: Option<&'static Profile>) -> Option<ObjectIndex> {
    let mut words = Tokenizer { text: name, at: 0, profile };
    let (object, _) = words.read_object().ok()?;
    words.next().is_none().then_some(object)
}

fn parse_statement(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let (at, verb) = words.next().ok_or(TextError { at: words.at, expected: EXPECTED_VERB })?;
    if let Some((reported, number)) = parse_process_verb(verb) {
        return parse_process_data(words, reported, number);
    }
    match () {
        () if is_word("nmt", verb) => parse_nmt(words),
        () if is_word("sync", verb) => {
            let counter =
                words.peek().map(|_| words.read_byte("a counter, 0 to 255")).transpose()?;
            Ok(Statement::Sync(SyncMessage { counter }))
        }
        () if is_word("time", verb) => parse_time(words),
        () if is_word("emcy", verb) => parse_emergency(words),
        () if is_word("boot-up", verb) => Ok(Statement::State(Heartbeat {
            state: NmtState::BootUp,
            toggle: words.accept_word("toggled"),
        })),
        () if is_word("heartbeat", verb) => parse_heartbeat(words),
        () if is_word("guard", verb) => Ok(Statement::Guard),
        () if is_word("read", verb) => parse_read(words),
        () if is_word("write", verb) => parse_write(words),
        () if is_word("value", verb) => parse_value(words),
        () if is_word("written", verb) => parse_written(words),
        () if is_word("upload", verb) => Ok(Statement::Upload(words.read_object()?.0, false)),
        () if is_word("upload-block", verb) => Ok(Statement::Upload(words.read_object()?.0, true)),
        () if is_word("download", verb) => parse_download(words, false),
        () if is_word("download-block", verb) => parse_download(words, true),
        () if is_word("abort", verb) => Ok(Statement::Request(
            SdoRequest::Abort(words.read_object()?.0, AbortCode(words.read_word("an abort code")?)),
            8,
        )),
        () if is_word("refused", verb) => {
            let object = words.read_object()?.0;
            Ok(Statement::Reply(
                SdoReply::Abort(object, AbortCode(words.read_word("an abort code")?)),
                8,
            ))
        }
        () if is_word("lss", verb) => parse_lss(words),
        () if is_word("raw", verb) => parse_raw(words),
        () => Err(TextError { at, expected: EXPECTED_VERB }),
    }
}

fn is_word(word: &str, verb: &str) -> bool {
    verb.eq_ignore_ascii_case(word)
}

/// An object and how many bytes it will get.
fn parse_download(words: &mut Tokenizer<'_>, block: bool) -> Result<Statement> {
    let (object, _) = words.read_object()?;
    let size = words.read_number("how many bytes", 0, u32::MAX.into())? as u32;
    Ok(Statement::Download(object, size, block))
}

/// `rpdo1` to `tpdo4`: whether the node sends it, and its number.
fn parse_process_verb(verb: &str) -> Option<(bool, u8)> {
    let (name, number) = verb.split_at_checked(4)?;
    let reported = match name {
        _ if name.eq_ignore_ascii_case("rpdo") => false,
        _ if name.eq_ignore_ascii_case("tpdo") => true,
        _ => return None,
    };
    let number = number.parse().ok().filter(|number| (1..=4).contains(number))?;
    Some((reported, number))
}

fn parse_process_data(words: &mut Tokenizer<'_>, reported: bool, number: u8) -> Result<Statement> {
    if reported && words.accept_word("remote") {
        let len = words.peek().map(|_| words.read_number("a length, 0 to 8", 0, 8)).transpose()?;
        return Ok(Statement::RequestProcess(number, len.unwrap_or(0) as u8));
    }
    let (data, len) = words.read_bytes("up to eight bytes such as 0F 00")?;
    Ok(Statement::Process { from_node: reported, number, data, len })
}

fn parse_nmt(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let expected = "start, stop, pre-operational, reset or reset-communication";
    let command = match words.accept_one_of(&COMMANDS) {
        Some(command) => command,
        None => words.read_byte(expected)?.into(),
    };
    Ok(Statement::Order(command, words.accept_word("all")))
}

/// `2026-11-21 14:24:37.000`, with a T in between if one likes, or days and milliseconds as they lie in the frame.
fn parse_time(words: &mut Tokenizer<'_>) -> Result<Statement> {
    if words.accept_word("day") {
        let days = words.read_number("days since 1984", 0, 0xFFFF)? as u16;
        words.expect_word("ms")?;
        let ms = words.read_number("milliseconds, 28 bits", 0, 0x0FFF_FFFF)? as u32;
        return Ok(Statement::Time(TimeOfDay { days, ms }));
    }
    let expected = "a day such as 2026-11-21, 1984 to 2163";
    let (at, day) = words.next().ok_or(TextError { at: words.at, expected })?;
    let (day, joined) = match day.split_once(['T', 't']) {
        Some((day, clock)) => (day, Some((at + day.len() + 1, clock))),
        None => (day, None),
    };
    let days = parse_days(day).ok_or(TextError { at, expected })?;
    let expected = "a time such as 14:24:37.500";
    let ms = match joined.or_else(|| words.next()) {
        None => 0,
        Some((at, clock)) => parse_milliseconds(clock).ok_or(TextError { at, expected })?,
    };
    Ok(Statement::Time(TimeOfDay { days, ms }))
}

fn parse_days(text: &str) -> Option<u16> {
    let mut parts = text.splitn(3, '-').map(|part| part.parse::<u32>().ok());
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    if !(1984..=2163).contains(&year) || !(1..=12).contains(&month) || day == 0 {
        return None;
    }
    if day > super::write::month_days(year, month) {
        return None;
    }
    let years = (1984..year).map(super::write::year_days).sum::<u32>();
    let months = (1..month).map(|month| super::write::month_days(year, month)).sum::<u32>();
    u16::try_from(years + months + day - 1).ok()
}

fn parse_milliseconds(text: &str) -> Option<u32> {
    let (clock, fraction) = text.split_once('.').unwrap_or((text, "0"));
    let mut parts = clock.splitn(3, ':').map(|part| part.parse::<u32>().ok());
    let (hours, minutes) = (parts.next()??, parts.next()??);
    let seconds = parts.next().unwrap_or(Some(0))?;
    let ms = match fraction.len() {
        len @ 1..=3 => fraction.parse::<u32>().ok()? * 10u32.pow(3 - len as u32),
        _ => return None,
    };
    let fits = hours < 24 && minutes < 60 && seconds < 60;
    fits.then_some(((hours * 60 + minutes) * 60 + seconds) * 1000 + ms)
}

fn parse_emergency(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let code = words.read_number("a code of 16 bits, 0 when all is well", 0, 0xFFFF)? as u16;
    if words.accept_word("short") {
        return Ok(Statement::Emergency(Emergency { code, ..Emergency::default() }, true));
    }
    let register = if words.accept_word("register") {
        words.read_byte("the error register, 0 to 0xFF")?
    } else {
        0
    };
    let mut vendor = [0; 5];
    if words.accept_word("vendor") {
        let at = words.at;
        let expected = "five bytes such as 00 00 00 00 00";
        let (bytes, 5) = words.read_bytes(expected)? else {
            return Err(TextError { at, expected });
        };
        vendor.copy_from_slice(&bytes[..5]);
    }
    Ok(Statement::Emergency(Emergency { code, register, vendor }, false))
}

fn parse_heartbeat(words: &mut Tokenizer<'_>) -> Result<Statement> {
    const STATES: [(&str, NmtState); 4] = [
        ("boot-up", NmtState::BootUp),
        ("stopped", NmtState::Stopped),
        ("operational", NmtState::Operational),
        ("pre-operational", NmtState::PreOperational),
    ];
    let state = match words.accept_one_of(&STATES) {
        Some(state) => state,
        None => {
            let expected = "boot-up, stopped, operational or pre-operational";
            NmtState::from(words.read_number(expected, 0, 0x7F)? as u8)
        }
    };
    Ok(Statement::State(Heartbeat { state, toggle: words.accept_word("toggled") }))
}

fn parse_read(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let request = match () {
        () if words.accept_word("segment") => SdoRequest::ReadSegment(words.read_toggle()?),
        () if words.accept_word("block") => match () {
            () if words.accept_word("start") => SdoRequest::ReadBlockStart,
            () if words.accept_word("end") => SdoRequest::ReadBlockEnd,
            () if words.accept_word("ack") => {
                let (arrived, segments) = words.read_block_ack()?;
                SdoRequest::ReadBlockAck { arrived, segments }
            }
            () => {
                let (object, crc) = (words.read_object()?.0, words.accept_word("crc"));
                let segments = words.read_option("segments", super::SEGMENTS)?;
                let threshold = words.read_option("threshold", 0)?;
                SdoRequest::ReadBlock { object, crc, segments, threshold }
            }
        },
        () => SdoRequest::Read(words.read_object()?.0),
    };
    Ok(Statement::Request(request, 8))
}

fn parse_write(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let request = match () {
        () if words.accept_word("segment") => SdoRequest::WriteSegment(words.read_segment()?),
        () if words.accept_word("block") => match () {
            () if words.accept_word("part") => return words.read_block_segment(false),
            () if words.accept_word("end") => {
                let (unused, crc) = words.read_block_end()?;
                SdoRequest::WriteBlockEnd { unused, crc }
            }
            () => {
                let (object, crc) = (words.read_object()?.0, words.accept_word("crc"));
                SdoRequest::WriteBlock { object, crc, size: words.read_size()? }
            }
        },
        () => {
            let (object, parameter) = words.read_object()?;
            match words.read_long_size()? {
                Some(size) => SdoRequest::WriteLong(object, size),
                None => {
                    let (bits, len) = words.read_value(parameter)?;
                    return Ok(Statement::Write(object, bits, len));
                }
            }
        }
    };
    Ok(Statement::Request(request, 8))
}

fn parse_value(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let reply = match () {
        () if words.accept_word("segment") => SdoReply::ValueSegment(words.read_segment()?),
        () if words.accept_word("block") => match () {
            () if words.accept_word("part") => return words.read_block_segment(true),
            () if words.accept_word("end") => {
                let (unused, crc) = words.read_block_end()?;
                SdoReply::ReadBlockEnd { unused, crc }
            }
            () => {
                let (object, crc) = (words.read_object()?.0, words.accept_word("crc"));
                SdoReply::ReadBlockReady { object, crc, size: words.read_size()? }
            }
        },
        () => {
            let (object, parameter) = words.read_object()?;
            match words.read_long_size()? {
                Some(size) => SdoReply::ValueLong(object, size),
                None => {
                    let at = words.at;
                    let (bits, len) = words.read_value(parameter)?;
                    let expected = "at most four bytes; longer values are `size` and segments";
                    if len > 4 {
                        return Err(TextError { at, expected });
                    }
                    SdoReply::Value(object, ExpeditedData { bits: bits as u32, len })
                }
            }
        }
    };
    Ok(Statement::Reply(reply, 8))
}

fn parse_written(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let reply = match () {
        () if words.accept_word("segment") => SdoReply::WrittenSegment(words.read_toggle()?),
        () if words.accept_word("block") => match () {
            () if words.accept_word("done") => SdoReply::WriteBlockDone,
            () if words.accept_word("ack") => {
                let (arrived, segments) = words.read_block_ack()?;
                SdoReply::WriteBlockAck { arrived, segments }
            }
            () => {
                let (object, crc) = (words.read_object()?.0, words.accept_word("crc"));
                let segments = words.read_option("segments", super::SEGMENTS)?;
                SdoReply::WriteBlockReady { object, crc, segments }
            }
        },
        () => {
            let object = words.read_object()?.0;
            let echo =
                if words.accept_word("echo") { words.read_word("the data again")? } else { 0 };
            SdoReply::Written(object, echo)
        }
    };
    Ok(Statement::Reply(reply, 8))
}

fn parse_lss(words: &mut Tokenizer<'_>) -> Result<Statement> {
    use lss::LssRequest;
    if words.accept_word("reply") {
        return parse_lss_reply(words).map(Statement::LssReply);
    }
    let expected = "configuration, waiting, select, node, bit-timing, activate, store, inquire, \
                    identify, unconfigured, scan or fastscan";
    let (at, word) = words.next().ok_or(TextError { at: words.at, expected })?;
    Ok(Statement::Lss(match () {
        () if is_word("fastscan", word) => return Ok(Statement::FastScan),
        () if is_word("configuration", word) => LssRequest::SwitchGlobal(true),
        () if is_word("waiting", word) => LssRequest::SwitchGlobal(false),
        () if is_word("select", word) => {
            LssRequest::SwitchSelective(words.read_lss_number()?, words.read_word("a number")?)
        }
        () if is_word("node", word) => {
            LssRequest::SetNode(words.read_byte("a node-ID, 1 to 127, or 255 for none")?)
        }
        () if is_word("bit-timing", word) => LssRequest::SetBitTiming(
            words.read_byte("a table, 0")?,
            words.read_byte("an index, 0 to 8")?,
        ),
        () if is_word("activate", word) => {
            LssRequest::ActivateBitTiming(words.read_number("a delay in ms", 0, 0xFFFF)? as u16)
        }
        () if is_word("store", word) => LssRequest::Store,
        () if is_word("inquire", word) => match words.accept_one_of(&NUMBERS) {
            Some(number) => LssRequest::Inquire(number),
            None => {
                words.accept_word("node");
                LssRequest::InquireNode
            }
        },
        () if is_word("identify", word) => {
            let expected = "vendor, product, revision-low, revision-high, serial-low, serial-high";
            let wrong = TextError { at: words.at, expected };
            let bound = words.accept_one_of(&BOUNDS).ok_or(wrong)?;
            LssRequest::Identify(bound, words.read_word("a number")?)
        }
        () if is_word("unconfigured", word) => LssRequest::IdentifyUnconfigured,
        () if is_word("scan", word) => {
            let (sub, number) = (words.read_lss_number()?, words.read_word("the number so far")?);
            words.expect_word("bit")?;
            let bit = words.read_byte("the lowest bit that counts, 0 to 31, or 128")?;
            words.expect_word("next")?;
            LssRequest::FastScan { number, bit, sub, next: words.read_lss_number()? }
        }
        () => return Err(TextError { at, expected }),
    }))
}

fn parse_lss_reply(words: &mut Tokenizer<'_>) -> Result<lss::LssReply> {
    use lss::LssReply;
    if let Some(number) = words.accept_one_of(&NUMBERS) {
        return Ok(LssReply::Number(number, words.read_word("a number")?));
    }
    let expected = "selected, node, bit-timing, store, vendor, product, revision, serial, node-id, \
                    identified or unconfigured";
    let (at, word) = words.next().ok_or(TextError { at: words.at, expected })?;
    Ok(match () {
        () if is_word("selected", word) => LssReply::Selected,
        () if is_word("node", word) => LssReply::SetNode(
            words.read_byte("an error, 0 for none")?,
            words.read_byte("the maker's own")?,
        ),
        () if is_word("bit-timing", word) => LssReply::SetBitTiming(
            words.read_byte("an error, 0 for none")?,
            words.read_byte("the maker's own")?,
        ),
        () if is_word("store", word) => LssReply::Store(
            words.read_byte("an error, 0 for none")?,
            words.read_byte("the maker's own")?,
        ),
        () if is_word("node-id", word) => LssReply::Node(words.read_byte("a node-ID")?),
        () if is_word("identified", word) => LssReply::Identified,
        () if is_word("unconfigured", word) => LssReply::Unconfigured,
        () => return Err(TextError { at, expected }),
    })
}

fn parse_raw(words: &mut Tokenizer<'_>) -> Result<Statement> {
    let id = words.read_number("an identifier, 0 to 0x7FF", 0, 0x7FF)? as u16;
    let (bytes, len) = words.read_bytes("up to eight bytes of two hexadecimal digits")?;
    Ok(Statement::Raw(Frame::standard(id, &bytes[..usize::from(len)])))
}

/// Words of a text with their places; remarks in parentheses are none.
struct Tokenizer<'a> {
    text: &'a str,
    at: usize,
    profile: Option<&'static Profile>,
}

impl<'a> Tokenizer<'a> {
    fn peek(&mut self) -> Option<(usize, &'a str)> {
        loop {
            let rest = self.text.get(self.at..)?;
            let gap = rest.len() - rest.trim_start_matches([' ', '\t', ',', '=']).len();
            self.at += gap;
            let rest = &self.text[self.at..];
            if !rest.starts_with('(') {
                let end = rest.find([' ', '\t', ',', '=', '(']).unwrap_or(rest.len());
                return (end > 0).then(|| (self.at, &rest[..end]));
            }
            self.at += rest.find(')').map_or(rest.len(), |end| end + 1);
        }
    }

    fn next(&mut self) -> Option<(usize, &'a str)> {
        let (at, word) = self.peek()?;
        self.at = at + word.len();
        Some((at, word))
    }

    /// Takes the next word if it is this one.
    fn accept_word(&mut self, wanted: &str) -> bool {
        let found = self.peek().is_some_and(|(_, word)| word.eq_ignore_ascii_case(wanted));
        if found {
            self.next();
        }
        found
    }

    fn expect_word(&mut self, wanted: &'static str) -> Result<()> {
        let at = self.peek().map_or(self.at, |(at, _)| at);
        if self.accept_word(wanted) { Ok(()) } else { Err(TextError { at, expected: wanted }) }
    }

    /// Takes the next word if it is one of these.
    fn accept_one_of<T: Copy>(&mut self, known: &[(&str, T)]) -> Option<T> {
        let (_, word) = self.peek()?;
        let (_, value) = known.iter().find(|(name, _)| word.eq_ignore_ascii_case(name))?;
        self.next();
        Some(*value)
    }

    fn read_lss_number(&mut self) -> Result<lss::IdentityNumber> {
        let wrong = TextError { at: self.at, expected: "vendor, product, revision or serial" };
        self.accept_one_of(&NUMBERS).ok_or(wrong)
    }

    fn read_number(&mut self, expected: &'static str, min: i64, max: i64) -> Result<i64> {
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected })?;
        let number = parse_integer(word).filter(|number| (min..=max).contains(number));
        number.ok_or(TextError { at, expected })
    }

    fn read_byte(&mut self, expected: &'static str) -> Result<u8> {
        self.read_number(expected, 0, 0xFF).map(|number| number as u8)
    }

    fn read_word(&mut self, expected: &'static str) -> Result<u32> {
        self.read_number(expected, 0, u32::MAX.into()).map(|number| number as u32)
    }

    fn read_dlc(&mut self) -> Result<u8> {
        self.read_number("a length, 7 or 8", 7, 8).map(|len| len as u8)
    }

    fn read_toggle(&mut self) -> Result<bool> {
        self.read_number("a toggle, 0 or 1", 0, 1).map(|toggle| toggle == 1)
    }

    /// A number behind its word, or what holds without.
    fn read_option(&mut self, word: &str, otherwise: u8) -> Result<u8> {
        if self.accept_word(word) { self.read_byte("a number, 0 to 255") } else { Ok(otherwise) }
    }

    fn read_size(&mut self) -> Result<Option<u32>> {
        self.accept_word("size").then(|| self.read_word("a number of bytes")).transpose()
    }

    /// The size of a value that follows in segments.
    fn read_long_size(&mut self) -> Result<Option<Option<u32>>> {
        if self.accept_word("long") {
            return Ok(Some(None));
        }
        Ok(self.read_size()?.map(Some))
    }

    fn read_block_ack(&mut self) -> Result<(u8, u8)> {
        let arrived = self.read_byte("the last segment that arrived, 0 to 127")?;
        Ok((arrived, self.read_option("segments", super::SEGMENTS)?))
    }

    fn read_block_end(&mut self) -> Result<(u8, u16)> {
        self.expect_word("unused")?;
        let unused = self.read_number("bytes that do not count, 0 to 7", 0, 7)? as u8;
        self.expect_word("crc")?;
        Ok((unused, self.read_number("a check of 16 bits", 0, 0xFFFF)? as u16))
    }

    fn read_segment(&mut self) -> Result<Segment> {
        let (toggle, last, at) = (self.read_toggle()?, self.accept_word("last"), self.at);
        let expected = "up to seven bytes";
        let (bytes, len) = self.read_bytes(expected)?;
        let [data @ .., 0] = bytes else { return Err(TextError { at, expected }) };
        if usize::from(len) > SEGMENT {
            return Err(TextError { at, expected });
        }
        Ok(Segment { toggle, last, len, data })
    }

    fn read_block_segment(&mut self, reported: bool) -> Result<Statement> {
        let number = self.read_number("a segment's number, 0 to 127", 0, 127)? as u8;
        let (last, at) = (self.accept_word("last"), self.at);
        let expected = "seven bytes";
        let ([data @ .., _], 7) = self.read_bytes(expected)? else {
            return Err(TextError { at, expected });
        };
        Ok(Statement::BlockSegment(BlockSegment { number, last, data }, reported))
    }

    /// Bytes of two digits, up to eight of them.
    fn read_bytes(&mut self, expected: &'static str) -> Result<([u8; 8], u8)> {
        let (mut bytes, mut len) = ([0; 8], 0);
        while let Some((at, word)) = self.peek() {
            if word.eq_ignore_ascii_case("dlc") {
                break;
            }
            let wrong = TextError { at, expected };
            let digits = Some(word).filter(|word| word.len() == 2).ok_or(wrong)?;
            let byte = u8::from_str_radix(digits, 16).map_err(|_| wrong)?;
            *bytes.get_mut(len).ok_or(wrong)? = byte;
            (len, self.at) = (len + 1, at + word.len());
        }
        Ok((padded(&bytes[..len]), len as u8))
    }

    /// `0x6040:0`, without a sub-index 0; or a parameter's name, of as many words as it has.
    fn read_object(&mut self) -> Result<(ObjectIndex, Option<&'static Parameter>)> {
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected: EXPECTED_OBJECT })?;
        let wrong = TextError { at, expected: EXPECTED_OBJECT };
        if word.starts_with(|c: char| c.is_ascii_digit()) {
            let object = parse_object(word).ok_or(wrong)?;
            return Ok((object, self.known_object(object)));
        }
        let parameter = self.match_parameter(at).ok_or(wrong)?;
        let object = ObjectIndex { index: parameter.index, sub: parameter.space };
        Ok((object, Some(parameter)))
    }

    fn known_object(&self, object: ObjectIndex) -> Option<&'static Parameter> {
        self.canopen_profile().and_then(|profile| {
            profile.parameters.iter().find(|p| (p.index, p.space) == (object.index, object.sub))
        })
    }

    fn canopen_profile(&self) -> Option<&'static Profile> {
        self.profile.filter(|profile| profile.protocol == "canopen")
    }

    /// The parameter whose name begins there; the longest name wins.
    fn match_parameter(&mut self, at: usize) -> Option<&'static Parameter> {
        const WORDS_MAX: usize = 6;
        let profile = self.canopen_profile()?;
        let (mut found, mut end) = (None, self.at);
        for _ in 0..WORDS_MAX {
            if let Some(id) = profile.find_parameter(&self.text[at..self.at]) {
                (found, end) = (profile.parameter(id), self.at);
            }
            if self.next().is_none() {
                break;
            }
        }
        self.at = end;
        found
    }

    /// A type and a value, or a value of the parameter's type; and the number of bytes, 0 if the frame shall not state
    /// it.
    fn read_value(&mut self, parameter: Option<&'static Parameter>) -> Result<(u64, u8)> {
        if self.accept_word("unsized") {
            return Ok((self.read_word("a value of 32 bits")?.into(), 0));
        }
        let expected = "a type: u8, i8, u16, i16, u24, i24, u32, i32, u64 or i64";
        let (at, word) = self.peek().ok_or(TextError { at: self.at, expected })?;
        let typed = TYPES.iter().find(|(name, _)| word.eq_ignore_ascii_case(name));
        let (len, signed) = match (typed, parameter) {
            (Some((name, len)), _) => {
                self.next();
                (*len, name.starts_with('i'))
            }
            (None, Some(parameter)) => encoding_width(parameter.encoding),
            (None, None) => return Err(TextError { at, expected }),
        };
        if self.accept_word("wide") {
            return Ok((self.read_word("a value of 32 bits")?.into(), len));
        }
        let expected = "a value that its type can hold";
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected })?;
        let named = parameter.and_then(|parameter| {
            parameter.values.iter().find(|(_, name)| name.eq_ignore_ascii_case(word))
        });
        let number = named.map(|(value, _)| *value).or_else(|| parse_integer(word));
        let bits = number.and_then(|number| fit_number(number, len, signed));
        Ok((bits.ok_or(TextError { at, expected })?, len))
    }
}

/// `0x6040:0`; without a sub-index it is 0.
fn parse_object(text: &str) -> Option<ObjectIndex> {
    let (index, sub) = text.split_once(':').unwrap_or((text, "0"));
    let index = u16::try_from(parse_integer(index)?).ok()?;
    Some(ObjectIndex { index, sub: u8::try_from(parse_integer(sub)?).ok()? })
}

fn parse_integer(text: &str) -> Option<i64> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text),
    };
    let number = match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        Some(hex) => u64::from_str_radix(hex, 16).ok().and_then(|n| i64::try_from(n).ok())?,
        None => digits.parse().ok()?,
    };
    Some(if negative { -number } else { number })
}

/// The bytes of a number that fits.
fn fit_number(number: i64, len: u8, signed: bool) -> Option<u64> {
    let bits = 8 * u32::from(len);
    let fits = match (signed, bits) {
        (_, 64) => signed || number >= 0,
        (true, bits) => (-(1 << (bits - 1))..1 << (bits - 1)).contains(&number),
        (false, bits) => (0..1 << bits).contains(&number),
    };
    fits.then_some(number.cast_unsigned() & u64::MAX >> (64 - bits))
}
