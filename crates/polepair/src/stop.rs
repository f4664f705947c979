//! Stops all drives of a link without knowing them.
//!
//! Several passes, so that no drive waits for the search of others: a broadcast stop, if the protocol has one;
//! then each address is tried briefly, and a drive that replies is stopped at once; then the further motors of
//! modules; then all are awaited together.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use polepair::stop::StopOptions;
//! use std::ops::ControlFlow;
//! let connector = polepair::Connector::default();
//! let url = "sim:tmcl?axes=2&time=virtual";
//! let on_event = &mut |_: polepair::stop::StopEvent<'_>| ControlFlow::Continue(());
//! let stopped = polepair::stop::stop(&connector, url, StopOptions::default(), on_event)?;
//! assert!(stopped.axes.len() == 2 && stopped.axes.iter().all(|(_, ended)| ended.is_ok()));
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod broadcast;
mod other_rates;
mod unidentified;

pub use crate::axis::StopOptions;
use crate::axis::{
    LocalAxis, Standstill, StopNotice, StopPersistence, StopProgress, StopSupervisor, WireAirtime,
    await_stops,
};
use crate::connect::Connector;
use crate::error::{Error, Exit};
use crate::identify::{IDENTIFY_RETRY_MAX, ProbeResult, Prober};
use crate::listen::RawWires;
use crate::no_reply::{NoReplyDetails, Wiring};
use crate::protocol_line::ProtocolLine;
use crate::scan::{self, DetectedDrive, ScanProgress};
use crate::url::{AxisNumber, LinkTarget, Url};
use broadcast::{broadcast_stop, send_broadcast};
use other_rates::{stated_rate, stop_at_other_rates};
use polepair_core::axis::{Command, ProgramEnd, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::Profile;
use polepair_core::proto::{sub_axis, with_sub_axis};
use polepair_link::clock;
use std::ops::ControlFlow;
use std::time::Duration;
use unidentified::SharedStop;

/// Time of an address to reply if the string names none, besides the time of the bytes.
const QUERY_TIMEOUT: Duration = Duration::from_millis(30);
/// Time behind a gateway of a network.
const NETWORK_QUERY_TIMEOUT: Duration = Duration::from_millis(300);
/// Bits of the longest question and reply of an identification, on a serial line.
const QUERY_BITS: u64 = 400;
/// Limit of the time waited for addresses that are not named; the rest is reported as not tried.
// Long enough for all addresses of a quick protocol; a person who stops cannot wait for all 247 of a slow
// one.
const SEARCH_MAX: Duration = Duration::from_secs(6);
/// Time limit for identifying a named drive before the protocol's common stop is sent.
const NAMED_QUERY_MAX: Duration = Duration::from_millis(250);
/// Pause between two attempts to identify a drive after its stop.
const REIDENTIFY_PAUSE: Duration = Duration::from_millis(50);
/// Longest delay of the other drives by a found one.
// For each axis in turn while the next is still turning, so not for long.
const STOP_WAIT_MAX: Duration = Duration::from_millis(150);
/// Time that a named silent drive may delay the others, after all stops were sent.
const SILENT_STOP_WAIT_MAX: Duration = Duration::from_secs(1);
/// Motors behind one address at most: a TMCL parameter number shares its byte with four bits of them.
const MOTORS_MAX: u8 = 16;
/// Silent motors in a row after which the drive counts as gone.
// Modules refuse numbers beyond their motors; one that is silent at four in a row is not there.
const SILENT_MOTORS_MAX: u8 = 4;

/// The result of a stop.
#[derive(Debug, Default)]
pub struct LinkStopReport {
    /// A broadcast stop was sent first. It has no confirmation.
    pub broadcast: bool,
    /// Each axis that was named or found, in the order of the addresses, and how its stop ended.
    pub axes: Vec<(String, Result<Standstill, Error>)>,
    /// Axes whose motor the stop did not slow, so that a quick stop was sent.
    pub quick_stops: Vec<String>,
    /// Results on the drives' own programs, where a drive runs any.
    pub programs: Vec<(String, DrivePrograms)>,
    /// Drives with more motors than the one that their axis is, in the same order.
    pub motors: Vec<DriveMotors>,
    /// Baud rate at which drives answered that were silent at the rate of the connection string.
    pub other_rate: Option<u32>,
    /// Addresses that were asked.
    pub queried: usize,
    /// Time that each had to reply; `None` for the host's own time-outs.
    pub reply_timeout: Option<Duration>,
    /// Frames received from silent addresses that were not named.
    pub received: NoReplyDetails,
    /// Kind of the wire.
    pub wiring: Wiring,
    /// All addresses were asked before an answer was awaited.
    pub asked_at_once: bool,
    /// Addresses that there was no time left for: first, last.
    pub not_queried: Option<(u32, u32)>,
}

/// Result of two stops, one after the other, on a drive's own program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DrivePrograms {
    /// One ran, and was ended.
    Ended,
    /// The drive acknowledged the end of its program, and reports it as running all the same.
    StillReported,
    /// One that may have run was ended: the drive does not report whether one runs.
    MayHaveRun,
    /// One was being loaded, and that was ended: it is incomplete.
    Incomplete,
}

