//! Programs as files, and in a drive's memory.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};

use clap::Args;
use polepair::Axis;
use polepair::program::{Program, Source, is_software};
use polepair_core::profile::Profile;
use polepair_core::program::{Language, Memory, Progress, sum};
use polepair_core::{drives, proto};

use super::{address, only};
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::target::Target;
use crate::terminal::{self, Output, say};

/// Words that are read at a time while the end of a program is looked for.
const CHUNK: usize = 64;
/// What erased permanent memory holds.
const ERASED: u16 = 0xFFFF;

/// Where a program lies.
#[derive(Args, Debug)]
struct Place {
    /// Into RAM: lost with the power
    #[arg(long)]
    ram: bool,
    /// Into the EEPROM: kept, and worn by every write
    #[arg(long, conflicts_with = "ram")]
    eeprom: bool,
    /// Where the first word of a text lies; else where RAM, or with --eeprom the EEPROM, begins
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    at: Option<u16>,
}

impl Place {
    /// Where a text's first word lies.
    fn origin(&self, language: &dyn Language) -> u16 {
        let rules = language.rules();
        self.at.unwrap_or(if self.eeprom {
            *rules.permanent.start()
        } else {
            *rules.volatile.start()
        })
    }

    /// Reads a file for an axis.
    fn read(&self, axis: &Axis, path: &Path) -> Result<Program> {
        let language = axis.language().map_err(outcome::error)?;
        let source = axis.source(self.origin(language)).map_err(outcome::error)?;
        let program = Program::read(path, &source).map_err(|e| outcome::error(e.into()))?;
        let lies = |memory| {
            let rules = language.rules();
            let mut pieces = program.pieces().iter();
            pieces.any(|piece| rules.memory(piece.start, piece.words.len()) == Some(memory))
        };
        let wrong = match () {
            () if self.ram && lies(Memory::Permanent) => "in the EEPROM, not in RAM",
            () if self.eeprom && lies(Memory::Volatile) => "in RAM, not in the EEPROM",
            () => return Ok(program),
        };
        let what = format!("a part of {} lies {wrong}.", path.display());
        Err(Problem::usage("E242", what).why("Where a software file's words lie stands in it."))
    }
}

/// Turns a program's text into a software file, or a software file into text.
///
/// A line holds instructions, parted by `;`, and a comment behind `//`; `name:` is a label for GOTO,
/// CALL and CALLS. Nothing is sent.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program assemble moves.tml -o moves.sw --eeprom
  polepair program assemble moves.sw                         shows the text of its words")]
pub struct Assemble {
    /// The text; a software file (.sw) is turned into text
    #[arg(value_name = "FILE")]
    path: PathBuf,
    /// Where the result goes; else to stdout
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The drive whose variables the text names: technosoft-fa00g, …
    #[arg(long, value_name = "DRIVE")]
    drive: Option<String>,
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    profiles: crate::cmd::ProfileFile,
}

impl Assemble {
    pub fn run(self) -> Result {
        let (language, profile) = self.language()?;
        let source = Source { language, profile, origin: self.place.origin(language) };
        let read = Program::read(&self.path, &source);
        let program = read.map_err(|error| outcome::error(error.into()))?;
        let text = match is_software(&self.path) {
            true => program.listing(language, profile),
            false => program.to_sw(),
        };
        let mut out = Output::to(self.output.as_deref())?;
        out.buffer().extend_from_slice(text.as_bytes());
        out.flush()?;
        describe(&program, language);
        for (name, address) in program.labels() {
            say(&format!("{name} = 0x{address:04X}"));
        }
        Ok(Exit::Ok)
    }

    /// The language that programs are written in, and whose names they use.
    fn language(&self) -> Result<(&'static dyn Language, Option<&'static Profile>)> {
        let known = self.profiles.known()?;
        let named = self.drive.as_deref().map(|word| crate::cmd::params::find(&known, word));
        let named = named.transpose()?;
        let speaks = |name: &str| named.is_none_or(|profile| profile.protocol == name);
        let found = proto::dissectors().iter().find_map(|dissector| {
            let language = dissector.programs().filter(|_| speaks(dissector.language()))?;
            Some((language, named.or_else(|| drives::usual(*dissector))))
        });
        found.ok_or_else(|| Problem::usage("E218", "This drive takes no programs."))
    }
}

/// Writes a program into a drive's memory.
///
/// Word by word, each chunk proven before the next; then the drive's own sum over it must agree. The
/// motor must have no power. RAM unless --eeprom is given: permanent memory wears.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program load tml+serial:///dev/ttyUSB0:9600#1 moves.tml
  polepair program load tml+serial:///dev/ttyUSB0:9600#1 cell.sw --eeprom")]
pub struct Load {
    #[command(flatten)]
    target: Target,
    /// A program's text, or a software file (.sw)
    #[arg(value_name = "FILE")]
    path: PathBuf,
    #[command(flatten)]
    place: Place,
    /// Say what would be written where, and write nothing
    #[arg(long)]
    dry_run: bool,
}

impl Load {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = only(&session)?;
        let program = self.place.read(axis, &self.path)?;
        let language = axis.language().map_err(outcome::error)?;
        describe(&program, language);
        if self.dry_run {
            say("dry run: nothing was written");
            return Ok(Exit::Ok);
        }
        session.listen();
        let mut meter = Meter::new();
        let written = axis.download(&program, self.place.eeprom, |progress| meter.show(progress));
        drop(meter);
        let written = written.map_err(|error| incomplete(outcome::error(error)))?;
        let again = match written.repeated {
            0 => String::new(),
            repeated => format!(", {repeated} of them once more because they were lost on the way"),
        };
        say(&format!("{} words written and proven by the drive's sum{again}", program.words()));
        Ok(Exit::Ok)
    }
}

