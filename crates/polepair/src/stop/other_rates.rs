//! Stops drives of a serial line that are at another baud rate than the connection string has.
//!
//! Another program may have set another rate since the string was written (SCIBR of a TML drive, a register, a
//! jumper). A drive that has to stop is searched there too, once it was silent at the stated rate.

use super::{
    LineSearch, LinkStopReport, QUERY_TIMEOUT, StopEvent, StopObserver, broadcast_stop,
    query_timeout,
};
use crate::axis::StopOptions;
use crate::connect::Connector;
use crate::error::{Error, Exit};
use crate::search::BAUD_RATES;
use crate::url::{AxisNumber, LinkTarget, Url};
use polepair_link::clock;
use std::time::Duration;

/// Time limit for all other rates together.
// A line without any drive is the usual cause of silence, and its user waits for the result.
const OTHER_RATES_MAX: Duration = Duration::from_secs(6);
/// Time limit for the addresses at one rate, if none was named.
const RATE_MAX: Duration = Duration::from_millis(700);

/// Repeats a stop at the other rates, for named axes that were silent, or if no drive was found.
///
/// # Errors
/// [`Error::Usage`] if the string's protocol is unknown.
pub(super) fn stop_at_other_rates(
    connector: &Connector,
    url: &Url,
    stated: u32,
    how: StopOptions,
    stopped: &mut LinkStopReport,
    on_event: StopObserver<'_>,
) -> Result<(), Error> {
    let missing = missing_axes(url, stopped);
    if missing.is_empty() && !(url.axes.is_empty() && stopped.axes.is_empty()) {
        return Ok(());
    }
    let end = clock::now() + clock::scale_timeout(OTHER_RATES_MAX);
    let protocol = url.protocol_info()?;
    let is_other = |rate: &u32| *rate != stated && protocol.has_rate(*rate);
    for rate in BAUD_RATES.into_iter().filter(is_other) {
        let Some(url) = Url { axes: missing.clone(), ..url.clone() }.with_baud(rate) else { break };
        if clock::now() > end || on_event(StopEvent::TryingRate(rate)).is_break() {
            break;
        }
        // An adapter that cannot do a rate refuses it. What is known of the stated rate stays.
        let Ok(mut found) = stop_at_rate(connector, &url, how, on_event) else { continue };
        if !found.axes.is_empty() {
            stopped.other_rate = Some(rate);
            let again = |label: &String| found.axes.iter().any(|(other, _)| other == label);
            stopped.axes.retain(|(label, _)| !again(label));
            stopped.axes.append(&mut found.axes);
            stopped.quick_stops.append(&mut found.quick_stops);
            stopped.programs.append(&mut found.programs);
            stopped.motors.append(&mut found.motors);
            break;
        }
    }
    Ok(())
}

/// Numbers of the named axes that did not answer.
fn missing_axes(url: &Url, stopped: &LinkStopReport) -> Vec<u32> {
    let is_silent = |number: &u32| {
        let label = format!("axis {}", AxisNumber(*number));
        let is_silent = |error: &Error| error.exit() == Exit::NoReply;
        let of_axis = stopped.axes.iter().find(|(of, _)| *of == label);
        of_axis.is_some_and(|(_, ended)| ended.as_ref().is_err_and(is_silent))
    };
    url.axes.iter().copied().filter(is_silent).collect()
}

/// Stops the drives that reply at the string's rate. Silent addresses are not in the report.
fn stop_at_rate(
    connector: &Connector,
    url: &Url,
    how: StopOptions,
    on_event: StopObserver<'_>,
) -> Result<LinkStopReport, Error> {
    let mut found = LinkStopReport::default();
    let (lines, _) = connector.open_lines(url)?;
    for line in &lines {
        if url.axes.is_empty() {
            broadcast_stop(connector, url, line, how.command())?;
        }
        let mut search = LineSearch::new(connector, url, line, how)?;
        let timeout = query_timeout(url, line).unwrap_or(QUERY_TIMEOUT);
        search.named = false;
        search.reply_timeout = Some(timeout);
        search.prober = search.prober.with_timeout(Some(timeout));
        search.time_limit = if url.axes.is_empty() { RATE_MAX } else { OTHER_RATES_MAX };
        let drives = search.run(&mut found, on_event)?;
        found.add_axes(&line.axes_of_found(&drives)?, how, on_event);
    }
    Ok(found)
}

/// The rate that a port is opened at, where a stop may look at others.
pub(super) fn stated_rate(url: &Url, rate: u32) -> Option<u32> {
    matches!(url.target, LinkTarget::Serial { .. }).then_some(rate).filter(|rate| *rate > 0)
}