impl DrivePrograms {
    /// With what one more stop found.
    const fn after(before: Option<Self>, found: ProgramEnd) -> Option<Self> {
        match (before, found) {
            (Some(Self::Ended), ProgramEnd::Ended) => Some(Self::StillReported),
            (None, ProgramEnd::Ended) => Some(Self::Ended),
            (None, ProgramEnd::MayHaveRun) => Some(Self::MayHaveRun),
            (before, _) => before,
        }
    }
}

/// Further motors of one address. They acknowledged the stop; their standstill was not checked.
#[derive(Debug)]
pub struct DriveMotors {
    /// The axis' label.
    pub axis: String,
    /// Address of the drive.
    pub number: u32,
    /// Motors that confirmed their stop, the first (0) not counted.
    pub confirmed: Vec<u8>,
    /// Motors that did not, and may exist.
    pub unconfirmed: Vec<u8>,
    /// Failure of the first of those.
    pub result: Result<(), Error>,
}

/// Events of a stop.
#[derive(Debug)]
pub enum StopEvent<'a> {
    /// An address is asked.
    Querying(ScanProgress),
    /// Nothing answered at the rate of the connection string, so this one is tried.
    TryingRate(u32),
    /// A stop was sent to a drive that replied, or was named.
    StopSent(&'a LocalAxis),
    /// Every stop was sent, and standstill is awaited. Reported some 50 times a second.
    Waiting,
}

