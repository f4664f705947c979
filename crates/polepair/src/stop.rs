//! Stops all drives of a link without knowing them.
//!
//! Several passes, so that no drive waits for the search of others: a broadcast stop, if the protocol has one;
//! then each address is tried briefly, and a drive that replies is stopped at once; then the further motors of
//! modules; then all are awaited together.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use polepair::stop::StopOptions;
//! let connector = polepair::Connector::default();
//! let stopped =
//!     polepair::stop::stop(&connector, "sim:tmcl?axes=2&time=virtual", StopOptions::default(), &mut |_| {})?;
//! assert!(stopped.axes.len() == 2 && stopped.axes.iter().all(|(_, ended)| ended.is_ok()));
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod unidentified;

use crate::axis::{LocalAxis, RunningRequest, Standstill, stop_until_standstill};
use crate::connect::{Connector, ProtocolLine};
use crate::error::{Error, Exit};
use crate::identify::{IDENTIFY_RETRY_MAX, ProbeResult, Prober};
use crate::listen::RawWires;
use crate::no_reply::NoReplyDetails;
use crate::scan::{self, DetectedDrive, ScanProgress};
use crate::url::{AxisNumber, LinkTarget, Url};
use crate::wire::{CountedLink, SharedLink};
use polepair_core::axis::{Command, ProgramEnd, RehearsalAction, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::medium::{Can, Frame, Medium, Stream};
use polepair_core::proto::{sub_axis, with_sub_axis};
use polepair_core::station::AxisIndex;
use polepair_link::{LinkIo as _, Received, clock};
use std::time::Duration;

/// How long an address is given to answer where the string names none, besides the time that the
/// bytes take.
const QUERY_TIMEOUT: Duration = Duration::from_millis(30);
/// Bits of the longest question and answer that tell who is there, on a serial line.
const QUERY_BITS: u64 = 400;
/// Time limit for trying addresses; the rest is reported as not tried.
const SEARCH_MAX: Duration = Duration::from_secs(6);
/// Time limit for identifying a named drive before the protocol's common stop is sent.
const NAMED_QUERY_MAX: Duration = Duration::from_millis(250);
/// How long a drive that was found may keep the others waiting.
const STOP_WAIT_MAX: Duration = Duration::from_millis(150);
/// Time that a named silent drive may delay the others, after all stops were sent.
const SILENT_STOP_WAIT_MAX: Duration = Duration::from_secs(1);
/// How long motors may take to come to rest.
const STANDSTILL_WAIT_MAX: Duration = Duration::from_secs(5);
/// Silence after each frame to everybody: more than drives that end frames by silence need.
const BROADCAST_PAUSE_MS: u32 = 30;
/// Motors behind one address at most: a TMCL parameter number shares its byte with four bits of them.
const MOTORS_MAX: u8 = 16;
/// After so many in a row that are not answered the drive is gone.
const SILENT_MOTORS_MAX: u8 = 4;
/// Maximum number of units received in such a silence.
const UNITS_MAX: usize = 1_000;

/// The result of a stop.
#[derive(Debug, Default)]
pub struct LinkStopReport {
    /// A broadcast stop was sent first. It has no confirmation.
    pub broadcast: bool,
    /// Each axis that was named or found, in the order of the addresses, and how its stop ended.
    pub axes: Vec<(String, Result<Standstill, Error>)>,
    /// What the stops found of the drives' own programs, where the drive runs any.
    pub programs: Vec<(String, DrivePrograms)>,
    /// Drives with more motors than the one that their axis is, in the same order.
    pub motors: Vec<DriveMotors>,
    /// Addresses that were asked.
    pub queried: usize,
    /// How long each had to answer; `None` where the host's own patience was the measure.
    pub reply_timeout: Option<Duration>,
    /// Frames received from silent addresses that were not named.
    pub received: NoReplyDetails,
    /// Addresses that there was no time left for: first, last.
    pub not_queried: Option<(u32, u32)>,
}

/// What two stops, one after the other, found of a drive's own program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DrivePrograms {
    /// One ran, and was ended.
    Ended,
    /// The drive acknowledged the end of its program, and reports it as running all the same.
    StillReported,
    /// One that may have run was ended: the drive does not report whether one runs.
    MayHaveRun,
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
    /// Its address.
    pub number: u32,
    /// Those that confirmed their stop, the first (0) not counted.
    pub confirmed: Vec<u8>,
    /// Those that did not, and may be there.
    pub unconfirmed: Vec<u8>,
    /// Why the first of those did not.
    pub result: Result<(), Error>,
}

