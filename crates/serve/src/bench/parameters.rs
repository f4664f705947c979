//! Parameters: listed, read, and written by a plan that was shown. Parameters that could move a motor are
//! refused here.

use std::collections::BTreeMap;
use std::sync::Arc;

use polepair::axis::{DeviceDetail, NamedValue, ParameterValue, PlannedWrite, ProgramStatus};
use polepair::interface::WriteValue;
use polepair::{Amount, InstructionProgram, LocalAxis};
use polepair_core::profile::{Access, ParameterId};
use serde_json::json;
use tokio::sync::oneshot;

use super::context::BenchContext;
use super::describe::parameter_info;
use super::journal_queue::ActionSubject;
use super::lease::SessionName;
use super::reply::Continuation;
use super::reply::PendingReply;
use super::reply::ReplySender;
use super::request_worker::RequestWorker;
use super::wire::{BenchWire, WireRequest};
use super::{Bench, BenchLink};
use crate::message::{
    DeviceDetailView, GatewayError, JournalAction, ParameterChange, ParameterInfo, ParameterInput,
    ParameterReading, ProgramLine, ProgramState, ProgramView, WriteParameters,
};

/// Parameters of one request.
const WRITES_MAX: usize = 1024;

impl Bench {
    /// The parameters of an axis, without their values; nothing is asked.
    ///
    /// # Errors
    /// `E212` where there is no such axis.
    pub fn parameters(&self, axis: u16) -> Result<Vec<ParameterInfo>, GatewayError> {
        let (link, index) = self.find_axis(axis)?;
        let axis = &link.wire.axes[index].1;
        let all = (0..).map(ParameterId).zip(axis.params());
        Ok(all.map(|(id, parameter)| parameter_info(axis, id, parameter)).collect())
    }

    /// Reads a parameter now.
    pub fn read_parameter(&self, axis: u16, name: &str) -> PendingReply<ParameterReading> {
        let (reply_sender, reply) = oneshot::channel();
        let result = self.find_axis(axis).map(|(link, index)| {
            let (axis, name) = (link.wire.axes[index].1.clone(), name.to_owned());
            link.request_worker
                .submit_query(reply_sender, move || read_axis_parameter(&axis, &name));
        });
        PendingReply::from_receiver(reply, result)
    }

    /// Asks a drive for its name, versions and the like now.
    pub fn read_device(&self, axis: u16) -> PendingReply<Vec<DeviceDetailView>> {
        self.query_axis(axis, |axis| {
            let view =
                |DeviceDetail { name, text }| DeviceDetailView { name: name.into_owned(), text };
            Ok(axis.device_details()?.into_iter().map(view).collect())
        })
    }

    /// Reads the program in a module's memory, instruction by instruction.
    pub fn read_program(&self, axis: u16) -> PendingReply<ProgramView> {
        self.query_axis(axis, |axis| {
            let program = axis.upload_instructions(None, |_| ())?.with_labels();
            let lines = (0..).map_while(|address| {
                let text = program.instruction_text(address)?;
                Some(ProgramLine { address, label: label_at(address, &program), text })
            });
            Ok(ProgramView { instructions: lines.collect() })
        })
    }

    /// Asks a module where its program is.
    pub fn program_state(&self, axis: u16) -> PendingReply<ProgramState> {
        self.query_axis(axis, |axis| {
            let ProgramStatus { running, counter } = axis.program_status()?;
            Ok(ProgramState { running, counter })
        })
    }

