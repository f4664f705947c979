//! The verbs: one file each, but for those that differ in a word alone.

mod completions;
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
mod monitor;
mod moves;
mod params;
mod ports;
mod program;
mod record;
mod release;
mod replay;
mod scan;
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

use std::path::PathBuf;
use std::sync::Once;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use polepair::url::shell_word;
use polepair::{Connector, Error, FileError};
use polepair_capture::Format;
use polepair_core::profile::Profile;

use crate::joined::{self, Join};
use crate::outcome;
use crate::problem::Result;
use crate::terminal::say;

/// Talk to motor drives, simulate them, and read what others said to them.
///
/// Drives are named by connection strings:
///   tmcl+serial:///dev/ttyUSB0:9600#1     modbus-rtu+tcp://10.0.0.5:4001#1,2     sim:tmcl
#[derive(Parser, Debug)]
#[command(name = "polepair", version, verbatim_doc_comment, max_term_width = 100)]
#[command(disable_help_subcommand = true, after_help = AFTER)]
pub struct Arguments {
    #[command(flatten)]
    join: Join,
    /// What to do.
    #[command(subcommand)]
    verb: Verb,
    /// The verb's word.
    #[arg(skip)]
    word: String,
}

impl Arguments {
    /// Reads the command line.
    pub fn read() -> std::result::Result<Self, clap::Error> {
        let names = |word: std::ffi::OsString| {
            word.to_str().is_some_and(|word| word == "--server" || word.starts_with("--server="))
        };
        let command = Join::left_out(Self::command());
        let command = match std::env::args_os().any(names) {
            true => Join::reworded(command),
            false => command,
        };
        let matches = command.try_get_matches()?;
        let word = matches.subcommand_name().unwrap_or_default().to_owned();
        Ok(Self { word, ..Self::from_arg_matches(&matches)? })
    }
}

const AFTER: &str = "\
Exit codes: 0 ok, 1 negative result, 2 usage, 3 no adapter or permission, 4 no reply,
5 corrupt or foreign reply, 6 the drive refused, 7 partial, 8 drive fault, 130 interrupted.
Data goes to stdout, prose to stderr. NO_COLOR is honoured.";

/// The verbs.
#[derive(Subcommand, Debug)]
pub enum Verb {
    /// Explain the frames of a capture
    Decode(decode::Decode),
    /// Tell what a capture holds: who, what, and what went wrong
    Summary(summary::Options),
    /// Tell what differs between two captures in behaviour
    Diff(diff::Options),
    /// Write a capture in another format
    Convert(convert::Convert),
    /// Turn text into the bytes of a frame
    Encode(encode::Encode),
    /// Say what a fault, a status, an exception or a frame means
    Explain(explain::Explain),
    /// Look for what is wrong, from the cable up
    Doctor(doctor::Doctor),
    /// Find the drives on a link
    Scan(scan::Scan),
    /// Show who a drive is, what it does, and its faults in words
    Info(info::Info),
    /// Read parameters by name, with units
    Get(get::Get),
    /// Write parameters by name, with units
    Set(set::Set),
    /// Save a drive's settings as a file, compare them with one, write them back
    #[command(subcommand)]
    Config(config::Config),
    /// Power the motor, holding it where it stands
    Enable(verbs::Enable),
    /// Take power off the motor
    Disable(verbs::Disable),
    /// Bring motors to rest; without #AXES every axis on the link
    Stop(stop::Stop),
    /// Owe axes of a server their stop no more, though nobody saw them stand
    Dismiss(dismiss::Dismiss),
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
    Stream(stream::Stream),
    /// Make programs, put them into a drive's memory, and run them
    Program(program::Program),
    /// Keep the time of several drives together
    Sync(sync::Sync),
    /// Show signals or parameters again and again
    Watch(watch::Watch),
    /// Show or set what drives do by themselves when their host falls silent
    Watchdog(watchdog::Watchdog),
    /// Show axes, frames and faults of a link, live
    Monitor(monitor::Options),
    /// Keep what passes on a link as a capture, and send nothing
    Record(record::Options),
    /// Play what a capture's host said onto a link, or to simulated drives
    Replay(replay::Options),
    /// List the serial adapters, and why one cannot be used
    Ports(ports::Ports),
    /// Show what a drive has: units, ranges, defaults, manual sections
    Params(params::Params),
    /// Simulate drives that any program can talk to
    Sim(sim::Sim),
    /// Open links and serve them to browsers and programs
    Serve(serve::Serve),
    /// Check what a server has kept of what was done
    #[command(subcommand)]
    Journal(journal::Journal),
    /// Find, move, fault and recover two simulated drives
    Demo(demo::Demo),
    /// Print a completion script for a shell
    Completions(completions::Completions),
}

/// Carries a verb out: on a server if one is named.
pub fn run(arguments: Arguments) -> Result {
    arguments.join.check()?;
    if arguments.join.is_wanted() { joined(arguments) } else { here(arguments.verb) }
}

