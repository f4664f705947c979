//! The verbs: one file each, but for those that differ in a word alone.

mod act;
pub mod completions;
mod config;
mod convert;
mod decode;
mod demo;
mod diff;
mod dismiss;
mod doctor;
mod encode;
mod explain;
mod get;
mod info;
mod journal;
mod lss;
mod monitor;
mod moves;
mod params;
mod ports;
mod program;
mod record;
mod release;
mod replay;
mod scan;
mod send;
mod serve;
mod set;
mod sim;
mod stop;
mod stream;
mod summary;
mod sync;
#[cfg(test)]
mod tests;
mod verbs;
mod watch;
mod watchdog;

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Once;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use polepair::url::shell_word;
use polepair::{Connector, Error, FileError};
use polepair_capture::CaptureFormat;
use polepair_core::profile::Profile;

use crate::outcome;
use crate::problem::Result;
use crate::remote::{self, ServerArgs};
use crate::terminal::{self, print_warning};

/// Talk to motor drives, simulate them, and read what others said to them.
///
/// Drives are named by connection strings:
///   tmcl+serial:///dev/ttyUSB0:9600#1     modbus-rtu+tcp://10.0.0.5:4001#1,2     sim:tmcl
#[derive(Parser, Debug)]
#[command(name = "polepair", version, verbatim_doc_comment, max_term_width = 100)]
#[command(after_help = HELP_FOOTER)]
pub struct CommandLine {
    /// Print no notes and no progress on stderr; errors, and warnings that a motor may turn, are printed
    #[arg(short, long, global = true)]
    quiet: bool,
    #[command(flatten)]
    join: ServerArgs,
    /// What to do.
    #[command(subcommand)]
    verb: CommandVerb,
    /// The verb's word.
    #[arg(skip)]
    word: String,
}

impl CommandLine {
    /// Reads the command line.
    pub fn parse(words: Vec<OsString>, version: &str) -> std::result::Result<Self, clap::Error> {
        let names = |word: &OsString| {
            word.to_str().is_some_and(|word| word == "--server" || word.starts_with("--server="))
        };
        let command = ServerArgs::hide_server_options(Self::command().version(version.to_owned()));
        let command = match words.iter().any(names) {
            true => ServerArgs::reword_help(command),
            false => command,
        };
        let matches = command.try_get_matches_from(words)?;
        let word = matches.subcommand_name().unwrap_or_default().to_owned();
        Ok(Self { word, ..Self::from_arg_matches(&matches)? })
    }
}

const HELP_FOOTER: &str = "\
Exit codes: 0 ok, 1 negative result, 2 usage, 3 no adapter or permission, 4 no reply,
5 corrupt or foreign reply, 6 the drive refused, 7 partial, 8 drive fault, 130 interrupted.
Data goes to stdout, prose to stderr. NO_COLOR is honoured.";

