//! A language for what goes over the wire: `TC -5 %`, `LA 10 rpm 90.0 deg`, `VM frames 1+2`, `QP`.
//!
//! The manual has letters and bytes alone; values and units are ours. A number without a unit is the
//! raw one of the wire. What stands in parentheses is a remark. Replies have a language too: `QP 48.0
//! V`, `TC -5 % accepted`, `TC refused`, `VC frame 1: 496 rpm, 48.0 V, 0.4 A`. Whatever bytes have no
//! words are `raw` and bytes. So every text that is written here is read here.

use core::fmt::{self, Write as _};

use super::fault;
use super::readings::{Form, Readings};
use super::rules::{self, ends, range_of};
use super::wire::{Bare, Command, Heard, RANGE, REFUSED, Reply, Report, Request, Shape, Width};
use crate::explain::{EncodeError, TextError};

/// What a text says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Said {
    /// To the drive.
    Request(Request),
    /// From the drive.
    Heard(Heard),
    /// Bytes, and whether they are from the drive.
    Raw {
        /// True for what comes from the drive.
        reply: bool,
        /// The bytes.
        bytes: [u8; 8],
        /// How many of them.
        len: u8,
    },
}

/// Gives a formatter's pieces on.
struct Pieces<'a>(&'a mut dyn FnMut(&str));

impl fmt::Write for Pieces<'_> {
    fn write_str(&mut self, piece: &str) -> fmt::Result {
        (self.0)(piece);
        Ok(())
    }
}

/// A raw number with its unit.
struct Amount(i64, Measure);

impl fmt::Display for Amount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(raw, Measure { unit, tenths }) = *self;
        if tenths {
            let (sign, size) = (if raw < 0 { "-" } else { "" }, raw.unsigned_abs());
            write!(f, "{sign}{}.{}", size / 10, size % 10)?;
        } else {
            write!(f, "{raw}")?;
        }
        if unit.is_empty() { Ok(()) } else { write!(f, " {unit}") }
    }
}

/// How a number is counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Measure {
    /// Its unit; empty for none.
    pub unit: &'static str,
    /// The raw number counts tenths of it.
    pub tenths: bool,
}

impl Measure {
    const fn of(unit: &'static str) -> Self {
        Self { unit, tenths: false }
    }

    const fn tenths(unit: &'static str) -> Self {
        Self { unit, tenths: true }
    }

    /// How a command's value is counted.
    #[must_use]
    pub const fn of_command(command: Command) -> Self {
        match command {
            Command::TC => Self::of("%"),
            Command::VC | Command::QV => RPM,
            Command::QC => AMPERE,
            Command::QP => VOLT,
            Command::QT | Command::EQ => CELSIUS,
            Command::CB => Self::of("kbit/s"),
            Command::ST => MS,
            Command::LA | Command::LR | Command::QA | Command::QR => DEGREE,
            _ => Self::of(""),
        }
    }
}

const RPM: Measure = Measure::of("rpm");
const MS: Measure = Measure::of("ms");
const CELSIUS: Measure = Measure::of("degC");
const VOLT: Measure = Measure::tenths("V");
const AMPERE: Measure = Measure::tenths("A");
const DEGREE: Measure = Measure::tenths("deg");

/// Writes a request.
pub fn write_request(request: &Request, readings: Readings, show: &mut dyn FnMut(&str)) {
    let out = &mut Pieces(show);
    let _ = match natural(request) {
        true => request_words(request, readings, out),
        false => raw(&request.frame(0).data, request.data.map_or(4, |_| 8), false, out),
    };
}

/// Writes what a drive says. `asked` is the data of the request that it answers, if that is known:
/// a reply that repeats EE EE refuses nothing.
pub fn write_heard(
    heard: &Heard,
    asked: Option<u32>,
    readings: Readings,
    show: &mut dyn FnMut(&str),
) {
    let out = &mut Pieces(show);
    let _ = match heard {
        Heard::Report(report) => report_words(report, readings, out),
        Heard::Bare(bare) => bare_words(bare, out),
        Heard::Reply(reply) if reply_is_natural(reply) => reply_words(reply, asked, readings, out),
        Heard::Reply(reply) => raw(&reply.frame(0).data, 8, true, out),
    };
}

