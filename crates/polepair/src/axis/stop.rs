//! The stop of an axis: the one place that decides its requests, how often they are sent, and when it is over.
//!
//! Every stop of a motor uses a [`StopSupervisor`]: the command line, the gateway, the bindings, and the end of an
//! armed motion. It is polled, has neither a thread nor a clock, and follows six rules:
//!
//! 1. **A stop goes first.** It overtakes what waits for the wire, and it is sent before anything is asked.
//! 2. **The order** is: stop the motor, end the drive's own program, stop the motor again. If the motor does not
//!    become slower within 300 ms, a quick stop follows, where the drive has one. Power is taken off last, and
//!    only if the caller asked for it.
//! 3. **Standstill is measured** after the drive replied to the stop. A signal that a drive lacks cannot confirm it;
//!    one that it refuses for the moment is read again.
//! 4. **A stop is repeated** while the motor turns, and while no reply came: by a gateway until standstill, by others
//!    for their own time limit.
//! 5. **Until then it is pending.** An error states that the motor may still turn.
//! 6. **The program that started the motion must stop it.** The end of a verb, of an armed axis and of a process sends
//!    the stop.
//!
//! docs/concepts/safety.md states them for users. Why: STOP-4, STOP-7, STOP-9, STOP-20, STOP-21.

mod airtime;
mod attempt;
mod failures;
mod requests;
mod standstill;

use std::time::Duration;

use airtime::SILENCE_MIN;
pub use airtime::WireAirtime;

use super::{LocalAxis, RunningRequest};
use crate::error::Error;
use crate::url::AxisNumber;
use attempt::StopAttempt;
pub use attempt::StopProgress;
use failures::{failure_of, is_impossible, is_superseded, may_be_lost};
use polepair_core::axis::{Command, Refusal, Verb};
use polepair_core::error::{Failure, Unsupported};
use polepair_core::plan::{Plan, Step};
use polepair_core::time::Instant;
use standstill::STANDSTILL_WAIT_MAX;

/// Time for which an unconfirmed stop is repeated by callers that end a motion.
pub const STOP_RETRY_MAX: Duration = Duration::from_secs(10);
/// A motor that is not slower after this time gets a quick stop.
const SLOWING_MAX: Duration = Duration::from_millis(300);
/// Speed after some braking, as a share of the speed before.
// More than the noise of a speed reading, less than any ramp takes off within 300 ms (STOP-20).
const SLOWER_SHARE: f64 = 0.998;
/// Pause before a stop is repeated to a motor that turns on: the first, and the others.
// A braking motor has time to become slower, and one that was not reached gets another stop soon.
const TURNING_PAUSE: Duration = Duration::from_secs(1);
const TURNING_PAUSE_MAX: Duration = Duration::from_secs(2);
/// Pause between a stop without a reply and the next.
const SILENT_PAUSE: Duration = Duration::from_millis(100);
/// The longest such pause: on a wire without other users, and on a shared one.
// Two seconds on a shared wire keep a silent drive at 5 % of its time (STOP-9).
const OWN_PAUSE_MAX: Duration = Duration::from_millis(250);
const SHARED_PAUSE_MAX: Duration = Duration::from_secs(2);
/// Interval at which the other axes are looked at while one is waited for.
const POLL_SLICE: Duration = Duration::from_millis(20);

/// Options of a stop.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StopOptions {
    /// True for a stop as fast as the drive can.
    pub quick: bool,
    /// Leave the drive's own program running, which may move the motor again.
    pub keep_program: bool,
    /// Take the motor's power off at the end, also after a stop that failed.
    pub power_off: bool,
}

impl StopOptions {
    /// The command that carries it out.
    #[must_use]
    pub const fn command(self) -> Command {
        let verb = if self.quick { Verb::QuickStop } else { Verb::Stop };
        Command { keep_program: self.keep_program, ..Command::new(verb) }
    }
}

