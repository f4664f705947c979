//! Text form of the messages: `TC -5 %`, `LA 10 rpm 90.0 deg`, `VM frames 1+2`, `QP`.
//!
//! The manual has letters and bytes only; values and units are ours. A number without unit is raw. Text in
//! parentheses is a comment. Replies are `QP 48.0 V`, `TC -5 % accepted`, `TC refused`, `VC frame 1: 496
//! rpm, 48.0 V, 0.4 A`. Other bytes are `raw` and bytes. Every text that is written here can be read here.

mod count_unit;

use core::fmt::{self, Write as _};

use super::fault;
use super::interpretation::{Interpretation, ReplyFormat};
use super::rules::{self, range_data, range_ends};
use super::wire::{
    CommandKind, CommandWord, DriveMessage, HeaderlessReport, RANGE_PARAMETER, REFUSED, Reply,
    ReportFrame, Request, Width,
};
use crate::explain::{EncodeError, NumberPlace, TextError};
pub use count_unit::CountUnit;
use count_unit::{AMPERE, CELSIUS, DEGREE, MS, MeasuredNumber, RPM, VOLT};

/// Content of a text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Statement {
    /// To the drive.
    Request(Request),
    /// From the drive.
    FromDrive(DriveMessage),
    /// Bytes, and whether they are from the drive.
    Raw {
        /// True for frames of the drive.
        reply: bool,
        /// The bytes.
        bytes: [u8; 8],
        /// Number of bytes.
        len: u8,
    },
}

/// Gives a formatter's pieces on.
struct PieceFormatter<'a>(&'a mut dyn FnMut(&str));

impl fmt::Write for PieceFormatter<'_> {
    fn write_str(&mut self, piece: &str) -> fmt::Result {
        (self.0)(piece);
        Ok(())
    }
}

/// Writes a request.
pub fn write_request(request: &Request, readings: Interpretation, show: &mut dyn FnMut(&str)) {
    let out = &mut PieceFormatter(show);
    let _ = if has_words(request) {
        write_request_words(request, readings, out)
    } else {
        write_raw(&request.frame(0).data, request.data.map_or(4, |_| 8), false, out)
    };
}

/// Writes a message of a drive. `asked` is the data of its request, if known: a reply that repeats EE EE is
/// not a refusal.
pub fn write_drive_message(
    message: &DriveMessage,
    requested: Option<u32>,
    readings: Interpretation,
    show: &mut dyn FnMut(&str),
) {
    let out = &mut PieceFormatter(show);
    let _ = match message {
        DriveMessage::Report(report) => write_report(report, readings, out),
        DriveMessage::Headerless(bare) => write_headerless(bare, out),
        DriveMessage::Reply(reply) if reply_has_words(reply) => {
            write_reply(reply, requested, readings, out)
        }
        DriveMessage::Reply(reply) => write_raw(&reply.frame(0).data, 8, true, out),
    };
}

/// Returns whether the text form covers the whole request.
fn has_words(request: &Request) -> bool {
    let Some((shape, _)) = request.command.definition() else { return false };
    let silent = matches!(shape, CommandKind::Query | CommandKind::Order | CommandKind::Zeros);
    has_sub_command(request.command, request.sub)
        && !(silent && request.data.is_some_and(|d| d != 0))
}

fn reply_has_words(reply: &Reply) -> bool {
    let Some((shape, _)) = reply.command.definition() else { return false };
    let empty = matches!(shape, CommandKind::Order | CommandKind::Zeros);
    has_sub_command(reply.command, reply.sub)
        && !(empty && reply.data != 0 && reply.data != REFUSED)
}

fn has_sub_command(command: CommandWord, sub: u16) -> bool {
    sub == 0
        || matches!(command, CommandWord::LA | CommandWord::LR | CommandWord::SP | CommandWord::RP)
}

fn write_raw(data: &[u8; 8], len: usize, reply: bool, out: &mut PieceFormatter<'_>) -> fmt::Result {
    out.write_str(if reply { "raw reply" } else { "raw" })?;
    data[..len].iter().try_for_each(|byte| write!(out, " {byte:02X}"))
}

