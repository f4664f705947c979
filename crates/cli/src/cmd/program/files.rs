//! `program assemble`, `load`, `verify` and `save`: programs as files and in the memory of a drive.

use std::path::{Path, PathBuf};

use clap::Args;
use polepair::LocalAxis;
use polepair::program::{AssemblyContext, Program, is_software};
use polepair_core::profile::Profile;
use polepair_core::program::{MemoryKind, ProgramLanguage, TransferProgress, checksum};
use polepair_core::proto;

use super::{instructions, module_axis, parse_address};
use crate::data_output::DataOutput;
use crate::outcome;
use crate::output_file;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::target::DriveArgs;
use crate::terminal::print_note;

/// Words that are read at a time while the end of a program is looked for.
const CHUNK: usize = 64;
/// Content of erased permanent memory.
const ERASED: u16 = 0xFFFF;

/// Memory location of a program.
#[derive(Args, Debug)]
struct ProgramLocation {
    /// Use the RAM; its content is lost at power-off
    #[arg(long)]
    ram: bool,
    /// Use the EEPROM; its content is kept, and each write wears it
    #[arg(long, conflicts_with = "ram")]
    eeprom: bool,
    /// Address of the first word of a text [default: start of the RAM, or of the EEPROM with --eeprom]
    #[arg(long, value_name = "ADDRESS", value_parser = parse_address)]
    at: Option<u16>,
}

impl ProgramLocation {
    /// Address of a text's first word.
    fn origin(&self, language: &dyn ProgramLanguage) -> u16 {
        let rules = language.memory_rules();
        self.at.unwrap_or(if self.eeprom {
            *rules.permanent.start()
        } else {
            *rules.volatile.start()
        })
    }

    /// A TMCL module has one memory, whose programs begin at address 0.
    fn refuse_for_module(&self) -> Result<()> {
        if self.ram || self.at.is_some() {
            Err(Problem::usage("E242", "A TMCL module keeps its program in the EEPROM, from 0 on.")
                .hint("remove --ram and --at"))
        } else {
            Ok(())
        }
    }

    /// Reads a file for an axis.
    fn read_program(&self, axis: &LocalAxis, path: &Path) -> Result<Program> {
        let language = axis.language().map_err(outcome::to_problem)?;
        let source = axis.assembly_context(self.origin(language)).map_err(outcome::to_problem)?;
        let program = Program::read(path, &source).map_err(|e| outcome::to_problem(e.into()))?;
        let lies = |memory| {
            let rules = language.memory_rules();
            let mut pieces = program.pieces().iter();
            pieces.any(|piece| rules.memory_at(piece.start, piece.words.len()) == Some(memory))
        };
        let wrong = match () {
            () if self.ram && lies(MemoryKind::Permanent) => "in the EEPROM, not in RAM",
            () if self.eeprom && lies(MemoryKind::Volatile) => "in RAM, not in the EEPROM",
            () => return Ok(program),
        };
        let what = format!("a part of {} lies {wrong}.", path.display());
        Err(Problem::usage("E242", what).why(
            "A software file contains the addresses of its \
         words.",
        ))
    }
}

/// Converts program text to a file for the drive, or such a file to text. Sends nothing.
///
/// TML (.tml, .sw): one line holds instructions, separated by `;`. A comment begins with `//`. `name:` is a
/// label for GOTO, CALL and CALLS.
///
/// TMCL (.tmc, .bin): one line holds one instruction. Labels, constants (`Speed = 500`), comments and
/// #include are written as in the TMCL-IDE.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program assemble moves.tml -o moves.sw --eeprom
  polepair program assemble moves.sw                         prints the words as text
  polepair program assemble moves.tmc                        prints a TMCL program with addresses
  polepair program assemble moves.tmc -o moves.bin")]
pub struct Assemble {
    /// Program text, or a program file (.sw, .bin)
    #[arg(value_name = "FILE")]
    path: PathBuf,
    /// File to write [default: stdout]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Drive whose variable names the text uses: technosoft-fa00g, …
    #[arg(long, value_name = "DRIVE")]
    drive: Option<String>,
    #[command(flatten)]
    place: ProgramLocation,
    #[command(flatten)]
    profiles: crate::profile_args::ProfileFile,
}

