//! Programs of drives that store instructions instead of words (TMCL): load, verify, save, step, break.

use std::io::{BufRead as _, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use polepair::LocalAxis;
use polepair::axis::ProgramStatus;
use polepair::instruction_program::{InstructionProgram, is_binary, language_of};
use polepair_core::program::TransferProgress;
use polepair_core::time::Instant;

use super::ending::{end_program, is_powered};
use super::module_axis;
use crate::data_output::DataOutput;
use crate::interrupt;
use crate::motion;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::session::LocalSession;
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value;

/// Interval of reading a program's address.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Default time limit of an instruction, s.
const STEP_MAX_S: f64 = 60.0;

/// Returns whether the drive keeps instructions.
pub fn is_module(axis: &LocalAxis) -> bool {
    axis.instruction_language().is_ok()
}

/// Returns whether a file is such a program, by its name.
pub fn is_program(path: &Path) -> bool {
    language_of(path).is_some()
}

pub fn assemble(path: &Path, output: Option<&Path>) -> Result {
    let language = language_of(path).ok_or_else(|| {
        Problem::usage("E242", format!("{} has no ending of a program file.", path.display()))
    })?;
    let program = InstructionProgram::read(language, path);
    write(&program.map_err(|error| outcome::to_problem(error.into()))?, output)?;
    Ok(Exit::Ok)
}

fn read(axis: &LocalAxis, path: &Path) -> Result<InstructionProgram> {
    let language = axis.instruction_language().map_err(outcome::to_problem)?;
    if language_of(path).is_none() {
        let what = format!("{} has no ending of a program file for this drive.", path.display());
        let called =
            format!("its text is called .{0}, its instructions .bin", language.extension());
        return Err(Problem::usage("E242", what).hint(called));
    }
    InstructionProgram::read(language, path).map_err(|error| outcome::to_problem(error.into()))
}

/// Writes the listing, or the bytes where the file is called `.bin`.
fn write(program: &InstructionProgram, path: Option<&Path>) -> Result<()> {
    let mut out = DataOutput::to_path(path)?;
    if path.is_some_and(is_binary) {
        out.buffer().extend_from_slice(&program.to_binary())
    } else {
        out.buffer().extend_from_slice(program.listing().as_bytes())
    }
    out.finish()?;
    let count = program.instructions().len();
    let labels: Vec<String> = program.labels().map(|(name, at)| format!("{name} = {at}")).collect();
    print_note(&format!("{count} instructions"));
    if !labels.is_empty() {
        print_note(&labels.join(", "));
    }
    Ok(())
}

pub fn load(session: &LocalSession, axis: &LocalAxis, path: &Path, dry_run: bool) -> Result {
    let program = read(axis, path)?;
    let count = program.instructions().len();
    print_note(&format!(
        "{count} instructions for the module's EEPROM, addresses 0 to {}",
        count - 1
    ));
    if dry_run {
        print_note("dry run: nothing was written");
        return Ok(Exit::Ok);
    }
    session.listen_for_interrupts();
    let meter = Progress::of_count(0, "instructions");
    // A module that is not in download mode would execute what it is sent.
    let holding = interrupt::hold_motion(&session.arguments);
    axis.arm(true);
    let stored = axis
        .download_instructions(&program, |at: TransferProgress| meter.set_of(at.done, at.total));
    axis.arm(false);
    drop((holding, meter));
    stored.map_err(|error| {
        let problem = outcome::to_problem(error);
        match problem.exit {
            Exit::Usage => problem,
            _ => problem
                .hint("the program in the module is incomplete: load it again before running it"),
        }
    })?;
    print_note(&format!("{count} instructions stored and verified"));
    Ok(Exit::Ok)
}

pub fn verify(session: &LocalSession, axis: &LocalAxis, path: &Path) -> Result {
    let program = read(axis, path)?;
    session.listen_for_interrupts();
    axis.verify_instructions(&program).map_err(outcome::to_problem)?;
    print_note(&format!("{} instructions match", program.instructions().len()));
    Ok(Exit::Ok)
}

pub fn save(session: &LocalSession, axis: &LocalAxis, path: &Path, count: Option<u16>) -> Result {
    session.listen_for_interrupts();
    let meter = Progress::of_count(0, "instructions");
    let read = axis.upload_instructions(count.map(usize::from), |at: TransferProgress| {
        meter.set_of(at.done, at.total)
    });
    drop(meter);
    let program = read.map_err(outcome::to_problem)?;
    if program.instructions().is_empty() {
        return Err(Problem::new(Exit::Negative, "E110", "the module has no program."));
    }
    write(&program, Some(path))?;
    Ok(Exit::Ok)
}

/// The program in the module, and its text where there is one.
struct Listing {
    source: Option<InstructionProgram>,
}

impl Listing {
    /// Takes the text, and makes sure that the module has its instructions.
    fn new(axis: &LocalAxis, source: Option<&Path>) -> Result<Self> {
        let source = source.map(|path| read(axis, path)).transpose()?;
        if let Some(program) = &source {
            axis.verify_instructions(program).map_err(|error| {
                outcome::to_problem(error)
                    .hint("the text given by --source is not the module's program")
            })?;
        }
        Ok(Self { source })
    }

    /// The address that a word means: a label, a line (`:12`), or a number.
    fn address(&self, word: &str) -> Result<u16> {
        let Some(source) = &self.source else {
            return word.parse().map_err(|_| {
                instruction_problem(format!("{word:?} is not the address of an instruction."))
                    .hint("for a label or a line (:12): --source FILE names the text")
            });
        };
        let line = word.strip_prefix(':').map(|line| line.parse().ok());
        let found = match line {
            Some(line) => line.and_then(|line| source.address_of_line(line)),
            None => source.label(word).or_else(|| word.parse().ok()),
        };
        found.ok_or_else(|| {
            let names: Vec<&str> = source.labels().map(|(name, _)| name).collect();
            instruction_problem(format!("the program has no place {word:?}."))
                .why(format!("Its labels are {}.", crate::problem::join_list(&names)))
                .hint("a line is written :12, an instruction by its number")
        })
    }

    /// An instruction as a line: `   7  WAIT POS, 0, 0     moves.tmc:9`.
    fn line(&self, axis: &LocalAxis, at: u16) -> Result<String> {
        let (text, place) = match &self.source {
            Some(source) => {
                let place =
                    source.line_of(at).map(|line| format!("  {}:{}", line.file, line.number));
                (source.instruction_text(at).unwrap_or_default(), place.unwrap_or_default())
            }
            None => {
                let read = axis.instruction_at(at).map_err(outcome::to_problem)?;
                (read.instruction_text(0).expect("one instruction was read"), String::new())
            }
        };
        Ok(format!("{at:4}  {text:<28}{place}").trim_end().to_owned())
    }
}

fn instruction_problem(what: String) -> Problem {
    Problem::usage("E242", what)
}

/// Starts the program and waits until it ends, or the time is over.
pub fn run(
    session: &LocalSession,
    axis: &LocalAxis,
    start: ProgramStart<'_>,
    detach: bool,
    seconds: Option<f64>,
) -> Result {
    motion::print_program_note(session, detach);
    session.listen_for_interrupts();
    let listing = Listing::new(axis, start.source)?;
    let from = match (start.place, start.here) {
        (Some(word), _) => Some(listing.address(word)?),
        (None, true) => None,
        (None, false) => Some(0),
    };
    let ending = ModuleEnding::begin(session, axis)?;
    let started = axis.run_instructions(from).map_err(outcome::to_problem);
    if detach && started.is_ok() {
        ending.detach(session);
        return Ok(Exit::Ok);
    }
    let end = seconds.map(|seconds| axis.connection().now().plus_ms((seconds * 1e3) as u32));
    let ended = started.and_then(|()| wait_end(axis, end)).and_then(|status| {
        match status {
            Some(status) => {
                let at = status.counter.saturating_sub(1);
                print_note(&format!(
                    "the program ended after {}",
                    listing.line(axis, at)?.trim_start()
                ));
            }
            None => print_note("its time limit is over"),
        }
        Ok(())
    });
    ending.conclude(ended)
}

/// Start of a program.
#[derive(Clone, Copy)]
pub struct ProgramStart<'a> {
    /// A label, a line or an address; else the first instruction.
    pub place: Option<&'a str>,
    /// The text whose labels and lines are meant.
    pub source: Option<&'a Path>,
    /// From where the program is.
    pub here: bool,
}

