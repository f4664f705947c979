//! Texts read.

use super::{BOUNDS, COMMANDS, NUMBERS, Said, TYPES, padded};
use crate::explain::TextError;
use crate::medium::Frame;
use crate::profile::{Parameter, Profile};
use crate::proto::canopen::axis::width;
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::heartbeat::Heartbeat;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::State;
use crate::proto::canopen::sdo::{
    Abort, BlockSegment, Object, Reply, Request, SEGMENT, Segment, Short,
};
use crate::proto::canopen::sync::Sync;
use crate::proto::canopen::time::TimeOfDay;

const VERB: &str = "read, write, nmt, sync, time, emcy, heartbeat, guard, rpdo1, tpdo1, lss, abort \
                    or raw";
const OBJECT: &str = "an object such as 0x6040:0, or a parameter's name of the profile given";

type Result<T> = core::result::Result<T, TextError>;

/// Reads a text.
///
/// # Errors
/// [`TextError`] with the place and what was expected there.
pub fn parse(text: &str, profile: Option<&'static Profile>) -> Result<Said> {
    let mut words = Words { text, at: 0, profile };
    let said = sentence(&mut words)?;
    let said = match said {
        Said::Request(request, _) if words.take("dlc") => Said::Request(request, words.dlc()?),
        Said::Reply(reply, _) if words.take("dlc") => Said::Reply(reply, words.dlc()?),
        Said::Write(object, bits, len @ 0..=4) if words.take("dlc") => {
            let short = Short { bits: bits as u32, len };
            Said::Request(Request::Write(object, short), words.dlc()?)
        }
        said => said,
    };
    match words.next() {
        None => Ok(said),
        Some((at, _)) => Err(TextError { at, expected: "the end" }),
    }
}

/// The parameter that a person means by `name`, as an object.
#[must_use]
pub fn named_object(name: &str, profile: Option<&'static Profile>) -> Option<Object> {
    let mut words = Words { text: name, at: 0, profile };
    let (object, _) = words.object().ok()?;
    words.next().is_none().then_some(object)
}

fn sentence(words: &mut Words<'_>) -> Result<Said> {
    let (at, verb) = words.next().ok_or(TextError { at: words.at, expected: VERB })?;
    let is = |word: &str| verb.eq_ignore_ascii_case(word);
    if let Some((told, number)) = process(verb) {
        return data(words, told, number);
    }
    match () {
        () if is("nmt") => order(words),
        () if is("sync") => {
            let counter = words.peek().map(|_| words.byte("a counter, 0 to 255")).transpose()?;
            Ok(Said::Sync(Sync { counter }))
        }
        () if is("time") => time(words),
        () if is("emcy") => emergency(words),
        () if is("boot-up") => {
            Ok(Said::State(Heartbeat { state: State::BootUp, toggle: words.take("toggled") }))
        }
        () if is("heartbeat") => heartbeat(words),
        () if is("guard") => Ok(Said::Guard),
        () if is("read") => read(words),
        () if is("write") => write(words),
        () if is("value") => value(words),
        () if is("written") => written(words),
        () if is("upload") => Ok(Said::Upload(words.object()?.0, false)),
        () if is("upload-block") => Ok(Said::Upload(words.object()?.0, true)),
        () if is("download") => download(words, false),
        () if is("download-block") => download(words, true),
        () if is("abort") => Ok(Said::Request(
            Request::Abort(words.object()?.0, Abort(words.word("an abort code")?)),
            8,
        )),
        () if is("refused") => {
            let object = words.object()?.0;
            Ok(Said::Reply(Reply::Abort(object, Abort(words.word("an abort code")?)), 8))
        }
        () if is("lss") => lss(words),
        () if is("raw") => raw(words),
        () => Err(TextError { at, expected: VERB }),
    }
}

