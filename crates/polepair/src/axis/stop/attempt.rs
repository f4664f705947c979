//! One attempt of a stop: sent, acknowledged step by step, and confirmed by standstill.

use std::time::Duration;

use super::failure_of;
use super::standstill::StandstillMonitor;
use crate::axis::{LocalAxis, RunningRequest};
use crate::error::Error;
use polepair_core::axis::{Command, StopPart};
use polepair_core::error::Failure;
use polepair_core::profile::RamMode;
use polepair_core::time::Instant;

/// The stop of one axis, sent once.
#[derive(Debug)]
pub(super) struct StopAttempt {
    command: Command,
    started_at: Instant,
    stage: StopStage,
    progress: StopProgress,
    elapsed: Duration,
    trouble: Option<Error>,
    /// True if a check of standstill is repeated after a missing reply.
    retries: bool,
}

/// Known progress of a stop.
#[derive(Clone, PartialEq, Debug)]
pub enum StopProgress {
    /// The stop was sent.
    Sent,
    /// The drive answered all of it.
    Acknowledged,
    /// Standstill was measured after the drive's reply.
    Standstill,
    /// The drive answered all of it, and measures nothing by which it could be seen to stand.
    Unobservable,
    /// The stop could not be sent, or was not confirmed, for this reason.
    Failed(Error),
}

#[derive(Debug)]
enum StopStage {
    /// Reads whether the writes of a stop go to RAM, before the stop is repeated.
    CheckingRamMode(RunningRequest, RamMode),
    /// Sees to it.
    SettingRamMode(RunningRequest),
    Sending(RunningRequest),
    Observing(Box<StandstillMonitor>),
    /// Sends the final requests at standstill.
    Releasing(RunningRequest, StopProgress),
    Ended,
}

impl StopAttempt {
    /// Sends it.
    pub fn begin(axis: &LocalAxis, command: Command) -> Self {
        let mut attempt = Self::new(axis, command);
        attempt.send_stop(axis, false);
        attempt
    }

    /// Repeats the stop to a drive without a reply, or after a lost link: each request once, so that a
    /// missing drive uses the wire for one request only. A drive that would write permanent memory, because
    /// it has restarted, is set to RAM first.
    pub fn resend(axis: &LocalAxis, command: Command) -> Self {
        let mut attempt = Self::new(axis, command);
        match axis.stop_ram_mode(command.verb) {
            // A drive that lost its supply writes to flash what a stop writes. It is asked before each repetition
            // (STOP-10).
            Some(ram) => match axis.start_ram_mode_read(ram.parameter) {
                Ok(running) => attempt.stage = StopStage::CheckingRamMode(running, ram),
                Err(error) => attempt.fail(error),
            },
            None => attempt.send_stop(axis, true),
        }
        attempt
    }

    /// A missing reply to a check of standstill is asked for again.
    pub fn with_retries(mut self) -> Self {
        self.retries = true;
        self
    }

    fn new(axis: &LocalAxis, command: Command) -> Self {
        Self {
            command,
            started_at: axis.connection.now(),
            stage: StopStage::Ended,
            progress: StopProgress::Sent,
            elapsed: Duration::ZERO,
            trouble: None,
            retries: false,
        }
    }

    fn send_stop(&mut self, axis: &LocalAxis, once: bool) {
        match axis.start_stop(self.command, StopPart::Halt, once) {
            Ok(running) => self.stage = StopStage::Sending(running),
            Err(error) => self.fail(error),
        }
    }

    fn fail(&mut self, error: Error) {
        (self.progress, self.stage) = (StopProgress::Failed(error), StopStage::Ended);
    }

    /// Progress of the attempt.
    pub fn progress(&self) -> &StopProgress {
        &self.progress
    }

    /// Reason why it does not proceed: the drive became silent after its reply, does not report its speed now, or
    /// reports standstill while its position changes.
    pub fn trouble(&self) -> Option<&Error> {
        match &self.stage {
            StopStage::Observing(monitor) => monitor.trouble(),
            _ => self.trouble.as_ref(),
        }
    }

    /// The time from its beginning to its last progress.
    pub fn elapsed(&self) -> Duration {
        self.elapsed
    }

    /// Returns whether something of it is still to be answered: nothing that moves is to be sent meanwhile.
    pub fn is_under_way(&self) -> bool {
        !matches!(self.stage, StopStage::Observing(_) | StopStage::Ended)
    }

    /// Returns whether nothing of it is on the wire yet: its drive is asked something else first.
    pub fn is_held_back(&self) -> bool {
        matches!(self.stage, StopStage::CheckingRamMode(..) | StopStage::SettingRamMode(_))
    }

    /// Returns whether nothing more will be known without a repetition.
    pub fn has_ended(&self) -> bool {
        matches!(self.stage, StopStage::Ended)
    }

    /// Returns whether the drive answered all of it, and the motor still turned at the last reading.
    pub fn is_seen_turning(&self) -> bool {
        matches!(&self.stage, StopStage::Observing(monitor) if monitor.is_seen_turning())
    }