/// Time for which a stop is repeated after a missing reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StopPersistence {
    /// For this time after the first stop. A motor that keeps turning ends it after 5 s without becoming slower.
    Within(Duration),
    /// Until standstill is confirmed, or a client dismisses the stop. The wire is shared with other requests.
    UntilStandstill,
}

/// Evidence on a motor whose stop was executed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Standstill {
    /// Standstill by measured speed, or by two positions.
    Observed,
    /// The drive reports neither.
    Unobservable,
    /// The stop was sent to a group, and no drive confirms it on this wire.
    Unconfirmed,
}

/// Result of a stop.
#[derive(Clone, PartialEq, Debug)]
pub struct StopResult {
    /// Evidence on the motor.
    pub standstill: Result<Standstill, Error>,
    /// True if its power was taken off. `None` if that was not requested, or the drive has no power switch.
    pub power_off: Option<Result<(), Error>>,
}

impl StopResult {
    /// The result for callers that end a motion. An axis without a stop has no verb that starts one, so there is
    /// nothing to end.
    ///
    /// # Errors
    /// The error of the stop.
    pub fn to_motion_end(&self) -> Result<(), Error> {
        match &self.standstill {
            Err(Error::Unsupported { why: Unsupported::NoPlan, .. }) | Ok(_) => Ok(()),
            Err(error) => Err(error.clone()),
        }
    }

    /// The first error, for callers that end a motion.
    ///
    /// # Errors
    /// The error of the stop, otherwise that of the power.
    pub fn into_result(self) -> Result<(), Error> {
        self.to_motion_end().and(self.power_off.unwrap_or(Ok(())))
    }
}

/// News of a stop.
#[derive(Clone, PartialEq, Debug)]
pub enum StopNotice {
    /// Standstill was not confirmed, for this reason, and the stop will be repeated unless [`StopSupervisor::give_up`]
    /// is called.
    Unconfirmed(Error),
    /// The stop had no effect, and a quick stop was sent.
    QuickStop,
    /// Standstill is still awaited. Only [`await_stops`] reports this, some 50 times a second.
    Waiting,
}

/// The stop of one axis, from its first frame until the motor is known to be at standstill.
///
/// ```
/// use polepair::axis::{StopNotice, StopOptions, StopPersistence, StopSupervisor, WireAirtime};
/// let link = polepair::connect_local("sim:tmcl?time=virtual")?;
/// let axis = &link.axes()[0];
/// let mut stop = StopSupervisor::begin(axis, StopOptions::default(), StopPersistence::UntilStandstill);
/// let mut airtime = WireAirtime::default();
/// while stop.result().is_none() {
///     airtime.update(axis);
///     if let Some(StopNotice::Unconfirmed(error)) = stop.poll(&mut airtime) {
///         eprintln!("{error}");
///     }
///     link.sleep(std::time::Duration::from_millis(10));
/// }
/// # Ok::<(), polepair::Error>(())
/// ```
#[derive(Debug)]
pub struct StopSupervisor {
    axis: LocalAxis,
    options: StopOptions,
    persistence: StopPersistence,
    /// A quick stop was sent because the stop did not slow the motor.
    escalated: bool,
    /// The last one that was sent; `None` before the first.
    attempt: Option<StopAttempt>,
    attempts: u32,
    sent_at: Instant,
    /// Time at which the last attempt ended without confirmation.
    ended_at: Option<Instant>,
    /// Reason why an attempt was not confirmed; `None` once another was.
    failure: Option<Error>,
    silent_pause: Duration,
    turning_pause: Duration,
    /// End of the repetitions after a missing reply.
    retry_until: Instant,
    /// Time of the newest reading of the axis at the last poll.
    last_reading: Option<Instant>,
    /// When the motor was to stop, and the slowest that it was seen to turn since then.
    brakes_since: Instant,
    slowest: (f64, Instant),
    /// An earlier attempt may have been executed.
    may_be_executed: bool,
    standstill: Option<Result<Standstill, Error>>,
    switching_off: Option<RunningRequest>,
    result: Option<StopResult>,
}