fn write_request_words(
    request: &Request,
    readings: Interpretation,
    out: &mut PieceFormatter<'_>,
) -> fmt::Result {
    let Request { command, sub, data } = *request;
    let set = matches!(command.definition(), Some((CommandKind::Set, _)));
    write_head(command, sub, out)?;
    match data {
        Some(data) if set => write_value(command, sub, data, readings, out),
        Some(_) if matches!(command.definition(), Some((CommandKind::Zeros, _))) => Ok(()),
        Some(_) => out.write_str(" dlc 8"),
        None if set || Request::without_value(command).data.is_some() => out.write_str(" dlc 4"),
        None => Ok(()),
    }
}

/// The command, with its speed or type.
fn write_head(command: CommandWord, sub: u16, out: &mut PieceFormatter<'_>) -> fmt::Result {
    out.write_str(command.letters().as_str())?;
    match command {
        CommandWord::SP | CommandWord::RP if sub == RANGE_PARAMETER => out.write_str("LA"),
        CommandWord::SP | CommandWord::RP => write!(out, " 0x{sub:04X}"),
        CommandWord::LA | CommandWord::LR => write!(out, " {}", MeasuredNumber(sub.into(), RPM)),
        _ => Ok(()),
    }
}

fn write_value(
    command: CommandWord,
    sub: u16,
    data: u32,
    readings: Interpretation,
    out: &mut PieceFormatter<'_>,
) -> fmt::Result {
    match command {
        CommandWord::SP | CommandWord::RP if sub == RANGE_PARAMETER => {
            let (reverse, forward) = range_ends(data);
            write!(
                out,
                " {} {}",
                MeasuredNumber(reverse.into(), DEGREE),
                MeasuredNumber(forward.into(), DEGREE)
            )
        }
        CommandWord::SP | CommandWord::RP => write!(out, " 0x{data:08X}"),
        CommandWord::EF | CommandWord::FR => {
            write!(out, " 0x{data:04X}")?;
            write_fault_names(data as u16, out)
        }
        CommandWord::VM if data <= 0xFFFF => write_vm(data as u16, readings, out),
        CommandWord::SR if data <= 0xFF_FFFF => write_sr(data, out),
        CommandWord::VM | CommandWord::SR => write!(out, " 0x{data:08X}"),
        _ => {
            let value = command.width().decode(data);
            write!(out, " {}", MeasuredNumber(value, CountUnit::of_command(command)))?;
            match width_word(command.width(), data) {
                "" => Ok(()),
                word => write!(out, " {word}"),
            }
        }
    }
}

/// The number that the answer to a query is, with its unit and its place, where the answer's text is the command and
/// that number.
pub(super) fn measured_number(reply: &Reply) -> Option<(i64, CountUnit, NumberPlace)> {
    const REFUSALS: &[(i64, &str)] =
        &[(REFUSED as i64, "refused"), ((REFUSED as u16).cast_signed() as i64, "refused")];
    let Reply { command, sub, data } = *reply;
    let has_form = matches!(
        command,
        CommandWord::RP | CommandWord::EF | CommandWord::FR | CommandWord::VM | CommandWord::SR
    );
    let is_query = matches!(command.definition(), Some((CommandKind::Query, _)));
    if sub != 0 || data > 0xFFFF || data == REFUSED || has_form || !is_query {
        return None;
    }
    let place = match command.width() {
        Width::Signed => NumberPlace::signed(6, 2),
        Width::Unsigned => NumberPlace::unsigned(6, 2),
        Width::Absolute | Width::Long => return None,
    };
    let place = NumberPlace { named: REFUSALS, ..place };
    Some((command.width().decode(data), CountUnit::of_command(command), place))
}

/// Word for a width that differs from the usual one.
fn width_word(width: Width, data: u32) -> &'static str {
    let value = width.decode(data);
    match width {
        _ if width.encode(value) == data && (data <= 0xFFFF || width != Width::Unsigned) => "",
        Width::Absolute => "short",
        _ => "wide",
    }
}

