//! `polepair --server URL dismiss AXES`

use clap::{Args, ValueEnum};
use polepair_client::linked;
use polepair_client::message::{DismissAbsent, DismissReason, DismissStop};

use crate::joined::{self, Joined};
use crate::problem::{Exit, Problem, Result};
use crate::target::Target;
use crate::terminal::say;

/// Owes axes their stop no more, though nobody saw them stand.
///
/// A server says a stop again until the motor was seen standing, and tells so in red for as long. Where
/// that cannot be seen any more, whoever knows better says why; the server's journal keeps it. A drive
/// that the server before owed a stop and that is not there goes by LINK#NUMBER.
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair --server http://127.0.0.1:7365 dismiss 1 --reason drive-gone
  polepair --server http://127.0.0.1:7365 dismiss 0#3 --reason drive-gone    one that is not there")]
pub struct Dismiss {
    #[command(flatten)]
    target: Target,
    /// Why nobody will see it stand
    #[arg(long, value_name = "REASON")]
    reason: Reason,
    /// Words for the journal
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
}

/// Why nobody will see an axis stand.
#[derive(ValueEnum, Clone, Copy, Debug)]
enum Reason {
    /// The drive was taken away, or has no supply
    DriveGone,
    /// Another master commands it
    OtherMaster,
    /// Something else turns its shaft: water a propeller, a load
    TurnedByLoad,
}

impl Dismiss {
    /// Only a server owes stops.
    pub fn run(self) -> Result {
        let what = "`dismiss` is about a server's axes.";
        Err(Problem::usage("E257", what).hint("say which server: --server URL"))
    }

    /// By a server.
    pub fn joined(self, server: &Joined) -> Result {
        let reason = match self.reason {
            Reason::DriveGone => DismissReason::DriveGone,
            Reason::OtherMaster => DismissReason::OtherMaster,
            Reason::TurnedByLoad => DismissReason::TurnedByLoad,
        };
        if let Some((link, number)) = absent(server, self.target.axes()?) {
            let what = format!("axis {number} of {link}");
            let dismiss = DismissAbsent { link, number, reason, note: self.note };
            server.gateway.dismiss_absent(&dismiss).map_err(joined::refused)?;
            say(&format!("{what} is owed no stop any more"));
            return Ok(Exit::Ok);
        }
        let dismiss = DismissStop { reason, epoch: 0, note: self.note };
        for axis in server.pick(&self.target)? {
            server.gateway.dismiss(axis.id, &dismiss).map_err(joined::refused)?;
            say(&format!("{} is owed no stop any more", axis.label));
        }
        Ok(Exit::Ok)
    }
}

/// The connection string and the number of a drive that the server before owed a stop and that is not
/// there: by the number or the connection string of its link, which this server need not have.
fn absent(server: &Joined, words: &str) -> Option<(String, u32)> {
    let (word, number) = words.rsplit_once('#')?;
    let number = number.parse().ok()?;
    match linked(&server.bench, word) {
        Some(link) => link.owed.contains(&number).then(|| (link.url.clone(), number)),
        None => word.contains(':').then(|| (word.to_owned(), number)),
    }
}
