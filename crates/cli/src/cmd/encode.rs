//! `polepair encode PROTO "TEXT" [--axis N] [--host N] [--via WIRE] [--format json]`

use clap::{Args, ValueEnum};
use polepair_capture::{Explanation, jsonl, text};
use polepair_core::explain::{
    Context, Direction, Dissector, EncodeError, EncodeOptions, EncodedFrame, RawFrame, TextError,
    WireKind,
};
use polepair_core::proto;

use crate::data_output::DataOutput;
use crate::problem::{self, Exit, Problem, Result};
use crate::terminal::print_warning;

/// The longest frame there is.
const FRAME_MAX: usize = polepair_core::medium::STREAM_UNIT_MAX;

/// Prints the bytes of a request, given as text in the protocol's own language. Sends nothing.
///
/// The output has the format that `decode` reads. Separate several instructions by `;` or a new line; each
/// gives one line.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair encode tmcl \"ROR 0, 350\" --axis 1          01 01 00 00 00 00 01 5E 61
  polepair encode modbus-rtu \"write Fn_33 200\"        01 06 00 33 00 C8 78 53
  polepair encode tmcl \"GAP 1, 0\" --via can           001#06010000000000
  polepair encode canopen \"write 0x6040:0 u16 0x000F\" --axis 2     602#2B4060000F000000
  polepair encode tml \"KPP=0x1234\" --axis 5 --via tmlcan          0400A05E#3412
  polepair encode tml \"MODE PP; UPD\" --axis g1+2 --via rs485
  polepair encode tmcl \"MST 0\" | polepair decode - --as tmcl")]
pub struct Encode {
    /// Protocol: tmcl, modbus-rtu, …
    #[arg(value_name = "PROTO")]
    protocol: String,
    /// Request in the protocol's own language
    #[arg(value_name = "TEXT")]
    text: String,
    /// Axis, station or module address; g1+2 for groups, g* for broadcast, h5 for the host at axis 5
    #[arg(long, value_name = "N", value_parser = parse_destination)]
    axis: Option<Destination>,
    /// Host address
    #[arg(long, value_name = "N")]
    host: Option<u32>,
    /// Medium: serial, rs485, can, or the name of a protocol variant such as tmlcan
    #[arg(long, value_name = "WIRE")]
    via: Option<String>,
    #[command(flatten)]
    named_by: crate::profile_args::NamingArgs,
    /// Output format
    #[arg(long, value_enum, default_value_t = EncodeFormat::Text)]
    format: EncodeFormat,
}

/// Output formats of `encode`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum EncodeFormat {
    /// The bytes, in the format that `decode` reads
    Text,
    /// JSON with the fields and the expected reply
    Json,
}

/// Receiver of a text.
#[derive(Clone, Copy, Debug)]
struct Destination {
    id: u32,
    groups: bool,
    host: bool,
}

/// `5`, `g1`, `g1+2`, `g*`, `h5`.
fn parse_destination(text: &str) -> std::result::Result<Destination, String> {
    let wrong = "expected an axis such as 5, groups such as g1 or g1+2, g* for broadcast, or h5 \
                 for the host at axis 5";
    let single = |text: &str, host| {
        let id = text.parse();
        id.map(|id| Destination { id, groups: false, host }).map_err(|_| wrong.to_owned())
    };
    if let Some(axis) = text.strip_prefix(['h', 'H']) {
        return single(axis, true);
    }
    match text.strip_prefix(['g', 'G']) {
        None => single(text, false),
        Some("*") => Ok(Destination { id: 0, groups: true, host: false }),
        Some(numbers) => {
            let mask =
                numbers.split('+').try_fold(0, |mask, n| Ok::<_, String>(mask | parse_group(n)?));
            mask.map(|id| Destination { id, groups: true, host: false })
        }
    }
}