/// Waits until no program runs; `None` when the time is over first.
fn wait_end(axis: &LocalAxis, end: Option<Instant>) -> Result<Option<ProgramStatus>> {
    loop {
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        let status = axis.program_status().map_err(outcome::to_problem)?;
        if !status.running {
            return Ok(Some(status));
        }
        motion::check_fault(axis)?;
        if end.is_some_and(|end| axis.connection().now() >= end) {
            return Ok(None);
        }
        axis.sleep(POLL_INTERVAL);
    }
}

/// Executes a TMCL program one instruction at a time.
///
/// The command shows the next instruction, and with --source its line of the text. On a terminal, Enter
/// executes it and `q` exits. Otherwise, and with --count, that many instructions are executed. At the end,
/// the program is ended and the motors are stopped, unless --detach is given.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program step tmcl+serial:///dev/ttyUSB0:9600#1 --source moves.tmc
  polepair program step tmcl+serial:///dev/ttyUSB0:9600#1 --count 20 --detach")]
pub struct ProgramStep {
    #[command(flatten)]
    target: DriveArgs,
    /// Program text
    #[arg(long, value_name = "FILE")]
    source: Option<PathBuf>,
    /// Start at the first instruction [default: at the actual one]
    #[arg(long)]
    reset: bool,
    /// Number of instructions
    #[arg(long, value_name = "N")]
    count: Option<u32>,
    /// Time limit for one instruction: 5s, 2min
    #[arg(long, value_name = "TIME", value_parser = value::parse_span)]
    timeout: Option<f64>,
    /// Leave motors and program as they are
    #[arg(long)]
    detach: bool,
}