/// Observer of the events. `Break` ends the wait for standstill; every stop is sent before that.
pub type StopObserver<'a> = &'a mut dyn FnMut(StopEvent<'_>) -> ControlFlow<()>;

/// Stops every axis that the string names, or everybody on its link.
///
/// # Errors
/// [`Error::Usage`], and [`Error::Link`] when the link cannot be opened or goes away. What a drive
/// makes of it is in [`LinkStopReport`].
pub fn stop(
    connector: &Connector,
    url: &str,
    how: StopOptions,
    on_event: StopObserver<'_>,
) -> Result<LinkStopReport, Error> {
    let mut parsed = connector.url(url)?;
    let mut stopped = LinkStopReport::default();
    if parsed.take_unanswered_broadcast() {
        return stop_by_broadcast(connector, parsed, how, stopped, on_event);
    }
    let group = parsed.axes.iter().any(|axis| AxisNumber(*axis).is_group());
    let rack = matches!(parsed.target, LinkTarget::Rack { .. });
    if group || rack || matches!(parsed.target, LinkTarget::Sim { .. }) {
        // The drives are known, or cannot be asked. A rack defines each: there is no wait for a silent one.
        let link = connector.connect_with(url, !rack)?;
        // Every drive gets a first stop before any standstill is waited for.
        stopped.send_first_stops(link.axes(), how);
        stopped.add_axes(link.axes(), how, on_event);
        return Ok(stopped);
    }
    let (lines, _) = connector.open_lines(&parsed)?;
    stop_on_lines(connector, &parsed, &lines, how, &mut stopped, on_event)?;
    let rate = lines.first().and_then(|line| stated_rate(&parsed, line.options.port_baud));
    // Each rate opens the port again.
    drop(lines);
    if let Some(rate) = rate {
        stop_at_other_rates(connector, &parsed, rate, how, &mut stopped, on_event)?;
    }
    Ok(stopped)
}

/// Sends the stop to all stations of a line, none of which answers it, and then stops each: those that the string
/// names, or all that are found.
fn stop_by_broadcast(
    connector: &Connector,
    mut url: Url,
    how: StopOptions,
    mut stopped: LinkStopReport,
    on_event: StopObserver<'_>,
) -> Result<LinkStopReport, Error> {
    let (lines, _simulation) = connector.open_lines(&url)?;
    for line in &lines {
        // Named by its user, it goes out before any drive is identified: all known ones of this protocol obey it.
        let prober = Prober::new(line, &connector.config);
        let chosen = connector.chosen_profile(&url, &line.protocol)?;
        let known = chosen.as_ref().map_or(prober.profiles(), std::slice::from_ref);
        let shared = unidentified::shared_stop(known, how.command().verb);
        if let Some((profile, verb)) = shared {
            stopped.broadcast |= send_broadcast(line, profile, Command::new(verb))?;
        }
        if url.axes.is_empty() && matches!(url.target, LinkTarget::Sim { .. }) {
            // Every address of a simulation is known.
            url.axes.clone_from(&line.axis_numbers);
        }
    }
    stop_on_lines(connector, &url, &lines, how, &mut stopped, on_event)?;
    Ok(stopped)
}

/// Stops drives on an open wire, for programs that set its axes in motion in ways of their own: those of these numbers,
/// or all without any.
///
/// # Errors
/// As [`stop`].
pub fn stop_on(
    connector: &Connector,
    opened: &RawWires,
    wire: usize,
    axes: &[u32],
    on_event: StopObserver<'_>,
) -> Result<LinkStopReport, Error> {
    let mut stopped = LinkStopReport::default();
    let Some(lines) = opened.by_wire().nth(wire) else { return Ok(stopped) };
    let url = Url { axes: axes.to_vec(), names: Vec::new(), ..opened.url.clone() };
    let how = StopOptions::default();
    stop_on_lines(connector, &url, lines, how, &mut stopped, on_event)?;
    Ok(stopped)
}

fn stop_on_lines(
    connector: &Connector,
    url: &Url,
    lines: &[ProtocolLine],
    how: StopOptions,
    stopped: &mut LinkStopReport,
    on_event: StopObserver<'_>,
) -> Result<(), Error> {
    // Each line of a wire has one of its own, unless the caller sent it.
    let is_sent = stopped.broadcast;
    for line in lines {
        if url.axes.is_empty() && !is_sent {
            // Before the search: it reaches in one frame all drives that obey it, and costs no reply.
            stopped.broadcast |= broadcast_stop(connector, url, line, how.command())?;
        }
        let found = LineSearch::new(connector, url, line, how)?.run(stopped, on_event)?;
        stopped.add_axes(&line.axes_of_found(&found)?, how, on_event);
    }
    Ok(())
}

/// The search of a line for drives to stop.
struct LineSearch<'a> {
    line: &'a ProtocolLine,
    how: StopOptions,
    prober: Prober<'a>,
    /// True if the addresses are named: each gets a stop, and is reported as missing if it is silent.
    named: bool,
    wanted: Vec<u32>,
    /// The profile that the string names.
    chosen: Option<&'static Profile>,
    reply_timeout: Option<Duration>,
    /// Limit of the time waited for addresses that are not named.
    time_limit: Duration,
    found: Vec<DetectedDrive>,
    /// Drives with a stop of their own or of their protocol, from which no usable reply came.
    deaf: Vec<(DetectedDrive, Error)>,
    unknown: Vec<UnknownDrive>,
}