fn parse_group(text: &str) -> std::result::Result<u32, String> {
    match text.parse::<u32>() {
        Ok(number @ 1..=8) => Ok(1 << (number - 1)),
        _ => Err("groups are 1 to 8: g1, g1+2, or g* for broadcast".to_owned()),
    }
}

impl Encode {
    pub fn run(self) -> Result {
        let (dissector, via) = self.find_wire()?;
        let groups = self.axis.is_some_and(|axis| axis.groups);
        let to_host = self.axis.is_some_and(|axis| axis.host);
        if (groups || to_host) && !dissector.has_groups() {
            let what = if groups { "groups" } else { "addresses of hosts" };
            return Err(Problem::usage("E245", format!("{} has no {what}.", dissector.name())));
        }
        let axis = self.axis.map(|axis| axis.id);
        let profile =
            self.named_by.profile()?.or_else(|| polepair_drives::usual_profile(dissector));
        let addressing =
            EncodeOptions { axis, groups, to_host, host: self.host, profile, wire: via };
        let mut out = DataOutput::stdout().with_text(self.format == EncodeFormat::Text);
        for (at, piece) in instructions(&self.text) {
            self.encode_piece(dissector, at, piece, &addressing, out.buffer())?;
        }
        out.flush()?;
        Ok(Exit::Ok)
    }

    fn encode_piece(
        &self,
        dissector: &dyn Dissector,
        at: usize,
        piece: &str,
        addressing: &EncodeOptions,
        out: &mut Vec<u8>,
    ) -> Result<()> {
        let mut buffer = [0; FRAME_MAX];
        let encoded = dissector
            .encode(piece, addressing, &mut buffer)
            .map_err(|error| self.encode_problem(at, piece, error))?;
        if !encoded.warning.is_empty() {
            print_warning(&format!("{}: {}", piece.trim(), encoded.warning));
        }
        let bytes = &buffer[..encoded.len];
        match self.format {
            EncodeFormat::Text => write_frame(&encoded, bytes, out),
            EncodeFormat::Json => write_json(dissector, &encoded, bytes, addressing, out),
        }
        out.push(b'\n');
        Ok(())
    }

    /// The dissector of the protocol, or of the wire where that is a protocol of the same language.
    fn find_wire(&self) -> Result<(&'static dyn Dissector, WireKind)> {
        let dissector = proto::find_dissector(&self.protocol)
            .ok_or_else(|| problem::no_such_protocol(&self.protocol))?;
        match self.via.as_deref() {
            None => Ok((dissector, WireKind::Default)),
            Some("serial" | "rs232") => Ok((dissector, WireKind::Serial)),
            Some("rs485") => Ok((dissector, WireKind::Rs485)),
            Some("can") => Ok((dissector, WireKind::Can)),
            Some(word) => {
                let other = proto::find_dissector(word);
                let same = other.filter(|other| other.language() == dissector.language());
                same.map(|other| (other, WireKind::Default))
                    .ok_or_else(|| no_such_wire(dissector, word))
            }
        }
    }

    /// Describes why a piece could not be encoded.
    fn encode_problem(&self, at: usize, piece: &str, error: EncodeError) -> Problem {
        match error {
            EncodeError::Text(error) => {
                self.language_problem(TextError { at: at + error.at, ..error })
            }
            EncodeError::Forbidden(rule) => {
                Problem::usage("E222", format!("{:?} cannot be sent like this.", piece.trim()))
                    .why(format!("{rule}."))
            }
        }
    }

    /// Points at the place in the text.
    fn language_problem(&self, error: TextError) -> Problem {
        let start = self.text[..error.at].rfind('\n').map_or(0, |end| end + 1);
        let line = self.text[start..].lines().next().unwrap_or_default();
        let column = self.text[start..error.at].chars().count();
        Problem::usage("E241", format!("this is not {}.", self.protocol))
            .why(format!("{line}\n{:column$}^ expected {}", "", error.expected))
    }
}

