//! `polepair decode FILE|- [--as PROTO[@ID],…] [--from FORMAT] [--format text|jsonl] [-o OUT]`

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, ValueEnum};
use polepair_capture::{
    Decoder, Event, Follow, Format as Form, Judge, Next, Place, Rules, Tally, Verdict, jsonl, text,
};
use polepair_core::profile::Profile;

use crate::problem::{self, Exit, Problem, Result};
use crate::terminal::{self, Output, say};

/// A capture on stdin that pauses so long is judged by what came so far, and followed from there.
const PAUSE: Duration = Duration::from_millis(700);
/// Bytes of a capture on stdin that are gathered for the judgement.
const GATHER_MAX: usize = 1 << 28;
const PIECE: usize = 1 << 18;

/// The drive whose names are used, if one is stated.
type Named = Option<&'static Profile>;

/// Explains every frame of a capture.
///
/// Reads candump and serial logs, pcap, pcapng, Vector ASC and BLF, PEAK TRC, python-can's CSV and its
/// own JSONL, also as .gz and .zst, from a file or from stdin. Without --as the whole capture is weighed
/// against every protocol, and the verdict goes to stderr.
#[derive(Args, Debug)]
#[command(after_help = "\
A log has one line for each CAN frame, or for each run of serial bytes:
  (1700000000.000500) can0 30B#5443000000000005
  (1700000000.000500) ttyUSB0 > 01 01 00 00 00 00 01 5E 61     > host to drive, < drive to host

Examples:
  polepair decode capture.log
  polepair decode capture.log --as tmcl --format jsonl -o frames.jsonl
  polepair decode machine.blf
  polepair decode bus.log --as canopen@2,thruster@11 --profile syntron-ts-canopen
  tail -f bus.log | polepair decode - --as modbus-rtu@ttyUSB0,tmcl@ttyUSB1")]
pub struct Decode {
    /// The capture; - for stdin
    #[arg(value_name = "FILE|-")]
    source: PathBuf,
    /// Protocol, of everything, or @ an axis number or a link; several with commas
    #[arg(long = "as", value_name = "PROTO[@ID],…")]
    rules: Option<String>,
    /// How the capture is stored [default: told by its first bytes]
    #[arg(long, value_name = "FORMAT", value_parser = super::capture_format())]
    from: Option<Form>,
    #[command(flatten)]
    named_by: super::NamedBy,
    /// How frames are written [default: text, or jsonl if OUT ends so]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write to a file instead of stdout
    #[arg(short, long = "out", value_name = "OUT")]
    out: Option<PathBuf>,
}

/// How frames are written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    /// One aligned line a frame
    Text,
    /// One JSON object a frame
    Jsonl,
}

impl Decode {
    pub fn run(self) -> Result {
        let rules = self.rules.as_deref().map(rules).transpose()?;
        let profile = self.named_by.profile()?;
        let mut writer = Writer::new(self.format(), self.out.as_deref())?;
        let source = Source { rules, profile, form: self.from };
        let decoder = if self.source.as_os_str() == "-" {
            source.follow(&mut writer)?
        } else {
            source.file(&self.source, &mut writer)?
        };
        report(&decoder)
    }

    fn format(&self) -> Format {
        let jsonl = |out: &PathBuf| out.extension().is_some_and(|end| end == "jsonl");
        let by_name = self.out.as_ref().filter(|out| jsonl(out)).map(|_| Format::Jsonl);
        self.format.or(by_name).unwrap_or(Format::Text)
    }
}

fn rules(text: &str) -> Result<Rules> {
    Rules::parse(text).map_err(|error| problem::no_such_protocol(&error.word))
}

/// A capture, and what is stated about it.
struct Source {
    rules: Option<Rules>,
    profile: Named,
    form: Option<Form>,
}

impl Source {
    fn decoder(&self, rules: Rules) -> Decoder {
        Decoder::new(rules).with_profile(self.profile).with_format(self.form)
    }

    fn judged(&self, judge: Judge) -> Decoder {
        let (verdicts, decoder) = judge.decide();
        verdicts.iter().for_each(tell);
        decoder.with_profile(self.profile)
    }

    /// Decodes a file: once through to judge it, once to explain it.
    fn file(mut self, path: &Path, writer: &mut Writer) -> Result<Decoder> {
        let mut decoder = match self.rules.take() {
            Some(rules) => self.decoder(rules),
            None => {
                let mut judge = Judge::of_format(self.form);
                pieces(path, &mut |piece| {
                    judge.feed(piece);
                    Ok(())
                })?;
                self.judged(judge)
            }
        };
        pieces(path, &mut |piece| {
            decoder.feed(piece, &mut |event| writer.write(event));
            writer.out.spill()
        })?;
        decoder.finish(&mut |event| writer.write(event));
        writer.out.flush()?;
        Ok(decoder)
    }