/// A drive that was not identified.
struct UnknownDrive {
    number: u32,
    /// The stop that it got, if its protocol has a common one.
    shared: Option<(DetectedDrive, StopOptions)>,
    /// Reason why it is not known.
    error: Error,
    is_other_device: bool,
}

impl<'a> LineSearch<'a> {
    fn new(
        connector: &'a Connector,
        url: &Url,
        line: &'a ProtocolLine,
        how: StopOptions,
    ) -> Result<Self, Error> {
        let named = !url.axes.is_empty();
        let query_timeout = query_timeout(url, line)?;
        let prober = Prober::new(line, &connector.config);
        // A named address gets its stop soon, whatever it is.
        let prober = if named {
            prober.with_time_limit(NAMED_QUERY_MAX.max(2 * query_timeout))
        } else {
            prober.with_timeout(Some(query_timeout))
        };
        Ok(Self {
            line,
            how,
            prober,
            named,
            wanted: if named { url.axes.clone() } else { scan::default_addresses(line)? },
            chosen: connector.chosen_profile(url, &line.protocol)?,
            reply_timeout: (!named).then_some(query_timeout),
            time_limit: SEARCH_MAX,
            found: Vec::new(),
            deaf: Vec::new(),
            unknown: Vec::new(),
        })
    }

    /// Tries each address, and stops each drive that replies. Returns those whose standstill is to be seen.
    fn run(
        mut self,
        stopped: &mut LinkStopReport,
        on_event: StopObserver<'_>,
    ) -> Result<Vec<DetectedDrive>, Error> {
        stopped.reply_timeout = self.reply_timeout;
        stopped.wiring = self.line.wiring();
        stopped.asked_at_once = !self.named && scan::asks_at_once(self.line);
        let mut waited = Duration::ZERO;
        let wanted = std::mem::take(&mut self.wanted);
        for (done, &number) in wanted.iter().enumerate() {
            debug_assert!(done < wanted.len());
            if waited >= self.time_limit {
                stopped.not_queried = wanted.last().map(|last| (number, *last));
                break;
            }
            let _ = on_event(StopEvent::Querying(ScanProgress { number, done, of: wanted.len() }));
            stopped.queried += 1;
            let began = clock::now();
            let probe = self.prober.probe(number)?;
            waited += match (self.reply_timeout, &probe) {
                (None, _) => Duration::ZERO,
                // Not the measured time: a busy computer must not ask fewer addresses than an idle one.
                (Some(timeout), ProbeResult::Silent(_)) => timeout,
                (Some(_), _) => clock::now().since(began),
            };
            self.stop_probed(number, probe, stopped, on_event)?;
        }
        self.finish_deaf(stopped)?;
        self.finish_unknown(stopped, on_event)?;
        Ok(self.found)
    }