fn no_such_wire(dissector: &dyn Dissector, word: &str) -> Problem {
    let protocols = proto::dissectors().iter().filter(|d| d.language() == dissector.language());
    let words: Vec<&str> =
        ["serial", "rs485", "can"].into_iter().chain(protocols.map(|d| d.name())).collect();
    Problem::usage("E245", format!("{} cannot be sent over {word:?}.", dissector.name()))
        .why(format!("Wires are {}.", problem::join_list(&words)))
}

/// Instructions, and where in the text they begin; comments behind `//` are none.
pub fn instructions(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().map(|line| line.find("//").map_or(line, |end| &line[..end]));
    let pieces = lines.flat_map(|line| line.split(';')).filter(|piece| !piece.trim().is_empty());
    // A text without any is refused by the protocol, which knows what it expects.
    let empty = Some((0, text)).filter(|_| text.trim().is_empty());
    empty.into_iter().chain(pieces.map(move |piece| (piece_offset(piece, text), piece)))
}

fn piece_offset(piece: &str, text: &str) -> usize {
    piece.as_ptr() as usize - text.as_ptr() as usize
}

/// The bytes as a capture's line without the time.
pub fn write_frame(encoded: &EncodedFrame, bytes: &[u8], out: &mut Vec<u8>) {
    match encoded.id {
        None => text::append_spaced_hex(out, bytes),
        Some(id) => {
            let digits = if encoded.extended { 8 } else { 3 };
            out.extend_from_slice(format!("{id:0digits$X}#").as_bytes());
            match encoded.remote_len {
                Some(len) => out.extend_from_slice(format!("R{len}").as_bytes()),
                None => jsonl::write_hex(out, bytes),
            }
        }
    }
}

fn write_json(
    dissector: &dyn Dissector,
    encoded: &EncodedFrame,
    bytes: &[u8],
    addressing: &EncodeOptions,
    out: &mut Vec<u8>,
) {
    let direction = Some(Direction::ToDrive);
    let EncodedFrame { id, extended, remote_len, .. } = *encoded;
    let remote = remote_len.is_some();
    let mut explained = Explanation::default();
    let profile = addressing.profile;
    let context = Context { direction, profile, id, extended, remote, ..Context::default() };
    dissector.explain(bytes, &context, &mut explained);
    out.extend_from_slice(b"{\"protocol\":");
    jsonl::write_string(out, dissector.name());
    out.extend_from_slice(b",\"bytes\":\"");
    jsonl::write_hex(out, bytes);
    let extended = id.map_or("null".to_owned(), |_| extended.to_string());
    let id = id.map_or("null".to_owned(), |id| id.to_string());
    out.extend_from_slice(format!("\",\"id\":{id},\"extended\":{extended},").as_bytes());
    write_explained(&explained, out);
    out.extend_from_slice(b",\"answer\":");
    let mut expected = Explanation::default();
    let raw = RawFrame { bytes, id: encoded.id, extended: encoded.extended };
    dissector.explain_expected_reply(&raw, addressing, &mut expected);
    match encoded.answer_len {
        None if expected.kind.is_empty() => out.extend_from_slice(b"null"),
        length => {
            let length = length.map_or("null".to_owned(), |bytes| bytes.to_string());
            out.extend_from_slice(format!("{{\"bytes\":{length}").as_bytes());
            if !expected.kind.is_empty() {
                out.push(b',');
                write_explained(&expected, out);
            }
            out.push(b'}');
        }
    }
    out.push(b'}');
}

/// Kind, axis, fields and text as members of an object.
fn write_explained(explained: &Explanation, out: &mut Vec<u8>) {
    out.extend_from_slice(b"\"kind\":");
    jsonl::write_string(out, &explained.kind);
    let axis = explained.axis.map_or("null".to_owned(), |axis| axis.to_string());
    out.extend_from_slice(format!(",\"axis\":{axis},\"fields\":").as_bytes());
    jsonl::write_fields(out, explained);
    out.extend_from_slice(b",\"text\":");
    jsonl::write_string(out, &explained.text);
}