/// Whether words can say all of it.
fn natural(request: &Request) -> bool {
    let Some((shape, _)) = request.command.known() else { return false };
    let silent = matches!(shape, Shape::Query | Shape::Order | Shape::Zeros);
    has_sub(request.command, request.sub) && !(silent && request.data.is_some_and(|d| d != 0))
}

fn reply_is_natural(reply: &Reply) -> bool {
    let Some((shape, _)) = reply.command.known() else { return false };
    let empty = matches!(shape, Shape::Order | Shape::Zeros);
    has_sub(reply.command, reply.sub) && !(empty && reply.data != 0 && reply.data != REFUSED)
}

fn has_sub(command: Command, sub: u16) -> bool {
    sub == 0 || matches!(command, Command::LA | Command::LR | Command::SP | Command::RP)
}

fn raw(data: &[u8; 8], len: usize, reply: bool, out: &mut Pieces<'_>) -> fmt::Result {
    out.write_str(if reply { "raw reply" } else { "raw" })?;
    data[..len].iter().try_for_each(|byte| write!(out, " {byte:02X}"))
}

fn request_words(request: &Request, readings: Readings, out: &mut Pieces<'_>) -> fmt::Result {
    let Request { command, sub, data } = *request;
    let set = matches!(command.known(), Some((Shape::Set, _)));
    head(command, sub, out)?;
    match data {
        Some(data) if set => value_words(command, sub, data, readings, out),
        Some(_) if matches!(command.known(), Some((Shape::Zeros, _))) => Ok(()),
        Some(_) => out.write_str(" dlc 8"),
        None if set || Request::plain(command).data.is_some() => out.write_str(" dlc 4"),
        None => Ok(()),
    }
}

/// The command, with its speed or type.
fn head(command: Command, sub: u16, out: &mut Pieces<'_>) -> fmt::Result {
    out.write_str(command.letters().as_str())?;
    match command {
        Command::SP | Command::RP if sub == RANGE => out.write_str("LA"),
        Command::SP | Command::RP => write!(out, " 0x{sub:04X}"),
        Command::LA | Command::LR => write!(out, " {}", Amount(sub.into(), RPM)),
        _ => Ok(()),
    }
}

fn value_words(
    command: Command,
    sub: u16,
    data: u32,
    readings: Readings,
    out: &mut Pieces<'_>,
) -> fmt::Result {
    match command {
        Command::SP | Command::RP if sub == RANGE => {
            let (reverse, forward) = ends(data);
            write!(out, " {} {}", Amount(reverse.into(), DEGREE), Amount(forward.into(), DEGREE))
        }
        Command::SP | Command::RP => write!(out, " 0x{data:08X}"),
        Command::EF | Command::FR => {
            write!(out, " 0x{data:04X}")?;
            bits(data as u16, out)
        }
        Command::VM if data <= 0xFFFF => vm_words(data as u16, readings, out),
        Command::SR if data <= 0xFF_FFFF => sr_words(data, out),
        Command::VM | Command::SR => write!(out, " 0x{data:08X}"),
        _ => {
            let value = command.width().read(data);
            write!(out, " {}", Amount(value, Measure::of_command(command)))?;
            match width_word(command.width(), data) {
                "" => Ok(()),
                word => write!(out, " {word}"),
            }
        }
    }
}

/// What tells this width from the usual one.
fn width_word(width: Width, data: u32) -> &'static str {
    let value = width.read(data);
    match width {
        _ if width.write(value) == data && (data <= 0xFFFF || width != Width::Unsigned) => "",
        Width::Absolute => "short",
        _ => "wide",
    }
}