    /// Stops the drive at an address, as far as it was identified.
    fn stop_probed(
        &mut self,
        number: u32,
        probe: ProbeResult,
        stopped: &mut LinkStopReport,
        on_event: StopObserver<'_>,
    ) -> Result<(), Error> {
        // Decided before the stop is sent: a device that is known to be no drive gets nothing (STOP-6).
        let is_other_device = unidentified::is_other_device(self.line, &probe);
        let (identified, error) = match probe {
            ProbeResult::Found { profile, identified, doubtful: false, .. } => {
                (Some((profile, identified)), None)
            }
            ProbeResult::Found { .. } => (None, Some(self.prober.confused_error(number))),
            ProbeResult::AnsweredTwice => (None, Some(self.prober.answered_twice_error(number))),
            ProbeResult::Silent(details) | ProbeResult::Damaged(details) if !self.named => {
                stopped.received = stopped.received.plus(details.only_foreign());
                return Ok(());
            }
            ProbeResult::Forbidden(_) if !self.named => return Ok(()),
            ProbeResult::Forbidden(hint) => (None, Some(self.prober.forbidden_error(number, hint))),
            ProbeResult::Silent(details) | ProbeResult::Damaged(details) => {
                (None, Some(self.prober.silent_error(number, details)))
            }
        };
        let known = |profile| DetectedDrive::with_known_profile(self.line, number, profile);
        let verb = self.how.command().verb;
        // Of which standstill can be seen as well.
        let has_stop = |profile: &&'static Profile| {
            profile.plan(verb).is_some() && !profile.signals.is_empty()
        };
        let generic = Some(self.line.protocol.generic).filter(has_stop);
        let one = match (self.chosen, identified) {
            (Some(profile), _) => Some(known(profile)),
            (None, Some((profile, identified))) if has_stop(&profile) => {
                Some(DetectedDrive { identified, ..known(profile) })
            }
            (None, _) => generic.map(known),
        };
        let Some(one) = one else {
            let error = error.unwrap_or_else(|| self.prober.unknown_error(number));
            let shared = (!is_other_device).then(|| self.shared_stop(number)).flatten();
            if let Some((one, how)) = &shared {
                self.stop_found(one, *how, stopped, on_event)?;
            }
            self.unknown.push(UnknownDrive { number, shared, error, is_other_device });
            return Ok(());
        };
        self.stop_found(&one, self.how, stopped, on_event)?;
        if let Some(error) = error {
            // It got its stop, and gets another at the end, after all others were.
            self.deaf.push((one, error));
            return Ok(());
        }
        // After its first axis is stopped: finding the others takes requests.
        let further = self.line.further_axes(&one)?;
        self.found.push(one);
        for axis in further {
            self.stop_found(&axis, self.how, stopped, on_event)?;
            self.found.push(axis);
        }
        Ok(())
    }

    /// Stop that all known drives of the protocol obey, for one that cannot be identified.
    fn shared_stop(&self, number: u32) -> Option<(DetectedDrive, StopOptions)> {
        let verb = self.how.command().verb;
        let (profile, verb) = unidentified::shared_stop(self.prober.profiles(), verb)?;
        let one = DetectedDrive::with_known_profile(self.line, number, profile);
        Some((one, StopOptions { quick: verb == Verb::QuickStop, ..self.how }))
    }

    /// A drive without a usable reply may have lost count of bytes, which a stop that is sent several times does
    /// not mind.
    fn finish_deaf(&mut self, stopped: &mut LinkStopReport) -> Result<(), Error> {
        for (one, error) in std::mem::take(&mut self.deaf) {
            match self.stop_unanswered(&one, self.how)? {
                // It was asked twice; the error of its identification has more of the cause.
                Err(ref reported) if reported.exit() == Exit::NoReply => {
                    stopped.axes.push((format!("axis {}", one.number), Err(error)));
                }
                _ => self.found.push(one),
            }
        }
        Ok(())
    }

    /// Identifies the other drives for a while.
    fn finish_unknown(
        &mut self,
        stopped: &mut LinkStopReport,
        on_event: StopObserver<'_>,
    ) -> Result<(), Error> {
        let end = self.line.link.deadline(IDENTIFY_RETRY_MAX);
        for UnknownDrive { number, shared, error, is_other_device } in
            std::mem::take(&mut self.unknown)
        {
            let one = loop {
                let one = unidentified::reidentify(&self.prober, self.line, number)?;
                let is_interrupted = on_event(StopEvent::Waiting).is_break();
                if one.is_some() || is_interrupted || self.line.link.now() > end {
                    break one;
                }
                // A drive that just got its supply answers within a second or two.
                clock::sleep_until(clock::now() + REIDENTIFY_PAUSE);
            };
            if let Some(one) = one {
                self.stop_found(&one, self.how, stopped, on_event)?;
                self.found.push(one);
                continue;
            }
            let sent = match shared {
                Some((one, how)) => SharedStop::Sent(self.stop_unanswered(&one, how)?),
                None if is_other_device => SharedStop::OtherDevice,
                None => SharedStop::None,
            };
            let error = unidentified::unidentified_error(&self.prober, number, error, sent);
            stopped.axes.push((format!("axis {number}"), Err(error)));
        }
        Ok(())
    }

    /// Stops a drive, and waits no longer than the others allow.
    fn stop_found(
        &self,
        one: &DetectedDrive,
        how: StopOptions,
        stopped: &mut LinkStopReport,
        on_event: StopObserver<'_>,
    ) -> Result<(), Error> {
        for axis in self.line.axes_of_found(std::slice::from_ref(one))? {
            // A drive that only receives may obey. Its reply is awaited together with all others.
            let mut stop = begin_stop(&axis, how);
            stopped.wait_first_stop(&axis, &mut stop, clock::scale_timeout(STOP_WAIT_MAX));
            if !stop.is_unsent() {
                let _ = on_event(StopEvent::StopSent(&axis));
            }
        }
        Ok(())
    }

    /// Stops a silent drive, and reports whether it replied.
    fn stop_unanswered(
        &self,
        one: &DetectedDrive,
        how: StopOptions,
    ) -> Result<Result<(), Error>, Error> {
        let axes = self.line.axes_of_found(std::slice::from_ref(one))?;
        Ok(axes.iter().try_for_each(|axis| {
            let mut stop = begin_stop(axis, how);
            stop.wait(&mut WireAirtime::default(), clock::scale_timeout(SILENT_STOP_WAIT_MAX));
            match stop.progress() {
                StopProgress::Failed(error) => Err(error.clone()),
                _ => Ok(()),
            }
        }))
    }
}

