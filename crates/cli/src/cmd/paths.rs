//! `polepair paths save|load|diff|check|run|plot URL FILE`

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};
use polepair::Axis;
use polepair::paths::{
    PathChainEnd, PathChange, PathFinding, PathPreview, PathTable, PathUnit, PreviewEnd,
};
use polepair_capture::jsonl;
use polepair_capture::plot::Plot;
use polepair_core::axis::{Command, Verb};

use crate::consent;
use crate::data_output::DataOutput;
use crate::motion::{self, MotionMode};
use crate::outcome;
use crate::output_file;
use crate::problem::{self, Exit, Problem, Result};
use crate::progress::Progress;
use crate::remote::ServerArgs;
use crate::session::Session;
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{self, TextTable, colour_out, print_note, print_warning};
use crate::value::{self, plural};

/// Time of a preview without another one.
const PREVIEW_MAX: &str = "60s";

/// The stored paths of a SYNTRON TS: save, load, compare, check, plot and run them.
///
/// A path is a motion that leads to the next one. The file has a line for each path, in words and with units.
#[derive(Subcommand, Debug)]
pub enum PathsCommand {
    /// Read the paths of a drive and write them to a file
    Save(PathsSave),
    /// Show what differs, write it to the drive, and read it back
    Load(PathsLoad),
    /// Compare a drive with a file; the exit code is 1 if they differ
    Diff(PathsDiff),
    /// Follow the chains of a file or a drive; the exit code is 1 if a path cannot run
    Check(PathsCheck),
    /// Run a path and those that it leads to, and measure their end
    Run(PathsRun),
    /// Plot position and speed of a run on the motor model; nothing moves
    Plot(PathsPlot),
}

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair paths save modbus-rtu+serial:///dev/ttyUSB0#1 feeder-paths.toml
  polepair paths save sim:syntron-ts --unit mm")]
pub struct PathsSave {
    #[command(flatten)]
    target: DriveArgs,
    /// File to write [default: stdout]
    #[arg(id = "table", value_name = "FILE")]
    file: Option<PathBuf>,
    /// Unit of the mechanics, which the drive does not store [default: deg if a turn travels 360, else mm]
    #[arg(long, value_enum)]
    unit: Option<UnitChoice>,
}

#[derive(Args, Debug)]
#[command(after_help = "\
Paths that the file does not have stay in the drive.

Examples:
  polepair paths load modbus-rtu+serial:///dev/ttyUSB0#1 feeder-paths.toml
  polepair paths load modbus-rtu+serial:///dev/ttyUSB0#1 feeder-paths.toml --yes --store")]
pub struct PathsLoad {
    #[command(flatten)]
    target: DriveArgs,
    /// File with the paths
    #[arg(id = "table", value_name = "FILE")]
    file: PathBuf,
    /// Print what would be written, and write nothing
    #[arg(long)]
    dry_run: bool,
    /// Do not ask for confirmation
    #[arg(short, long)]
    yes: bool,
    /// Save the paths to the drive's permanent memory
    #[arg(long)]
    store: bool,
}

#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair paths diff modbus-rtu+serial:///dev/ttyUSB0#1 feeder-paths.toml")]
pub struct PathsDiff {
    #[command(flatten)]
    target: DriveArgs,
    /// File with the paths
    #[arg(id = "table", value_name = "FILE")]
    file: PathBuf,
    /// Output format
    #[arg(long, value_enum, default_value_t = OutputFormat::Text)]
    format: OutputFormat,
}

/// Paths of a file, or of a drive.
#[derive(Args, Debug)]
struct PathSource {
    #[command(flatten)]
    target: DriveArgs,
    /// File with paths, together with those of the drive that it leaves out
    #[arg(id = "table", value_name = "FILE")]
    file: Option<PathBuf>,
    /// Unit of the drive's mechanics, which it does not store
    #[arg(long, value_enum)]
    unit: Option<UnitChoice>,
}

#[derive(Args, Debug)]
#[command(after_help = "\
Instead of a connection string, URL may be a file: no drive is needed.

