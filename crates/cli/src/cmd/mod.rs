//! The verbs. Each has a file of its own, except those that differ only in the operation.

mod act;
pub mod completions;
mod config;
mod convert;
mod couple;
pub mod decode;
mod demo;
mod diff;
mod dismiss;
mod doctor;
mod eds;
mod encode;
mod explain;
mod fleet;
mod get;
pub mod groups;
mod info;
mod journal;
mod lss;
mod monitor;
mod moves;
mod params;
mod paths;
mod ports;
mod program;
mod record;
mod record_in_drive;
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

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use crate::problem::Result;
use crate::remote::{self, ServerArgs};
use crate::terminal;

/// Configure, move, watch and simulate motor drives, and analyse captures of their buses.
///
/// A connection string names a link and its drives:
///   tmcl+serial:///dev/ttyUSB0:9600#1     modbus-rtu+tcp://10.0.0.5:4001#1,2     sim:tmcl
#[derive(Parser, Debug)]
#[command(name = "polepair", version, verbatim_doc_comment, max_term_width = 100)]
#[command(after_help = HELP_FOOTER)]
pub struct CommandLine {
    /// Print no notes and no progress on stderr; errors and motion warnings are still printed
    #[arg(short, long, global = true)]
    quiet: bool,
    #[command(flatten)]
    join: ServerArgs,
    /// The verb to run.
    #[command(subcommand)]
    verb: CommandVerb,
    /// The verb's name.
    #[arg(skip)]
    word: String,
}

impl CommandLine {
    /// All verbs and options, with the verbs grouped in the help.
    pub fn grammar() -> clap::Command {
        groups::with_grouped_verbs(Self::command())
    }

    /// Reads the command line.
    pub fn parse(words: Vec<OsString>, version: &str) -> std::result::Result<Self, clap::Error> {
        let command = ServerArgs::hide_server_options(Self::grammar().version(version.to_owned()));
        let command =
            if words.iter().any(names_server) { ServerArgs::reword_help(command) } else { command };
        let matches = command.try_get_matches_from(words)?;
        let word = matches.subcommand_name().unwrap_or_default().to_owned();
        Ok(Self { word, ..Self::from_arg_matches(&matches)? })
    }
}

fn names_server(word: &OsString) -> bool {
    word.to_str().is_some_and(|word| word == "--server" || word.starts_with("--server="))
}

const HELP_FOOTER: &str = "\
Exit codes: 0 ok; 1 negative result; 2 usage; 3 no adapter or permission; 4 no reply;
5 corrupt or foreign reply; 6 the drive refused; 7 partial; 8 drive fault; 130 interrupted.
Results are printed on stdout, notes and errors on stderr. NO_COLOR switches colours off.";

/// The verbs.
#[derive(Subcommand, Debug)]
pub enum CommandVerb {
    /// Decode and explain the frames of a capture
    Decode(decode::Decode),
    /// Summarise a capture: axes, states, response times, faults
    Summary(summary::SummaryOptions),
    /// Compare the behaviour of two captures
    Diff(diff::DiffOptions),
    /// Convert a capture to another file format
    Convert(convert::Convert),
    /// Convert a request from text to bytes
    Encode(encode::Encode),
    /// Explain a fault, a status, an exception or a frame
    Explain(explain::Explain),
    /// Check a link, from the cable to the drive
    Doctor(doctor::Doctor),
    /// Find the drives on a link
    Scan(scan::ScanCommand),
    /// Set node-IDs and bit rates of CANopen devices (LSS)
    Lss(lss::LssCommand),
    /// Show identity, state and faults of a drive
    Info(info::Info),
    /// Read parameters by name or number, with units
    Get(get::Get),
    /// Write parameters by name or number, with units
    Set(set::Set),
    /// Send requests in the protocol's own text, and explain the replies
    Send(send::Send),
    /// Save, compare and restore a drive's settings
    #[command(subcommand)]
    Config(config::ConfigCommand),
    /// Write the data sheet of a CANopen drive: EDS, or DCF with its values
    Eds(eds::EdsCommand),
    /// Power the motor; it holds its position
    Enable(verbs::Enable),
    /// Remove power from the motor
    Disable(verbs::Disable),
    /// Stop motors; without #AXES, all axes of the link
    Stop(stop::StopCommand),
    /// Clear the stop that a server still has pending for axes
    Dismiss(dismiss::DismissCommand),
    /// Allow motion again after a server stopped all axes
    Release(release::Release),
    /// Clear faults
    Clear(verbs::Clear),
    /// Turn a motor at constant speed until Ctrl-C
    Spin(moves::Spin),
    /// Move an axis to a position
    Move(moves::Move),
    /// Turn a motor with constant torque until Ctrl-C
    Torque(moves::Torque),
    /// Search the reference position of an axis
    Home(moves::Home),
    /// Turn a motor slowly until Ctrl-C
    Jog(moves::Jog),
    /// Save, load, check, plot and run the stored paths of a SYNTRON TS
    #[command(subcommand)]
    Paths(paths::PathsCommand),
    /// Move axes along the points of a file
    Stream(stream::StreamCommand),
    /// Assemble, load and run programs in the memory of a drive
    Program(program::ProgramArgs),
    /// Synchronise the clocks of several drives
    Sync(sync::Sync),
    /// Let an axis follow another one by a gear's ratio or a cam's table
    Couple(couple::Couple),
    /// End the coupling of an axis
    Uncouple(couple::Uncouple),
    /// Print signals or parameters periodically
    Watch(watch::WatchCommand),
    /// Show or set the reaction of drives to a silent host
    Watchdog(watchdog::WatchdogCommand),
    /// Show axes, faults and frames of a link live
    Monitor(monitor::MonitorOptions),
    /// Decode captures of many machines and query them; needs the Python package
    Fleet(fleet::Fleet),
    /// Record the frames of a link to a capture; sends nothing
    Record(record::RecordOptions),
    /// Record variables in the drive's own memory, at the rate of its control loop
    RecordInDrive(record_in_drive::RecordInDrive),
    /// Send the recorded frames of a capture to a link or to simulated drives
    Replay(replay::ReplayOptions),
    /// List serial and CAN adapters, with the reason if one is unusable
    Ports(ports::Ports),
    /// List parameters of a drive: units, ranges, defaults, manual sections
    Params(params::Params),
    /// Simulate drives for any program
    Sim(sim::Sim),
    /// Change a simulated drive: load, fault, input
    Act(act::ActCommand),
    /// Serve links to browsers and programs
    Serve(serve::Serve),
    /// Check the journal of a server
    #[command(subcommand)]
    Journal(journal::JournalCommand),
    /// Find, move, fault and recover simulated drives
    Demo(demo::Demo),
    /// Print a completion script for a shell
    Completions(completions::Completions),
}