fn begin_stop(axis: &LocalAxis, how: StopOptions) -> StopSupervisor {
    StopSupervisor::begin(axis, how, StopPersistence::Within(Duration::ZERO))
}

/// Time limit of an address: the string's, otherwise that of the drives.
fn query_timeout(url: &Url, line: &ProtocolLine) -> Result<Duration, Error> {
    if let Some(ms) = url.milliseconds("timeout")? {
        return Ok(Duration::from_secs_f64(ms / 1000.0));
    }
    if line.protocol.network_port.is_some() {
        return Ok(NETWORK_QUERY_TIMEOUT);
    }
    let bits = Duration::from_secs(QUERY_BITS).checked_div(line.options.baud);
    Ok(QUERY_TIMEOUT + bits.unwrap_or_default())
}

/// Stops every motor of the drives besides the axes, whose stop was already sent, up to the first missing
/// number. A missing reply does not prevent the stops of further motors, and is repeated once at the end.
fn stop_more_motors(axes: &[LocalAxis]) -> Vec<DriveMotors> {
    let of = |axis: &LocalAxis| {
        let mut received = Vec::new();
        let mut silent: Vec<(u8, Error)> = Vec::new();
        // Motors behind one address are numbered without gaps, but one of them can be silent for a moment.
        let mut in_a_row = 0;
        for number in (1..MOTORS_MAX).filter(|number| !is_axis_number(*number, axis, axes)) {
            let sent =
                |axis: &LocalAxis| axis.connection().with_axes(|axes, _| axes.counters().sent);
            // Nothing left means a lost link, which the stop of the axis itself reports.
            let before = sent(axis);
            match axis.stop_motor(number) {
                Ok(()) => received.push(number),
                Err(Error::Unsupported { .. }) => break,
                Err(error) if is_no_such_motor(&error) => break,
                // The axis' own stop reports a lost link.
                Err(_) if sent(axis) == before => break,
                Err(error) => silent.push((number, error)),
            }
            in_a_row = if received.last() == Some(&number) { 0 } else { in_a_row + 1 };
            if in_a_row == SILENT_MOTORS_MAX {
                break;
            }
        }
        // Once more at the end: while the first round runs, a module may be busy with its stop.
        silent.retain_mut(|(number, why)| match axis.stop_motor(*number) {
            Ok(()) => {
                received.push(*number);
                false
            }
            Err(error) if is_no_such_motor(&error) => false,
            Err(error) => {
                *why = error;
                true
            }
        });
        received.sort_unstable();
        let (silent, mut errors): (Vec<u8>, Vec<Error>) = silent.into_iter().unzip();
        let ended = if errors.is_empty() { Ok(()) } else { Err(errors.swap_remove(0)) };
        DriveMotors {
            axis: axis.label(),
            number: axis.number(),
            confirmed: received,
            unconfirmed: silent,
            result: ended,
        }
    };
    let all = axes.iter().filter(|axis| sub_axis(axis.number()) == 0).map(of);
    all.filter(|motors| !motors.confirmed.is_empty() || motors.result.is_err()).collect()
}