Examples:
  polepair paths check feeder-paths.toml
  polepair paths check modbus-rtu+serial:///dev/ttyUSB0#1
  polepair paths check modbus-rtu+serial:///dev/ttyUSB0#1 feeder-paths.toml")]
pub struct PathsCheck {
    #[command(flatten)]
    source: PathSource,
}

#[derive(Args, Debug)]
#[command(after_help = "\
Instead of a connection string, URL may be a file: no drive is needed.

Examples:
  polepair paths plot feeder-paths.toml
  polepair paths plot feeder-paths.toml --path 3 -o run.svg
  polepair paths plot modbus-rtu+serial:///dev/ttyUSB0#1 --from 90deg")]
pub struct PathsPlot {
    #[command(flatten)]
    source: PathSource,
    /// Path that is triggered [default: the first that no other one leads to]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    path: Option<u8>,
    /// Position at the beginning, in the unit of the mechanics [default: 0]
    #[arg(long, value_name = "POSITION", allow_hyphen_values = true)]
    from: Option<String>,
    /// End the plot after this time
    #[arg(long = "for", value_name = "TIME", default_value = PREVIEW_MAX, value_parser = value::parse_span)]
    span: f64,
    /// Write an SVG file instead of drawing in the terminal
    #[arg(long, short = 'o', value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Args, Debug)]
#[command(after_help = "\
The motor is powered during the command. A chain that repeats, or turns on, runs until Ctrl-C or --for.

Examples:
  polepair paths run modbus-rtu+serial:///dev/ttyUSB0#1 1
  polepair paths run sim:syntron-ts?fn00=14 3 --for 10s")]
pub struct PathsRun {
    #[command(flatten)]
    target: DriveArgs,
    /// Number of the path, 1 to 32
    #[arg(value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    number: u8,
    /// Unit of the mechanics, which the drive does not store [default: deg if a turn travels 360, else mm]
    #[arg(long, value_enum)]
    unit: Option<UnitChoice>,
    /// Load this file first, as `paths load --yes` does
    #[arg(id = "load", long, value_name = "FILE")]
    file: Option<PathBuf>,
    /// Stop paths that do not end after this time
    #[arg(long = "for", value_name = "TIME", value_parser = value::parse_span)]
    seconds: Option<f64>,
    /// Stop waiting for the end after this time; the motor is stopped
    #[arg(long, value_name = "TIME", value_parser = value::parse_span)]
    timeout: Option<f64>,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

/// Unit of the mechanics.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum UnitChoice {
    /// Degrees
    Deg,
    /// Millimetres
    Mm,
}

impl From<UnitChoice> for PathUnit {
    fn from(unit: UnitChoice) -> Self {
        match unit {
            UnitChoice::Deg => Self::Degree,
            UnitChoice::Mm => Self::Millimetre,
        }
    }
}

impl PathsCommand {
    pub fn run(self, server: ServerArgs) -> Result {
        match self {
            Self::Save(verb) => verb.run(server),
            Self::Load(verb) => verb.run(server),
            Self::Diff(verb) => verb.run(server),
            Self::Check(verb) => verb.run(server),
            Self::Run(verb) => verb.run(server),
            Self::Plot(verb) => verb.run(server),
        }
    }
}

impl PathsSave {
    fn run(self, server: ServerArgs) -> Result {
        output_file::refuse_input(self.file.as_deref(), self.target.profiles.path())?;
        let session = self.target.connect(server)?;
        let axis = only_axis(&session)?;
        let table = read_table(axis, self.unit)?;
        print_findings(&table.check());
        let mut out = DataOutput::to_path(self.file.as_deref())?;
        out.buffer().extend_from_slice(table.to_string().as_bytes());
        out.finish()?;
        note_unit(&table, self.unit);
        if let Some(file) = self.file.as_deref().filter(|file| file.as_os_str() != "-") {
            let count = plural(table.paths.len() as u64, "path");
            print_note(&format!("{count} saved in {}", file.display()));
        }
        Ok(Exit::Ok)
    }
}

impl PathsLoad {
    fn run(self, server: ServerArgs) -> Result {
        let table = load_table(&self.file)?;
        let session = self.target.connect(server)?;
        let axis = only_axis(&session)?;
        let drive = read_table(axis, Some(unit_choice(table.unit)))?;
        let after = table.written_over(&drive);
        refuse_errors(&after.check(), "Nothing was written.")?;
        let changes = drive.changes(&after);
        if changes.is_empty() {
            print_note("nothing to write");
            return Ok(Exit::Ok);
        }
        let mut out = DataOutput::stdout();
        out.buffer().extend_from_slice(changes_table(&changes, ["now", "becomes"]).as_bytes());
        out.flush()?;
        if self.dry_run {
            print_note("dry run: none of this was written");
            return Ok(Exit::Ok);
        }
        consent::ask(self.yes, &plural(changes.len() as u64, "field"), self.store)?;
        table.write(axis, &drive, self.store).map_err(outcome::to_problem)?;
        let kept = if self.store { "stored" } else { "in RAM until the next power-on" };
        let count = plural(changes.len() as u64, "field");
        print_note(&format!("{count} written and read back, {kept}"));
        Ok(Exit::Ok)
    }
}

impl PathsDiff {
    fn run(self, server: ServerArgs) -> Result {
        let table = load_table(&self.file)?;
        let session = self.target.connect(server)?;
        let drive = read_table(only_axis(&session)?, Some(unit_choice(table.unit)))?;
        // What the file leaves out is left as it is by `load`, so it is no difference.
        let changes = drive.changes(&table.written_over(&drive));
        let mut out = DataOutput::stdout().with_text(self.format == OutputFormat::Text);
        match self.format {
            OutputFormat::Text if changes.is_empty() => {}
            OutputFormat::Text => out
                .buffer()
                .extend_from_slice(changes_table(&changes, ["drive", "file"]).as_bytes()),
            OutputFormat::Csv => {
                out.write_line("path,field,drive,file");
                for PathChange { path, field, from, to } in &changes {
                    let path = path.map_or_else(String::new, |path| path.to_string());
                    out.write_line(&format!("{path},{field},{from},{to}"));
                }
            }
            OutputFormat::Jsonl => changes.iter().for_each(|it| write_json(it, out.buffer())),
        }
        out.flush()?;
        print_note(&match changes.len() {
            0 => "nothing differs".to_owned(),
            1 => "1 field differs".to_owned(),
            count => format!("{count} fields differ"),
        });
        Ok(if changes.is_empty() { Exit::Ok } else { Exit::Negative })
    }
}

impl PathSource {
    /// The paths of the file and of the drive, and the drive, if one was named.
    fn read(&self, server: ServerArgs) -> Result<PathTable> {
        let named = Path::new(&self.target.url);
        if named.is_file() && !server.is_given() {
            return match self.file {
                None => load_table(named),
                Some(_) => Err(Problem::usage("E212", "two files are named.")
                    .hint("one file, or a connection string and a file")),
            };
        }
        let file = self.file.as_deref().map(load_table).transpose()?;
        let unit = file.as_ref().map(|table| unit_choice(table.unit)).or(self.unit);
        let session = self.target.connect(server)?;
        let drive = read_table(only_axis(&session)?, unit)?;
        note_unit(&drive, unit);
        Ok(match file {
            Some(file) => file.written_over(&drive),
            None => drive,
        })
    }
}

impl PathsCheck {
    fn run(self, server: ServerArgs) -> Result {
        let table = self.source.read(server)?;
        let mut out = DataOutput::stdout();
        for start in table.first_paths() {
            out.write_line(&table.chain(start).to_string());
        }
        out.flush()?;
        let findings = table.check();
        print_findings(&findings);
        let errors = findings.iter().filter(|finding| finding.is_error).count();
        let paths = plural(table.paths.len() as u64, "path");
        print_note(&match errors {
            0 => format!("{paths} can run"),
            count => format!("{paths}, {} found", plural(count as u64, "error")),
        });
        Ok(if errors == 0 { Exit::Ok } else { Exit::Negative })
    }
}

impl PathsPlot {
    fn run(self, server: ServerArgs) -> Result {
        let table = self.source.read(server)?;
        refuse_errors(&table.check(), "Nothing was plotted.")?;
        let Some(start) = self.path.or_else(|| table.first_paths().first().copied()) else {
            return Err(no_path_problem());
        };
        require_path(&table, start)?;
        let from = self.from.as_deref().map_or(Ok(0), |text| table.parse_position(text));
        let from = from.map_err(outcome::to_problem)?;
        let span = Duration::from_secs_f64(self.span);
        let preview = table.preview(start, from, span).map_err(outcome::to_problem)?;
        let mut plot = Plot::default();
        for point in &preview.points {
            plot.add_value(1, "position", preview.unit.symbol(), point.time, point.position);
            plot.add_value(1, "speed", "rpm", point.time, point.speed);
        }
        let mut out = DataOutput::to_path(self.output.as_deref())?.with_text(self.output.is_none());
        let picture = match &self.output {
            Some(_) => plot.svg(),
            None => plot.terminal(terminal::width(), colour_out()),
        };
        out.buffer().extend(picture.bytes());
        out.finish()?;
        print_note(&format!("path {}", table.chain(start)));
        print_note(&describe_preview(&preview));
        if let PreviewEnd::Alarm(text) = preview.end {
            let what = format!("the model of the drive stops with an alarm: {text}.");
            return Err(Problem::new(Exit::Negative, "E102", what)
                .why("Its motor has the size of that of a TS, and no load."));
        }
        Ok(Exit::Ok)
    }
}

impl PathsRun {
    fn run(self, server: ServerArgs) -> Result {
        let command = Command { path: Some(self.number.into()), ..Command::new(Verb::RunPath) };
        if self.dry_run {
            server.refuse_dry_run()?;
            return self.target.rehearse_motion(|_| Ok(command));
        }
        let file = self.file.as_deref().map(load_table).transpose()?;
        let session = self.target.connect(server)?;
        let axis = only_axis(&session)?;
        let unit = file.as_ref().map(|table| unit_choice(table.unit)).or(self.unit);
        let drive = read_table(axis, unit)?;
        note_unit(&drive, unit);
        let table = match &file {
            Some(file) => file.written_over(&drive),
            None => drive.clone(),
        };
        require_path(&table, self.number)?;
        refuse_errors(&table.check(), "Nothing was written, and nothing moved.")?;
        if let Some(file) = &file {
            file.write(axis, &drive, false).map_err(outcome::to_problem)?;
        }
        let from = table.position(axis).map_err(outcome::to_problem)?;
        let chain = table.chain(self.number);
        print_note(&format!("path {chain}"));
        let ends = chain.end == PathChainEnd::Stops;
        if ends {
            let most = Duration::from_secs(3600);
            let at = (from * 1000.0).round() as i32;
            let preview = table.preview(self.number, at, most).map_err(outcome::to_problem)?;
            print_note(&describe_preview(&preview));
        }
        let then = match (ends, self.seconds) {
            (true, None) => MotionMode::Arrive(self.timeout),
            (_, seconds) => MotionMode::Hold(seconds),
        };
        let exit = motion::run_motion(&session, &[(axis.clone(), command)], then)?;
        let unit = table.unit.symbol();
        let mut out = DataOutput::stdout();
        if let MotionMode::Arrive(_) = then {
            let arrival = table.check_arrival(axis, self.number, from);
            let arrival = arrival.map_err(outcome::to_problem)?;
            out.write_line(&format!("position = {:.3} {unit}", arrival.position));
            out.flush()?;
            if arrival.expected.is_none() {
                print_note(
                    "where it ends depends on how long the motor turned: nothing to compare",
                );
            }
        } else {
            let position = table.position(axis).map_err(outcome::to_problem)?;
            out.write_line(&format!("position = {position:.3} {unit}"));
            out.flush()?;
        }
        Ok(exit)
    }
}

/// The only axis of a link.
fn only_axis(session: &Session) -> Result<&Axis> {
    session.listen_for_interrupts();
    match session.axes() {
        [axis] => Ok(axis),
        _ => Err(Problem::usage("E212", "paths belong to one drive.")
            .hint("name one axis in the connection string: #1")),
    }
}

fn read_table(axis: &Axis, unit: Option<UnitChoice>) -> Result<PathTable> {
    let bar = Progress::of_count(0, &format!("paths of {}", axis.label()));
    let table = PathTable::read(axis, unit.map(Into::into), |done| bar.set_of(done.into(), 32));
    drop(bar);
    table.map_err(outcome::to_problem)
}

fn load_table(file: &Path) -> Result<PathTable> {
    if !file.exists() {
        return Err(problem::file_problem(file, "read", &std::io::ErrorKind::NotFound.into()));
    }
    PathTable::load(file).map_err(outcome::to_problem)
}

const fn unit_choice(unit: PathUnit) -> UnitChoice {
    match unit {
        PathUnit::Degree => UnitChoice::Deg,
        PathUnit::Millimetre => UnitChoice::Mm,
    }
}

/// Notes which unit was taken for the drive's, where nothing states it.
fn note_unit(table: &PathTable, stated: Option<UnitChoice>) {
    if stated.is_none() {
        let (turns, travel, unit) = (table.motor_turns, table.travel, table.unit.symbol());
        let turns = plural(turns.into(), "turn");
        print_note(&format!(
            "positions are taken for {unit}: {turns} of the motor travel {travel}; --unit says \
             otherwise"
        ));
    }
}

fn print_findings(findings: &[PathFinding]) {
    for finding in findings {
        let word = if finding.is_error { "error: " } else { "" };
        print_warning(&format!("{word}{finding}"));
    }
}

/// Prints what may be intended, and refuses the rest.
fn refuse_errors(findings: &[PathFinding], nothing: &str) -> Result<()> {
    print_findings(findings);
    match findings.iter().filter(|finding| finding.is_error).count() {
        0 => Ok(()),
        count => {
            let what = format!("the paths have {}.", plural(count as u64, "error"));
            Err(Problem::usage("E217", what).why(nothing))
        }
    }
}

fn require_path(table: &PathTable, number: u8) -> Result<()> {
    if table.path(number).is_empty() {
        let known: Vec<String> = table.paths.keys().map(u8::to_string).collect();
        let hint = match known.len() {
            0 => "there are none: `paths load` writes them".to_owned(),
            _ => format!("there are {}", known.join(", ")),
        };
        return Err(Problem::usage("E212", format!("path {number} is empty.")).hint(hint));
    }
    Ok(())
}

fn no_path_problem() -> Problem {
    Problem::usage("E212", "there is no path.").hint("`paths load URL FILE` writes some")
}

/// The run on the model in a line.
fn describe_preview(preview: &PathPreview) -> String {
    let (unit, seconds) = (preview.unit.symbol(), preview.duration().as_secs_f64());
    let (low, high) = preview.travel();
    let end = match preview.end {
        PreviewEnd::Running => "and runs on".to_owned(),
        _ => format!("to its end at {:.3} {unit}", preview.end_position()),
    };
    format!("on the motor model {seconds:.2} s {end}, between {low:.3} and {high:.3} {unit}")
}

fn changes_table(changes: &[PathChange], heads: [&str; 2]) -> String {
    let mut table = TextTable::with_heads(&["path", "field", heads[0], heads[1]]);
    for PathChange { path, field, from, to } in changes {
        let path = path.map_or_else(|| "-".to_owned(), |path| path.to_string());
        table.add_row([path, (*field).to_owned(), from.clone(), to.clone()]);
    }
    table.render(colour_out())
}

fn write_json(change: &PathChange, out: &mut Vec<u8>) {
    let path = change.path.map_or_else(|| "null".to_owned(), |path| path.to_string());
    out.extend_from_slice(format!("{{\"path\":{path}").as_bytes());
    for (key, text) in [("field", change.field), ("drive", &change.from), ("file", &change.to)] {
        out.extend_from_slice(format!(",\"{key}\":").as_bytes());
        jsonl::write_string(out, text);
    }
    out.extend_from_slice(b"}\n");
}