fn write_vm(value: u16, readings: Interpretation, out: &mut PieceFormatter<'_>) -> fmt::Result {
    let (headerless, silent) = readings.flags();
    match value {
        0 => out.write_str(" echo"),
        value if value == headerless => out.write_str(" headerless"),
        value if value == silent => out.write_str(" silent"),
        1..=7 => {
            out.write_str(" frames ")?;
            write_frames(value as u8, out)
        }
        _ => write!(out, " 0x{value:04X}"),
    }
}

fn write_sr(value: u32, out: &mut PieceFormatter<'_>) -> fmt::Result {
    let (mask, interval) = ((value >> 16) as u8, i64::from(value as u16));
    match mask {
        _ if value == 0 => out.write_str(" off"),
        1..=7 => {
            out.write_str(" frames ")?;
            write_frames(mask, out)?;
            write!(out, " every {}", MeasuredNumber(interval, MS))
        }
        _ => write!(out, " 0x{value:06X}"),
    }
}

fn write_frames(mask: u8, out: &mut PieceFormatter<'_>) -> fmt::Result {
    let mut join = "";
    (1..=3).filter(|n| mask >> (n - 1) & 1 == 1).try_for_each(|n| {
        write!(out, "{join}{n}")?;
        join = "+";
        Ok(())
    })
}

/// The names of a fault word, as a remark.
fn write_fault_names(word: u16, out: &mut PieceFormatter<'_>) -> fmt::Result {
    let mut join = " (";
    fault::named_bits(word).try_for_each(|bit| {
        write!(out, "{join}{}", bit.name)?;
        join = ", ";
        Ok::<(), fmt::Error>(())
    })?;
    if join == ", " { out.write_str(")") } else { Ok(()) }
}

fn write_reply(
    reply: &Reply,
    requested: Option<u32>,
    readings: Interpretation,
    out: &mut PieceFormatter<'_>,
) -> fmt::Result {
    let Reply { command, sub, data } = *reply;
    write_head(command, sub, out)?;
    if data == REFUSED && requested != Some(data) {
        return out.write_str(" refused");
    }
    match command.definition() {
        Some((CommandKind::Query, _)) => write_value(command, sub, data, readings, out),
        Some((CommandKind::Set, _)) => {
            write_value(command, sub, data, readings, out)?;
            out.write_str(" accepted")
        }
        _ => out.write_str(" accepted"),
    }
}

fn write_report(
    report: &ReportFrame,
    readings: Interpretation,
    out: &mut PieceFormatter<'_>,
) -> fmt::Result {
    let of = match report.source {
        b'T' => "TC",
        b'V' => "VC",
        _ => "SR",
    };
    write!(out, "{of} frame {}: ", report.part)?;
    let [a, b, c] = report.words;
    match report.part {
        1 => {
            let (rpm, amperes) =
                (MeasuredNumber(signed_word(a), RPM), MeasuredNumber(signed_word(c), AMPERE));
            write!(out, "{rpm}, {}, {amperes}", MeasuredNumber(b.into(), VOLT))
        }
        2 => {
            write!(out, "status 0x{a:04X}")?;
            write_fault_names(a, out)?;
            let (motor, driver) =
                (MeasuredNumber(signed_word(b), CELSIUS), MeasuredNumber(signed_word(c), CELSIUS));
            write!(out, ", {motor} (motor), {driver} (driver)")
        }
        _ => {
            let (absolute, relative) = readings.positions(report);
            write!(
                out,
                "{} (absolute), {} (relative)",
                measured_tenths(absolute),
                measured_tenths(relative)
            )
        }
    }
}

fn measured_tenths(raw: i32) -> MeasuredNumber {
    MeasuredNumber(raw.into(), DEGREE)
}

fn signed_word(word: u16) -> i64 {
    i64::from(word.cast_signed())
}

fn write_headerless(bare: &HeaderlessReport, out: &mut PieceFormatter<'_>) -> fmt::Result {
    let HeaderlessReport { rpm, decivolt, deciamp, status } = *bare;
    let (rpm, volts) = (MeasuredNumber(rpm.into(), RPM), MeasuredNumber(decivolt.into(), VOLT));
    let amperes = MeasuredNumber(deciamp.into(), AMPERE);
    write!(out, "report {rpm}, {volts}, {amperes}, status 0x{status:04X}")?;
    write_fault_names(status, out)
}