fn vm_words(value: u16, readings: Readings, out: &mut Pieces<'_>) -> fmt::Result {
    let (headerless, silent) = readings.flags();
    match value {
        0 => out.write_str(" echo"),
        value if value == headerless => out.write_str(" headerless"),
        value if value == silent => out.write_str(" silent"),
        1..=7 => {
            out.write_str(" frames ")?;
            frames(value as u8, out)
        }
        _ => write!(out, " 0x{value:04X}"),
    }
}

fn sr_words(value: u32, out: &mut Pieces<'_>) -> fmt::Result {
    let (mask, interval) = ((value >> 16) as u8, i64::from(value as u16));
    match mask {
        _ if value == 0 => out.write_str(" off"),
        1..=7 => {
            out.write_str(" frames ")?;
            frames(mask, out)?;
            write!(out, " every {}", Amount(interval, MS))
        }
        _ => write!(out, " 0x{value:06X}"),
    }
}

fn frames(mask: u8, out: &mut Pieces<'_>) -> fmt::Result {
    let mut join = "";
    (1..=3).filter(|n| mask >> (n - 1) & 1 == 1).try_for_each(|n| {
        write!(out, "{join}{n}")?;
        join = "+";
        Ok(())
    })
}

/// The names of a fault word, as a remark.
fn bits(word: u16, out: &mut Pieces<'_>) -> fmt::Result {
    let mut join = " (";
    fault::named(word).try_for_each(|bit| {
        write!(out, "{join}{}", bit.name)?;
        join = ", ";
        Ok::<(), fmt::Error>(())
    })?;
    if join == ", " { out.write_str(")") } else { Ok(()) }
}

fn reply_words(
    reply: &Reply,
    asked: Option<u32>,
    readings: Readings,
    out: &mut Pieces<'_>,
) -> fmt::Result {
    let Reply { command, sub, data } = *reply;
    head(command, sub, out)?;
    if data == REFUSED && asked != Some(data) {
        return out.write_str(" refused");
    }
    match command.known() {
        Some((Shape::Query, _)) => value_words(command, sub, data, readings, out),
        Some((Shape::Set, _)) => {
            value_words(command, sub, data, readings, out)?;
            out.write_str(" accepted")
        }
        _ => out.write_str(" accepted"),
    }
}

fn report_words(report: &Report, readings: Readings, out: &mut Pieces<'_>) -> fmt::Result {
    let of = match report.of {
        b'T' => "TC",
        b'V' => "VC",
        _ => "SR",
    };
    write!(out, "{of} frame {}: ", report.part)?;
    let [a, b, c] = report.words;
    let signed = |word: u16| i64::from(word.cast_signed());
    match report.part {
        1 => {
            let (rpm, amperes) = (Amount(signed(a), RPM), Amount(signed(c), AMPERE));
            write!(out, "{rpm}, {}, {amperes}", Amount(b.into(), VOLT))
        }
        2 => {
            write!(out, "status 0x{a:04X}")?;
            bits(a, out)?;
            let (motor, driver) = (Amount(signed(b), CELSIUS), Amount(signed(c), CELSIUS));
            write!(out, ", {motor} (motor), {driver} (driver)")
        }
        _ => {
            let (absolute, relative) = readings.positions(report);
            let tenths = |raw: i32| Amount(raw.into(), DEGREE);
            write!(out, "{} (absolute), {} (relative)", tenths(absolute), tenths(relative))
        }
    }
}

fn bare_words(bare: &Bare, out: &mut Pieces<'_>) -> fmt::Result {
    let Bare { rpm, decivolt, deciamp, status } = *bare;
    let (rpm, volts) = (Amount(rpm.into(), RPM), Amount(decivolt.into(), VOLT));
    let amperes = Amount(deciamp.into(), AMPERE);
    write!(out, "report {rpm}, {volts}, {amperes}, status 0x{status:04X}")?;
    bits(status, out)
}

