//! `polepair explain PROTO CODE|BYTES`

use clap::{Args, ValueEnum};
use polepair_capture::{
    Explanation, ExplanationField, ExplanationValue, RecordData, read_first_record,
};
use polepair_core::explain::{Context, Direction, Dissector};
use polepair_core::profile::{Fault, Profile, Severity};
use polepair_core::proto;

use crate::data_output::DataOutput;
use crate::outcome::faults;
use crate::problem::{self, Exit, Problem, Result};
use crate::terminal::{TextTable, colour_out};

/// Explains a code, a register value, or every byte of a frame.
///
/// One number is a code: a status, an exception, a fault or fault bits. A name and a number are a register
/// and its value. Several bytes are a frame, alone or in a line of any log that `decode` reads.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair explain tmcl 3                             a status code
  polepair explain tmcm-171 0x101                     fault bits of a drive: cause and remedy
  polepair explain modbus-rtu 2                       an exception
  polepair explain tml MER 0x0008                     bits of a register
  polepair explain canopen 0x06020000                 an abort code
  polepair explain canopen statusword 0x0237          bits of a word
  polepair explain syntron-ts Fn_100 1053             digits of a register
  polepair explain tmcl 01 01 00 00 00 00 01 5E 61    a frame, byte by byte
  polepair explain tmcl 001#0100000000015E            a CAN frame
  polepair explain modbus-rtu '[RTU]>Rx > 12:48:40:533 - 01 03 02 00 05 78 47'   a line of a log")]
pub struct Explain {
    /// Protocol or drive: tmcl, modbus-rtu, tmcm-171, …
    #[arg(value_name = "PROTO")]
    subject: String,
    /// Number, fault name, register and value, or the bytes of a frame in hexadecimal
    #[arg(value_name = "CODE|BYTES", required = true)]
    words: Vec<String>,
    /// Sender of the frame, if the bytes do not show it
    #[arg(long, value_enum)]
    from: Option<FrameSender>,
}

/// Sender of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum FrameSender {
    Host,
    Drive,
}

/// Subject of the explanation.
enum ExplainSubject {
    Protocol(&'static dyn Dissector),
    Drive(&'static Profile),
}

impl Explain {
    pub fn run(self) -> Result {
        let subject = ExplainSubject::find(&self.subject)?;
        let text = self.words.join(" ");
        let mut out = DataOutput::stdout();
        let found = match parse_code(&text) {
            Some(code) => subject.code_text(code),
            None => match subject.fault_by_name(&text) {
                Some(fault) => fault,
                None => match subject.register_value(&self.words)? {
                    Some(register) => register,
                    None => self.explain_frame(&subject, &text)?,
                },
            },
        };
        out.buffer().extend_from_slice(found.as_bytes());
        out.flush()?;
        if found.is_empty() { Err(self.unknown(&text)) } else { Ok(Exit::Ok) }
    }

    fn explain_frame(&self, subject: &ExplainSubject, text: &str) -> Result<String> {
        let record = read_first_record(text, |record| {
            let (frame, bytes) = match &record.data {
                RecordData::Bytes(bytes) => (None, bytes.to_vec()),
                RecordData::Frame(frame) => (Some(*frame), frame.bytes().to_vec()),
                RecordData::Error(error) => {
                    let words: Vec<&str> = error.descriptions().collect();
                    return Err(Some(format!("error frame: {}\n", words.join(", "))));
                }
                RecordData::Fd(_) => return Err(None),
            };
            Ok((frame, bytes, record.direction))
        });
        let (frame, bytes, direction) = match record {
            Some(Ok(found)) => found,
            Some(Err(Some(text))) => return Ok(text),
            Some(Err(None)) | None => return Err(self.unknown(text)),
        };
        let (extended, remote) = frame.map_or((false, false), |f| (f.extended, f.remote));
        let id = frame.map(|frame| frame.id);
        let stated = self.from.map(|from| match from {
            FrameSender::Host => Direction::ToDrive,
            FrameSender::Drive => Direction::ToHost,
        });
        let direction = stated.or(direction);
        let profile = subject.naming_profile();
        let context = Context { direction, profile, id, extended, remote, ..Context::default() };
        let mut explained = Explanation::default();
        subject.dissector()?.explain(&bytes, &context, &mut explained);
        Ok(frame_text(&bytes, &explained))
    }

    fn unknown(&self, text: &str) -> Problem {
        let name = &self.subject;
        Problem::new(Exit::Negative, "E110", format!("{text:?} is unknown in {name}."))
            .why("It is neither a code, nor a fault's name, nor bytes in hexadecimal.")
            .hint(format!("`polepair params {name}` lists the parameters"))
    }
}

impl ExplainSubject {
    fn find(name: &str) -> Result<Self> {
        if let Some(dissector) = proto::find_dissector(name) {
            return Ok(Self::Protocol(dissector));
        }
        let profile = polepair_drives::profiles()
            .iter()
            .find(|profile| profile.name == name || profile.family == name)
            .copied();
        let profile = profile.or_else(|| polepair::profile::find_shipped(name));
        profile.map(Self::Drive).ok_or_else(|| problem::no_such_protocol(name))
    }

    /// The profile that has the names.
    fn naming_profile(&self) -> Option<&'static Profile> {
        match self {
            Self::Protocol(dissector) => polepair_drives::usual_profile(*dissector),
            Self::Drive(profile) => Some(profile),
        }
    }

    /// The protocol, or the first wire of the drive's protocol.
    fn dissector(&self) -> Result<&'static dyn Dissector> {
        match self {
            Self::Protocol(dissector) => Ok(*dissector),
            Self::Drive(profile) => proto::dissectors()
                .iter()
                .copied()
                .find(|dissector| dissector.language() == profile.protocol)
                .ok_or_else(|| problem::no_such_protocol(profile.protocol)),
        }
    }

