//! Recordings in a drive's own memory, with the command whose course they show.

use std::ops::ControlFlow;

use polepair::{DriveLog, DriveLogRequest, DriveLogStage, LocalAxis};
use polepair_core::profile::{ParameterId, Signal};
use serde_json::json;

use super::Bench;
use super::lease::SessionName;
use super::reply::PendingReply;
use crate::message::{DriveLogInfo, DriveLogVariable, DriveLogView, RecordDriveLog};

/// Variables of the page's recordings: a signal and its target, of 32 bits each.
const PAGE_WORDS: usize = 4;

impl Bench {
    /// Records in the drive under a lease, and gives its command when the recording runs.
    pub fn record_in_drive(
        &self,
        axis: u16,
        session: &SessionName,
        wanted: RecordDriveLog,
    ) -> PendingReply<DriveLogView> {
        let (bench, who, epoch) = (self.clone(), session.clone(), wanted.epoch);
        let (variables, rate, seconds) = (wanted.variables.clone(), wanted.rate, wanted.seconds);
        let detail = json!({ "record_in_drive": variables, "rate": rate, "seconds": seconds });
        self.change_axis(
            axis,
            session,
            epoch,
            |_| detail,
            move |changed| {
                let its = &changed.axis;
                let plan = its.plan_drive_log(&read_request(its, &wanted)?)?;
                let (mut command, mut afterwards, mut reply) =
                    (wanted.command, wanted.afterwards, None);
                let log = its.record_in_drive(&plan, |progress| {
                    if let Some(command) = command.take() {
                        reply = Some(bench.command(axis, &who, command));
                    }
                    let is_recorded = progress.stage == DriveLogStage::Reading;
                    if let Some(command) = afterwards.take_if(|_| is_recorded) {
                        // No one waits for its outcome: a client sees the motor in the axis' state.
                        drop(bench.command(axis, &who, command));
                    }
                    ControlFlow::Continue(())
                })?;
                let outcome = reply.and_then(|mut reply| reply.try_recv()).transpose()?;
                Ok(DriveLogView {
                    interval_s: log.interval.as_secs_f64(),
                    variables: variables_of(&log),
                    outcome,
                })
            },
        )
    }
}

/// The recorder of an axis' drive, if it has one.
pub(super) fn drive_log_info(axis: &LocalAxis) -> Option<DriveLogInfo> {
    let facts = axis.drive_log_facts().ok()?;
    Some(DriveLogInfo {
        points: facts.points(PAGE_WORDS),
        rates: facts.rates,
        inferred: facts.is_layout_inferred,
    })
}

fn read_request(
    axis: &LocalAxis,
    wanted: &RecordDriveLog,
) -> Result<DriveLogRequest, polepair::Error> {
    let variables = wanted.variables.iter().map(|name| find_variable(axis, name));
    let variables = variables.collect::<Result<_, _>>()?;
    let request = DriveLogRequest::at_rate(variables, wanted.rate, wanted.seconds)?;
    Ok(DriveLogRequest { accept_inferred: wanted.inferred, ..request })
}

/// A signal by its word, or a parameter by name.
fn find_variable(axis: &LocalAxis, name: &str) -> Result<ParameterId, polepair::Error> {
    let signal = Signal::from_name(name).and_then(|signal| axis.profile().signal(signal));
    signal.map_or_else(|| axis.find(name), |source| Ok(source.parameter))
}

fn variables_of(log: &DriveLog) -> Vec<DriveLogVariable> {
    let variable = |it: &polepair::LoggedVariable| DriveLogVariable {
        name: it.name.to_owned(),
        unit: it.si_symbol().to_owned(),
        // JSON has no NaN.
        values: it.si_values().map(|value| value.is_finite().then_some(value)).collect(),
    };
    log.variables.iter().map(variable).collect()
}