impl Assemble {
    pub fn run(self) -> Result {
        output_file::refuse_input(self.output.as_deref(), [self.path.as_path()])?;
        if instructions::is_program(&self.path) {
            return instructions::assemble(&self.path, self.output.as_deref());
        }
        let (language, profile) = self.language()?;
        let source = AssemblyContext { language, profile, origin: self.place.origin(language) };
        let read = Program::read(&self.path, &source);
        let program = read.map_err(|error| outcome::to_problem(error.into()))?;
        let text = if is_software(&self.path) {
            program.listing(language, profile)
        } else {
            program.to_sw()
        };
        let mut out = DataOutput::to_path(self.output.as_deref())?;
        out.buffer().extend_from_slice(text.as_bytes());
        out.finish()?;
        print_layout(&program, language);
        for (name, address) in program.labels() {
            print_note(&format!("{name} = 0x{address:04X}"));
        }
        Ok(Exit::Ok)
    }

    /// The language that programs are written in, and whose names they use.
    fn language(&self) -> Result<(&'static dyn ProgramLanguage, Option<&'static Profile>)> {
        let known = self.profiles.known_profiles()?;
        let named = self.drive.as_deref().map(|word| crate::cmd::params::find_drive(&known, word));
        let named = named.transpose()?;
        let found = proto::dissectors().iter().find_map(|dissector| {
            let language = dissector
                .program_language()
                .filter(|_| profile_speaks(dissector.language(), named))?;
            Some((language, named.or_else(|| polepair_drives::usual_profile(*dissector))))
        });
        found.ok_or_else(|| Problem::usage("E218", "This drive takes no programs."))
    }
}

fn profile_speaks(name: &str, named: Option<&Profile>) -> bool {
    named.is_none_or(|profile| profile.protocol == name)
}

/// Writes a program to the drive's memory, and verifies it.
///
/// TML: the command writes word by word, and verifies each block. At the end it compares the checksum that
/// the drive computes. The motor must not be powered. The program goes to RAM, unless --eeprom is given.
///
/// TMCL: the command writes instruction by instruction to the module's EEPROM, and reads all back. No
/// program may run, and no motor of the module may turn. To start the program at power-up, set `auto start`
/// to 1.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program load tml+serial:///dev/ttyUSB0:9600#1 moves.tml
  polepair program load tml+serial:///dev/ttyUSB0:9600#1 cell.sw --eeprom
  polepair program load tmcl+serial:///dev/ttyUSB0:9600#1 moves.tmc")]
pub struct ProgramLoad {
    #[command(flatten)]
    target: DriveArgs,
    /// Program text, or a program file (.sw, .bin)
    #[arg(value_name = "FILE")]
    path: PathBuf,
    #[command(flatten)]
    place: ProgramLocation,
    /// Print what would be written to which address, and write nothing
    #[arg(long)]
    dry_run: bool,
}

impl ProgramLoad {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = module_axis(&session)?;
        if instructions::is_module(axis) {
            self.place.refuse_for_module()?;
            return instructions::load(&session, axis, &self.path, self.dry_run);
        }
        let program = self.place.read_program(axis, &self.path)?;
        let language = axis.language().map_err(outcome::to_problem)?;
        print_layout(&program, language);
        if self.dry_run {
            print_note("dry run: nothing was written");
            return Ok(Exit::Ok);
        }
        session.listen_for_interrupts();
        let meter = Progress::of_count(0, "words");
        let written = axis.download(&program, self.place.eeprom, |at: TransferProgress| {
            meter.set_of(at.done, at.total)
        });
        drop(meter);
        let written = written.map_err(|error| hint_incomplete(outcome::to_problem(error)))?;
        let again = match written.repeated {
            0 => String::new(),
            repeated => format!(", {repeated} of them repeated because they were lost"),
        };
        print_note(&format!(
            "{} words written and verified by the drive's checksum{again}",
            program.words()
        ));
        Ok(Exit::Ok)
    }
}

/// Adds a hint on an unfinished write.
fn hint_incomplete(problem: Problem) -> Problem {
    match problem.exit {
        Exit::Usage | Exit::Refused => problem,
        _ => {
            problem.hint("the program in the drive is incomplete: load it again before running it")
        }
    }
}

/// Compares the drive's memory with a program. Writes nothing.
///
/// TML: the drive computes a checksum. TMCL: all instructions are read back.
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair program verify tml+serial:///dev/ttyUSB0:9600#1 cell.sw")]
pub struct ProgramVerify {
    #[command(flatten)]
    target: DriveArgs,
    /// Program text, or a program file (.sw, .bin)
    #[arg(value_name = "FILE")]
    path: PathBuf,
    #[command(flatten)]
    place: ProgramLocation,
    /// Read every word; a checksum does not detect swapped words
    #[arg(long)]
    words: bool,
}

impl ProgramVerify {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = module_axis(&session)?;
        if instructions::is_module(axis) {
            self.place.refuse_for_module()?;
            return instructions::verify(&session, axis, &self.path);
        }
        let program = self.place.read_program(axis, &self.path)?;
        session.listen_for_interrupts();
        if self.words {
            return compare_words(axis, &program);
        }
        axis.verify(&program).map_err(outcome::to_problem)?;
        print_note(&format!("the drive's checksums over {} words match", program.words()));
        Ok(Exit::Ok)
    }
}