/// Runs a verb, on a server if `--server` is given.
pub fn run(arguments: CommandLine) -> Result {
    let CommandLine { quiet, join, verb, word } = arguments;
    if quiet {
        terminal::be_quiet();
    }
    join.check()?;
    let on_server = join.is_given();
    match verb {
        CommandVerb::Enable(verb) => verb.run(join),
        CommandVerb::Disable(verb) => verb.run(join),
        CommandVerb::Clear(verb) => verb.run(join),
        CommandVerb::Spin(verb) => verb.run(join),
        CommandVerb::Move(verb) => verb.run(join),
        CommandVerb::Torque(verb) => verb.run(join),
        CommandVerb::Home(verb) => verb.run(join),
        CommandVerb::Jog(verb) => verb.run(join),
        CommandVerb::Watchdog(verb) => verb.run(join),
        CommandVerb::Paths(verb) => verb.run(join),
        CommandVerb::Get(verb) => verb.run(join),
        CommandVerb::Send(verb) => verb.run(join),
        CommandVerb::Monitor(verb) => verb.run(join),
        CommandVerb::Set(verb) => verb.run(join),
        CommandVerb::Watch(verb) => verb.run(join),
        CommandVerb::Scan(verb) => verb.run(join),
        CommandVerb::Info(verb) => verb.run(join),
        CommandVerb::Stop(verb) => verb.run(join),
        CommandVerb::Dismiss(verb) => verb.run(join),
        CommandVerb::Release(verb) => verb.run(join),
        CommandVerb::Act(verb) => verb.run(join),
        _ if on_server => Err(remote::no_such_verb(&word)),
        CommandVerb::Decode(verb) => verb.run(),
        CommandVerb::Summary(verb) => verb.run(),
        CommandVerb::Diff(verb) => verb.run(),
        CommandVerb::Convert(verb) => verb.run(),
        CommandVerb::Fleet(verb) => verb.run(),
        CommandVerb::Encode(verb) => verb.run(),
        CommandVerb::Explain(verb) => verb.run(),
        CommandVerb::Doctor(verb) => verb.run(),
        CommandVerb::Lss(verb) => verb.run(),
        CommandVerb::Config(verb) => verb.run(),
        CommandVerb::Eds(verb) => verb.run(),
        CommandVerb::Stream(verb) => verb.run(),
        CommandVerb::Program(verb) => verb.run(),
        CommandVerb::Sync(verb) => verb.run(),
        CommandVerb::Couple(verb) => verb.run(),
        CommandVerb::Uncouple(verb) => verb.run(),
        CommandVerb::Record(verb) => verb.run(),
        CommandVerb::RecordInDrive(verb) => verb.run(),
        CommandVerb::Replay(verb) => verb.run(),
        CommandVerb::Ports(verb) => verb.run(),
        CommandVerb::Params(verb) => verb.run(),
        CommandVerb::Sim(verb) => verb.run(),
        CommandVerb::Serve(verb) => verb.run(),
        CommandVerb::Journal(verb) => verb.run(),
        CommandVerb::Demo(verb) => verb.run(),
        CommandVerb::Completions(verb) => verb.run(),
    }
}