/// Reads a text.
///
/// # Errors
/// [`EncodeError::Text`] with the place and the expected words; [`EncodeError::Forbidden`] for
/// a request that [the rules](super::rules) keep a host from sending.
pub fn parse(text: &str, readings: Interpretation) -> Result<Statement, EncodeError> {
    let mut words = Tokenizer { text, at: 0 };
    let statement = parse_statement(&mut words, readings)?;
    if let Some((at, _)) = words.peek() {
        let expected = "the end: nothing more belongs to this command";
        return Err(TextError { at, expected }.into());
    }
    if let Statement::Request(request) = &statement {
        rules::check(request).map_err(EncodeError::Forbidden)?;
    }
    Ok(statement)
}

fn parse_statement(
    words: &mut Tokenizer<'_>,
    readings: Interpretation,
) -> Result<Statement, TextError> {
    let expected = "a command of two letters, such as TC, QP or LS";
    let (at, name) = words.next().ok_or(TextError { at: words.at, expected })?;
    if name.eq_ignore_ascii_case("raw") {
        return parse_raw(words);
    }
    if name.eq_ignore_ascii_case("report") {
        return parse_headerless(words)
            .map(|bare| Statement::FromDrive(DriveMessage::Headerless(bare)));
    }
    let ranged = ["SPLA", "RPLA"].into_iter().find(|word| name.eq_ignore_ascii_case(word));
    let command = CommandWord::parse(ranged.map_or(name, |word| &word[..2]));
    let command = command.ok_or(TextError { at, expected })?;
    if words.accept_word("frame") {
        return parse_report(command, words, readings, at)
            .map(|it| Statement::FromDrive(DriveMessage::Report(it)));
    }
    let sub = match command {
        CommandWord::SP | CommandWord::RP if ranged.is_some() => RANGE_PARAMETER,
        CommandWord::SP | CommandWord::RP => {
            words.read_number("a type, 0 to 0xFFFF", CountUnit::in_units(""), 0, 0xFFFF)? as u16
        }
        CommandWord::LA | CommandWord::LR => {
            words.read_number("a speed in rpm", RPM, 0, 0xFFFF)? as u16
        }
        _ => 0,
    };
    if words.accept_word("refused") {
        return Ok(Statement::FromDrive(DriveMessage::Reply(Reply {
            command,
            sub,
            data: REFUSED,
        })));
    }
    let data =
        if words.has_no_value() { None } else { Some(parse_value(command, sub, words, readings)?) };
    parse_ending(Request { command, sub, data }, words)
}

/// Parses what follows the value: a length, or the mark of a reply.
fn parse_ending(mut request: Request, words: &mut Tokenizer<'_>) -> Result<Statement, TextError> {
    let Request { command, sub, data } = request;
    let query = matches!(command.definition(), Some((CommandKind::Query, _)));
    let accepted = words.accept_word("accepted");
    if accepted || (query && data.is_some()) {
        let data = data.unwrap_or(0);
        return Ok(Statement::FromDrive(DriveMessage::Reply(Reply { command, sub, data })));
    }
    if data.is_none() {
        request.data = Request::without_value(command).data;
    }
    if words.accept_word("dlc") {
        let none = CountUnit::in_units("");
        match words.read_number("a length, 4 or 8", none, 4, 8)? {
            4 => request.data = None,
            _ => request.data = Some(request.value()),
        }
    }
    Ok(Statement::Request(request))
}

