//! The question before something is written to a drive.

use std::io::IsTerminal as _;

use crate::problem::{Problem, Result};
use crate::terminal;

/// Asks whether to write `things`, such as "3 settings", unless `agreed` already.
///
/// # Errors
/// `E247` if it is not agreed, or cannot be asked.
pub fn ask(agreed: bool, things: &str, store: bool) -> Result<()> {
    if agreed {
        return Ok(());
    }
    let refusal = |what: &str| Problem::usage("E247", what).why("Nothing was written.");
    if !std::io::stdin().is_terminal() {
        let what = "stdin is not a terminal, so the question cannot be answered.";
        return Err(refusal(what).hint("--yes writes without asking"));
    }
    let stored = if store { " and store them in permanent memory" } else { "" };
    terminal::draw(&format!("write {things}{stored}? [y/N] "));
    let mut answer = String::new();
    let read = std::io::stdin().read_line(&mut answer).is_ok();
    if read && matches!(answer.trim(), "y" | "Y" | "yes") {
        return Ok(());
    }
    Err(refusal("not agreed."))
}