/// An object and how many bytes it will get.
fn download(words: &mut Words<'_>, block: bool) -> Result<Said> {
    let (object, _) = words.object()?;
    let size = words.number("how many bytes", 0, u32::MAX.into())? as u32;
    Ok(Said::Download(object, size, block))
}

/// `rpdo1` to `tpdo4`: whether the node tells it, and its number.
fn process(verb: &str) -> Option<(bool, u8)> {
    let (name, number) = verb.split_at_checked(4)?;
    let told = match name {
        _ if name.eq_ignore_ascii_case("rpdo") => false,
        _ if name.eq_ignore_ascii_case("tpdo") => true,
        _ => return None,
    };
    let number = number.parse().ok().filter(|number| (1..=4).contains(number))?;
    Some((told, number))
}

fn data(words: &mut Words<'_>, told: bool, number: u8) -> Result<Said> {
    if told && words.take("remote") {
        let len = words.peek().map(|_| words.number("a length, 0 to 8", 0, 8)).transpose()?;
        return Ok(Said::AskProcess(number, len.unwrap_or(0) as u8));
    }
    let (data, len) = words.bytes("up to eight bytes such as 0F 00")?;
    Ok(Said::Process { told, number, data, len })
}

fn order(words: &mut Words<'_>) -> Result<Said> {
    let expected = "start, stop, pre-operational, reset or reset-communication";
    let command = match words.one_of(&COMMANDS) {
        Some(command) => command,
        None => words.byte(expected)?.into(),
    };
    Ok(Said::Order(command, words.take("all")))
}

/// `2026-11-21 14:24:37.000`, with a T in between if one likes, or days and milliseconds as they lie in the frame.
fn time(words: &mut Words<'_>) -> Result<Said> {
    if words.take("day") {
        let days = words.number("days since 1984", 0, 0xFFFF)? as u16;
        words.need("ms")?;
        let ms = words.number("milliseconds, 28 bits", 0, 0x0FFF_FFFF)? as u32;
        return Ok(Said::Time(TimeOfDay { days, ms }));
    }
    let expected = "a day such as 2026-11-21, 1984 to 2163";
    let (at, day) = words.next().ok_or(TextError { at: words.at, expected })?;
    let (day, joined) = match day.split_once(['T', 't']) {
        Some((day, clock)) => (day, Some((at + day.len() + 1, clock))),
        None => (day, None),
    };
    let days = days(day).ok_or(TextError { at, expected })?;
    let expected = "a time such as 14:24:37.500";
    let ms = match joined.or_else(|| words.next()) {
        None => 0,
        Some((at, clock)) => milliseconds(clock).ok_or(TextError { at, expected })?,
    };
    Ok(Said::Time(TimeOfDay { days, ms }))
}