impl StopSupervisor {
    /// Sends the stop.
    #[must_use]
    pub fn begin(axis: &LocalAxis, options: StopOptions, persistence: StopPersistence) -> Self {
        let mut stop = Self::pending(axis, options, persistence);
        stop.begin_attempt(false);
        stop
    }

    /// A stop of which nothing was sent yet: the first poll sends it if the link is open.
    #[must_use]
    pub fn pending(axis: &LocalAxis, options: StopOptions, persistence: StopPersistence) -> Self {
        let now = axis.connection.now();
        let retry_until = match persistence {
            StopPersistence::Within(within) => now + within,
            StopPersistence::UntilStandstill => Instant::FAR_FUTURE,
        };
        Self {
            axis: axis.clone(),
            options,
            persistence,
            escalated: false,
            attempt: None,
            attempts: 0,
            sent_at: now,
            ended_at: None,
            failure: None,
            silent_pause: SILENT_PAUSE,
            turning_pause: TURNING_PAUSE,
            retry_until,
            last_reading: None,
            brakes_since: now,
            slowest: (f64::MAX, now),
            may_be_executed: false,
            standstill: None,
            switching_off: None,
            result: None,
        }
    }

    /// Sends the stop again now, because it was requested again, or the link is open again. `is_new` for a request:
    /// nothing is read before. After a lost link the drive may have restarted, and would write permanent memory; it is
    /// read first.
    pub fn send_again(&mut self, is_new: bool) {
        let now = self.axis.connection.now();
        // A person asked for it, so all pauses begin anew.
        (self.silent_pause, self.turning_pause) = (SILENT_PAUSE, TURNING_PAUSE);
        (self.brakes_since, self.slowest) = (now, (f64::MAX, now));
        self.begin_attempt(!is_new);
    }

    /// Ends the repetitions after a missing reply.
    pub fn give_up(&mut self) {
        self.retry_until = Instant::ZERO;
    }

    /// Ends the wait for standstill, which stays unconfirmed.
    pub fn abandon(&mut self) {
        let interrupted =
            |what: &str| Error::Interrupted { what: format!("{}: {what}", self.axis.label()) };
        let error = match self.progress() {
            // The result shows whether anything was sent.
            StopProgress::Failed(error) if self.may_be_executed => {
                error.clone().after_earlier_attempt()
            }
            StopProgress::Failed(error) => error.clone(),
            StopProgress::Sent => interrupted("the stop is not confirmed"),
            _ => {
                interrupted("the drive acknowledged the stop, and its standstill is not confirmed")
            }
        };
        let standstill = self.standstill.take().unwrap_or(Err(error));
        self.result.get_or_insert(StopResult { standstill, power_off: None });
    }

    fn begin_attempt(&mut self, is_repetition: bool) {
        let now = self.axis.connection.now();
        let command = self.command();
        let attempt = if is_repetition {
            StopAttempt::resend(&self.axis, command)
        } else {
            StopAttempt::begin(&self.axis, command)
        };
        self.attempt = Some(match self.persistence {
            // No other request waits for the wire: a query without a reply is repeated.
            StopPersistence::Within(_) => attempt.with_retries(),
            StopPersistence::UntilStandstill => attempt,
        });
        debug_assert!(self.result.is_none(), "a stop that has ended is not sent again");
        self.attempts += 1;
        (self.sent_at, self.ended_at) = (now, None);
    }

    fn command(&self) -> Command {
        let quick = self.options.quick || self.escalated;
        // A drive without a quick stop gets its stop: a refusal would leave the motor turning.
        let quick = quick && self.axis.profile.plan(Verb::QuickStop).is_some();
        StopOptions { quick, ..self.options }.command()
    }

    /// Progress of the last attempt.
    #[must_use]
    pub fn progress(&self) -> &StopProgress {
        self.attempt.as_ref().map_or(&StopProgress::Sent, StopAttempt::progress)
    }