/// Compares word by word.
fn compare_words(axis: &LocalAxis, program: &Program) -> Result {
    let mut different = 0;
    for piece in program.pieces() {
        let meter = Progress::of_count(0, "words");
        let read = axis.upload(piece.start, piece.words.len(), |at: TransferProgress| {
            meter.set_of(at.done, at.total)
        });
        drop(meter);
        let read = read.map_err(outcome::to_problem)?;
        let found = read.pieces().iter().flat_map(|piece| &piece.words);
        for ((at, word), found) in (piece.start..=u16::MAX).zip(&piece.words).zip(found) {
            if word != found {
                different += 1;
                print_note(&format!("{at:04X}: {found:04X} in the drive, {word:04X} in the file"));
            }
        }
    }
    if different > 0 {
        let what = format!("{different} of {} words differ.", program.words());
        return Err(Problem::new(Exit::Negative, "E103", what).hint("load the program again"));
    }
    print_note(&format!("{} words match", program.words()));
    Ok(Exit::Ok)
}

/// Saves the drive's memory to a file: words (.sw), instructions (.bin), or text.
///
/// Without --words, the command reads until 64 erased words, or until 8 invalid TMCL instructions in a row.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program save tml+serial:///dev/ttyUSB0:9600#1 backup.sw
  polepair program save tml+serial:///dev/ttyUSB0:9600#1 routine.tml --at 0x8270 --words 40")]
pub struct ProgramSave {
    #[command(flatten)]
    target: DriveArgs,
    /// File to write; its ending selects the format
    #[arg(value_name = "FILE")]
    path: PathBuf,
    /// First address [default: where the drive starts programs by itself]
    #[arg(long, value_name = "ADDRESS", value_parser = parse_address)]
    at: Option<u16>,
    /// Number of words, or of TMCL instructions
    #[arg(long, value_name = "N")]
    words: Option<u16>,
}

impl ProgramSave {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = module_axis(&session)?;
        if instructions::is_module(axis) {
            return instructions::save(&session, axis, &self.path, self.words);
        }
        session.listen_for_interrupts();
        let language = axis.language().map_err(outcome::to_problem)?;
        let start = self.at.unwrap_or(language.memory_rules().autorun.0);
        let words = match self.words {
            Some(count) => read_words(axis, start, count.into())?,
            None => read_written(axis, start, *language.memory_rules().permanent.end())?,
        };
        if words.is_empty() {
            let what = format!("the memory from 0x{start:04X} on is erased.");
            return Err(Problem::new(Exit::Negative, "E110", what));
        }
        let program = Program::from_words(start, words);
        let text = if is_software(&self.path) {
            program.to_sw()
        } else {
            program.listing(language, Some(axis.profile()))
        };
        let mut out = DataOutput::file(&self.path)?;
        out.buffer().extend_from_slice(text.as_bytes());
        out.finish()?;
        print_layout(&program, language);
        Ok(Exit::Ok)
    }
}

/// Words from an address on, without the erased ones behind them.
fn read_written(axis: &LocalAxis, start: u16, last: u16) -> Result<Vec<u16>> {
    let capacity = usize::from(last.saturating_sub(start)) + 1;
    let mut words = Vec::new();
    while words.len() < capacity {
        let at = start.wrapping_add(words.len() as u16);
        let chunk = read_words(axis, at, CHUNK.min(capacity - words.len()))?;
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

fn read_words(axis: &LocalAxis, start: u16, count: usize) -> Result<Vec<u16>> {
    let meter = Progress::of_count(0, "words");
    let read = axis.upload(start, count, |at: TransferProgress| meter.set_of(at.done, at.total));
    drop(meter);
    let read = read.map_err(outcome::to_problem)?;
    Ok(read.pieces().iter().flat_map(|piece| piece.words.clone()).collect())
}

/// Prints the addresses of a program.
fn print_layout(program: &Program, language: &dyn ProgramLanguage) {
    for piece in program.pieces() {
        let count = piece.words.len();
        let memory = match language.memory_rules().memory_at(piece.start, count) {
            Some(MemoryKind::Permanent) => "EEPROM",
            Some(MemoryKind::Volatile) => "RAM",
            None => "no memory for programs",
        };
        let end = usize::from(piece.start) + count - 1;
        let sum = checksum(&piece.words);
        print_note(&format!(
            "{:04X} to {end:04X}: {count} words, sum {sum:04X}, {memory}",
            piece.start
        ));
    }
}