fn days(text: &str) -> Option<u16> {
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

fn milliseconds(text: &str) -> Option<u32> {
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

fn emergency(words: &mut Words<'_>) -> Result<Said> {
    let code = words.number("a code of 16 bits, 0 when all is well", 0, 0xFFFF)? as u16;
    if words.take("short") {
        return Ok(Said::Emergency(Emergency { code, ..Emergency::default() }, true));
    }
    let register = match words.take("register") {
        true => words.byte("the error register, 0 to 0xFF")?,
        false => 0,
    };
    let mut vendor = [0; 5];
    if words.take("vendor") {
        let at = words.at;
        let expected = "five bytes such as 00 00 00 00 00";
        let (bytes, 5) = words.bytes(expected)? else { return Err(TextError { at, expected }) };
        vendor.copy_from_slice(&bytes[..5]);
    }
    Ok(Said::Emergency(Emergency { code, register, vendor }, false))
}

fn heartbeat(words: &mut Words<'_>) -> Result<Said> {
    const STATES: [(&str, State); 4] = [
        ("boot-up", State::BootUp),
        ("stopped", State::Stopped),
        ("operational", State::Operational),
        ("pre-operational", State::PreOperational),
    ];
    let state = match words.one_of(&STATES) {
        Some(state) => state,
        None => {
            let expected = "boot-up, stopped, operational or pre-operational";
            State::from(words.number(expected, 0, 0x7F)? as u8)
        }
    };
    Ok(Said::State(Heartbeat { state, toggle: words.take("toggled") }))
}

fn read(words: &mut Words<'_>) -> Result<Said> {
    let request = match () {
        () if words.take("segment") => Request::ReadSegment(words.toggle()?),
        () if words.take("block") => match () {
            () if words.take("start") => Request::ReadBlockStart,
            () if words.take("end") => Request::ReadBlockEnd,
            () if words.take("ack") => {
                let (arrived, segments) = words.arrived()?;
                Request::ReadBlockAck { arrived, segments }
            }
            () => {
                let (object, crc) = (words.object()?.0, words.take("crc"));
                let segments = words.option("segments", super::SEGMENTS)?;
                let threshold = words.option("threshold", 0)?;
                Request::ReadBlock { object, crc, segments, threshold }
            }
        },
        () => Request::Read(words.object()?.0),
    };
    Ok(Said::Request(request, 8))
}

fn write(words: &mut Words<'_>) -> Result<Said> {
    let request = match () {
        () if words.take("segment") => Request::WriteSegment(words.segment()?),
        () if words.take("block") => match () {
            () if words.take("part") => return words.part(false),
            () if words.take("end") => {
                let (unused, crc) = words.end()?;
                Request::WriteBlockEnd { unused, crc }
            }
            () => {
                let (object, crc) = (words.object()?.0, words.take("crc"));
                Request::WriteBlock { object, crc, size: words.size()? }
            }
        },
        () => {
            let (object, parameter) = words.object()?;
            match words.long()? {
                Some(size) => Request::WriteLong(object, size),
                None => {
                    let (bits, len) = words.bits(parameter)?;
                    return Ok(Said::Write(object, bits, len));
                }
            }
        }
    };
    Ok(Said::Request(request, 8))
}

fn value(words: &mut Words<'_>) -> Result<Said> {
    let reply = match () {
        () if words.take("segment") => Reply::ValueSegment(words.segment()?),
        () if words.take("block") => match () {
            () if words.take("part") => return words.part(true),
            () if words.take("end") => {
                let (unused, crc) = words.end()?;
                Reply::ReadBlockEnd { unused, crc }
            }
            () => {
                let (object, crc) = (words.object()?.0, words.take("crc"));
                Reply::ReadBlockReady { object, crc, size: words.size()? }
            }
        },
        () => {
            let (object, parameter) = words.object()?;
            match words.long()? {
                Some(size) => Reply::ValueLong(object, size),
                None => {
                    let at = words.at;
                    let (bits, len) = words.bits(parameter)?;
                    let expected = "at most four bytes; longer values are `size` and segments";
                    if len > 4 {
                        return Err(TextError { at, expected });
                    }
                    Reply::Value(object, Short { bits: bits as u32, len })
                }
            }
        }
    };
    Ok(Said::Reply(reply, 8))
}

fn written(words: &mut Words<'_>) -> Result<Said> {
    let reply = match () {
        () if words.take("segment") => Reply::WrittenSegment(words.toggle()?),
        () if words.take("block") => match () {
            () if words.take("done") => Reply::WriteBlockDone,
            () if words.take("ack") => {
                let (arrived, segments) = words.arrived()?;
                Reply::WriteBlockAck { arrived, segments }
            }
            () => {
                let (object, crc) = (words.object()?.0, words.take("crc"));
                let segments = words.option("segments", super::SEGMENTS)?;
                Reply::WriteBlockReady { object, crc, segments }
            }
        },
        () => {
            let object = words.object()?.0;
            let echo = match words.take("echo") {
                true => words.word("the data again")?,
                false => 0,
            };
            Reply::Written(object, echo)
        }
    };
    Ok(Said::Reply(reply, 8))
}

fn lss(words: &mut Words<'_>) -> Result<Said> {
    use lss::Request;
    if words.take("reply") {
        return lss_reply(words).map(Said::LssReply);
    }
    let expected = "configuration, waiting, select, node, bit-timing, activate, store, inquire, \
                    identify, unconfigured, scan or fastscan";
    let (at, word) = words.next().ok_or(TextError { at: words.at, expected })?;
    let is = |name: &str| word.eq_ignore_ascii_case(name);
    Ok(Said::Lss(match () {
        () if is("fastscan") => return Ok(Said::FastScan),
        () if is("configuration") => Request::SwitchGlobal(true),
        () if is("waiting") => Request::SwitchGlobal(false),
        () if is("select") => Request::SwitchSelective(words.named()?, words.word("a number")?),
        () if is("node") => Request::SetNode(words.byte("a node-ID, 1 to 127, or 255 for none")?),
        () if is("bit-timing") => {
            Request::SetBitTiming(words.byte("a table, 0")?, words.byte("an index, 0 to 8")?)
        }
        () if is("activate") => {
            Request::ActivateBitTiming(words.number("a delay in ms", 0, 0xFFFF)? as u16)
        }
        () if is("store") => Request::Store,
        () if is("inquire") => match words.one_of(&NUMBERS) {
            Some(number) => Request::Inquire(number),
            None => {
                words.take("node");
                Request::InquireNode
            }
        },
        () if is("identify") => {
            let expected = "vendor, product, revision-low, revision-high, serial-low, serial-high";
            let wrong = TextError { at: words.at, expected };
            let bound = words.one_of(&BOUNDS).ok_or(wrong)?;
            Request::Identify(bound, words.word("a number")?)
        }
        () if is("unconfigured") => Request::IdentifyUnconfigured,
        () if is("scan") => {
            let (sub, number) = (words.named()?, words.word("the number so far")?);
            words.need("bit")?;
            let bit = words.byte("the lowest bit that counts, 0 to 31, or 128")?;
            words.need("next")?;
            Request::FastScan { number, bit, sub, next: words.named()? }
        }
        () => return Err(TextError { at, expected }),
    }))
}

fn lss_reply(words: &mut Words<'_>) -> Result<lss::Reply> {
    use lss::Reply;
    if let Some(number) = words.one_of(&NUMBERS) {
        return Ok(Reply::Number(number, words.word("a number")?));
    }
    let expected = "selected, node, bit-timing, store, vendor, product, revision, serial, node-id, \
                    identified or unconfigured";
    let (at, word) = words.next().ok_or(TextError { at: words.at, expected })?;
    let is = |name: &str| word.eq_ignore_ascii_case(name);
    Ok(match () {
        () if is("selected") => Reply::Selected,
        () if is("node") => {
            Reply::SetNode(words.byte("an error, 0 for none")?, words.byte("the maker's own")?)
        }
        () if is("bit-timing") => {
            Reply::SetBitTiming(words.byte("an error, 0 for none")?, words.byte("the maker's own")?)
        }
        () if is("store") => {
            Reply::Store(words.byte("an error, 0 for none")?, words.byte("the maker's own")?)
        }
        () if is("node-id") => Reply::Node(words.byte("a node-ID")?),
        () if is("identified") => Reply::Identified,
        () if is("unconfigured") => Reply::Unconfigured,
        () => return Err(TextError { at, expected }),
    })
}

fn raw(words: &mut Words<'_>) -> Result<Said> {
    let id = words.number("an identifier, 0 to 0x7FF", 0, 0x7FF)? as u16;
    let (bytes, len) = words.bytes("up to eight bytes of two hexadecimal digits")?;
    Ok(Said::Raw(Frame::standard(id, &bytes[..usize::from(len)])))
}

/// Words of a text with their places; remarks in parentheses are none.
struct Words<'a> {
    text: &'a str,
    at: usize,
    profile: Option<&'static Profile>,
}

impl<'a> Words<'a> {
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
    fn take(&mut self, wanted: &str) -> bool {
        let found = self.peek().is_some_and(|(_, word)| word.eq_ignore_ascii_case(wanted));
        if found {
            self.next();
        }
        found
    }

    fn need(&mut self, wanted: &'static str) -> Result<()> {
        let at = self.peek().map_or(self.at, |(at, _)| at);
        if self.take(wanted) { Ok(()) } else { Err(TextError { at, expected: wanted }) }
    }

    /// Takes the next word if it is one of these.
    fn one_of<T: Copy>(&mut self, known: &[(&str, T)]) -> Option<T> {
        let (_, word) = self.peek()?;
        let (_, value) = known.iter().find(|(name, _)| word.eq_ignore_ascii_case(name))?;
        self.next();
        Some(*value)
    }

    fn named(&mut self) -> Result<lss::Number> {
        let wrong = TextError { at: self.at, expected: "vendor, product, revision or serial" };
        self.one_of(&NUMBERS).ok_or(wrong)
    }

    fn number(&mut self, expected: &'static str, least: i64, most: i64) -> Result<i64> {
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected })?;
        let number = integer(word).filter(|number| (least..=most).contains(number));
        number.ok_or(TextError { at, expected })
    }

    fn byte(&mut self, expected: &'static str) -> Result<u8> {
        self.number(expected, 0, 0xFF).map(|number| number as u8)
    }

    fn word(&mut self, expected: &'static str) -> Result<u32> {
        self.number(expected, 0, u32::MAX.into()).map(|number| number as u32)
    }

    fn dlc(&mut self) -> Result<u8> {
        self.number("a length, 7 or 8", 7, 8).map(|len| len as u8)
    }

    fn toggle(&mut self) -> Result<bool> {
        self.number("a toggle, 0 or 1", 0, 1).map(|toggle| toggle == 1)
    }

    /// A number behind its word, or what holds without.
    fn option(&mut self, word: &str, otherwise: u8) -> Result<u8> {
        if self.take(word) { self.byte("a number, 0 to 255") } else { Ok(otherwise) }
    }

    fn size(&mut self) -> Result<Option<u32>> {
        self.take("size").then(|| self.word("a number of bytes")).transpose()
    }

    /// What stands for a value that follows in segments.
    fn long(&mut self) -> Result<Option<Option<u32>>> {
        if self.take("long") {
            return Ok(Some(None));
        }
        Ok(self.size()?.map(Some))
    }

    fn arrived(&mut self) -> Result<(u8, u8)> {
        let arrived = self.byte("the last segment that arrived, 0 to 127")?;
        Ok((arrived, self.option("segments", super::SEGMENTS)?))
    }

    fn end(&mut self) -> Result<(u8, u16)> {
        self.need("unused")?;
        let unused = self.number("bytes that do not count, 0 to 7", 0, 7)? as u8;
        self.need("crc")?;
        Ok((unused, self.number("a check of 16 bits", 0, 0xFFFF)? as u16))
    }

    fn segment(&mut self) -> Result<Segment> {
        let (toggle, last, at) = (self.toggle()?, self.take("last"), self.at);
        let expected = "up to seven bytes";
        let (bytes, len) = self.bytes(expected)?;
        let [data @ .., 0] = bytes else { return Err(TextError { at, expected }) };
        if usize::from(len) > SEGMENT {
            return Err(TextError { at, expected });
        }
        Ok(Segment { toggle, last, len, data })
    }

    fn part(&mut self, told: bool) -> Result<Said> {
        let number = self.number("a segment's number, 0 to 127", 0, 127)? as u8;
        let (last, at) = (self.take("last"), self.at);
        let expected = "seven bytes";
        let ([data @ .., _], 7) = self.bytes(expected)? else {
            return Err(TextError { at, expected });
        };
        Ok(Said::Part(BlockSegment { number, last, data }, told))
    }

    /// Bytes of two digits, up to eight of them.
    fn bytes(&mut self, expected: &'static str) -> Result<([u8; 8], u8)> {
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
    fn object(&mut self) -> Result<(Object, Option<&'static Parameter>)> {
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected: OBJECT })?;
        let wrong = TextError { at, expected: OBJECT };
        let known = |object: Object| {
            let same = |p: &&Parameter| (p.index, p.space) == (object.index, object.sub);
            self.own().and_then(|profile| profile.parameters.iter().find(same))
        };
        if word.starts_with(|c: char| c.is_ascii_digit()) {
            let object = object(word).ok_or(wrong)?;
            return Ok((object, known(object)));
        }
        let parameter = self.parameter(at).ok_or(wrong)?;
        let object = Object { index: parameter.index, sub: parameter.space };
        Ok((object, Some(parameter)))
    }

    fn own(&self) -> Option<&'static Profile> {
        self.profile.filter(|profile| profile.protocol == "canopen")
    }

    /// The parameter whose name begins there; the longest name wins.
    fn parameter(&mut self, at: usize) -> Option<&'static Parameter> {
        const WORDS_MAX: usize = 6;
        let profile = self.own()?;
        let (mut found, mut end) = (None, self.at);
        for _ in 0..WORDS_MAX {
            if let Some(id) = profile.find(&self.text[at..self.at]) {
                (found, end) = (profile.parameter(id), self.at);
            }
            if self.next().is_none() {
                break;
            }
        }
        self.at = end;
        found
    }

    /// A type and a value, or a value of the parameter's type; how many bytes, 0 where the frame
    /// shall not say.
    fn bits(&mut self, parameter: Option<&'static Parameter>) -> Result<(u64, u8)> {
        if self.take("unsized") {
            return Ok((self.word("a value of 32 bits")?.into(), 0));
        }
        let expected = "a type: u8, i8, u16, i16, u24, i24, u32, i32, u64 or i64";
        let (at, word) = self.peek().ok_or(TextError { at: self.at, expected })?;
        let typed = TYPES.iter().find(|(name, _)| word.eq_ignore_ascii_case(name));
        let (len, signed) = match (typed, parameter) {
            (Some((name, len)), _) => {
                self.next();
                (*len, name.starts_with('i'))
            }
            (None, Some(parameter)) => width(parameter.encoding),
            (None, None) => return Err(TextError { at, expected }),
        };
        if self.take("wide") {
            return Ok((self.word("a value of 32 bits")?.into(), len));
        }
        let expected = "a value that its type can hold";
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected })?;
        let named = parameter.and_then(|parameter| {
            parameter.values.iter().find(|(_, name)| name.eq_ignore_ascii_case(word))
        });
        let number = named.map(|(value, _)| *value).or_else(|| integer(word));
        let bits = number.and_then(|number| fitting(number, len, signed));
        Ok((bits.ok_or(TextError { at, expected })?, len))
    }
}

/// `0x6040:0`; without a sub-index it is 0.
fn object(text: &str) -> Option<Object> {
    let (index, sub) = text.split_once(':').unwrap_or((text, "0"));
    let index = u16::try_from(integer(index)?).ok()?;
    Some(Object { index, sub: u8::try_from(integer(sub)?).ok()? })
}

fn integer(text: &str) -> Option<i64> {
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
fn fitting(number: i64, len: u8, signed: bool) -> Option<u64> {
    let bits = 8 * u32::from(len);
    let fits = match (signed, bits) {
        (_, 64) => signed || number >= 0,
        (true, bits) => (-(1 << (bits - 1))..1 << (bits - 1)).contains(&number),
        (false, bits) => (0..1 << bits).contains(&number),
    };
    fits.then_some(number.cast_unsigned() & u64::MAX >> (64 - bits))
}