/// The verbs.
#[derive(Subcommand, Debug)]
pub enum CommandVerb {
    /// Explain the frames of a capture
    Decode(decode::Decode),
    /// Tell what a capture holds: who, what, and what went wrong
    Summary(summary::SummaryOptions),
    /// Tell what differs between two captures in behaviour
    Diff(diff::DiffOptions),
    /// Write a capture in another format
    Convert(convert::Convert),
    /// Turn text into the bytes of a frame
    Encode(encode::Encode),
    /// Say what a fault, a status, an exception or a frame means
    Explain(explain::Explain),
    /// Look for what is wrong, from the cable up
    Doctor(doctor::Doctor),
    /// Find the drives on a link
    Scan(scan::ScanCommand),
    /// Show and set node-IDs and bit rates of CANopen devices (LSS)
    Lss(lss::LssCommand),
    /// Show who a drive is, what it does, and its faults in words
    Info(info::Info),
    /// Read parameters by name or number, with units
    Get(get::Get),
    /// Write parameters by name or number, with units
    Set(set::Set),
    /// Send requests in the protocol's own text, and explain the replies
    Send(send::Send),
    /// Save a drive's settings as a file, compare them with one, write them back
    #[command(subcommand)]
    Config(config::ConfigCommand),
    /// Power the motor, holding it where it stands
    Enable(verbs::Enable),
    /// Take power off the motor
    Disable(verbs::Disable),
    /// Bring motors to rest; without #AXES every axis on the link
    Stop(stop::StopCommand),
    /// Owe axes of a server their stop no more, though nobody saw them stand
    Dismiss(dismiss::DismissCommand),
    /// Let the axes of a server move again after everything was stopped
    Release(release::Release),
    /// Clear faults
    Clear(verbs::Clear),
    /// Turn a motor at a speed until Ctrl-C
    Spin(moves::Spin),
    /// Move an axis to a position
    Move(moves::Move),
    /// Turn a motor with a torque until Ctrl-C
    Torque(moves::Torque),
    /// Find an axis' reference position
    Home(moves::Home),
    /// Turn a motor slowly until Ctrl-C
    Jog(moves::Jog),
    /// Move an axis along the points of a file
    Stream(stream::StreamCommand),
    /// Make programs, put them into a drive's memory, and run them
    Program(program::ProgramArgs),
    /// Keep the time of several drives together
    Sync(sync::Sync),
    /// Show signals or parameters again and again
    Watch(watch::WatchCommand),
    /// Show or set what drives do by themselves when their host falls silent
    Watchdog(watchdog::WatchdogCommand),
    /// Show axes, frames and faults of a link, live
    Monitor(monitor::MonitorOptions),
    /// Keep what passes on a link as a capture, and send nothing
    Record(record::RecordOptions),
    /// Play what a capture's host said onto a link, or to simulated drives
    Replay(replay::ReplayOptions),
    /// List the serial adapters, and why one cannot be used
    Ports(ports::Ports),
    /// Show what a drive has: units, ranges, defaults, manual sections
    Params(params::Params),
    /// Simulate drives that any program can talk to
    Sim(sim::Sim),
    /// Do something to a simulated drive: a load, a fault, an input
    Act(act::ActCommand),
    /// Open links and serve them to browsers and programs
    Serve(serve::Serve),
    /// Check what a server has kept of what was done
    #[command(subcommand)]
    Journal(journal::JournalCommand),
    /// Find, move, fault and recover two simulated drives
    Demo(demo::Demo),
    /// Print a completion script for a shell
    Completions(completions::Completions),
}

/// Carries a verb out: on a server if one is named.
pub fn run(arguments: CommandLine) -> Result {
    if arguments.quiet {
        terminal::be_quiet();
    }
    arguments.join.check()?;
    if arguments.join.is_given() { run_on_server(arguments) } else { run_locally(arguments.verb) }
}

