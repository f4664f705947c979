//! A request that is being executed.

use super::LocalAxis;
use super::failure::RequestKind;
use crate::error::Error;
use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::profile::ParameterId;
use polepair_core::time::Instant;
use polepair_link::{PendingRequest, WaitResult};
use std::task;
use std::time::Duration;

/// A verb that was looked at and can be started: see [`LocalAxis::prepare`].
#[derive(Clone, Debug)]
#[must_use = "nothing moves before it is started"]
pub struct PreparedCommand {
    pub(super) axis: LocalAxis,
    pub(super) command: Command,
}

impl PreparedCommand {
    /// Starts it, and does not wait for its end.
    ///
    /// # Errors
    /// [`Error::Unsupported`]: nothing was sent.
    pub fn start(&self) -> Result<RunningRequest, Error> {
        let Self { axis, command } = self;
        let verb = command.verb.name();
        let submitted = axis
            .connection
            .submit(|axes, now, ticket| axes.command(now, ticket, axis.index, *command));
        let mut running = axis.running(verb, RequestKind::Verb(command.verb), submitted)?;
        // It is the move that arrived or did not.
        if command.verb == Verb::Reached {
            "move".clone_into(&mut running.what);
        }
        Ok(running)
    }
}

/// A request under way. Dropped before its end, it goes on by itself.
#[derive(Debug)]
#[must_use = "wait for it, or drop it to continue in the background"]
pub struct RunningRequest {
    pub(super) axis: LocalAxis,
    pub(super) pending: PendingRequest,
    pub(super) what: String,
    pub(super) kind: RequestKind,
}

impl LocalAxis {
    /// Begins to read a parameter and does not wait for its value, which the axis'
    /// [`state`](Self::state) has afterwards as well, if it is a signal's.
    ///
    /// # Errors
    /// [`Error::Unsupported`]: nothing was sent.
    pub fn start_read(&self, id: ParameterId) -> Result<RunningRequest, Error> {
        let what = format!("reading `{}`", self.required_parameter(id)?.name);
        let submitted = self.connection.submit_in_turn(Instant::FAR_FUTURE, |axes, now, ticket| {
            axes.read_parameter(now, ticket, self.index, id)
        });
        self.running(what, RequestKind::Query, submitted)
    }

    /// Begins to write a parameter, raw, and does not wait until it is done: as
    /// [`write`](Self::write).
    ///
    /// # Errors
    /// [`Error::Usage`] and [`Error::Unsupported`]: nothing was sent.
    pub fn start_write(
        &self,
        id: ParameterId,
        raw: i64,
        keep: bool,
    ) -> Result<RunningRequest, Error> {
        let what = format!("setting `{}`", self.required_parameter(id)?.name);
        // Before it is submitted, so that a value outside of a file's limits costs no byte.
        self.check_write(id, raw)?;
        let submitted = self.connection.submit_in_turn(Instant::FAR_FUTURE, |axes, now, ticket| {
            axes.write_parameter(now, ticket, self.index, id, raw, keep)
        });
        self.running(what, RequestKind::Write(id, raw, keep), submitted)
    }

    /// A request of this axis that was submitted, with its description.
    ///
    /// # Errors
    /// [`Error::Unsupported`] if it was not.
    pub(super) fn running(
        &self,
        what: impl Into<String>,
        kind: RequestKind,
        submitted: Result<PendingRequest, Unsupported>,
    ) -> Result<RunningRequest, Error> {
        let what = what.into();
        let pending = submitted.map_err(|why| self.unsupported_error(&what, why))?;
        Ok(RunningRequest { axis: self.clone(), pending, what, kind })
    }
}

impl RunningRequest {
    /// Waits for the end. The value is the last one read.
    ///
    /// # Errors
    /// [`Error::Failed`] by source, [`Error::Interrupted`] after an interruption; the request then
    /// continues, and can be awaited again.
    pub fn finish(&mut self) -> Result<i64, Error> {
        match self.wait_until(Instant::FAR_FUTURE)? {
            Some(raw) => Ok(raw),
            None => Err(Error::Interrupted { what: self.description() }),
        }
    }

    /// Waits for the end, at most for this time; `None` if it continues.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn wait(&mut self, at_most: Duration) -> Result<Option<i64>, Error> {
        self.wait_until(self.axis.connection.now() + at_most)
    }

    /// Looks whether it has ended, without waiting.
    ///
    /// # Errors
    /// [`Error::Failed`] by blame.
    pub fn poll(&mut self) -> Result<Option<i64>, Error> {
        let outcome = self.pending.poll();
        outcome.map(|outcome| self.to_result(outcome)).transpose()
    }

    /// Looks whether it has ended, and has `waker` woken when it does otherwise.
    pub fn poll_or_wake(&mut self, waker: &task::Waker) -> bool {
        self.pending.poll_or_wake(waker).is_some()
    }

    pub(super) fn wait_until(&mut self, deadline: Instant) -> Result<Option<i64>, Error> {
        match self.pending.wait(deadline) {
            WaitResult::Ended(outcome) => self.to_result(outcome).map(Some),
            WaitResult::TimedOut => Ok(None),
            WaitResult::Interrupted => Err(Error::Interrupted { what: self.description() }),
        }
    }

    fn to_result(&self, outcome: Outcome) -> Result<i64, Error> {
        match outcome {
            Outcome::Done(raw) => Ok(raw),
            other => Err(self.axis.outcome_error(&self.what, self.kind, other)),
        }
    }

    fn description(&self) -> String {
        format!("{}: {}", self.axis.label(), self.what)
    }
}
