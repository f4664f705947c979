//! `polepair --server URL release`

use clap::Args;

use crate::joined::{self, Join};
use crate::problem::{Exit, Problem, Result};
use crate::terminal::say;

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
    pub fn joined(self, join: Join) -> Result {
        join.gateway()?.release().map_err(joined::refused)?;
        say("motion is let again");
        Ok(Exit::Ok)
    }
}