fn joined(Arguments { join, verb, word }: Arguments) -> Result {
    match verb {
        Verb::Scan(verb) => verb.joined(&join.open()?),
        Verb::Info(verb) => verb.joined(&join.open()?),
        Verb::Get(verb) => verb.joined(&join.open()?),
        Verb::Set(verb) => verb.joined(&join.open()?),
        Verb::Enable(verb) => verb.joined(&join.open()?),
        Verb::Disable(verb) => verb.joined(&join.open()?),
        Verb::Stop(verb) => verb.joined(join),
        Verb::Dismiss(verb) => verb.joined(&join.open()?),
        Verb::Release(verb) => verb.joined(join),
        Verb::Clear(verb) => verb.joined(&join.open()?),
        Verb::Spin(verb) => verb.joined(&join.open()?),
        Verb::Move(verb) => verb.joined(&join.open()?),
        Verb::Torque(verb) => verb.joined(&join.open()?),
        Verb::Home(verb) => verb.joined(&join.open()?),
        Verb::Jog(verb) => verb.joined(&join.open()?),
        Verb::Watch(verb) => verb.joined(&join.open()?),
        Verb::Watchdog(verb) => verb.joined(&join.open()?),
        Verb::Monitor(verb) => verb.joined(&join.open()?),
        _ => Err(joined::no_such_verb(&word)),
    }
}

fn here(verb: Verb) -> Result {
    match verb {
        Verb::Decode(verb) => verb.run(),
        Verb::Summary(verb) => verb.run(),
        Verb::Diff(verb) => verb.run(),
        Verb::Convert(verb) => verb.run(),
        Verb::Encode(verb) => verb.run(),
        Verb::Explain(verb) => verb.run(),
        Verb::Doctor(verb) => verb.run(),
        Verb::Scan(verb) => verb.run(),
        Verb::Info(verb) => verb.run(),
        Verb::Get(verb) => verb.run(),
        Verb::Set(verb) => verb.run(),
        Verb::Config(verb) => verb.run(),
        Verb::Enable(verb) => verb.run(),
        Verb::Disable(verb) => verb.run(),
        Verb::Stop(verb) => verb.run(),
        Verb::Dismiss(verb) => verb.run(),
        Verb::Release(verb) => verb.run(),
        Verb::Clear(verb) => verb.run(),
        Verb::Spin(verb) => verb.run(),
        Verb::Move(verb) => verb.run(),
        Verb::Torque(verb) => verb.run(),
        Verb::Home(verb) => verb.run(),
        Verb::Jog(verb) => verb.run(),
        Verb::Stream(verb) => verb.run(),
        Verb::Program(verb) => verb.run(),
        Verb::Sync(verb) => verb.run(),
        Verb::Watch(verb) => verb.run(),
        Verb::Watchdog(verb) => verb.run(),
        Verb::Monitor(verb) => verb.run(),
        Verb::Record(verb) => verb.run(),
        Verb::Replay(verb) => verb.run(),
        Verb::Ports(verb) => verb.run(),
        Verb::Params(verb) => verb.run(),
        Verb::Sim(verb) => verb.run(),
        Verb::Serve(verb) => verb.run(),
        Verb::Journal(verb) => verb.run(),
        Verb::Demo(verb) => verb.run(),
        Verb::Completions(verb) => verb.run(),
    }
}

/// Reads the word of a capture format.
pub fn capture_format() -> impl TypedValueParser<Value = Format> {
    PossibleValuesParser::new(Format::names())
        .map(|word| Format::named(&word).unwrap_or(Format::Text))
}

/// How links are opened. A file of the configuration that is wrong is told once and stands in nobody's
/// way who needs nothing of it, least of all a stop's.
pub fn discovered() -> Connector {
    static TOLD: Once = Once::new();
    let connector = Connector::discover();
    TOLD.call_once(|| connector.config.broken.iter().for_each(passed_over));
    connector
}

/// Says that a file, or a name of one, is wrong and done without.
pub fn passed_over(error: &FileError) {
    say(&format!("warning: {error}; it is passed over"));
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
        let connector = discovered();
        outcome::count(&connector);
        match &self.file {
            Some(file) => connector.with_profile(file).map_err(outcome::error),
            None => Ok(connector),
        }
    }

    /// The same for those who bring motors to rest: a profile that is wrong is told and done without.
    pub fn connector_to_stop(&self) -> Connector {
        let mut connector = discovered().for_stop();
        outcome::count(&connector);
        match self.file.as_deref().map(|file| connector.config.add_profile(file)) {
            Some(Err(Error::File(error))) => passed_over(&error),
            Some(Err(error)) => say(&format!("warning: {error}")),
            Some(Ok(_)) | None => {}
        }
        connector
    }

    /// What gives it to another verb, behind a URL; empty without one.
    pub fn words(&self) -> String {
        let Some(file) = &self.file else { return String::new() };
        format!(" --profile {}", shell_word(&file.display().to_string()))
    }

    /// Whether there is one.
    pub fn is_given(&self) -> bool {
        self.file.is_some()
    }

    /// Every profile that is known, the user's own first.
    pub fn known(&self) -> Result<Vec<&'static Profile>> {
        Ok(self.connector()?.config.all_profiles().collect())
    }
}

/// The drive whose names are used.
#[derive(Args, Debug)]
pub struct NamedBy {
    /// Name parameters and faults as this drive does: its name, a TOML file of your own, or a
    /// CANopen data sheet (EDS, DCF)
    #[arg(long = "profile", value_name = "NAME|FILE")]
    drive: Option<String>,
}

impl NamedBy {
    /// The word that names the drive; empty if there is none.
    pub fn word(&self) -> &str {
        self.drive.as_deref().unwrap_or_default()
    }

    /// The drive's profile, if one is named.
    pub fn profile(&self) -> Result<Option<&'static Profile>> {
        let Some(word) = &self.drive else { return Ok(None) };
        discovered().config.profile_of(word).map(Some).map_err(outcome::error)
    }
}
