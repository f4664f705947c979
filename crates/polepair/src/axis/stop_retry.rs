//! Repeats stops until they are confirmed.

use super::stop_sequence::STANDSTILL_WAIT_MAX;
use super::{LocalAxis, Standstill, StopProgress, StopSequence};
use crate::error::Error;
use crate::url::AxisNumber;
use polepair_core::axis::Verb;
use polepair_core::error::Failure;
use polepair_core::time::Instant;
use std::time::Duration;

/// Time for which an unconfirmed stop is repeated by callers that end a motion.
pub const STOP_RETRY_MAX: Duration = Duration::from_secs(10);
/// Pause before a repetition.
const RETRY_PAUSE: Duration = Duration::from_millis(250);

/// While an axis is waited for, the others are looked at after so long.
const POLL_SLICE: Duration = Duration::from_millis(20);
/// Time after which a stop is repeated to a motor that still turns.
const RESEND_AFTER: Duration = Duration::from_secs(1);
const RESEND_AFTER_MAX: Duration = Duration::from_secs(2);
/// A motor that brakes turns so many times as fast after a while.
const BRAKING_RATIO: f64 = 0.98;

/// Stops axes that somebody here has set in motion, and tells how each stop ended: all are sent
/// before the first is waited for. A motor that turns on is told again, and a stop that was lost with
/// its wire, or in silence, is said again for `within` at most; `again` is told of the latter each
/// time, and `false` from it ends that. An axis whose profile has no stop is passed over.
///
/// ```
/// use polepair::axis::{STOP_RETRY_MAX, stop_with_retry};
/// let link = polepair::connect_local("sim:tmcl?axes=2&time=virtual")?;
/// let ended = stop_with_retry(link.axes(), STOP_RETRY_MAX, |_, _| true);
/// assert!(ended.iter().all(Result::is_ok));
/// # Ok::<(), polepair::Error>(())
/// ```
pub fn stop_with_retry(
    axes: &[LocalAxis],
    within: Duration,
    again: impl FnMut(&LocalAxis, &Error) -> bool,
) -> Vec<Result<(), Error>> {
    let has_stop = |axis: &&LocalAxis| axis.profile.plan(Verb::Stop).is_some();
    let stopped: Vec<&LocalAxis> = axes.iter().filter(has_stop).collect();
    let mut ended = stop_until_standstill(&stopped, false, within, again).into_iter();
    let result = |axis| match has_stop(&axis) {
        true => ended.next().map_or(Ok(()), |ended| ended.map(drop)),
        false => Ok(()),
    };
    axes.iter().map(result).collect()
}

/// Stops axes, and waits for the standstill of each. All stops are sent before the first wait, and no axis
/// delays another. A lost stop is repeated for `within`, as in [`stop_with_retry`]. A motor that becomes
/// slower may take the time of its profile; another one must stop soon. The drive's program is ended too,
/// unless `keep_program`.
pub(crate) fn stop_until_standstill(
    axes: &[&LocalAxis],
    keep_program: bool,
    within: Duration,
    mut again: impl FnMut(&LocalAxis, &Error) -> bool,
) -> Vec<Result<Standstill, Error>> {
    let begin = |axis: &&LocalAxis| RepeatedStop::begin(axis, keep_program, within);
    let mut stops: Vec<_> = axes.iter().map(begin).collect();
    while stops.iter().any(|stop| stop.ended.is_none()) {
        for (axis, stop) in axes.iter().zip(&mut stops) {
            if stop.ended.is_none() {
                stop.step(axis, &mut again);
            }
        }
    }
    stops.into_iter().filter_map(|stop| stop.ended).collect()
}

/// The stop of one axis, repeated until standstill.
struct RepeatedStop {
    stopping: StopSequence,
    keep_program: bool,
    sent_at: Instant,
    /// Pause before it is repeated to a motor that still turns.
    pause: Duration,
    /// Time of the repetition after a loss.
    retry_at: Option<Instant>,
    /// End of the repetitions after a loss.
    retry_until: Instant,
    /// Since when it was to stand; it went on.
    started_at: Instant,
    /// The slowest that the motor was seen to turn, and when.
    slowest: (f64, Instant),
    /// An earlier attempt may have been executed.
    may_be_executed: bool,
    ended: Option<Result<Standstill, Error>>,
}

impl RepeatedStop {
    fn begin(axis: &LocalAxis, keep_program: bool, within: Duration) -> Self {
        let now = axis.connection.now();
        Self {
            stopping: StopSequence::begin_with(axis, keep_program).with_retries(),
            keep_program,
            sent_at: now,
            pause: RESEND_AFTER,
            retry_at: None,
            retry_until: now + within,
            started_at: now,
            slowest: (f64::MAX, now),
            may_be_executed: false,
            ended: None,
        }
    }