/// What was begun and not ended is told.
fn incomplete(problem: Problem) -> Problem {
    match problem.exit {
        Exit::Usage | Exit::Refused => problem,
        _ => {
            problem.hint("the program in the drive is not whole now: load it again before it runs")
        }
    }
}

/// Compares a drive's memory with a program, by the drive's sums. Writes nothing.
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair program verify tml+serial:///dev/ttyUSB0:9600#1 cell.sw")]
pub struct Verify {
    #[command(flatten)]
    target: Target,
    /// A program's text, or a software file (.sw)
    #[arg(value_name = "FILE")]
    path: PathBuf,
    #[command(flatten)]
    place: Place,
    /// Read every word: sums do not see words that changed places
    #[arg(long)]
    words: bool,
}

impl Verify {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = only(&session)?;
        let program = self.place.read(axis, &self.path)?;
        session.listen();
        if self.words {
            return compare(axis, &program);
        }
        axis.verify(&program).map_err(outcome::error)?;
        say(&format!("the drive's sums over {} words agree", program.words()));
        Ok(Exit::Ok)
    }
}

/// Compares word by word.
fn compare(axis: &Axis, program: &Program) -> Result {
    let mut different = 0;
    for piece in program.pieces() {
        let mut meter = Meter::new();
        let read = axis.upload(piece.start, piece.words.len(), |progress| meter.show(progress));
        drop(meter);
        let read = read.map_err(outcome::error)?;
        let found = read.pieces().iter().flat_map(|piece| &piece.words);
        for ((at, word), found) in (piece.start..=u16::MAX).zip(&piece.words).zip(found) {
            if word != found {
                different += 1;
                say(&format!("{at:04X}: {found:04X} in the drive, {word:04X} in the file"));
            }
        }
    }
    if different > 0 {
        let what = format!("{different} of {} words differ.", program.words());
        return Err(Problem::new(Exit::Negative, "E103", what).hint("load the program again"));
    }
    say(&format!("{} words agree", program.words()));
    Ok(Exit::Ok)
}

/// Keeps what is in a drive's memory as a file: words (.sw), or text.
///
/// Without --words it reads to the end of what was written: to 64 erased words in a row.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program save tml+serial:///dev/ttyUSB0:9600#1 backup.sw
  polepair program save tml+serial:///dev/ttyUSB0:9600#1 routine.tml --at 0x8270 --words 40")]
pub struct Save {
    #[command(flatten)]
    target: Target,
    /// Where it goes; words if it is called .sw, else text
    #[arg(value_name = "FILE")]
    path: PathBuf,
    /// The first address; else where the drive starts by itself
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    at: Option<u16>,
    /// How many words
    #[arg(long, value_name = "N")]
    words: Option<u16>,
}

impl Save {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = only(&session)?;
        session.listen();
        let language = axis.language().map_err(outcome::error)?;
        let start = self.at.unwrap_or(language.rules().autorun.0);
        let words = match self.words {
            Some(count) => read(axis, start, count.into())?,
            None => written(axis, start, *language.rules().permanent.end())?,
        };
        if words.is_empty() {
            let what = format!("the memory from 0x{start:04X} on is erased.");
            return Err(Problem::new(Exit::Negative, "E110", what));
        }
        let program = Program::of(start, words);
        let text = match is_software(&self.path) {
            true => program.to_sw(),
            false => program.listing(language, Some(axis.profile())),
        };
        let mut out = Output::file(&self.path)?;
        out.buffer().extend_from_slice(text.as_bytes());
        out.flush()?;
        describe(&program, language);
        Ok(Exit::Ok)
    }
}

/// What was written from an address on, without the erased words behind it.
fn written(axis: &Axis, start: u16, last: u16) -> Result<Vec<u16>> {
    let room = usize::from(last.saturating_sub(start)) + 1;
    let mut words = Vec::new();
    while words.len() < room {
        let at = start.wrapping_add(words.len() as u16);
        let chunk = read(axis, at, CHUNK.min(room - words.len()))?;
        if chunk.iter().all(|word| *word == ERASED) {
            break;
        }
        words.extend(chunk);
    }
    while words.last() == Some(&ERASED) {
        words.pop();
    }
    Ok(words)
}

fn read(axis: &Axis, start: u16, count: usize) -> Result<Vec<u16>> {
    let mut meter = Meter::new();
    let read = axis.upload(start, count, |progress| meter.show(progress));
    drop(meter);
    let read = read.map_err(outcome::error)?;
    Ok(read.pieces().iter().flat_map(|piece| piece.words.clone()).collect())
}

/// Says where a program lies.
fn describe(program: &Program, language: &dyn Language) {
    for piece in program.pieces() {
        let count = piece.words.len();
        let memory = match language.rules().memory(piece.start, count) {
            Some(Memory::Permanent) => "EEPROM",
            Some(Memory::Volatile) => "RAM",
            None => "no memory for programs",
        };
        let end = usize::from(piece.start) + count - 1;
        let sum = sum(&piece.words);
        say(&format!("{:04X} to {end:04X}: {count} words, sum {sum:04X}, {memory}", piece.start));
    }
}

/// One line on a terminal, drawn again and again.
struct Meter {
    shown: bool,
}

impl Meter {
    fn new() -> Self {
        Self { shown: std::io::stderr().is_terminal() }
    }

    fn show(&mut self, progress: Progress) {
        if self.shown {
            terminal::draw(&format!("\r\x1b[K{} of {} words", progress.done, progress.total));
        }
    }
}

impl Drop for Meter {
    fn drop(&mut self) {
        if self.shown {
            terminal::draw("\r\x1b[K");
        }
    }
}