    /// Decodes stdin, piece by piece as it comes.
    fn follow(mut self, writer: &mut Writer) -> Result<Decoder> {
        let source = Follow::new(std::io::stdin());
        let (mut decoder, mut ended) = match self.rules.take() {
            Some(rules) => (self.decoder(rules), false),
            None => self.gather(&source, writer)?,
        };
        writer.out.flush()?;
        while !ended {
            ended = match source.next(None) {
                Next::Piece(piece) => {
                    decoder.feed(&piece, &mut |event| writer.write(event));
                    writer.out.flush()?;
                    false
                }
                Next::Pause => false,
                Next::End(error) => end(error)?,
            };
        }
        decoder.finish(&mut |event| writer.write(event));
        writer.out.flush()?;
        Ok(decoder)
    }

    /// Gathers stdin until it ends or pauses, judges it, and explains what was gathered.
    fn gather(&self, source: &Follow, writer: &mut Writer) -> Result<(Decoder, bool)> {
        let mut gathered = Vec::new();
        let ended = loop {
            match source.next(Some(PAUSE)) {
                Next::Piece(piece) => gathered.extend_from_slice(&piece),
                Next::Pause if gathered.is_empty() => {}
                Next::Pause => break false,
                Next::End(error) => break end(error)?,
            }
            if gathered.len() > GATHER_MAX {
                break false;
            }
        };
        let mut judge = Judge::of_format(self.form);
        judge.feed(&gathered);
        let mut decoder = self.judged(judge);
        if !ended {
            say("judged by what came so far; --as PROTO states the protocol");
        }
        decoder.feed(&gathered, &mut |event| writer.write(event));
        Ok((decoder, ended))
    }
}

/// Reads a file in pieces.
pub fn pieces(path: &Path, each: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<()> {
    let failed = |error| problem::file(path, "read", &error);
    let mut file = std::fs::File::open(path).map_err(failed)?;
    let mut buffer = vec![0; PIECE];
    loop {
        match file.read(&mut buffer).map_err(failed)? {
            0 => return Ok(()),
            count => each(&buffer[..count])?,
        }
    }
}

fn end(error: Option<std::io::Error>) -> Result<bool> {
    error.map_or(Ok(true), |error| Err(problem::file(Path::new("stdin"), "read", &error)))
}

fn tell(verdict: &Verdict) {
    let doubt = verdict.protocol.is_some() && verdict.sure < 0.5;
    let advice = if doubt { " - a guess; --as PROTO states the protocol" } else { "" };
    say(&format!("{verdict}{advice}"));
}

fn report(decoder: &Decoder) -> Result {
    if decoder.left_out() > 0 {
        let links = "frames of more links than are followed at once are left out";
        say(&format!("{} {links}", decoder.left_out()));
    }
    damage(decoder.tally())
}

/// Names damaged places. A file without a single readable one is no capture.
pub fn damage(tally: &Tally) -> Result {
    const SHOWN: usize = 5;
    for damage in tally.damage.iter().take(SHOWN) {
        let what = if matches!(damage.place, Place::Line(_)) { "the line" } else { "this part" };
        say(&format!("{damage}; {what} is left out"));
    }
    if tally.damaged > SHOWN as u64 {
        say(&format!("{} places could not be read, {} records were", tally.damaged, tally.records));
    }
    if tally.damaged > 0 && tally.records == 0 {
        return Err(Problem::new(Exit::Corrupt, "E510", "this is not a capture.")
            .why("Nothing of it could be read.")
            .hint("--from FORMAT states its format; polepair decode --help shows what is read"));
    }
    Ok(Exit::Ok)
}

/// Writes frames in the format asked for.
struct Writer {
    out: Output,
    text: Option<text::Text>,
}

impl Writer {
    fn new(format: Format, path: Option<&Path>) -> Result<Self> {
        let style = text::Style { colour: path.is_none() && terminal::colour_out() };
        let text = (format == Format::Text).then(|| text::Text::new(style));
        Ok(Self { out: Output::to(path)?, text })
    }

    fn write(&mut self, event: &Event<'_>) {
        match &mut self.text {
            Some(text) => text.write(event, self.out.buffer()),
            None => jsonl::write(event, self.out.buffer()),
        }
    }
}