fn run_on_server(CommandLine { join, verb, word, .. }: CommandLine) -> Result {
    match verb {
        CommandVerb::Scan(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Info(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Get(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Set(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Send(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Enable(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Disable(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Stop(verb) => verb.run_on_server(join),
        CommandVerb::Dismiss(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Release(verb) => verb.run_on_server(join),
        CommandVerb::Clear(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Act(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Spin(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Move(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Torque(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Home(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Jog(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Watch(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Watchdog(verb) => verb.run_on_server(&join.open()?),
        CommandVerb::Monitor(verb) => verb.run_on_server(&join.open()?),
        _ => Err(remote::no_such_verb(&word)),
    }
}

fn run_locally(verb: CommandVerb) -> Result {
    match verb {
        CommandVerb::Decode(verb) => verb.run(),
        CommandVerb::Summary(verb) => verb.run(),
        CommandVerb::Diff(verb) => verb.run(),
        CommandVerb::Convert(verb) => verb.run(),
        CommandVerb::Encode(verb) => verb.run(),
        CommandVerb::Explain(verb) => verb.run(),
        CommandVerb::Doctor(verb) => verb.run(),
        CommandVerb::Scan(verb) => verb.run(),
        CommandVerb::Lss(verb) => verb.run(),
        CommandVerb::Info(verb) => verb.run(),
        CommandVerb::Get(verb) => verb.run(),
        CommandVerb::Set(verb) => verb.run(),
        CommandVerb::Send(verb) => verb.run(),
        CommandVerb::Config(verb) => verb.run(),
        CommandVerb::Enable(verb) => verb.run(),
        CommandVerb::Disable(verb) => verb.run(),
        CommandVerb::Stop(verb) => verb.run(),
        CommandVerb::Dismiss(verb) => verb.run(),
        CommandVerb::Release(verb) => verb.run(),
        CommandVerb::Clear(verb) => verb.run(),
        CommandVerb::Spin(verb) => verb.run(),
        CommandVerb::Move(verb) => verb.run(),
        CommandVerb::Torque(verb) => verb.run(),
        CommandVerb::Home(verb) => verb.run(),
        CommandVerb::Jog(verb) => verb.run(),
        CommandVerb::Stream(verb) => verb.run(),
        CommandVerb::Program(verb) => verb.run(),
        CommandVerb::Sync(verb) => verb.run(),
        CommandVerb::Watch(verb) => verb.run(),
        CommandVerb::Watchdog(verb) => verb.run(),
        CommandVerb::Monitor(verb) => verb.run(),
        CommandVerb::Record(verb) => verb.run(),
        CommandVerb::Replay(verb) => verb.run(),
        CommandVerb::Ports(verb) => verb.run(),
        CommandVerb::Params(verb) => verb.run(),
        CommandVerb::Sim(verb) => verb.run(),
        CommandVerb::Act(verb) => verb.run(),
        CommandVerb::Serve(verb) => verb.run(),
        CommandVerb::Journal(verb) => verb.run(),
        CommandVerb::Demo(verb) => verb.run(),
        CommandVerb::Completions(verb) => verb.run(),
    }
}

/// Reads the word of a capture format.
pub fn capture_format() -> impl TypedValueParser<Value = CaptureFormat> {
    PossibleValuesParser::new(CaptureFormat::names())
        .map(|word| CaptureFormat::from_name(&word).unwrap_or(CaptureFormat::Text))
}

/// How links are opened. A file of the configuration that is wrong is told once and stands in nobody's
/// way who needs nothing of it, least of all a stop's.
pub fn discover_connector() -> Connector {
    static WARNED: Once = Once::new();
    let connector = Connector::discover();
    WARNED.call_once(|| connector.config.broken.iter().for_each(warn_ignored_file));
    connector
}

/// Says that a file, or a name of one, is wrong and done without.
pub fn warn_ignored_file(error: &FileError) {
    print_warning(&format!("warning: {error}; it is passed over"));
}

/// A user's own profile.
#[derive(Args, Debug)]
pub struct ProfileFile {
    /// Describe a drive by a TOML file of your own, or by a TML drive's set-up archive (.t.zip)
    #[arg(long = "profile", value_name = "FILE")]
    file: Option<PathBuf>,
}

impl ProfileFile {
    /// How links are opened, with the profile.
    pub fn connector(&self) -> Result<Connector> {
        let connector = discover_connector();
        outcome::count_frames_of(&connector);
        match &self.file {
            Some(file) => connector.with_profile(file).map_err(outcome::to_problem),
            None => Ok(connector),
        }
    }

    /// The same for those who bring motors to rest: a profile that is wrong is told and done without.
    pub fn connector_to_stop(&self) -> Connector {
        let mut connector = discover_connector().for_stop();
        outcome::count_frames_of(&connector);
        match self.file.as_deref().map(|file| connector.config.add_profile(file)) {
            Some(Err(Error::File(error))) => warn_ignored_file(&error),
            Some(Err(error)) => print_warning(&format!("warning: {error}")),
            Some(Ok(_)) | None => {}
        }
        connector
    }

    /// What gives it to another verb, behind a URL; empty without one.
    pub fn as_arguments(&self) -> String {
        let Some(file) = &self.file else { return String::new() };
        format!(" --profile {}", shell_word(&file.display().to_string()))
    }

    /// Whether there is one.
    pub fn is_given(&self) -> bool {
        self.file.is_some()
    }

    /// Every profile that is known, the user's own first.
    pub fn known_profiles(&self) -> Result<Vec<&'static Profile>> {
        let catalogue = polepair::profile::catalogue().iter().map(|module| module.profile());
        Ok(self.connector()?.config.all_profiles().chain(catalogue).collect())
    }
}

/// The drive whose names are used.
#[derive(Args, Debug)]
pub struct NamingArgs {
    /// Name parameters and faults as this drive does: its name, a TOML file of your own, or a
    /// CANopen data sheet (EDS, DCF)
    #[arg(long = "profile", value_name = "NAME|FILE")]
    drive: Option<String>,
}

impl NamingArgs {
    /// The word that names the drive; empty if there is none.
    pub fn word(&self) -> &str {
        self.drive.as_deref().unwrap_or_default()
    }

    /// The drive's profile, if one is named.
    pub fn profile(&self) -> Result<Option<&'static Profile>> {
        let Some(word) = &self.drive else { return Ok(None) };
        discover_connector().config.resolve_profile(word).map(Some).map_err(outcome::to_problem)
    }
}