/// Executes a TMCL program up to a breakpoint, then one instruction at a time.
///
/// Each instruction is started by a request (130), so the program runs slower than normal. Timers and
/// motors are not slowed down.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program break tmcl+serial:///dev/ttyUSB0:9600#1 Loop --source moves.tmc
  polepair program break tmcl+serial:///dev/ttyUSB0:9600#1 :12 --source moves.tmc --count 0
  polepair program break tmcl+serial:///dev/ttyUSB0:9600#1 7")]
pub struct ProgramBreak {
    #[command(flatten)]
    target: DriveArgs,
    /// Breakpoint: a label or line (:12) of the text, or an instruction address
    #[arg(value_name = "WHERE")]
    place: String,
    /// Program text
    #[arg(long, value_name = "FILE")]
    source: Option<PathBuf>,
    /// Start at the actual instruction [default: at the first one]
    #[arg(long)]
    here: bool,
    /// Number of instructions to execute after the breakpoint
    #[arg(long, value_name = "N")]
    count: Option<u32>,
    /// Time limit for one instruction: 5s, 2min
    #[arg(long, value_name = "TIME", value_parser = value::parse_span)]
    timeout: Option<f64>,
    /// Leave motors and program as they are
    #[arg(long)]
    detach: bool,
}

impl ProgramStep {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = module_axis(&session)?;
        let stepper = ProgramStepper::new(&session, axis, self.source.as_deref(), self.timeout)?;
        stepper.run(self.reset, None, self.count, self.detach)
    }
}

impl ProgramBreak {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = module_axis(&session)?;
        let stepper = ProgramStepper::new(&session, axis, self.source.as_deref(), self.timeout)?;
        let place = stepper.listing.address(&self.place)?;
        stepper.run(!self.here, Some(place), self.count, self.detach)
    }
}

/// Goes through a program instruction by instruction.
struct ProgramStepper<'a> {
    session: &'a LocalSession,
    axis: &'a LocalAxis,
    listing: Listing,
    within: Duration,
}

impl<'a> ProgramStepper<'a> {
    fn new(
        session: &'a LocalSession,
        axis: &'a LocalAxis,
        source: Option<&Path>,
        timeout: Option<f64>,
    ) -> Result<Self> {
        if !is_module(axis) {
            return Err(Problem::usage("E218", "This drive's programs cannot be stepped through.")
                .why("TMCL modules can."));
        }
        session.listen_for_interrupts();
        let listing = Listing::new(axis, source)?;
        let within = Duration::from_secs_f64(timeout.unwrap_or(STEP_MAX_S));
        Ok(Self { session, axis, listing, within })
    }