    fn profiles(&self) -> Vec<&'static Profile> {
        match self {
            Self::Drive(profile) => vec![profile],
            Self::Protocol(dissector) => {
                let mut profiles: Vec<_> = polepair_drives::profiles()
                    .iter()
                    .filter(|p| dissector.language() == p.protocol)
                    .collect();
                profiles.dedup_by_key(|profile| profile.family);
                profiles.into_iter().copied().collect()
            }
        }
    }

    /// Everything that the number may mean.
    fn code_text(&self, code: u32) -> String {
        let mut text = String::new();
        if let Ok(dissector) = self.dissector()
            && let Some(meaning) = dissector.code_meaning(code)
        {
            text.push_str(&format!("{} {code} (0x{code:02X}): {meaning}\n", dissector.name()));
        }
        for profile in self.profiles() {
            for fault in faults(profile, code) {
                text.push_str(&fault_text(profile, fault));
            }
        }
        text
    }

    /// A value of something that has a name: `MER 0x0008`.
    fn register_value(&self, words: &[String]) -> Result<Option<String>> {
        let [name, value] = words else { return Ok(None) };
        let Some(value) = parse_code(value) else { return Ok(None) };
        if let Some(digits) = self.digit_word(name, value.into()) {
            return Ok(Some(digits));
        }
        let mut explained = Explanation::default();
        let found = self.dissector()?.explain_named_value(
            name,
            value,
            self.naming_profile(),
            &mut explained,
        );
        Ok(found.then(|| register_text(&explained)))
    }

    /// A value whose decimal digits have meanings of their own: `Fn_100 1053`.
    fn digit_word(&self, name: &str, value: i64) -> Option<String> {
        let parameters = self
            .profiles()
            .into_iter()
            .filter_map(|profile| profile.parameter(profile.find_parameter(name)?));
        let parameter = parameters.into_iter().find(|it| !it.digits.is_empty())?;
        let mut table = TextTable::with_heads(&["digits", "value", "meaning"]);
        for (field, digits) in parameter.split_digits(value) {
            let number = format!("{digits:0places$}", places = field.places as usize);
            let unnamed = if digits > field.max { "no meaning" } else { "" };
            let meaning = field.word(digits).unwrap_or(unnamed);
            table.add_row([field.name.to_owned(), number, meaning.to_owned()]);
        }
        let defect = parameter.digit_defect(value);
        let defect = defect.map_or_else(String::new, |defect| format!("! {defect}\n"));
        let (name, symbol, about) = (parameter.name, parameter.symbol, parameter.about);
        let rows = table.render(colour_out());
        Some(format!("{symbol} ({name}) = {value}: {about}\n{defect}\n{rows}"))
    }

    fn fault_by_name(&self, name: &str) -> Option<String> {
        self.profiles().into_iter().find_map(|profile| {
            profile
                .faults
                .iter()
                .find(|fault| fault.name.eq_ignore_ascii_case(name))
                .map(|fault| fault_text(profile, fault))
        })
    }
}

