//! The axis interface of an axis on a wire of this program.

use crate::interface::{AxisControl, AxisMotion, AxisParameters, AxisReadings};
use std::ops::ControlFlow;
use std::time::Duration;

use polepair_core::axis::{Command, Verb};
use polepair_core::judge::LimitEnd;
use polepair_core::plan::Argument;
use polepair_core::profile::{ParameterId, Signal, Watchdog};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

use super::{
    AxisFacts, AxisInterface, AxisRequest, AxisSnapshot, FaultReport, LatestValue, MotionState,
    ParameterDescription, ReadValue, Reply, SignalReading, WatchdogKind, WatchdogReport,
    WriteValue,
};
use crate::amount::{Amount, Value};
use crate::axis::{
    DeviceDetail, LocalAxis, NamedValue, ParameterValue, STOP_RETRY_MAX, StopOptions, StopResult,
    WatchdogState, WriteChange, stop_axes,
};
use crate::doctor::read_watchdog;
use crate::error::Error;
use crate::faults::active_faults;
use crate::url::AxisNumber;

impl AxisParameters for LocalAxis {
    fn parameters(&self) -> Result<Vec<ParameterDescription>, Error> {
        Ok(self.params().iter().map(ParameterDescription::from).collect())
    }

    fn find(&self, name: &str) -> Result<ParameterId, Error> {
        self.find(name)
    }

    fn amount_for_name(
        &self,
        name: &str,
        id: ParameterId,
        amount: Amount,
    ) -> Result<Amount, Error> {
        self.amount_for_name(name, id, amount)
    }

    fn start_read(&self, id: ParameterId) -> Result<AxisRequest, Error> {
        self.start_read(id).map(AxisRequest::from)
    }

    fn start_write(
        &self,
        id: ParameterId,
        value: &WriteValue,
        store: bool,
    ) -> Result<AxisRequest, Error> {
        let raw = match value {
            WriteValue::Raw(raw) => *raw,
            WriteValue::Amount(amount) => self.raw_within_limits(id, amount)?,
        };
        self.start_write(id, raw, store).map(AxisRequest::from)
    }

    fn reading(&self, id: ParameterId, reply: Reply) -> Result<ReadValue, Error> {
        match reply {
            Reply::Raw(raw) => {
                let value = ParameterValue::Number(self.value(id, raw)?);
                Ok(ReadValue::of(self.required_parameter(id)?, &value))
            }
            Reply::Reading(reading) => Ok(reading),
        }
    }

    fn read(&self, id: ParameterId) -> Result<ReadValue, Error> {
        let value = self.read_any(id)?;
        Ok(ReadValue::of(self.required_parameter(id)?, &value))
    }

    fn read_each(&self, id: ParameterId) -> Result<Vec<(u32, ReadValue)>, Error> {
        if !AxisNumber(self.number()).is_group() {
            return Ok(vec![(self.number(), AxisParameters::read(self, id)?)]);
        }
        let parameter = self.required_parameter(id)?;
        self.read_each(id)?
            .into_iter()
            .map(|(number, raw)| {
                let value = ParameterValue::Number(self.value(id, raw)?);
                Ok((number, ReadValue::of(parameter, &value)))
            })
            .collect()
    }

    fn read_data(&self, id: ParameterId) -> Result<Vec<u8>, Error> {
        self.read_data(id, true, &mut |_| {})
    }

    fn write_data(&self, id: ParameterId, data: &[u8]) -> Result<(), Error> {
        self.write_data(id, data, &mut |_| {})
    }

    fn plan_changes(&self, values: &[NamedValue]) -> Result<Vec<WriteChange>, Error> {
        let plan = self.plan_writes(values)?;
        plan.writes.iter().map(|write| self.planned_change(&plan, write, true)).collect()
    }

    fn write_all(
        &self,
        values: &[NamedValue],
        store: bool,
        each: &mut dyn FnMut(&WriteChange) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let plan = self.plan_writes(values)?;
        self.check_armed_for(&plan)?;
        let changes = plan.writes.iter().map(|write| self.planned_change(&plan, write, false));
        let changes = changes.collect::<Result<Vec<_>, Error>>()?;
        for (write, change) in plan.writes.iter().zip(&changes) {
            self.start_write(write.id, write.raw, store)?.finish()?;
            if each(change).is_break() {
                break;
            }
        }
        Ok(())
    }
}

impl AxisMotion for LocalAxis {
    fn unit_of(&self, verb: Verb, which: Argument) -> Option<Unit> {
        self.unit_of(verb, which)
    }

    fn argument(&self, verb: Verb, which: Argument, amount: &Amount) -> Result<f64, Error> {
        self.argument(verb, which, amount)
    }