/// Reads a text.
///
/// # Errors
/// [`EncodeError::Text`] with the place and what was expected there; [`EncodeError::Forbidden`] for
/// a request that [the rules](super::rules) keep a host from sending.
pub fn parse(text: &str, readings: Readings) -> Result<Said, EncodeError> {
    let mut words = Words { text, at: 0 };
    let said = sentence(&mut words, readings)?;
    if let Some((at, _)) = words.peek() {
        let expected = "the end: nothing more belongs to this command";
        return Err(TextError { at, expected }.into());
    }
    if let Said::Request(request) = &said {
        rules::check(request).map_err(EncodeError::Forbidden)?;
    }
    Ok(said)
}

fn sentence(words: &mut Words<'_>, readings: Readings) -> Result<Said, TextError> {
    let expected = "a command of two letters, such as TC, QP or LS";
    let (at, name) = words.next().ok_or(TextError { at: words.at, expected })?;
    if name.eq_ignore_ascii_case("raw") {
        return raw_bytes(words);
    }
    if name.eq_ignore_ascii_case("report") {
        return bare(words).map(|bare| Said::Heard(Heard::Bare(bare)));
    }
    let ranged = ["SPLA", "RPLA"].into_iter().find(|word| name.eq_ignore_ascii_case(word));
    let command = Command::named(ranged.map_or(name, |word| &word[..2]));
    let command = command.ok_or(TextError { at, expected })?;
    if words.take("frame") {
        return report(command, words, readings, at).map(|it| Said::Heard(Heard::Report(it)));
    }
    let sub = match command {
        Command::SP | Command::RP if ranged.is_some() => RANGE,
        Command::SP | Command::RP => {
            words.number("a type, 0 to 0xFFFF", Measure::of(""), 0, 0xFFFF)? as u16
        }
        Command::LA | Command::LR => words.number("a speed in rpm", RPM, 0, 0xFFFF)? as u16,
        _ => 0,
    };
    if words.take("refused") {
        return Ok(Said::Heard(Heard::Reply(Reply { command, sub, data: REFUSED })));
    }
    let data = if words.ends_here() { None } else { Some(value(command, sub, words, readings)?) };
    ending(Request { command, sub, data }, words)
}

/// What stands behind the value: a length, or that it is a reply.
fn ending(mut request: Request, words: &mut Words<'_>) -> Result<Said, TextError> {
    let Request { command, sub, data } = request;
    let query = matches!(command.known(), Some((Shape::Query, _)));
    let accepted = words.take("accepted");
    if accepted || (query && data.is_some()) {
        let data = data.unwrap_or(0);
        return Ok(Said::Heard(Heard::Reply(Reply { command, sub, data })));
    }
    if data.is_none() {
        request.data = Request::plain(command).data;
    }
    if words.take("dlc") {
        let none = Measure::of("");
        match words.number("a length, 4 or 8", none, 4, 8)? {
            4 => request.data = None,
            _ => request.data = Some(request.data.unwrap_or(0)),
        }
    }
    Ok(Said::Request(request))
}

/// The data that a command's value makes.
fn value(
    command: Command,
    sub: u16,
    words: &mut Words<'_>,
    readings: Readings,
) -> Result<u32, TextError> {
    let none = Measure::of("");
    let (least, most) = (i64::from(i32::MIN), i64::from(u32::MAX));
    match command {
        Command::SP | Command::RP if sub == RANGE => {
            let mut end = || {
                let expected = "an end of the range, such as -90 deg";
                words.number(expected, DEGREE, i16::MIN.into(), i16::MAX.into())
            };
            Ok(range_of(end()? as i16, end()? as i16))
        }
        Command::VM => vm(words, readings),
        Command::SR => sr(words),
        _ if matches!(command.known(), Some((Shape::Order | Shape::Zeros, _))) => {
            let at = words.peek().map_or(words.at, |(at, _)| at);
            Err(TextError { at, expected: "the end: this command has no value" })
        }
        Command::SP | Command::RP | Command::EF | Command::FR => {
            words.number("a value of 32 bits", none, least, most).map(|value| value as u32)
        }
        _ => {
            let (measure, at) = (Measure::of_command(command), words.at);
            let value = words.number("a value", measure, least, most)?;
            let data = match command.width() {
                _ if words.take("wide") => value as u32,
                _ if words.take("short") => value as u32 & 0xFFFF,
                width => width.write(value),
            };
            let expected = "a value that its bytes can hold";
            let same = command.width().read(data) == value;
            if same { Ok(data) } else { Err(TextError { at, expected }) }
        }
    }
}

