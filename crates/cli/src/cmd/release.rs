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
    /// Releases motion on a server.
    pub fn run(self, server: ServerArgs) -> Result {
        if !server.is_given() {
            let what = "`release` needs a server.";
            return Err(Problem::usage("E257", what).hint("add --server URL"));
        }
        server.gateway()?.release().map_err(remote::refusal_problem)?;
        print_note("motion is allowed again");
        Ok(Exit::Ok)
    }
}