    /// Reason why it does not proceed: the drive became silent after its reply, does not report its speed now, or
    /// reports standstill while its position changes.
    #[must_use]
    pub fn trouble(&self) -> Option<&Error> {
        self.attempt.as_ref()?.trouble()
    }

    /// Reason why the attempt before was not confirmed, until one is.
    #[must_use]
    pub fn failure(&self) -> Option<&Error> {
        match self.progress() {
            StopProgress::Sent | StopProgress::Failed(_) => self.failure.as_ref(),
            _ => None,
        }
    }

    /// The time from the last attempt to its last progress.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.attempt.as_ref().map_or(Duration::ZERO, StopAttempt::elapsed)
    }

    /// Returns whether it has ended well, and this was reported for the given time.
    #[must_use]
    pub fn is_expired(&self, reported_for: Duration) -> bool {
        let age = self.axis.connection.now().since(self.sent_at);
        matches!(&self.result, Some(StopResult { standstill: Ok(_), .. }))
            && age > self.elapsed() + reported_for
    }

    /// Returns whether a request of it is unanswered: nothing that moves may be sent meanwhile.
    #[must_use]
    pub fn is_under_way(&self) -> bool {
        self.attempt.as_ref().is_some_and(StopAttempt::is_under_way)
    }

    /// Returns whether nothing of the last attempt is on the wire.
    #[must_use]
    pub fn is_unsent(&self) -> bool {
        self.attempt.as_ref().is_none_or(StopAttempt::is_held_back)
    }

    /// Returns whether the last attempt has ended without confirmation, or there was none.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.result.is_none() && self.attempt.as_ref().is_none_or(StopAttempt::has_ended)
    }

    /// Returns whether the drive replied to all of it, and the motor turned at the last reading, as far as is known.
    #[must_use]
    pub fn may_be_turning(&self) -> bool {
        self.attempt.as_ref().is_some_and(StopAttempt::may_be_turning)
    }

    /// Returns whether the motor did not become slower, so that a quick stop was sent.
    #[must_use]
    pub fn sent_quick_stop(&self) -> bool {
        self.escalated
    }

    /// Number of times the stop was sent.
    #[must_use]
    pub fn attempts(&self) -> u32 {
        self.attempts
    }

    /// Result of the stop; `None` while it is pending.
    #[must_use]
    pub fn result(&self) -> Option<&StopResult> {
        self.result.as_ref()
    }

    /// Checks its progress, and sends the requests that are due. Waits for nothing.
    pub fn poll(&mut self, airtime: &mut WireAirtime) -> Option<StopNotice> {
        if self.result.is_some() {
            return None;
        }
        if self.standstill.is_some() {
            self.poll_power();
            return None;
        }
        let now = self.axis.connection.now();
        // Looked at in every poll, so that the first reply after a silence is noticed whatever state the stop
        // is in.
        let replied = self.replied_after_silence();
        let is_identified = self.is_identified();
        let error = match &mut self.attempt {
            None => None,
            Some(attempt) => {
                attempt.poll(&self.axis, now);
                match attempt.progress() {
                    StopProgress::Standstill => {
                        self.end(Ok(Standstill::Observed));
                        return None;
                    }
                    // The stop of an unidentified drive may have another meaning to it.
                    StopProgress::Unobservable if !is_identified => {
                        return self.supervise_unidentified(now);
                    }
                    StopProgress::Unobservable => {
                        self.end(Ok(self.axis.unobserved()));
                        return None;
                    }
                    StopProgress::Failed(error) => Some(error.clone()),
                    _ if attempt.has_ended() => attempt.trouble().cloned(),
                    _ => return self.supervise_braking(now),
                }
            }
        };
        let is_open = self.axis.connection.link_error().is_none();
        match error {
            Some(error) => self.handle_failure(error, replied, is_open, now, airtime),
            None => {
                if is_open {
                    self.begin_attempt(true);
                }
                None
            }
        }
    }

    /// The last attempt failed: it is repeated, or the stop has failed.
    fn handle_failure(
        &mut self,
        error: Error,
        replied: bool,
        is_open: bool,
        now: Instant,
        airtime: &mut WireAirtime,
    ) -> Option<StopNotice> {
        let shares_wire = self.persistence == StopPersistence::UntilStandstill;
        // Once one of the attempts may have arrived, no later one can end as "not executed".
        self.may_be_executed |= error.executed() != Some(false);
        if matches!(failure_of(&error), Some(Failure::Refused { .. })) && self.escalate() {
            return Some(StopNotice::QuickStop);
        }
        // A drive in a state that forbids it may take it later.
        let is_refused = self.is_refused_for_now(&error);
        let retry_until = if is_refused {
            self.brakes_since + self.axis.connection.scale_timeout(STANDSTILL_WAIT_MAX)
        } else {
            self.retry_until
        };
        let may_arrive = may_be_lost(&error) || is_superseded(&error) || is_refused;
        // A device without the object of the stop is no drive.
        let is_no_drive = matches!(failure_of(&error), Some(Failure::Refused { .. }))
            && !is_refused
            && !self.is_identified();
        let is_impossible = is_impossible(&error) || is_no_drive;
        if is_impossible || !shares_wire && (!may_arrive || now >= retry_until) {
            let error = if is_superseded(&error) { error.with_unseen_motor() } else { error };
            let error = if self.may_be_executed { error.after_earlier_attempt() } else { error };
            self.end(Err(error));
            return None;
        }
        let Some(ended_at) = self.ended_at else {
            self.ended_at = Some(now);
            debug_assert!(self.ended_at.is_some(), "an attempt that failed has ended");
            airtime.reserve(now, now.since(self.sent_at));
            self.failure = Some(error.clone());
            return Some(StopNotice::Unconfirmed(error));
        };
        let pause_max = if shares_wire { SHARED_PAUSE_MAX } else { OWN_PAUSE_MAX };
        let woke = airtime.woke_since(ended_at);
        // The second is sent soon, also while others are not answered: a single reply may just have been lost.
        let is_free = !shares_wire || self.attempts == 1 || airtime.is_free(now);
        let is_due = replied || woke || is_free && now >= ended_at + self.silent_pause;
        // A local link opens a lost adapter again when something is sent.
        if is_due && (is_open || !shares_wire) {
            self.silent_pause = (self.silent_pause * 2).min(pause_max);
            if !is_refused {
                (self.brakes_since, self.slowest) = (now, (f64::MAX, now));
            }
            self.begin_attempt(true);
        }
        None
    }

    /// Returns whether the drive refused it for another reason than a missing object.
    fn is_refused_for_now(&self, error: &Error) -> bool {
        let Some(Failure::Refused { code }) = failure_of(error) else { return false };
        let index = self.axis.index;
        let refusal = self.axis.connection.with_axes(|axes, _| axes.refusal(index, code));
        refusal != Refusal::Missing
    }

    fn is_identified(&self) -> bool {
        !self.axis.identified.is_generic() || AxisNumber(self.axis.number).is_group()
    }

    /// A device that was not identified took the stop of its protocol: nothing confirms it.
    fn supervise_unidentified(&mut self, now: Instant) -> Option<StopNotice> {
        if self.persistence != StopPersistence::UntilStandstill {
            self.end(Err(self.axis.unidentified_error()));
        } else if now >= self.sent_at + self.axis.connection.scale_timeout(self.turning_pause) {
            (self.turning_pause, self.may_be_executed) = (TURNING_PAUSE_MAX, true);
            self.failure = Some(self.axis.unidentified_error());
            self.begin_attempt(true);
        }
        None
    }

    /// The drive replied to the stop: checks whether the motor brakes.
    fn supervise_braking(&mut self, now: Instant) -> Option<StopNotice> {
        let attempt = self.attempt.as_ref()?;
        if let Some((rate, at)) = attempt.rate()
            && rate < SLOWER_SHARE * self.slowest.0
        {
            self.slowest = (rate, at);
        }
        let connection = &self.axis.connection;
        // Since the motor was last seen to become slower: a long ramp is no failure as long as it works.
        let unslowed = now.since(self.slowest.1);
        let may_be_turning = attempt.may_be_turning();
        // Scaled as the time until the quick stop is, which would never come otherwise.
        let turning_pause = connection.scale_timeout(self.turning_pause);
        let is_braking = unslowed < connection.scale_timeout(STANDSTILL_WAIT_MAX)
            && now.since(self.brakes_since) < self.axis.standstill_timeout(self.command().verb);
        if !is_braking && self.persistence != StopPersistence::UntilStandstill {
            let is_group = AxisNumber(self.axis.number).is_group();
            let after = now.since(self.brakes_since);
            self.end(match attempt.trouble() {
                Some(error) => Err(error.clone()),
                // Drives of a group rarely report the same.
                None if is_group && !may_be_turning => Ok(self.axis.unobserved()),
                None => Err(self.axis.not_at_rest_error(after)),
            });
            return None;
        }
        if attempt.is_seen_turning()
            && attempt.observed_for(now) >= connection.scale_timeout(SLOWING_MAX)
            && unslowed >= connection.scale_timeout(SLOWING_MAX)
            && self.escalate()
        {
            return Some(StopNotice::QuickStop);
        }
        if may_be_turning && now >= self.sent_at + turning_pause {
            // The drive replied to the one before.
            (self.turning_pause, self.may_be_executed) = (TURNING_PAUSE_MAX, true);
            self.begin_attempt(true);
        }
        None
    }

    /// Sends a quick stop, if the drive has one that differs from its stop and it was not sent yet.
    fn escalate(&mut self) -> bool {
        let has_other = self
            .sending_plan(Verb::QuickStop)
            .is_some_and(|quick| Some(quick) != self.sending_plan(Verb::Stop));
        // Once: a drive that ignores its quick stop gets another one, and its operator is asked to cut the
        // power.
        if self.options.quick || self.escalated || !has_other {
            return false;
        }
        debug_assert!(self.axis.profile.plan(Verb::QuickStop).is_some());
        (self.escalated, self.may_be_executed) = (true, true);
        let now = self.axis.connection.now();
        self.slowest = (f64::MAX, now);
        self.begin_attempt(false);
        true
    }

    fn sending_plan(&self, verb: Verb) -> Option<&[Step]> {
        self.axis.profile.plan(verb).map(Plan::before_wait)
    }

    /// Returns whether the axis sent a value just now, after a silence.
    fn replied_after_silence(&mut self) -> bool {
        let state = self.axis.state();
        let signals = self.axis.profile.signals.iter();
        let newest = signals.filter_map(|source| state.reading(source.signal).at).max();
        match (std::mem::replace(&mut self.last_reading, newest), newest) {
            // A drive that answers again may just have got its supply back, with its motor still turning.
            (Some(before), Some(newest)) => newest.since(before) >= SILENCE_MIN,
            (before, newest) => before.is_none() && newest.is_some(),
        }
    }

    fn end(&mut self, standstill: Result<Standstill, Error>) {
        debug_assert!(self.standstill.is_none(), "standstill is decided once");
        self.standstill = Some(standstill);
        self.poll_power();
    }

    /// Takes the power off, where the caller asked for that.
    fn poll_power(&mut self) {
        let power_off = if let Some(running) = &mut self.switching_off {
            match running.poll() {
                Ok(None) => return,
                ended => Some(ended.map(drop)),
            }
        // Only after standstill: a motor without power coasts, and a load may fall.
        } else if self.options.power_off && self.axis.profile.plan(Verb::Disable).is_some() {
            match self.axis.start(Command::new(Verb::Disable)) {
                Ok(running) => {
                    self.switching_off = Some(running);
                    return;
                }
                // There is room when the requests before it have ended.
                Err(Error::Unsupported { why: Unsupported::Busy, .. }) => return,
                Err(error) => Some(Err(error)),
            }
        } else {
            None
        };
        self.switching_off = None;
        self.result = self.standstill.take().map(|standstill| StopResult { standstill, power_off });
    }

    /// Waits for its end, at most for this time. Returns early with news.
    pub fn wait(&mut self, airtime: &mut WireAirtime, at_most: Duration) -> Option<StopNotice> {
        let end = self.axis.connection.now() + at_most;
        loop {
            if let Some(notice) = self.poll(airtime) {
                return Some(notice);
            }
            let left = end.since(self.axis.connection.now());
            if self.result.is_some() || left.is_zero() {
                return None;
            }
            // The result is looked at by the next poll.
            match (&mut self.switching_off, &mut self.attempt) {
                (Some(running), _) => drop(running.wait(left)),
                (None, Some(attempt)) if !attempt.has_ended() => attempt.wait(&self.axis, left),
                _ => self.axis.sleep(left.min(POLL_SLICE)),
            }
        }
    }
}