    /// Asks an axis, on the thread that waits for its link.
    pub(super) fn query_axis<T: Send + 'static>(
        &self,
        axis: u16,
        query: impl FnOnce(&LocalAxis) -> Result<T, polepair::Error> + Send + 'static,
    ) -> PendingReply<T> {
        let (reply_sender, reply) = oneshot::channel();
        let result = self.find_axis(axis).map(|(link, index)| {
            let axis = link.wire.axes[index].1.clone();
            link.request_worker.submit_query(reply_sender, move || Ok(query(&axis)?));
        });
        PendingReply::from_receiver(reply, result)
    }

    /// Reads parameters and returns the changes and, unless it is a dry run, writes those that differ: every name and
    /// value is checked before the first is written. A dry run needs no lease.
    pub fn write_parameters(
        &self,
        axis: u16,
        session: &SessionName,
        write: WriteParameters,
    ) -> PendingReply<Vec<ParameterChange>> {
        let (reply_sender, reply) = oneshot::channel();
        let result = self.find_axis(axis).and_then(|(link, index)| {
            if write.values.len() > WRITES_MAX {
                let what = format!("at most {WRITES_MAX} parameters are written at once");
                return Err(GatewayError::new("gateway.request", what));
            }
            let (epoch, dry) = (write.epoch, write.dry_run);
            let writer = ParameterWriter::new(self, link, index, axis, session, write);
            let worker = Arc::clone(&link.request_worker);
            if dry {
                worker.submit_query(reply_sender, move || writer.plan().map(|plan| plan.0));
                return Ok(());
            }
            let go = Box::new(move |may| writer.run(worker, may, reply_sender));
            let session = session.clone();
            link.wire.submit(WireRequest::Write { axis: index, session, epoch, then: go })
        });
        PendingReply::from_receiver(reply, result)
    }
}

fn label_at(address: u16, program: &InstructionProgram) -> Option<String> {
    program.labels().find(|(_, at)| *at == address).map(|(name, _)| name.to_owned())
}

fn read_axis_parameter(axis: &LocalAxis, name: &str) -> Result<ParameterReading, GatewayError> {
    let id = axis.find(name)?;
    let read = axis.read_any(id)?;
    let text = read.to_string();
    let parameter = axis.parameter(id);
    let number = read.number();
    Ok(ParameterReading {
        name: parameter.map_or(name, |parameter| parameter.name).to_owned(),
        value: number.map(|number| number.value).filter(|value| value.is_finite()),
        raw: number.map(|number| number.raw),
        unit: number.map_or("", |number| number.unit.symbol()).to_owned(),
        word: number.and_then(|number| number.word).map(str::to_owned),
        text,
        symbol: parameter.map_or("", |parameter| parameter.symbol).to_owned(),
        kind: match read {
            ParameterValue::Number(_) => "number",
            ParameterValue::Text(_) => "text",
            ParameterValue::Bytes(_) => "bytes",
        }
        .to_owned(),
    })
}

/// A raw value as text: a double does not hold every one.
fn parse_raw_text(text: &str) -> Result<i64, GatewayError> {
    text.trim()
        .parse()
        .map_err(|_| GatewayError::new("E217", format!("{text:?} is not a whole number")))
}

/// A raw value: no drive has one that a `f64` cannot hold.
fn parse_raw_number(number: f64) -> Result<i64, GatewayError> {
    let is_whole = number.fract() == 0.0 && number.abs() <= 9e15;
    is_whole
        .then_some(number as i64)
        .ok_or_else(|| GatewayError::new("E217", format!("{number} is not a whole number")))
}

/// Writer of the parameters of one request.
struct ParameterWriter {
    axis: LocalAxis,
    id: u16,
    local_index: usize,
    session: SessionName,
    epoch: u64,
    values: BTreeMap<String, ParameterInput>,
    persist: bool,
    /// Numbers are as they lie in the drive.
    raw: bool,
    wire: Arc<BenchWire>,
    context: Arc<BenchContext>,
}

impl ParameterWriter {
    fn new(
        bench: &Bench,
        link: &BenchLink,
        local_index: usize,
        id: u16,
        session: &SessionName,
        write: WriteParameters,
    ) -> Self {
        let WriteParameters { values, keep, raw, epoch, .. } = write;
        let (wire, context) = (link.wire.clone(), bench.0.context.clone());
        let (axis, session) = (link.wire.axes[local_index].1.clone(), session.clone());
        Self { axis, id, local_index, session, epoch, values, persist: keep, raw, wire, context }
    }

