//! `polepair --server URL dismiss AXES`

use clap::{Args, ValueEnum};
use polepair_client::find_link;
use polepair_client::message::{DismissAbsent, DismissReason, DismissStop};

use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, RemoteSession, ServerArgs};
use crate::target::DriveArgs;
use crate::terminal::print_note;

/// Clears the stop that a server still has pending for axes.
///
/// A server repeats a stop until the drive confirms standstill, and shows an alarm until then. If the drive
/// can no longer confirm it, this command ends the repetition. The server's journal records the reason. If
/// the drive is missing since a restart of the server, use LINK#NUMBER as its axis.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair --server http://127.0.0.1:7365 dismiss 1 --reason drive-gone
  polepair --server http://127.0.0.1:7365 dismiss 0#3 --reason drive-gone    a missing drive")]
pub struct DismissCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// Why standstill can no longer be confirmed
    #[arg(long, value_name = "REASON")]
    reason: DismissCause,
    /// Comment for the journal
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
}

/// Reason why standstill can no longer be confirmed.
#[derive(ValueEnum, Clone, Copy, Debug)]
enum DismissCause {
    /// The drive was removed or has no supply
    DriveGone,
    /// Another master controls the drive
    OtherMaster,
    /// An external force turns the shaft: water, a load
    TurnedByLoad,
}

impl DismissCommand {
    /// Dismisses pending stops of a server.
    pub fn run(self, server: ServerArgs) -> Result {
        if !server.is_given() {
            let what = "`dismiss` needs a server.";
            return Err(Problem::usage("E257", what).hint("add --server URL"));
        }
        let server = &server.open()?;
        let reason = match self.reason {
            DismissCause::DriveGone => DismissReason::DriveGone,
            DismissCause::OtherMaster => DismissReason::OtherMaster,
            DismissCause::TurnedByLoad => DismissReason::TurnedByLoad,
        };
        if let Some((link, number)) = parse_absent(server, self.target.remote_axes()?) {
            let what = format!("axis {number} of {link}");
            let dismiss = DismissAbsent { link, number, reason, note: self.note };
            server.gateway.dismiss_absent(&dismiss).map_err(remote::refusal_problem)?;
            print_note(&format!("{what} has no pending stop any more"));
            return Ok(Exit::Ok);
        }
        let dismiss = DismissStop { reason, epoch: 0, note: self.note };
        for axis in server.axes_named(self.target.remote_axes()?)? {
            server.gateway.dismiss(axis.id, &dismiss).map_err(remote::refusal_problem)?;
            print_note(&format!("{} has no pending stop any more", axis.label));
        }
        Ok(Exit::Ok)
    }
}

/// Connection string and number of an absent drive with an inherited pending stop: by the number or the connection
/// string of its link, which this server need not have.
fn parse_absent(server: &RemoteSession, words: &str) -> Option<(String, u32)> {
    let (word, number) = words.rsplit_once('#')?;
    let number = number.parse().ok()?;
    match find_link(&server.bench, word) {
        Some(link) => link.pending_stops.contains(&number).then(|| (link.url.clone(), number)),
        None => word.contains(':').then(|| (word.to_owned(), number)),
    }
}