/// What happens meanwhile.
#[derive(Debug)]
pub enum StopEvent<'a> {
    /// An address is asked.
    Querying(ScanProgress),
    /// A stop was sent to a drive that replied, or was named.
    StopSent(&'a LocalAxis),
}

/// How to stop.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StopOptions {
    /// As fast as the drive can.
    pub quick: bool,
    /// Leave the drive's own program running, which may move the motor again.
    pub keep_program: bool,
}

impl StopOptions {
    /// What carries it out.
    #[must_use]
    pub const fn command(self) -> Command {
        let verb = if self.quick { Verb::QuickStop } else { Verb::Stop };
        Command { keep_program: self.keep_program, ..Command::new(verb) }
    }
}

/// Stops every axis that the string names, or everybody on its link.
///
/// # Errors
/// [`Error::Usage`], and [`Error::Link`] when the link cannot be opened or goes away. What a drive
/// makes of it is in [`LinkStopReport`].
pub fn stop(
    connector: &Connector,
    url: &str,
    how: StopOptions,
    on_event: &mut dyn FnMut(StopEvent<'_>),
) -> Result<LinkStopReport, Error> {
    let parsed = connector.url(url)?;
    let mut stopped = LinkStopReport::default();
    let group = parsed.axes.iter().any(|axis| AxisNumber(*axis).is_group());
    let rack = matches!(parsed.target, LinkTarget::Rack { .. });
    if group || rack || matches!(parsed.target, LinkTarget::Sim { .. }) {
        // Who is there is known, or cannot be asked. A rack says what each is: nobody waits for one
        // that is silent.
        let link = connector.connect_with(url, !rack)?;
        // What is told now is on its way; who stops another motor of the drive ends waiting for it.
        drop(start_stops(link.axes(), how.command()));
        stopped.motors = stop_more_motors(link.axes());
        stopped.add_axes(link.axes(), how);
        return Ok(stopped);
    }
    let (lines, _) = connector.open_lines(&parsed)?;
    stop_on_lines(connector, &parsed, &lines, how, &mut stopped, on_event)?;
    Ok(stopped)
}

/// The same on a wire that is open already, for those who set its axes in motion in ways of their
/// own: those of these numbers, or everybody where there is none.
///
/// # Errors
/// As [`stop`].
pub fn stop_on(
    connector: &Connector,
    opened: &RawWires,
    wire: usize,
    axes: &[u32],
    on_event: &mut dyn FnMut(StopEvent<'_>),
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
    on_event: &mut dyn FnMut(StopEvent<'_>),
) -> Result<(), Error> {
    for line in lines {
        if url.axes.is_empty() {
            stopped.broadcast |= broadcast_stop(connector, url, line, how.command())?;
        }
        let found = find_and_stop(connector, url, line, how.command(), (stopped, &mut *on_event))?;
        let axes = line.axes_of_found(&found)?;
        stopped.motors.extend(stop_more_motors(&axes));
        stopped.add_axes(&axes, how);
    }
    Ok(())
}

/// Sends the requests of the stop that need no reply as broadcast. `false` if the protocol has no
/// broadcast, or the stop of these drives is unknown.
fn broadcast_stop(
    connector: &Connector,
    url: &Url,
    line: &ProtocolLine,
    command: Command,
) -> Result<bool, Error> {
    let Some(address) = line.protocol.broadcast else { return Ok(false) };
    let profile = connector.chosen_profile(url, &line.protocol)?.unwrap_or(line.protocol.generic);
    let connection = line.open_connection(&[(profile, address)])?;
    let (mut runs, mut frames, mut open) = (Vec::new(), Vec::new(), true);
    connection.with_axes(|axes, _| {
        // It ends at the first step that asks, which an address of everybody's cannot.
        let _ = axes.rehearse(AxisIndex(0), command, &mut |step| {
            open &= matches!(
                step.action,
                RehearsalAction::Write(..) | RehearsalAction::Send | RehearsalAction::EndProgram
            );
            match (open, step.frame) {
                (true, Some(frame)) => frames.push(*frame),
                (true, None) => runs.push(step.bytes.to_vec()),
                (false, _) => {}
            }
        });
    });
    match &line.link {
        SharedLink::Serial(link) => {
            for run in &runs {
                link.send(run)?;
                wait_silence::<Stream>(link, &mut [0; 64])?;
            }
        }
        SharedLink::Can(link) => {
            for frame in &frames {
                link.send(frame)?;
            }
            wait_silence::<Can>(link, &mut Frame::default())?;
        }
    }
    Ok(!runs.is_empty() || !frames.is_empty())
}

/// Lets the line be silent, whatever comes back.
fn wait_silence<M: Medium>(link: &CountedLink<M>, buffer: &mut M::Out) -> Result<(), Error> {
    let until = link.now().plus_ms(BROADCAST_PAUSE_MS);
    for _ in 0..UNITS_MAX {
        if matches!(link.receive(buffer, until)?, Received::TimedOut) {
            break;
        }
    }
    Ok(())
}

/// Tries each address, and stops each drive that replies.
fn find_and_stop(
    connector: &Connector,
    url: &Url,
    line: &ProtocolLine,
    command: Command,
    (stopped, on_event): (&mut LinkStopReport, &mut dyn FnMut(StopEvent<'_>)),
) -> Result<Vec<DetectedDrive>, Error> {
    let named = !url.axes.is_empty();
    let wanted = if named { url.axes.clone() } else { scan::default_addresses(line)? };
    stopped.reply_timeout = if named { None } else { Some(query_timeout(url, line)?) };
    let chosen = connector.chosen_profile(url, &line.protocol)?;
    let generic = line.protocol.generic;
    // Where the protocol has a word for it, whoever is named is told soon, whatever it is.
    let soon = NAMED_QUERY_MAX.max(2 * query_timeout(url, line)?);
    let patience = stopped.reply_timeout.or(generic.plan(command.verb).map(|_| soon));
    let prober = Prober::new(line, &connector.config).with_timeout(patience);
    let end = clock::now() + SEARCH_MAX * clock::timeout_scale();
    let (mut found, mut deaf, mut unknown) = (Vec::new(), Vec::new(), Vec::new());
    for (done, &number) in wanted.iter().enumerate() {
        if !named && clock::now() > end {
            stopped.not_queried = wanted.last().map(|last| (number, *last));
            break;
        }
        on_event(StopEvent::Querying(ScanProgress { number, done, of: wanted.len() }));
        stopped.queried += 1;
        let probe = prober.probe(number)?;
        let missing = match probe {
            ProbeResult::Found { doubtful: false, .. } => None,
            ProbeResult::Found { .. } => Some(prober.confused_error(number)),
            ProbeResult::AnsweredTwice => Some(prober.answered_twice_error(number)),
            ProbeResult::Silent(details) | ProbeResult::Damaged(details) if !named => {
                stopped.received = stopped.received.plus(details.only_foreign());
                continue;
            }
            ProbeResult::Forbidden(_) if !named => continue,
            ProbeResult::Forbidden(hint) => Some(prober.forbidden_error(number, hint)),
            ProbeResult::Silent(details) | ProbeResult::Damaged(details) => {
                Some(prober.silent_error(number, details))
            }
        };
        let (one, command) = match (chosen, probe) {
            (Some(profile), _) => {
                (DetectedDrive::with_known_profile(line, number, profile), command)
            }
            (None, ProbeResult::Found { profile, identified, doubtful: false, .. }) => (
                DetectedDrive {
                    identified,
                    ..DetectedDrive::with_known_profile(line, number, profile)
                },
                command,
            ),
            (None, _) if generic.plan(command.verb).is_some() => {
                (DetectedDrive::with_known_profile(line, number, generic), command)
            }
            (None, ProbeResult::Forbidden(_)) => {
                let error = missing.map(|error| (format!("axis {number}"), Err(error)));
                stopped.axes.extend(error);
                continue;
            }
            (None, _) => {
                let shared = unidentified::shared_stop(prober.profiles(), command.verb);
                let report = shared.map(|(profile, verb)| {
                    let command = Command { verb, ..command };
                    (DetectedDrive::with_known_profile(line, number, profile), command)
                });
                unknown.extend(missing.map(|error| (number, report.clone(), error)));
                let Some(report) = report else { continue };
                stop_found(line, &report, (stopped, on_event))?;
                continue;
            }
        };
        stop_found(line, &(one.clone(), command), (&mut *stopped, &mut *on_event))?;
        match missing {
            None => {
                let further = line.further_axes(&one)?;
                found.push(one);
                for axis in further {
                    stop_found(line, &(axis.clone(), command), (&mut *stopped, &mut *on_event))?;
                    found.push(axis);
                }
            }
            Some(error) => deaf.push((one, error)),
        }
    }
    for (one, error) in deaf {
        // It may have lost count of bytes, which a stop that is said several times does not mind.
        match stop_unanswered(line, &(one.clone(), command))? {
            Err(ref reported) if reported.exit() == Exit::NoReply => {
                stopped.axes.push((format!("axis {}", one.number), Err(error)));
            }
            _ => found.push(one),
        }
    }
    let end = line.link.deadline(IDENTIFY_RETRY_MAX);
    for (number, report, error) in unknown {
        let one = loop {
            let one = unidentified::reidentify(&prober, line, number)?;
            if one.is_some() || line.link.now() > end {
                break one;
            }
        };
        if let Some(one) = one {
            stop_found(line, &(one.clone(), command), (stopped, on_event))?;
            found.push(one);
            continue;
        }
        let ended = report.map(|report| stop_unanswered(line, &report)).transpose()?;
        let error = unidentified::unidentified_error(&prober, error, ended);
        stopped.axes.push((format!("axis {number}"), Err(error)));
    }
    Ok(found)
}

/// Stops a drive, and waits no longer than the others allow.
fn stop_found(
    line: &ProtocolLine,
    (one, command): &(DetectedDrive, Command),
    (stopped, on_event): (&mut LinkStopReport, &mut dyn FnMut(StopEvent<'_>)),
) -> Result<(), Error> {
    for axis in line.axes_of_found(std::slice::from_ref(one))? {
        // One that only listens may obey. What it says is heard when all are waited for.
        if let Ok(mut running) = axis.start(*command) {
            let _ = running.wait(clock::scale_timeout(STOP_WAIT_MAX));
            stopped.note_program(&axis);
            on_event(StopEvent::StopSent(&axis));
        }
    }
    Ok(())
}

/// Stops a silent drive, and reports the result.
fn stop_unanswered(
    line: &ProtocolLine,
    (one, command): &(DetectedDrive, Command),
) -> Result<Result<(), Error>, Error> {
    let axes = line.axes_of_found(std::slice::from_ref(one))?;
    let reported = |axis: &LocalAxis| {
        axis.start(*command)
            .and_then(|mut running| running.wait(clock::scale_timeout(SILENT_STOP_WAIT_MAX)))
    };
    Ok(axes.iter().try_for_each(|axis| reported(axis).map(drop)))
}

/// How long an address has: the string's word, else what a drive needs.
fn query_timeout(url: &Url, line: &ProtocolLine) -> Result<Duration, Error> {
    if let Some(ms) = url.milliseconds("timeout")? {
        return Ok(Duration::from_secs_f64(ms / 1000.0));
    }
    let bits = Duration::from_secs(QUERY_BITS).checked_div(line.options.baud);
    Ok(QUERY_TIMEOUT + bits.unwrap_or_default())
}

fn start_stops(axes: &[LocalAxis], command: Command) -> Vec<Result<RunningRequest, Error>> {
    axes.iter().map(|axis| axis.start(command)).collect()
}

/// Stops every motor of the drives besides the axes, whose stop was already sent, up to the first missing
/// number. A missing reply does not prevent the stops of further motors, and is repeated once at the end.
fn stop_more_motors(axes: &[LocalAxis]) -> Vec<DriveMotors> {
    let of = |axis: &LocalAxis| {
        let mut received = Vec::new();
        let mut silent: Vec<(u8, Error)> = Vec::new();
        let mut in_a_row = 0;
        let is_axis = |number: u8| {
            let address = with_sub_axis(axis.number(), number);
            let is_it = |other: &LocalAxis| {
                other.number() == address && other.connection().is_same(axis.connection())
            };
            axes.iter().any(is_it)
        };
        for number in (1..MOTORS_MAX).filter(|number| !is_axis(*number)) {
            let sent =
                |axis: &LocalAxis| axis.connection().with_axes(|axes, _| axes.counters().sent);
            let before = sent(axis);
            match axis.stop_motor(number) {
                Ok(()) => received.push(number),
                Err(Error::Unsupported { .. }) => break,
                Err(error) if is_no_such_motor(&error) => break,
                // The axis' own stop tells of a link that is gone.
                Err(_) if sent(axis) == before => break,
                Err(error) => silent.push((number, error)),
            }
            in_a_row = if received.last() == Some(&number) { 0 } else { in_a_row + 1 };
            if in_a_row == SILENT_MOTORS_MAX {
                break;
            }
        }
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

/// Whether the drive reports that it has no such motor.
fn is_no_such_motor(error: &Error) -> bool {
    let Error::Failed { outcome, .. } = error else { return false };
    matches!(outcome, Outcome::NotDone(Failure::Refused { .. }))
}

impl LinkStopReport {
    /// Waits until all of these axes are at rest, and notes how.
    fn add_axes(&mut self, axes: &[LocalAxis], how: StopOptions) {
        axes.iter().for_each(|axis| self.note_program(axis));
        let ended = match how.quick {
            false => {
                let axes: Vec<&LocalAxis> = axes.iter().collect();
                stop_until_standstill(&axes, how.keep_program, Duration::ZERO, |_, _| false)
            }
            true => run_to_standstill(axes, how.command()),
        };
        // All of them were told before, and that may have been executed.
        let ended = ended.into_iter().map(|ended| ended.map_err(Error::after_earlier_attempt));
        self.axes.extend(axes.iter().map(LocalAxis::label).zip(ended));
        axes.iter().for_each(|axis| self.note_program(axis));
    }

    /// Notes what the last stop of an axis found of its drive's program.
    fn note_program(&mut self, axis: &LocalAxis) {
        let Some(found) = axis.state().program_end else { return };
        let label = axis.label();
        let known = self.programs.iter_mut().find(|(name, _)| *name == label);
        let before = known.as_ref().map(|(_, before)| *before);
        match (known, DrivePrograms::after(before, found)) {
            (Some((_, known)), Some(found)) => *known = found,
            (None, Some(found)) => self.programs.push((label, found)),
            (_, None) => {}
        }
    }
}

/// The same by any other verb.
fn run_to_standstill(axes: &[LocalAxis], command: Command) -> Vec<Result<Standstill, Error>> {
    let running = start_stops(axes, command);
    let wait_max = clock::scale_timeout(STANDSTILL_WAIT_MAX);
    let end = clock::now() + wait_max;
    let ended = axes.iter().zip(running).map(|(axis, running)| {
        let mut running = running?;
        let left = end.since(clock::now());
        running.wait(left)?.map(drop).ok_or_else(|| axis.not_at_rest_error(wait_max))
    });
    // All brake meanwhile.
    let ended: Vec<Result<(), Error>> = ended.collect();
    axes.iter().zip(ended).map(|(axis, ended)| axis.wait_standstill(ended)).collect()
}