/// Stops axes and waits until each stop has ended. All stops are sent before the first wait, and no axis delays
/// another. `on_notice` is called with the news of each. Its `false` ends the repetitions after a missing
/// reply, and after [`StopNotice::Waiting`] the wait for that axis.
///
/// ```
/// use polepair::axis::{STOP_RETRY_MAX, StopOptions, stop_axes};
/// let link = polepair::connect_local("sim:tmcl?axes=2&time=virtual")?;
/// let ended = stop_axes(link.axes(), StopOptions::default(), STOP_RETRY_MAX, |_, _| true);
/// assert!(ended.iter().all(|stop| stop.standstill.is_ok()));
/// # Ok::<(), polepair::Error>(())
/// ```
pub fn stop_axes(
    axes: &[LocalAxis],
    options: StopOptions,
    within: Duration,
    on_notice: impl FnMut(&LocalAxis, &StopNotice) -> bool,
) -> Vec<StopResult> {
    let persistence = StopPersistence::Within(within);
    await_stops(
        axes.iter().map(|axis| StopSupervisor::begin(axis, options, persistence)).collect(),
        on_notice,
    )
}

/// Waits until each of these stops has ended, as [`stop_axes`].
pub fn await_stops(
    mut stops: Vec<StopSupervisor>,
    mut on_notice: impl FnMut(&LocalAxis, &StopNotice) -> bool,
) -> Vec<StopResult> {
    let mut airtime = WireAirtime::default();
    // All were sent before the first is waited for; here each gets its turn, however long another takes.
    while stops.iter().any(|stop| stop.result.is_none()) {
        for stop in &mut stops {
            if stop.result.is_some() {
                continue;
            }
            let notice = stop.wait(&mut airtime, POLL_SLICE).unwrap_or(StopNotice::Waiting);
            match (on_notice(&stop.axis, &notice), notice) {
                (true, _) => {}
                (false, StopNotice::Waiting) => stop.abandon(),
                (false, _) => stop.give_up(),
            }
        }
    }
    stops.into_iter().filter_map(|stop| stop.result).collect()
}

impl LocalAxis {
    /// Stops along the ramp, and returns when standstill is confirmed by measured values, if the drive has
    /// any. The stop is repeated while the motor turns, and has priority over all other requests. The
    /// drive's program (TMCL, TML) is ended too, because it could move the motor again;
    /// [`AxisStatus::program_end`](polepair_core::axis::AxisStatus::program_end) states whether one was
    /// running.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn stop(&self) -> Result<(), Error> {
        self.stop_with(StopOptions::default())
    }

    /// Stops as [`stop`](Self::stop) does, but leaves the drive's own program running, which may move the
    /// motor again.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn stop_keeping_program(&self) -> Result<(), Error> {
        self.stop_with(StopOptions { keep_program: true, ..StopOptions::default() })
    }

    fn stop_with(&self, options: StopOptions) -> Result<(), Error> {
        let one = std::slice::from_ref(self);
        let ended = stop_axes(one, options, Duration::ZERO, |_, _| true);
        ended.into_iter().try_for_each(|stop| stop.standstill.map(drop))
    }
}