fn vm(words: &mut Words<'_>, readings: Readings) -> Result<u32, TextError> {
    let (headerless, silent) = readings.flags();
    if words.take("echo") {
        return Ok(0);
    }
    if words.take("headerless") {
        return Ok(headerless.into());
    }
    if words.take("silent") {
        return Ok(silent.into());
    }
    if words.take("frames") {
        return words.frames().map(u32::from);
    }
    let expected = "echo, headerless, silent, frames 1+2+3, or flags and frames as numbers";
    let first = words.number(expected, Measure::of(""), 0, u32::MAX.into())? as u32;
    match words.peek() {
        Some((_, word)) if word.starts_with(|c: char| c.is_ascii_digit()) => {
            let frames = words.number(expected, Measure::of(""), 0, 0xFF)? as u32;
            Ok(first << 8 | frames)
        }
        _ => Ok(first),
    }
}

fn sr(words: &mut Words<'_>) -> Result<u32, TextError> {
    if words.take("off") {
        return Ok(0);
    }
    let mask = if words.take("frames") {
        u32::from(words.frames()?)
    } else {
        let expected = "off, frames 1+2+3 every 100 ms, or frames and ms as numbers";
        words.number(expected, Measure::of(""), 0, u32::MAX.into())? as u32
    };
    let every = words.take("every");
    match words.peek() {
        Some((_, word)) if every || word.starts_with(|c: char| c.is_ascii_digit()) => {
            Ok(mask << 16 | words.number("an interval in ms", MS, 0, 0xFFFF)? as u32)
        }
        _ => Ok(mask),
    }
}

fn report(
    command: Command,
    words: &mut Words<'_>,
    readings: Readings,
    at: usize,
) -> Result<Report, TextError> {
    let of = match command {
        Command::TC => b'T',
        Command::VC => b'V',
        Command::SR => Report::BY_ITSELF,
        _ => return Err(TextError { at, expected: "TC, VC or SR before a frame's number" }),
    };
    let part = words.number("a frame's number, 1 to 3", Measure::of(""), 1, 3)? as u8;
    let words = match part {
        1 => [words.signed(RPM)?, words.number("volts", VOLT, 0, 0xFFFF)? as u16, {
            words.signed(AMPERE)?
        }],
        2 => [words.status()?, words.signed(CELSIUS)?, words.signed(CELSIUS)?],
        _ => {
            let limit = i64::from(i32::MAX);
            let mut place = || words.number("a position in degrees", DEGREE, -limit - 1, limit);
            readings.position_words(place()? as i32, place()? as i32)
        }
    };
    Ok(Report { of, part, words })
}

fn bare(words: &mut Words<'_>) -> Result<Bare, TextError> {
    Ok(Bare {
        rpm: words.signed(RPM)?.cast_signed(),
        decivolt: words.number("volts", VOLT, 0, 0xFFFF)? as u16,
        deciamp: words.signed(AMPERE)?.cast_signed(),
        status: words.status()?,
    })
}

fn raw_bytes(words: &mut Words<'_>) -> Result<Said, TextError> {
    let reply = words.take("reply");
    let (mut bytes, mut len) = ([0; 8], 0);
    while let Some((at, word)) = words.next() {
        let expected = "at most eight bytes of two hexadecimal digits";
        let wrong = TextError { at, expected };
        let byte = Some(word).filter(|word| word.len() == 2).ok_or(wrong)?;
        *bytes.get_mut(len).ok_or(wrong)? = u8::from_str_radix(byte, 16).map_err(|_| wrong)?;
        len += 1;
    }
    Ok(Said::Raw { reply, bytes, len: len as u8 })
}

