//! The library's errors as the user sees them. One place, so that every verb says the same.

use polepair::Error;
pub use polepair::faults;
use polepair_link::LinkError;

use crate::problem::{Exit, Problem};

/// Any error of the library.
pub fn error(error: Error) -> Problem {
    let mut problem = Problem::new(error.exit(), error.code(), sentence(&error.to_string()));
    problem = problem.why(why(&error));
    problem.hint_if(Some(error.hint().trim()).filter(|hint| !hint.is_empty()))
}

/// A link that the system took away or did not give.
pub fn link_error(link: &LinkError) -> Problem {
    error(Error::Link(link.clone()))
}

/// One sentence of why, where the exit code alone does not say it.
fn why(error: &Error) -> &'static str {
    match (error.exit(), error.executed()) {
        (Exit::NoReply, _) => "Nothing came back within the time allowed, repeats included.",
        (Exit::Corrupt, _) => "Noise, a second host, or two drives with one address can do that.",
        (Exit::Refused, Some(false)) => "The drive said no; it was not executed.",
        (Exit::Negative, _) => "The drive took the command, but what was waited for did not come.",
        (Exit::Usage, _) => "Nothing was sent.",
        _ => "",
    }
}

/// With a capital and a full stop.
pub fn sentence(text: &str) -> String {
    let text = text.trim();
    let stop = if text.is_empty() || text.ends_with(['.', '!', '?']) { "" } else { "." };
    format!("{text}{stop}")
}
