//! `polepair --server URL release`

use clap::Args;

use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::terminal::print_note;

/// Allows motion again after a server stopped all axes.
///
/// A stop of all axes locks motion. Check that no person is near the motors before you release it. The
/// server's journal records who released it. The command itself moves no motor.
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair --server http://127.0.0.1:7365 release")]
pub struct Release {}

impl Release {
    /// Refuses the command without a server: only a server locks motion.
    pub fn run(self) -> Result {
        let what = "`release` needs a server.";
        Err(Problem::usage("E257", what).hint("add --server URL"))
    }

    /// Releases motion on a server.
    pub fn run_on_server(self, join: ServerArgs) -> Result {
        join.gateway()?.release().map_err(remote::refusal_problem)?;
        print_note("motion is allowed again");
        Ok(Exit::Ok)
    }
}