fn fault_text(profile: &Profile, fault: &Fault) -> String {
    let severity = match fault.severity {
        Severity::Note => "note",
        Severity::Warning => "warning",
        Severity::Fault => "fault",
    };
    let Fault { code, name, text, cause, remedy, .. } = *fault;
    let mut shown = format!("{} {severity} {code} (0x{code:02X}) {name}: {text}\n", profile.name);
    for (word, sentence) in [("cause", cause), ("remedy", remedy)] {
        if !sentence.is_empty() {
            shown.push_str(&format!("  {word:<7} {sentence}\n"));
        }
    }
    shown
}

/// A register, bit by bit.
fn register_text(explained: &Explanation) -> String {
    let mut table = TextTable::with_heads(&["bits", "name", "value", "meaning"]);
    for item in explained.fields() {
        let name = item.name.to_owned();
        table.add_row([
            byte_range(item.start, item.end),
            name,
            item_text(&item),
            item.meaning.to_owned(),
        ]);
    }
    let (summary, remedies) = explained.text.split_once('\n').unwrap_or((&explained.text, ""));
    let remedies = if remedies.is_empty() { String::new() } else { format!("\n{remedies}\n") };
    format!("{}: {summary}\n\n{}{remedies}", explained.kind, table.render(colour_out()))
}

/// A frame, byte by byte.
pub fn frame_text(bytes: &[u8], explained: &Explanation) -> String {
    let mut hex = Vec::new();
    polepair_capture::text::append_spaced_hex(&mut hex, bytes);
    let axis = explained.axis.map_or(String::new(), |axis| format!(", axis {axis}"));
    let mut text = format!("{}\n", String::from_utf8_lossy(&hex));
    text.push_str(&format!("{}{axis}: {}\n", explained.kind, explained.text));
    if let Some(error) = explained.error {
        text.push_str(&format!("! {error}\n"));
    }
    let mut table = TextTable::with_heads(&["bytes", "hex", "field", "value", "meaning"]);
    for item in explained.fields() {
        let part = bytes.get(usize::from(item.start)..usize::from(item.end)).unwrap_or_default();
        let mut hex = Vec::new();
        polepair_capture::text::append_spaced_hex(&mut hex, part);
        table.add_row([
            byte_range(item.start, item.end),
            String::from_utf8_lossy(&hex).into_owned(),
            item.name.replace('_', " "),
            item_text(&item),
            item.meaning.to_owned(),
        ]);
    }
    if !table.is_empty() {
        text.push('\n');
        text.push_str(&table.render(colour_out()));
    }
    text
}

fn byte_range(start: u16, end: u16) -> String {
    if end == start + 1 { start.to_string() } else { format!("{start}-{}", end.saturating_sub(1)) }
}

pub fn item_text(item: &ExplanationField<'_>) -> String {
    match item.value {
        ExplanationValue::Int(value) => value.to_string(),
        ExplanationValue::Hex(value, digits) => {
            format!("0x{value:0digits$X}", digits = digits.into())
        }
        ExplanationValue::Real(value) => value.to_string(),
        ExplanationValue::Text(text) => text.to_owned(),
        ExplanationValue::Words(words) => words
            .chunks(2)
            .map(|pair| format!("0x{:04X}", pair.iter().fold(0, |w, b| w << 8 | u32::from(*b))))
            .collect::<Vec<_>>()
            .join(" "),
    }
}

/// A code: decimal, or hexadecimal with 0x.
fn parse_code(text: &str) -> Option<u32> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None if text.len() <= 5 => text.parse().ok(),
        None => None,
    }
}