    /// Returns whether the motor turns, or the drive cannot report it now.
    pub fn may_be_turning(&self) -> bool {
        self.is_seen_turning()
            || matches!(self.stage, StopStage::Observing(_)) && self.trouble().is_some()
    }

    /// Speed of a motor that turns, in a unit of the drive that is the same for all readings, and the time of
    /// the reading.
    pub fn rate(&self) -> Option<(f64, Instant)> {
        match &self.stage {
            StopStage::Observing(monitor) => monitor.rate(),
            _ => None,
        }
    }

    /// The time since the drive answered all of it.
    pub fn observed_for(&self, now: Instant) -> Duration {
        match &self.stage {
            StopStage::Observing(monitor) => now.since(monitor.since()),
            _ => Duration::ZERO,
        }
    }

    /// Waits until there is something to [`poll`](Self::poll), at most for this time.
    pub fn wait(&mut self, axis: &LocalAxis, at_most: Duration) {
        match &mut self.stage {
            StopStage::CheckingRamMode(running, _)
            | StopStage::SettingRamMode(running)
            | StopStage::Sending(running)
            | StopStage::Releasing(running, _) => drop(running.wait(at_most)),
            StopStage::Observing(monitor) => monitor.wait(axis, at_most),
            StopStage::Ended => {}
        }
    }

    /// Checks how far it has come. Waits for nothing.
    pub fn poll(&mut self, axis: &LocalAxis, now: Instant) {
        match std::mem::replace(&mut self.stage, StopStage::Ended) {
            StopStage::CheckingRamMode(mut running, ram) => match running.poll() {
                Ok(None) => self.stage = StopStage::CheckingRamMode(running, ram),
                Ok(Some(raw)) if raw == ram.ram => self.send_stop(axis, false),
                Ok(Some(_)) => match axis.start_write(ram.parameter, ram.ram, false) {
                    Ok(running) => self.stage = StopStage::SettingRamMode(running),
                    Err(_) => self.send_stop(axis, false),
                },
                // It answers: to stop is worth a write to its memory.
                Err(error) if !is_communication_error(&error) => self.send_stop(axis, false),
                Err(error) => self.fail(error),
            },
            StopStage::SettingRamMode(mut running) => match running.poll() {
                Ok(None) => self.stage = StopStage::SettingRamMode(running),
                Err(error) if is_communication_error(&error) => self.fail(error),
                Ok(Some(_)) | Err(_) => self.send_stop(axis, false),
            },
            StopStage::Sending(mut running) => match running.poll() {
                Ok(None) => self.stage = StopStage::Sending(running),
                Ok(Some(_)) => {
                    // Without a reply, the stop may have been lost.
                    let index = axis.index;
                    // TML on CAN confirms no command, so only the motor can (STOP-8).
                    if axis.connection().with_axes(|axes, _| axes.is_confirmed(index)) {
                        self.set_progress(StopProgress::Acknowledged, now);
                    }
                    let monitor = StandstillMonitor::new(axis, now, self.retries);
                    self.stage = StopStage::Observing(Box::new(monitor));
                    self.poll(axis, now);
                }
                Err(error) => self.fail(error),
            },
            StopStage::Observing(mut monitor) => match monitor.poll(axis, now) {
                Ok(None) => self.stage = StopStage::Observing(monitor),
                Ok(Some(class)) => self.start_release(axis, class, now),
                Err(error) => self.trouble = Some(error),
            },
            // The rest of the stop, for a motor at standstill: it lets the drive be moved again.
            StopStage::Releasing(mut running, class) => match running.poll() {
                Ok(None) => self.stage = StopStage::Releasing(running, class),
                Ok(Some(_)) => self.set_progress(class, now),
                Err(error) => self.trouble = Some(error),
            },
            StopStage::Ended => {}
        }
    }

    fn set_progress(&mut self, class: StopProgress, now: Instant) {
        (self.progress, self.elapsed) = (class, now.since(self.started_at));
    }

    /// Sends the final requests at standstill.
    fn start_release(&mut self, axis: &LocalAxis, class: StopProgress, now: Instant) {
        let plan = axis.profile.plan(self.command.verb);
        debug_assert!(matches!(class, StopProgress::Standstill | StopProgress::Unobservable));
        if plan.is_none_or(|plan| plan.after_wait().is_empty()) {
            return self.set_progress(class, now);
        }
        match axis.start_stop(self.command, StopPart::Release, false) {
            Ok(running) => self.stage = StopStage::Releasing(running, class),
            Err(error) => self.trouble = Some(error),
        }
    }
}

/// Returns whether a request failed without a reply, so that a repetition may succeed.
pub(super) fn is_communication_error(error: &Error) -> bool {
    use Failure::{AnsweredTwice, Cancelled, LinkDown, Misbehaved, Silent};
    let failed = matches!(
        failure_of(error),
        Some(Silent | Misbehaved | AnsweredTwice | Cancelled | LinkDown)
    );
    failed || matches!(error, Error::Link(_))
}
