//! `polepair --server URL release`

use clap::Args;

use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::terminal::print_note;

/// Lets the axes of a server move again after everything was stopped.
///
/// A stop of everything locks motion. Whoever releases it should have seen that nobody is near the motors;
/// the server's journal keeps who did. No motor moves by it.
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair --server http://127.0.0.1:7365 release")]
pub struct Release {}

impl Release {
    /// Only a server locks motion.
    pub fn run(self) -> Result {
        let what = "`release` is about a server's motion.";
        Err(Problem::usage("E257", what).hint("say which server: --server URL"))
    }

    /// By a server.
    pub fn run_on_server(self, join: ServerArgs) -> Result {
        join.gateway()?.release().map_err(remote::refusal_problem)?;
        print_note("motion is let again");
        Ok(Exit::Ok)
    }
}