/// The data that a command's value makes.
fn parse_value(
    command: CommandWord,
    sub: u16,
    words: &mut Tokenizer<'_>,
    readings: Interpretation,
) -> Result<u32, TextError> {
    let none = CountUnit::in_units("");
    let (min, max) = (i64::from(i32::MIN), i64::from(u32::MAX));
    match command {
        CommandWord::SP | CommandWord::RP if sub == RANGE_PARAMETER => {
            let mut end = || {
                let expected = "an end of the range, such as -90 deg";
                words.read_number(expected, DEGREE, i16::MIN.into(), i16::MAX.into())
            };
            Ok(range_data(end()? as i16, end()? as i16))
        }
        CommandWord::VM => parse_vm(words, readings),
        CommandWord::SR => parse_sr(words),
        _ if matches!(command.definition(), Some((CommandKind::Order | CommandKind::Zeros, _))) => {
            let at = words.peek().map_or(words.at, |(at, _)| at);
            Err(TextError { at, expected: "the end: this command has no value" })
        }
        CommandWord::SP | CommandWord::RP | CommandWord::EF | CommandWord::FR => {
            words.read_number("a value of 32 bits", none, min, max).map(|value| value as u32)
        }
        _ => {
            let (measure, at) = (CountUnit::of_command(command), words.at);
            let value = words.read_number("a value", measure, min, max)?;
            let data = match command.width() {
                _ if words.accept_word("wide") => value as u32,
                _ if words.accept_word("short") => value as u32 & 0xFFFF,
                width => width.encode(value),
            };
            let expected = "a value that its bytes can hold";
            let same = command.width().decode(data) == value;
            if same { Ok(data) } else { Err(TextError { at, expected }) }
        }
    }
}

fn parse_vm(words: &mut Tokenizer<'_>, readings: Interpretation) -> Result<u32, TextError> {
    let (headerless, silent) = readings.flags();
    if words.accept_word("echo") {
        return Ok(0);
    }
    if words.accept_word("headerless") {
        return Ok(headerless.into());
    }
    if words.accept_word("silent") {
        return Ok(silent.into());
    }
    if words.accept_word("frames") {
        return words.read_frames().map(u32::from);
    }
    let expected = "echo, headerless, silent, frames 1+2+3, or flags and frames as numbers";
    let first = words.read_number(expected, CountUnit::in_units(""), 0, u32::MAX.into())? as u32;
    match words.peek() {
        Some((_, word)) if word.starts_with(|c: char| c.is_ascii_digit()) => {
            let frames = words.read_number(expected, CountUnit::in_units(""), 0, 0xFF)? as u32;
            Ok(first << 8 | frames)
        }
        _ => Ok(first),
    }
}

fn parse_sr(words: &mut Tokenizer<'_>) -> Result<u32, TextError> {
    if words.accept_word("off") {
        return Ok(0);
    }
    let mask = if words.accept_word("frames") {
        u32::from(words.read_frames()?)
    } else {
        let expected = "off, frames 1+2+3 every 100 ms, or frames and ms as numbers";
        words.read_number(expected, CountUnit::in_units(""), 0, u32::MAX.into())? as u32
    };
    let every = words.accept_word("every");
    match words.peek() {
        Some((_, word)) if every || word.starts_with(|c: char| c.is_ascii_digit()) => {
            Ok(mask << 16 | words.read_number("an interval in ms", MS, 0, 0xFFFF)? as u32)
        }
        _ => Ok(mask),
    }
}

fn parse_report(
    command: CommandWord,
    words: &mut Tokenizer<'_>,
    readings: Interpretation,
    at: usize,
) -> Result<ReportFrame, TextError> {
    let of = match command {
        CommandWord::TC => b'T',
        CommandWord::VC => b'V',
        CommandWord::SR => ReportFrame::UNSOLICITED,
        _ => return Err(TextError { at, expected: "TC, VC or SR before a frame's number" }),
    };
    let part = words.read_number("a frame's number, 1 to 3", CountUnit::in_units(""), 1, 3)? as u8;
    let words = match part {
        1 => [words.read_signed(RPM)?, words.read_number("volts", VOLT, 0, 0xFFFF)? as u16, {
            words.read_signed(AMPERE)?
        }],
        2 => [words.read_status()?, words.read_signed(CELSIUS)?, words.read_signed(CELSIUS)?],
        _ => {
            let limit = i64::from(i32::MAX);
            let mut locate =
                || words.read_number("a position in degrees", DEGREE, -limit - 1, limit);
            readings.position_words(locate()? as i32, locate()? as i32)
        }
    };
    Ok(ReportFrame { source: of, part, words })
}

