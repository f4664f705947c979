//! The requests of a stop. None of them blocks.

use crate::axis::failure::RequestKind;
use crate::axis::{LocalAxis, RunningRequest};
use crate::error::Error;
use polepair_core::axis::{Command, StopPart, Verb};
use polepair_core::plan::Step;
use polepair_core::profile::{ParameterId, Persistence, RamMode};

impl LocalAxis {
    /// The setting that keeps the writes of a stop out of permanent memory, if there is one.
    pub(super) fn stop_ram_mode(&self, verb: Verb) -> Option<RamMode> {
        // Drives without such a mode keep nothing that a stop writes.
        let ram = self.profile.ram?;
        let steps = self.profile.plan(verb)?.steps;
        steps
            .iter()
            .any(|step| matches!(step, Step::Write(id, _) if self.is_stored_parameter(id)))
            .then_some(ram)
    }

    fn is_stored_parameter(&self, id: &ParameterId) -> bool {
        let parameter = self.parameter(*id);
        parameter.is_some_and(|found| found.persistence == Persistence::UnlessRam)
    }

    /// Sends a part of the stop; each of its requests `once` even if the drive is silent.
    pub(super) fn start_stop(
        &self,
        command: Command,
        part: StopPart,
        once: bool,
    ) -> Result<RunningRequest, Error> {
        let kind = RequestKind::Verb(command.verb);
        let submitted = self.connection.submit(|axes, now, ticket| {
            // Submitted and marked under one lock, so that no attempt leaves in between.
            axes.stop(now, ticket, self.index, command, part)?;
            if once {
                axes.disable_retries(ticket);
            }
            Ok(())
        });
        self.running(command.verb.name(), kind, submitted)
    }

    /// Reads the setting that a repeated stop depends on.
    pub(super) fn start_ram_mode_read(&self, id: ParameterId) -> Result<RunningRequest, Error> {
        let what = format!("stop: reading `{}` first", self.required_parameter(id)?.name);
        self.start_read_now(id, what, RequestKind::Verb(Verb::Stop), true)
    }

    /// Reads a source of standstill after a stop.
    pub(super) fn start_standstill_read(
        &self,
        id: ParameterId,
        once: bool,
    ) -> Result<RunningRequest, Error> {
        let what = format!(
            "received a stop, but its standstill is not confirmed: `{}`",
            self.required_parameter(id)?.name
        );
        self.start_read_now(id, what, RequestKind::StandstillQuery, once)
    }

    /// [`start_read`](Self::start_read) without waiting for room; a silent drive may be asked `once`.
    fn start_read_now(
        &self,
        id: ParameterId,
        what: String,
        kind: RequestKind,
        once: bool,
    ) -> Result<RunningRequest, Error> {
        let submitted = self.connection.submit(|axes, now, ticket| {
            axes.read_parameter(now, ticket, self.index, id)?;
            if once {
                axes.disable_retries(ticket);
            }
            Ok(())
        });
        self.running(what, kind, submitted)
    }
}