    fn start(&self, command: Command) -> Result<AxisRequest, Error> {
        self.start(command).map(AxisRequest::from)
    }

    fn start_raw(&self, text: &str) -> Result<AxisRequest, Error> {
        self.start_raw(text).map(AxisRequest::from)
    }

    fn check_command(&self, command: Command) -> Result<(), Error> {
        self.rehearse(command).map(drop)
    }

    fn prepare_mode(&self, verb: Verb) -> Result<(), Error> {
        self.prepare_mode(verb)
    }

    fn motion_state(&self, since: Instant, velocity: bool) -> Result<MotionState, Error> {
        let read = |signal| {
            if !self.provides_signal(signal)? {
                return Ok::<_, Error>(None);
            }
            Ok(self.signals(&[signal])?.into_iter().next())
        };
        let faults = self.unless_forbidden(AxisReadings::faults(self))?.unwrap_or_default();
        let fault = faults.into_iter().find(|fault| !fault.is_warning);
        let enabled = self.unless_forbidden(read(Signal::Enabled))?.flatten();
        let enabled = enabled.map(|reading| reading.raw != 0);
        // The drives of a group rarely have the same speed and position.
        if AxisNumber(self.number()).is_group() {
            let emergency = self.emergency_since(since);
            return Ok(MotionState { fault, enabled, emergency, ..MotionState::default() });
        }
        let velocity = if velocity { read(Signal::Velocity)? } else { None };
        let position = read(Signal::Position)?;
        let mut ends = [false; 2];
        for (holds, signal) in ends.iter_mut().zip([Signal::PositiveLimit, Signal::NegativeLimit]) {
            *holds = read(signal)?.is_some_and(|reading| reading.raw != 0);
        }
        let limit = match ends {
            [true, true] => Some(LimitEnd::Either),
            [true, false] => Some(LimitEnd::Positive),
            [false, true] => Some(LimitEnd::Negative),
            [false, false] => None,
        };
        Ok(MotionState {
            fault,
            enabled,
            velocity: velocity.map(|reading| reading.value),
            position: position.map(|reading| reading.value),
            limit: limit.map(|end| self.limit_name(end).to_owned()),
            emergency: self.emergency_since(since),
        })
    }
}

impl AxisControl for LocalAxis {
    fn arm(&self) -> Result<(), Error> {
        self.arm_exclusively()
    }

    fn disarm(&self) -> Result<(), Error> {
        self.arm(false);
        Ok(())
    }

    fn is_armed(&self) -> bool {
        self.state().armed
    }

    fn stop(&self) -> Result<(), Error> {
        self.stop()
    }

    fn release(&self) -> Result<(), Error> {
        let one = std::slice::from_ref(self);
        let options = StopOptions { power_off: true, ..StopOptions::default() };
        let stopped = stop_axes(one, options, STOP_RETRY_MAX, |_, _| true);
        self.arm(false);
        stopped.into_iter().try_for_each(StopResult::into_result)
    }
}

impl AxisReadings for LocalAxis {
    fn signal_unit(&self, signal: Signal) -> String {
        self.signal_unit(signal).to_owned()
    }

    fn signals(&self, signals: &[Signal]) -> Result<Vec<SignalReading>, Error> {
        let readings = self.signals(signals)?;
        let now = self.connection().now();
        Ok(signals
            .iter()
            .zip(readings)
            .map(|(signal, reading)| SignalReading {
                signal: *signal,
                value: reading.value,
                age: reading.at.map_or(Duration::ZERO, |at| now.since(at)),
            })
            .collect())
    }

    fn signal_text(&self, signal: Signal) -> Result<Option<String>, Error> {
        Ok(self.signal_value(signal)?.map(|value| value.to_string()))
    }

    fn format_signal(&self, signal: Signal, si: f64) -> Option<String> {
        let source = self.profile().signal(signal)?;
        Some(self.value_of_si(source.parameter, si).ok()?.to_string())
    }

    fn latest_value(&self, name: &str, _hz: f64) -> Result<LatestValue, Error> {
        let (id, signal) = self.find_signal_or_parameter(name)?;
        let source = signal.and_then(|signal| self.profile().signal(signal));
        let is_flag = source.is_some_and(|source| source.is_flag());
        // Reads what the unit depends on. What cannot be read shows with the first value.
        let _ = self.value(id, 0);
        let unit = if is_flag { "" } else { self.unit(id).symbol() };
        let axis = self.clone();
        Ok(LatestValue::new(unit, move || {
            let value = match signal {
                Some(signal) => axis.signal_value(signal)?,
                None => Some(axis.value(id, axis.read(id)?)?),
            };
            Ok(value.map_or(f64::NAN, finite_value))
        }))
    }