fn parse_headerless(words: &mut Tokenizer<'_>) -> Result<HeaderlessReport, TextError> {
    Ok(HeaderlessReport {
        rpm: words.read_signed(RPM)?.cast_signed(),
        decivolt: words.read_number("volts", VOLT, 0, 0xFFFF)? as u16,
        deciamp: words.read_signed(AMPERE)?.cast_signed(),
        status: words.read_status()?,
    })
}

fn parse_raw(words: &mut Tokenizer<'_>) -> Result<Statement, TextError> {
    let reply = words.accept_word("reply");
    let (mut bytes, mut len) = ([0; 8], 0);
    while let Some((at, word)) = words.next() {
        let expected = "at most eight bytes of two hexadecimal digits";
        let wrong = TextError { at, expected };
        let byte = Some(word).filter(|word| word.len() == 2).ok_or(wrong)?;
        *bytes.get_mut(len).ok_or(wrong)? = u8::from_str_radix(byte, 16).map_err(|_| wrong)?;
        len += 1;
    }
    Ok(Statement::Raw { reply, bytes, len: len as u8 })
}

/// Words of a text with their places; remarks in parentheses are none.
struct Tokenizer<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Tokenizer<'a> {
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
    fn accept_word(&mut self, wanted: &str) -> bool {
        let found = self.peek().is_some_and(|(_, word)| word.eq_ignore_ascii_case(wanted));
        if found {
            self.next();
        }
        found
    }

    /// Returns whether no value follows.
    fn has_no_value(&mut self) -> bool {
        let word = self.peek().map_or("", |(_, word)| word);
        word.is_empty() || ["dlc", "accepted"].iter().any(|w| w.eq_ignore_ascii_case(word))
    }

    /// A number, raw or with its unit, in raw counts.
    fn read_number(
        &mut self,
        expected: &'static str,
        measure: CountUnit,
        min: i64,
        max: i64,
    ) -> Result<i64, TextError> {
        let (at, word) = self.next().ok_or(TextError { at: self.at, expected })?;
        let wrong = TextError { at, expected };
        if let Some(digits) = word.strip_prefix("0x").or(word.strip_prefix("0X")) {
            let number = i64::from_str_radix(digits, 16).map_err(|_| wrong)?;
            return Some(number).filter(|n| (min..=max).contains(n)).ok_or(wrong);
        }
        let end = word.find(|c: char| !matches!(c, '0'..='9' | '-' | '+' | '.'));
        let (number, unit) = word.split_at(end.unwrap_or(word.len()));
        let CountUnit { unit: wanted, tenths } = measure;
        let has_unit = match unit {
            "" => !wanted.is_empty() && self.accept_word(wanted),
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
        Some(raw).filter(|raw| (min..=max).contains(raw)).ok_or(wrong)
    }

    /// Signed 16 bits.
    fn read_signed(&mut self, measure: CountUnit) -> Result<u16, TextError> {
        let (min, max) = (i16::MIN.into(), i16::MAX.into());
        let value = self.read_number("a number of 16 bits", measure, min, max)?;
        Ok((value as i16).cast_unsigned())
    }

    fn read_status(&mut self) -> Result<u16, TextError> {
        self.accept_word("status");
        Ok(self.read_number("a status such as 0x0008", CountUnit::in_units(""), 0, 0xFFFF)? as u16)
    }

    /// Numbers of frames, parted by `+`, as a mask.
    fn read_frames(&mut self) -> Result<u8, TextError> {
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

/// Text for a value of VM.
#[must_use]
pub const fn format_text(form: ReplyFormat) -> &'static str {
    match form {
        ReplyFormat::Echo => "TC and VC are answered with themselves",
        ReplyFormat::Headerless => "TC and VC are answered with speed, voltage, current and status",
        ReplyFormat::Silent => "TC and VC are not answered",
        ReplyFormat::Frames(_) => "TC and VC are answered with reports 1 to 3 as chosen",
    }
}
