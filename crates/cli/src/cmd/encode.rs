//! `polepair encode PROTO "TEXT" [--axis N] [--host N] [--format json]`

use clap::{Args, ValueEnum};
use polepair_capture::{Explained, jsonl, text};
use polepair_core::explain::{Addressing, Context, Direction, Dissector, Encoded, TextError};
use polepair_core::proto;

use crate::problem::{self, Exit, Problem, Result};
use crate::terminal::Output;

/// The longest frame there is.
const FRAME_MAX: usize = polepair_core::medium::STREAM_UNIT_MAX;

/// Prints the bytes that a text of a protocol's own language becomes on the wire.
///
/// Nothing is sent. The line is in the format that decode reads.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair encode tmcl \"ROR 0, 350\" --axis 1          01 01 00 00 00 00 01 5E 61
  polepair encode modbus-rtu \"write Fn_33 200\"        01 06 00 33 00 C8 78 53
  polepair encode tmcl \"GAP 1, 0\" --via can           001#06010000000000
  polepair encode tmcl \"MST 0\" | polepair decode - --as tmcl")]
pub struct Encode {
    /// The protocol: tmcl, modbus-rtu, …
    #[arg(value_name = "PROTO")]
    protocol: String,
    /// What to say, in the protocol's own language
    #[arg(value_name = "TEXT")]
    text: String,
    /// Axis, station or module address
    #[arg(long, value_name = "N")]
    axis: Option<u32>,
    /// Host address
    #[arg(long, value_name = "N")]
    host: Option<u32>,
    /// The wire: serial, can, or a protocol word such as tmlcan
    #[arg(long, value_name = "WIRE")]
    via: Option<String>,
    /// How it is printed
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// How bytes are printed.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    /// The bytes, as a line that decode reads
    Text,
    /// With the fields and the answer to expect
    Json,
}

impl Encode {
    pub fn run(self) -> Result {
        let dissector = proto::dissector(&self.protocol)
            .ok_or_else(|| problem::no_such_protocol(&self.protocol))?;
        let can = self.via.as_deref().is_some_and(|wire| wire.ends_with("can"));
        let addressing = Addressing { axis: self.axis, host: self.host, profile: None, can };
        let mut buffer = [0; FRAME_MAX];
        let encoded = dissector
            .encode(&self.text, &addressing, &mut buffer)
            .map_err(|error| self.not_of_the_language(error))?;
        let bytes = &buffer[..encoded.len];
        let mut out = Output::stdout();
        match self.format {
            Format::Text => line(&encoded, bytes, out.buffer()),
            Format::Json => object(dissector, &encoded, bytes, out.buffer()),
        }
        out.buffer().push(b'\n');
        out.flush()?;
        Ok(Exit::Ok)
    }

    /// Points at the place in the text.
    fn not_of_the_language(&self, error: TextError) -> Problem {
        let before = self.text.char_indices().take_while(|(at, _)| *at < error.at);
        let column = before.count();
        Problem::usage("E241", format!("this is not {}.", self.protocol))
            .why(format!("{}\n{:column$}^ expected {}", self.text, "", error.expected))
    }
}

/// The bytes as a capture's line without the time.
pub fn line(encoded: &Encoded, bytes: &[u8], out: &mut Vec<u8>) {
    match encoded.id {
        None => text::spaced_hex(out, bytes),
        Some(id) => {
            let digits = if id > 0x7FF { 8 } else { 3 };
            out.extend_from_slice(format!("{id:0digits$X}#").as_bytes());
            jsonl::hex(out, bytes);
        }
    }
}

fn object(dissector: &dyn Dissector, encoded: &Encoded, bytes: &[u8], out: &mut Vec<u8>) {
    let direction = Some(Direction::ToDrive);
    let mut explained = Explained::default();
    let context = Context { direction, id: encoded.id, ..Context::default() };
    dissector.explain(bytes, &context, &mut explained);
    out.extend_from_slice(b"{\"protocol\":");
    jsonl::string(out, dissector.name());
    out.extend_from_slice(b",\"bytes\":\"");
    jsonl::hex(out, bytes);
    let id = encoded.id.map_or("null".to_owned(), |id| id.to_string());
    let extended = encoded.id.map_or("null".to_owned(), |id| (id > 0x7FF).to_string());
    out.extend_from_slice(format!("\",\"id\":{id},\"extended\":{extended},\"kind\":").as_bytes());
    jsonl::string(out, &explained.kind);
    let axis = explained.axis.map_or("null".to_owned(), |axis| axis.to_string());
    out.extend_from_slice(format!(",\"axis\":{axis},\"fields\":").as_bytes());
    jsonl::fields(out, &explained);
    out.extend_from_slice(b",\"text\":");
    jsonl::string(out, &explained.text);
    let answer = encoded.answer.map_or("null".to_owned(), |bytes| format!("{{\"bytes\":{bytes}}}"));
    out.extend_from_slice(format!(",\"answer\":{answer}}}").as_bytes());
}