    fn run(&self, reset: bool, until: Option<u16>, count: Option<u32>, detach: bool) -> Result {
        motion::print_program_note(self.session, detach);
        let status = self.axis.program_status().map_err(outcome::to_problem)?;
        if status.running {
            return Err(Problem::new(Exit::Refused, "E602", "a program runs in the module.")
                .hint(format!("polepair program stop {}", self.session.arguments)));
        }
        let ending = ModuleEnding::begin(self.session, self.axis)?;
        let ended = self.step_through(reset, until, count);
        if detach && ended.is_ok() {
            ending.detach(self.session);
            return Ok(Exit::Ok);
        }
        ending.conclude(ended)
    }

    fn step_through(&self, reset: bool, until: Option<u16>, count: Option<u32>) -> Result<()> {
        if reset {
            self.axis.reset_program().map_err(outcome::to_problem)?;
        }
        let mut at = self.axis.program_status().map_err(outcome::to_problem)?.counter;
        if let Some(place) = until {
            while at != place {
                at = self.step(at)?;
            }
        }
        self.show(at)?;
        let asks =
            count.is_none() && std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
        let mut left = count.unwrap_or(u32::from(until.is_none()));
        while asks || left > 0 {
            if asks && !self.wants_more()? {
                break;
            }
            at = self.step(at)?;
            self.show(at)?;
            left = left.saturating_sub(1);
        }
        Ok(())
    }

    fn show(&self, at: u16) -> Result<()> {
        let mut out = DataOutput::stdout();
        out.write_line(&self.listing.line(self.axis, at)?);
        out.flush()
    }

    /// Enter goes on; anything else, or the end of the input, ends.
    fn wants_more(&self) -> Result<bool> {
        let mut line = String::new();
        let read = std::io::stdin().lock().read_line(&mut line);
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        Ok(read.is_ok_and(|bytes| bytes > 0) && line.trim().is_empty())
    }

    /// Executes an instruction, and waits until that is done.
    fn step(&self, at: u16) -> Result<u16> {
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        let mut status = self.axis.step_instruction().map_err(outcome::to_problem)?;
        if status.running {
            let end = self.axis.connection().now() + self.within;
            status = wait_end(self.axis, Some(end))?.ok_or_else(|| {
                let what = format!("the instruction at {at} did not end in time.");
                Problem::new(Exit::Negative, "E101", what).hint("increase --timeout")
            })?;
        }
        motion::check_fault(self.axis)?;
        Ok(status.counter)
    }
}

/// End of a program that was started.
struct ModuleEnding<'a> {
    axis: &'a LocalAxis,
    powered: bool,
    _holding: interrupt::HoldGuard,
}

impl<'a> ModuleEnding<'a> {
    fn begin(session: &LocalSession, axis: &'a LocalAxis) -> Result<Self> {
        let powered = is_powered(axis)?;
        let holding = interrupt::hold_motion(&session.arguments);
        axis.arm(true);
        Ok(Self { axis, powered, _holding: holding })
    }

    fn detach(self, session: &LocalSession) {
        print_warning(&format!(
            "left as it is; to end the program and stop the motors: polepair program stop {}",
            session.arguments
        ));
    }

    fn conclude(self, ended: Result<()>) -> Result {
        let quiet = end_program(self.axis, self.powered).and_then(|()| stop_others(self.axis));
        self.axis.arm(false);
        motion::conclude(ended, quiet, "the program was ended and the motors stopped")
    }
}

/// Stops the motors of a module behind the first.
pub fn stop_others(axis: &LocalAxis) -> Result<()> {
    let others = 1..axis.profile().motors.max(1);
    others.clone().try_for_each(|motor| axis.stop_motor(motor)).map_err(outcome::to_problem)?;
    let end = axis.connection().now() + Duration::from_secs(10);
    for motor in others {
        while axis.motor_speed(motor).map_err(outcome::to_problem)? != 0 {
            if axis.connection().now() >= end {
                let what = format!("motor {motor} of the module still turns.");
                return Err(Problem::new(Exit::Negative, "E101", what).hint("cut its supply"));
            }
            axis.sleep(POLL_INTERVAL);
        }
    }
    Ok(())
}