    /// Changes of the request, and the writes for them.
    fn plan(&self) -> Result<(Vec<ParameterChange>, Vec<PlannedWrite>), GatewayError> {
        let values = self.values.iter().map(|(name, given)| self.named_value(name, given));
        let plan = self.axis.plan_writes(&values.collect::<Result<Vec<_>, _>>()?)?;
        if let Some(write) = plan.writes.iter().find(|write| write.parameter.moves) {
            let what = format!("`{}` may move the motor", write.parameter.name);
            return Err(GatewayError::new("E219", what).hint("use a command, not a setting"));
        }
        let (mut changes, mut writes) = (Vec::new(), Vec::new());
        for write in &plan.writes {
            let change = self.axis.planned_change(&plan, write, true)?;
            if change.is_changed || self.persist {
                writes.push(*write);
            }
            changes.push(ParameterChange {
                name: change.name,
                from: change.from,
                to: change.to,
                from_text: change.from_text,
                to_text: change.to_text,
                unit: change.unit,
                changed: change.is_changed,
            });
        }
        Ok((changes, writes))
    }

    fn named_value(&self, name: &str, given: &ParameterInput) -> Result<NamedValue, GatewayError> {
        let value = match given {
            ParameterInput::Number(number) if self.raw => {
                WriteValue::Raw(parse_raw_number(*number)?)
            }
            ParameterInput::Text(text) if self.raw => WriteValue::Raw(parse_raw_text(text)?),
            ParameterInput::Number(number) => WriteValue::Amount(Amount::Number(*number)),
            ParameterInput::Text(text) => WriteValue::Amount(Amount::Text(text.clone())),
        };
        Ok(NamedValue { name: name.to_owned(), value })
    }

    /// Plans at the desk, announces the plan, and executes its writes there.
    fn run(
        self,
        worker: Arc<RequestWorker>,
        may: Result<(), GatewayError>,
        reply_sender: ReplySender<Vec<ParameterChange>>,
    ) {
        // The receiver may have been dropped, here and below.
        if let Err(refused) = may {
            return drop(reply_sender.send(Err(refused)));
        }
        let again = Arc::clone(&worker);
        worker.submit(Box::new(move |may| {
            let (changes, writes) = match may.and_then(|()| self.plan()) {
                Ok(plan) => plan,
                Err(refused) => return drop(reply_sender.send(Err(refused))),
            };
            let detail = json!({ "keep": self.persist, "changes": changes });
            let (session, shared) = (self.session.clone(), Arc::clone(&self.context));
            let what = ActionSubject::new(&session, JournalAction::Parameters, Some(self.id));
            let then: Continuation = Box::new(move |recorded| match recorded {
                Ok(()) => again.submit_query(reply_sender, move || {
                    self.write_planned(&writes).map(|()| changes)
                }),
                Err(refused) => drop(reply_sender.send(Err(refused))),
            });
            shared.journal.write_ahead(what, detail, shared.now(), then);
        }));
    }

    fn write_planned(&self, writes: &[PlannedWrite]) -> Result<(), GatewayError> {
        let written = writes.iter().try_for_each(|wanted| {
            check_lease_held(&self.wire, self.local_index, self.epoch, &self.session)?;
            self.axis.write(wanted.id, wanted.raw, self.persist)?;
            // The others were converted by it.
            let scales = self.axis.scales(wanted.id) && wanted.parameter.access != Access::Write;
            if scales && self.axis.read(wanted.id)? != wanted.raw {
                let what = format!("the drive did not keep `{}`", wanted.parameter.name);
                return Err(GatewayError::new("E111", what).hint(
                    "others are scaled by it: check the written values, and write the rest again",
                ));
            }
            Ok(())
        });
        let detail = json!({ "error": written.as_ref().err() });
        self.context.record(&self.session, JournalAction::Outcome, Some(self.id), detail);
        written
    }
}

/// A lease that ended meanwhile ends the writing as well.
pub(super) fn check_lease_held(
    wire: &BenchWire,
    index: usize,
    epoch: u64,
    session: &SessionName,
) -> Result<(), GatewayError> {
    let lease = wire.lease(index);
    let its = lease.is_some_and(|lease| lease.epoch == epoch && *lease.owner == **session);
    if its {
        Ok(())
    } else {
        Err(lease_ended().hint(
            "check the written values, and write the rest \
     again",
        ))
    }
}

fn lease_ended() -> GatewayError {
    GatewayError::new("gateway.lease", "the lease ended while this was written")
}
