//! Converts errors of the library to texts for the user. All verbs use it, so the texts are the same.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

pub use polepair::faults;
use polepair::no_reply::NoReplyDetails;
use polepair::{Connector, Error, LocalAxis, SentCounter};
use polepair_core::error::Outcome;
use polepair_core::profile::ParameterId;
use polepair_link::LinkError;

use crate::problem::{Exit, Problem};
use crate::terminal::print_note;

/// Counters of the sent frames on links that this process opened.
static SENT_COUNTERS: Mutex<Vec<SentCounter>> = Mutex::new(Vec::new());

/// Has the frames counted that leave on a connector's links.
pub fn count_frames_of(connector: &Connector) {
    SENT_COUNTERS.lock().unwrap_or_else(PoisonError::into_inner).push(connector.sent_counter());
}

/// A sentence on whether anything was sent before a refusal here.
pub fn sent_so_far() -> String {
    let sent = SENT_COUNTERS.lock().unwrap_or_else(PoisonError::into_inner);
    match sent.iter().map(SentCounter::count).sum::<u64>() {
        0 => "Nothing was sent.".to_owned(),
        1 => "It was not sent. 1 frame was sent before it.".to_owned(),
        count => format!("It was not sent. {count} frames were sent before it."),
    }
}

/// Any error of the library.
pub fn to_problem(error: Error) -> Problem {
    let mut problem =
        Problem::new(error.exit(), error.code().to_owned(), to_sentence(&error.sentence()));
    problem = match &error {
        Error::Failed { received, .. }
            if error.exit() == Exit::NoReply && !received.is_nothing() =>
        {
            problem.why("Frames were received, but no reply, even after repeats.")
        }
        Error::MotionEnded { why, .. } if !why.is_empty() => problem.why(to_sentence(why)),
        _ => problem.why(reason_text(&error)),
    };
    problem.may_turn = error.may_turn();
    problem.hint_if(Some(error.hint().trim()).filter(|hint| !hint.is_empty()))
}

/// Results of addresses without a reply.
pub fn unanswered_text(details: &NoReplyDetails) -> String {
    if details.is_nothing() {
        "No address replied.".to_owned()
    } else {
        format!("No address replied, but frames were received: {details}.")
    }
}

/// Notes once, for each axis and reason, that values have no unit and are shown as the drive's own numbers.
pub fn note_missing_unit(axis: &LocalAxis, id: ParameterId) {
    static NOTED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let Some((why, values)) = axis.unit_problem_parts(id) else { return };
    let mut noted = NOTED.lock().unwrap_or_else(PoisonError::into_inner);
    if noted.insert(format!("{} {why}", axis.label())) {
        let name = axis.parameter(id).map_or("", |parameter| parameter.name);
        let values = if values.is_empty() { values } else { format!(" ({values})") };
        print_note(&format!(
            "note: {}: `{name}` has no unit, the drive's own number is shown: {why}{values}",
            axis.label()
        ));
    }
}

/// A link that the system took away or did not give.
pub fn link_problem(link: &LinkError) -> Problem {
    to_problem(Error::Link(link.clone()))
}

/// One sentence with the reason, where the exit code alone is not enough.
fn reason_text(error: &Error) -> String {
    let partly = matches!(error, Error::Failed { outcome: Outcome::Partly(..), .. });
    let output = match (error.exit(), error.executed()) {
        // The sentence names the missing reply.
        (Exit::NoReply, _) if error.may_turn() => "",
        // Some of several requests may have been answered.
        (Exit::NoReply, _) if partly => "Some requests had no reply, even after repeats.",
        (Exit::NoReply, _) => "No reply within the time limit, even after repeats.",
        (Exit::Corrupt, _) if error.code() == "E502" => "",
        (Exit::Corrupt, _) => "Possible causes: noise, a second host, two drives with one address.",
        (Exit::Refused, Some(false)) if error.code() == "E602" => "It was not executed.",
        (Exit::Refused, Some(false)) => "The drive refused it; it was not executed.",
        (Exit::Negative, _) if error.code() == "E101" => {
            "The expected state was not reached in time."
        }
        // The sentence has the executed part.
        (Exit::Usage, Some(false)) => return sent_so_far(),
        _ => "",
    };
    output.to_owned()
}

/// With a capital and a full stop.
pub fn to_sentence(text: &str) -> String {
    let text = text.trim();
    let stop = if text.is_empty() || text.ends_with(['.', '!', '?']) { "" } else { "." };
    format!("{text}{stop}")
}