/// Words of a text with their places; remarks in parentheses are none.
struct Words<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Words<'a> {
    fn peek(&mut self) -> Option<(usize, &'a str)> {
        loop {
            let rest = &self.text[self.at..];
            let gap = rest.len() - rest.trim_start_matches([' ', '\t', ',', ':']).len();
            self.at += gap;
            let rest = &self.text[self.at..];
            if !rest.starts_with('(') {
                let end = rest.find([' ', '\t', ',', ':', '(']).unwrap_or(rest.len());
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

    /// Whether no value comes next.
    fn ends_here(&mut self) -> bool {
        let word = self.peek().map_or("", |(_, word)| word);
        word.is_empty() || ["dlc", "accepted"].iter().any(|w| w.eq_ignore_ascii_case(word))
    }

    /// A number, raw or with its unit, in raw counts.
    fn number(
        &mut self,
        expected: &'static str,
        measure: Measure,
        least: i64,
        most: i64,
    ) -> Result<i64, TextError> {
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected })?;
        let wrong = TextError { at, expected };
        if let Some(digits) = word.strip_prefix("0x").or(word.strip_prefix("0X")) {
            let number = i64::from_str_radix(digits, 16).map_err(|_| wrong)?;
            return Some(number).filter(|n| (least..=most).contains(n)).ok_or(wrong);
        }
        let end = word.find(|c: char| !matches!(c, '0'..='9' | '-' | '+' | '.'));
        let (number, unit) = word.split_at(end.unwrap_or(word.len()));
        let Measure { unit: wanted, tenths } = measure;
        let has_unit = match unit {
            "" => !wanted.is_empty() && self.take(wanted),
            unit if unit.eq_ignore_ascii_case(wanted) => true,
            _ => return Err(wrong),
        };
        let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
        let counted = tenths && (has_unit || !fraction.is_empty());
        let scaled =
            whole.parse::<i64>().ok().and_then(|n| n.checked_mul(if counted { 10 } else { 1 }));
        let size = scaled.ok_or(wrong)?;
        let tenth = match fraction.as_bytes() {
            [] => 0,
            [digit @ b'0'..=b'9', zeros @ ..] if counted && zeros.iter().all(|c| *c == b'0') => {
                i64::from(digit - b'0')
            }
            _ => return Err(wrong),
        };
        let tenth = if number.starts_with('-') { -tenth } else { tenth };
        let raw = size.saturating_add(tenth);
        Some(raw).filter(|raw| (least..=most).contains(raw)).ok_or(wrong)
    }

    /// Signed 16 bits.
    fn signed(&mut self, measure: Measure) -> Result<u16, TextError> {
        let (least, most) = (i16::MIN.into(), i16::MAX.into());
        let value = self.number("a number of 16 bits", measure, least, most)?;
        Ok((value as i16).cast_unsigned())
    }

    fn status(&mut self) -> Result<u16, TextError> {
        self.take("status");
        Ok(self.number("a status such as 0x0008", Measure::of(""), 0, 0xFFFF)? as u16)
    }

    /// Numbers of frames, parted by `+`, as a mask.
    fn frames(&mut self) -> Result<u8, TextError> {
        let expected = "frames 1, 2 or 3, such as 1+2";
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected })?;
        word.split('+').try_fold(0, |mask, number| match number {
            "1" => Ok(mask | 1),
            "2" => Ok(mask | 2),
            "3" => Ok(mask | 4),
            _ => Err(TextError { at, expected }),
        })
    }
}

/// What a value of VM asks for, for people.
#[must_use]
pub const fn form_text(form: Form) -> &'static str {
    match form {
        Form::Echo => "TC and VC are answered with themselves",
        Form::Headerless => "TC and VC are answered with speed, voltage, current and status",
        Form::Silent => "TC and VC are not answered",
        Form::Frames(_) => "TC and VC are answered with reports 1 to 3 as chosen",
    }
}