fn is_axis_number(number: u8, axis: &LocalAxis, axes: &[LocalAxis]) -> bool {
    let address = with_sub_axis(axis.number(), number);
    axes.iter()
        .any(|other| other.number() == address && other.connection().is_same(axis.connection()))
}

/// Returns whether the drive reports that it has no such motor.
fn is_no_such_motor(error: &Error) -> bool {
    let Error::Failed { outcome, .. } = error else { return false };
    matches!(outcome, Outcome::NotDone(Failure::Refused { .. }))
}

impl LinkStopReport {
    /// Sends a first stop to all of these axes.
    fn send_first_stops(&mut self, axes: &[LocalAxis], how: StopOptions) {
        // All are sent before the first reply is awaited: the last of ten axes must not turn ten times as
        // long.
        let stops: Vec<_> = axes.iter().map(|axis| begin_stop(axis, how)).collect();
        let end = clock::now() + clock::scale_timeout(STOP_WAIT_MAX);
        for (axis, mut stop) in axes.iter().zip(stops) {
            self.wait_first_stop(axis, &mut stop, end.since(clock::now()));
        }
    }

    /// Waits for the first stop of an axis, and records its findings.
    fn wait_first_stop(&mut self, axis: &LocalAxis, stop: &mut StopSupervisor, at_most: Duration) {
        let end = axis.connection().now() + at_most;
        let mut airtime = WireAirtime::default();
        while stop.wait(&mut airtime, end.since(axis.connection().now())).is_some() {}
        self.note_program(axis);
        if stop.sent_quick_stop() {
            self.note_quick_stop(axis.label());
        }
    }

    fn note_quick_stop(&mut self, label: String) {
        if !self.quick_stops.contains(&label) {
            self.quick_stops.push(label);
        }
    }

    /// Stops the further motors of these axes and then the axes, waits until all of them are at rest, and notes how.
    /// The stop of a further motor replaces that of its axis, which goes last for that reason.
    fn add_axes(&mut self, axes: &[LocalAxis], how: StopOptions, on_event: StopObserver<'_>) {
        // Before standstill is awaited, which takes seconds.
        self.motors.extend(stop_more_motors(axes));
        let stops = axes.iter().map(|axis| begin_stop(axis, how)).collect();
        let ended = await_stops(stops, |axis, notice| match notice {
            StopNotice::Waiting => on_event(StopEvent::Waiting).is_continue(),
            StopNotice::QuickStop => {
                self.note_quick_stop(axis.label());
                true
            }
            StopNotice::Unconfirmed(_) => true,
        });
        // All of them were stopped before, and that may have been executed.
        let ended =
            ended.into_iter().map(|stop| stop.standstill.map_err(Error::after_earlier_attempt));
        self.axes.extend(axes.iter().map(LocalAxis::label).zip(ended));
        axes.iter().for_each(|axis| self.note_program(axis));
    }

    /// Notes what the last stop of an axis found of its drive's program.
    fn note_program(&mut self, axis: &LocalAxis) {
        let (state, label) = (axis.state(), axis.label());
        // A stop that had to end a download leaves half a program in the module: worth a line of its own.
        if state.store_ended
            && !self
                .programs
                .iter()
                .any(|(name, found)| *name == label && *found == DrivePrograms::Incomplete)
        {
            self.programs.push((label.clone(), DrivePrograms::Incomplete));
        }
        let Some(found) = state.program_end else { return };
        let mut noted = self.programs.iter_mut();
        let known =
            noted.find(|(name, found)| *name == label && *found != DrivePrograms::Incomplete);
        let before = known.as_ref().map(|(_, before)| *before);
        match (known, DrivePrograms::after(before, found)) {
            (Some((_, known)), Some(found)) => *known = found,
            (None, Some(found)) => self.programs.push((label, found)),
            (_, None) => {}
        }
    }
}