    fn faults(&self) -> Result<Vec<FaultReport>, Error> {
        if self.provides_signal(Signal::Fault)? {
            Ok(active_faults(self.profile(), self.signals(&[Signal::Fault])?[0].raw))
        } else {
            Ok(Vec::new())
        }
    }

    fn device_details(&self) -> Result<Vec<DeviceDetail>, Error> {
        self.device_details()
    }

    fn watchdog(&self) -> Result<WatchdogReport, Error> {
        Ok(self.report_watchdog(read_watchdog(self)?))
    }

    fn set_watchdog(&self, after: Option<Duration>) -> Result<WatchdogReport, Error> {
        Ok(self.report_watchdog(self.set_watchdog(after)?))
    }
}

impl AxisInterface for LocalAxis {
    fn facts(&self) -> AxisFacts {
        let profile = self.profile();
        AxisFacts {
            number: self.number(),
            name: self.name().to_owned(),
            label: self.label(),
            protocol: self.protocol().to_owned(),
            profile: profile.name.to_owned(),
            title: profile.title.to_owned(),
            kind: profile.axis,
            caution: profile.caution.to_owned(),
            watchdog_rule: self.watchdog_rule(),
            watchdog: self.watchdog_kind(),
            is_simulated: self.simulation.is_some(),
            verbs: profile.verbs().collect(),
            signals: profile.signals.iter().map(|source| source.signal).collect(),
        }
    }

    fn local(&self) -> Option<&LocalAxis> {
        Some(self)
    }

    fn state(&self) -> Result<AxisSnapshot, Error> {
        let (state, now) = (self.state(), self.connection().now());
        let flag = |signal| {
            let known = self.profile().signal(signal).and(state.reading(signal).at);
            known.map(|_| state.reading(signal).raw != 0)
        };
        let signals = self.profile().signals.iter().filter_map(|source| {
            let reading = state.reading(source.signal);
            let age = now.since(reading.at?);
            Some(SignalReading { signal: source.signal, value: reading.value, age })
        });
        Ok(AxisSnapshot {
            mode: self.mode(&state),
            enabled: flag(Signal::Enabled),
            armed: state.armed,
            moving: self.moving(&state),
            signals: signals.collect(),
            owner: None,
        })
    }

    fn now(&self) -> Instant {
        self.connection().now()
    }

    fn sleep(&self, span: Duration) {
        self.sleep(span);
    }
}

/// The value in its unit, or the raw value if its scale is unknown.
fn finite_value(value: Value) -> f64 {
    if value.value.is_finite() { value.value } else { value.raw as f64 }
}

impl LocalAxis {
    /// The kind of the drive's watchdog.
    fn watchdog_kind(&self) -> WatchdogKind {
        match self.profile().watchdog {
            Watchdog::None => WatchdogKind::None,
            Watchdog::Fixed { after_ms } => WatchdogKind::Fixed(f64::from(after_ms) / 1e3),
            Watchdog::Configurable { .. } => self
                .watchdog_parameter_name()
                .map_or(WatchdogKind::None, WatchdogKind::Configurable),
            Watchdog::LifeGuarding { .. } => WatchdogKind::Heartbeat(None),
            Watchdog::Heartbeat { .. } => WatchdogKind::Heartbeat(
                self.heartbeat().and_then(|_| self.watchdog_parameter_name()),
            ),
        }
    }

    fn watchdog_parameter_name(&self) -> Option<String> {
        let parameter = self.watchdog_parameter().and_then(|id| self.parameter(id));
        parameter.map(|parameter| parameter.name.to_owned())
    }

    /// Setting of the drive's watchdog in words.
    #[must_use]
    pub fn report_watchdog(&self, state: WatchdogState) -> WatchdogReport {
        let parameter = self.watchdog_parameter().and_then(|id| self.parameter(id));
        let (text, parameter) = match (parameter, state) {
            (Some(parameter), WatchdogState::None) => {
                let rule = "the motor continues its last command";
                (format!("none in this firmware (`{}`): {rule}", parameter.name), None)
            }
            // Another setting than the one that is written.
            (_, WatchdogState::LifeGuarding(_)) => (self.describe_watchdog(state), None),
            _ => (self.describe_watchdog(state), parameter),
        };
        WatchdogReport {
            text,
            after: state.after(),
            parameter: parameter.map(|parameter| parameter.name.to_owned()),
            caution: self.watchdog_caution(false).unwrap_or_default(),
        }
    }
}