    fn resend(&mut self, stopping: StopSequence, now: Instant) {
        (self.stopping, self.sent_at, self.retry_at) = (stopping.with_retries(), now, None);
    }

    /// Whether the motor became slower recently, or received the stop just now.
    fn may_be_braking(&mut self, axis: &LocalAxis, now: Instant) -> bool {
        if let Some(rate) = self.stopping.rate()
            && rate < BRAKING_RATIO * self.slowest.0
        {
            self.slowest = (rate, now);
        }
        now.since(self.slowest.1) < axis.connection.scale_timeout(STANDSTILL_WAIT_MAX)
            && now.since(self.started_at) < axis.standstill_timeout()
    }

    fn step(&mut self, axis: &LocalAxis, again: &mut impl FnMut(&LocalAxis, &Error) -> bool) {
        if let Some(at) = self.retry_at {
            let now = axis.connection.now();
            if now < at {
                return axis.sleep(at.since(now).min(POLL_SLICE));
            }
            (self.started_at, self.slowest) = (now, (f64::MAX, now));
            self.resend(StopSequence::resend_with(axis, self.keep_program), now);
        }
        self.stopping.wait(axis, POLL_SLICE);
        let now = axis.connection.now();
        let trouble = self.stopping.trouble().cloned();
        let error = match self.stopping.progress() {
            StopProgress::Standstill => return self.ended = Some(Ok(Standstill::Observed)),
            StopProgress::Unobservable => return self.ended = Some(Ok(axis.unobserved())),
            StopProgress::Failed(error) => Some(error.clone()),
            _ if self.stopping.has_ended() => trouble.clone(),
            _ => None,
        };
        if let Some(error) = error {
            self.may_be_executed |= error.executed() != Some(false);
            if (may_be_lost(&error) || is_superseded(&error))
                && now < self.retry_until
                && again(axis, &error)
            {
                self.retry_at = Some(now + RETRY_PAUSE);
            } else {
                let error = if is_superseded(&error) { error.with_unseen_motor() } else { error };
                self.ended = Some(Err(if self.may_be_executed {
                    error.after_earlier_attempt()
                } else {
                    error
                }));
            }
        } else if !self.may_be_braking(axis, now) {
            let is_group = AxisNumber(axis.number).is_group();
            self.ended = Some(match trouble {
                Some(error) => Err(error),
                // Drives of a group rarely tell the same.
                None if is_group && !self.stopping.is_seen_turning() => {
                    Ok(Standstill::Unobservable)
                }
                None => Err(axis.not_at_rest_error(now.since(self.started_at))),
            });
        } else if self.stopping.is_seen_turning() && now >= self.sent_at + self.pause {
            // Its drive took the one before, and answers.
            (self.pause, self.may_be_executed) = (RESEND_AFTER_MAX, true);
            self.resend(StopSequence::begin_with(axis, self.keep_program), now);
        }
    }
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
        self.stop_with(false)
    }

    /// Stops as [`stop`](Self::stop) does, but leaves the drive's own program running, which may move the
    /// motor again.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn stop_keeping_program(&self) -> Result<(), Error> {
        self.stop_with(true)
    }

    fn stop_with(&self, keep_program: bool) -> Result<(), Error> {
        let mut ended = stop_until_standstill(&[self], keep_program, Duration::ZERO, |_, _| false);
        ended.pop().map_or(Ok(()), |ended| ended.map(drop))
    }

    /// Ends the drive's program, as [`abort`](Self::abort), with the repetitions of [`stop_with_retry`].
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn abort_with_retry(
        &self,
        within: Duration,
        mut again: impl FnMut(&Self, &Error) -> bool,
    ) -> Result<(), Error> {
        let until = self.connection.now() + within;
        loop {
            let ended = self.abort();
            match &ended {
                Err(error)
                    if may_be_lost(error)
                        && self.connection.now() < until
                        && again(self, error) =>
                {
                    self.sleep(RETRY_PAUSE);
                }
                _ => return ended,
            }
        }
    }
}

/// Whether a later stop or motion replaced it. The stop is still pending then.
fn is_superseded(error: &Error) -> bool {
    matches!(error, Error::Failed { outcome, .. } if outcome.failure() == Some(Failure::Cancelled))
}

/// Whether a repeated stop may still arrive. A drive that refused it has received it.
fn may_be_lost(error: &Error) -> bool {
    let Error::Failed { outcome, .. } = error else { return false };
    matches!(outcome.failure(), Some(Failure::Silent | Failure::Misbehaved | Failure::LinkDown))
}
