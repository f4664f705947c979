//! A broadcast of a protocol whose stations do not answer it: each of them is asked afterwards.

use std::io::IsTerminal as _;
use std::ops::ControlFlow;

use polepair::no_reply::Wiring;
use polepair::scan::{self, ScanAddresses};
use polepair::url::{LinkTarget, Url};
use polepair::{Axis, Connector};

use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::target::DriveArgs;
use crate::terminal::{self, print_note};

/// Time-out of an address in the search. The host awaits late replies for four times as long.
const SEARCH_TIMEOUT_MS: u32 = 10;

/// Note of a command on the broadcast itself.
pub const SENT: &str = "sent to every station; no drive answers a broadcast, so each is asked";

/// The target with the stations of the line beside its broadcast, unless the URL names them or there is no
/// broadcast that needs it.
///
/// They are searched before the broadcast, so that one session sends it and asks them.
///
/// # Errors
/// As a scan; `E403` if no station answers.
pub fn with_stations(target: DriveArgs) -> Result<DriveArgs> {
    // Without its taps: the session that follows writes the trace.
    let connector = target.profiles.connector_to_stop();
    // Errors of the URL are reported when it is opened.
    let Ok(mut url) = connector.url(&target.url) else { return Ok(target) };
    if !url.take_unanswered_broadcast() || !url.axes.is_empty() || !url.names.is_empty() {
        return Ok(target);
    }
    let (stations, wiring) = find_stations(&connector, &url)?;
    if stations.is_empty() {
        let what = "no station answered, so nothing shows who obeys a broadcast.".to_owned();
        return Err(Problem::new(Exit::NoReply, "E403", what)
            .why("Nothing was sent.")
            .hint(wiring.hint()));
    }
    let named = stations.iter().map(u32::to_string).collect::<Vec<_>>().join(",");
    Ok(target.at(format!("{url}#g*,{named}")))
}

fn find_stations(connector: &Connector, url: &Url) -> Result<(Vec<u32>, Wiring)> {
    if matches!(url.target, LinkTarget::Sim { .. }) {
        let link = connector.connect_local(&url.to_string()).map_err(outcome::to_problem)?;
        let stations = link.axes().iter().map(|axis| axis.number()).collect();
        return Ok((stations, Wiring::SerialLine));
    }
    let live = std::io::stderr().is_terminal();
    let mut show = |at: scan::ScanProgress| {
        if live {
            terminal::draw(&format!(
                "\r\x1b[Klooking for stations: address {} ({} of {})",
                at.number,
                at.done + 1,
                at.of
            ));
        }
        if interrupt::was_interrupted() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let mut url = url.clone();
    if url.key("timeout").is_none() {
        url.keys.push(("timeout".to_owned(), SEARCH_TIMEOUT_MS.to_string()));
    }
    print_note("looking for the stations of the line first; `#0,1,2` names them");
    let report = scan::scan(connector, &url.to_string(), ScanAddresses::ALL, &mut show);
    if live {
        terminal::draw("\r\x1b[K");
    }
    if interrupt::was_interrupted() {
        return Err(Problem::interrupted());
    }
    let report = report.map_err(outcome::to_problem)?;
    Ok((report.found.iter().map(|drive| drive.number).collect(), report.wiring))
}

/// The axes of a session, those of a broadcast first: what it did is only seen after it.
pub fn broadcasts_first(axes: &[Axis]) -> impl Iterator<Item = &Axis> {
    let (first, others): (Vec<_>, Vec<_>) = axes.iter().partition(|axis| is_broadcast(axis));
    first.into_iter().chain(others)
}

/// Returns whether it is all stations of a line, none of which answers.
pub fn is_broadcast(axis: &Axis) -> bool {
    axis.local().is_some_and(polepair::LocalAxis::is_unanswered_broadcast)
}
