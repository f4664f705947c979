//! The axis interface of an axis of a gateway.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;

use polepair_client::message::{
    AxisInfo, BenchView, ParameterReading as ReadingMessage, SetWatchdog, SignalInfo,
    WriteParameters,
};
use polepair_client::{GatewayError, Lease, PendingOperation};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::{ParameterId, Signal, same_name};
use polepair_core::time::Instant;
use polepair_core::units::Unit;
use polepair_link::clock;

use super::convert::{
    argument_unit, axis_facts, axis_state, command_arguments, drive_unit, format_signal,
    parameter_description, parameter_input, parameter_reading, signal_reading, watchdog_report,
    write_change, write_request,
};
use super::server::{LeaseGuard, REPLY_MAX, STOP_MAX, Server};
use super::{RemoteRequest, SampleRows, stop_axes};
use crate::amount::Amount;
use crate::axis::{DeviceDetail, NamedValue, WriteChange};
use crate::error::{ARMING_HINT, Error};
use crate::interface::{
    AxisControl, AxisFacts, AxisInterface, AxisMotion, AxisParameters, AxisReadings, AxisRequest,
    AxisSnapshot, FaultReport, LatestValue, MotionState, ParameterDescription, ReadValue, Reply,
    SignalReading, WatchdogReport, WriteValue, not_on_gateway,
};

/// The highest rate at which a gateway sends a signal.
const HZ_MAX: f64 = 1000.0;
/// Periods, and least time, for which a sample is the latest value: a drive may be slower than the requested rate.
const FRESH_PERIODS: f64 = 3.0;
const FRESH_MIN: Duration = Duration::from_secs(1);

/// An axis of a gateway. Clones are the same axis and share its lease.
#[derive(Clone, Debug)]
pub struct RemoteAxis {
    server: Arc<Server>,
    info: Arc<AxisInfo>,
}

impl RemoteAxis {
    pub(super) fn new(server: Arc<Server>, info: AxisInfo) -> Self {
        Self { server, info: Arc::new(info) }
    }

    /// The gateway's description of the axis.
    #[must_use]
    pub fn info(&self) -> &AxisInfo {
        &self.info
    }

    /// The gateway's client.
    #[must_use]
    pub fn gateway(&self) -> &polepair_client::Gateway {
        self.server.gateway()
    }

    /// Returns whether its parameters are known without a request.
    #[must_use]
    pub fn has_parameters(&self) -> bool {
        self.server.has_parameters(self.info.id)
    }

    /// Subscribes to signals, a row each `period` seconds, or as often as the gateway sends them.
    ///
    /// # Errors
    /// `E213` without a signal, or for one that the drive does not report; `E217` for an invalid period.
    pub fn subscribe(&self, signals: &[Signal], period: f64) -> Result<SampleRows, Error> {
        if signals.is_empty() {
            return Err(Error::usage("E213", "no signal is named", "name what to watch"));
        }
        if !(period.is_finite() && period >= 0.0) {
            let hint = "give seconds, or 0 for as often as possible";
            return Err(Error::usage("E217", format!("a period of {period} s"), hint));
        }
        let (axis, hz) = (self.info.id, (1.0 / period).min(HZ_MAX));
        let live = self.server.live_connection()?;
        let streams =
            signals.iter().map(|signal| live.subscribe(axis, Some(signal.name()), None, hz));
        Ok(SampleRows::new(streams.collect::<Result<_, _>>()?))
    }

    /// Starts `stop` or `disable` by the lease of this program, so that no other client's motion is stopped. `None` if
    /// this program did not arm the axis.
    ///
    /// # Errors
    /// `gateway.lease` if the lease has ended.
    pub fn start_by_lease(&self, verb: Verb) -> Result<Option<AxisRequest>, Error> {
        let Some(lease) = self.armed_lease() else { return Ok(None) };
        lease.check()?;
        let started = lease.start(verb.name(), command_arguments(&Command::new(verb)))?;
        Ok(Some(RemoteRequest::command(started).into()))
    }

    /// Waits until no other thread acquires or releases the lease of this axis, at most for this time.
    #[must_use]
    pub fn lock_lease_within(&self, within: Duration) -> Option<LeaseGuard> {
        self.server.lock_slot_within(self.info.id, within)
    }

    pub(super) fn bench(&self) -> &BenchView {
        self.server.bench()
    }

    /// The lease by which this program armed the axis, whether it is still valid or not.
    pub(super) fn armed_lease(&self) -> Option<Arc<Lease>> {
        self.server.armed_lease(self.info.id)
    }

    fn slot(&self) -> LeaseGuard {
        self.server.lock_slot(self.info.id)
    }

    pub(super) fn has_verb(&self, verb: Verb) -> bool {
        self.info.verbs.iter().any(|info| info.verb == verb.name())
    }

    /// Refuses a verb that the drive does not have, and raw values.
    fn check_verb(&self, command: &Command) -> Result<(), GatewayError> {
        let verb = command.verb;
        if !self.has_verb(verb) {
            let what =
                format!("{}: {} has no `{}`", self.info.label, self.info.profile, verb.name());
            let known = self.info.verbs.iter().map(|info| &*info.verb);
            let known: Vec<_> = known.filter(|verb| !["arm", "disarm"].contains(verb)).collect();
            return Err(
                GatewayError::new("E218", what).hint(format!("it has {}", known.join(", ")))
            );
        }
        if command.raw {
            let what = format!("{}: a gateway takes values with units", self.info.label);
            return Err(GatewayError::new("E257", what).hint("give the value with its unit"));
        }
        Ok(())
    }

    /// Starts a verb: by the lease if the axis is armed; one that moves nothing needs no lease before.
    fn start_verb(&self, command: &Command) -> Result<PendingOperation, GatewayError> {
        self.check_verb(command)?;
        let (verb, id) = (command.verb, self.info.id);
        let (lease, arguments) = (self.server.armed_lease(id), command_arguments(command));
        if matches!(verb, Verb::Stop | Verb::QuickStop) {
            return match lease.filter(|lease| lease.check().is_ok()) {
                Some(lease) => lease.start(verb.name(), arguments),
                None => {
                    let server = Arc::clone(&self.server);
                    // The stop comes first, then the check whether it was this axis.
                    Ok(self.server.gateway().spawn(move |gateway| {
                        stop_axes(gateway, vec![id]).and_then(|()| server.check_same_drives())
                    }))
                }
            };
        }
        if let Some(lease) = lease {
            lease.check()?;
            return lease.start(verb.name(), arguments);
        }
        // A wait for another client's motion does not take the axis from it.
        let moves = self.info.verbs.iter().any(|info| info.verb == verb.name() && info.moves);
        if moves || verb == Verb::Reached {
            let what = format!("{}: {}: the axis is not armed", self.info.label, verb.name());
            return Err(GatewayError::new("E219", what).hint(ARMING_HINT));
        }
        let server = Arc::clone(&self.server);
        Ok(self.server.gateway().spawn(move |_| {
            server.with_lease(id, move |lease| lease.run(verb.name(), arguments, REPLY_MAX))
        }))
    }

    /// Has the gateway read a parameter.
    fn request_reading(&self, id: ParameterId) -> Result<ReadingMessage, Error> {
        let name = self.server.parameter_name(self.info.id, id)?;
        Ok(self.gateway().parameter(self.info.id, &name)?)
    }

    /// Has the gateway read signals now; one that this version does not know is left out.
    fn read_signals(&self, signals: &[Signal]) -> Result<Vec<SignalReading>, Error> {
        let words: Vec<_> = signals.iter().map(|signal| signal.name()).collect();
        let read = self.gateway().signals(self.info.id, &words)?;
        Ok(read.iter().filter_map(signal_reading).collect())
    }
}

impl AxisParameters for RemoteAxis {
    fn parameters(&self) -> Result<Vec<ParameterDescription>, Error> {
        Ok(self.server.parameters(self.info.id)?.iter().map(parameter_description).collect())
    }

    fn find(&self, name: &str) -> Result<ParameterId, Error> {
        Ok(self.server.find_parameter(self.info.id, name)?)
    }

    fn amount_for_name(
        &self,
        name: &str,
        id: ParameterId,
        amount: Amount,
    ) -> Result<Amount, Error> {
        match self.server.parameters(self.info.id)?.get(usize::from(id.0)) {
            Some(info) => Ok(amount.for_written_name(name, &info.name, &info.symbol)),
            // The gateway gets the address itself, and has the same rule.
            None => Ok(amount),
        }
    }

    fn start_read(&self, id: ParameterId) -> Result<AxisRequest, Error> {
        let (axis, name) = (self.info.id, self.server.parameter_name(self.info.id, id)?);
        let read = self.gateway().spawn(move |gateway| gateway.parameter(axis, &name));
        Ok(RemoteRequest::read(read).into())
    }

    fn start_write(
        &self,
        id: ParameterId,
        value: &WriteValue,
        store: bool,
    ) -> Result<AxisRequest, Error> {
        let (axis, mut name) = (self.info.id, self.server.parameter_name(self.info.id, id)?);
        if let WriteValue::Amount(Amount::Own(_) | Amount::Either(_)) = value {
            // The gateway has the same rule for amounts behind a symbol.
            let known = self.server.parameters(axis)?.get(usize::from(id.0));
            name = known.map_or(name, |info| info.symbol.clone());
        }
        let (input, raw) = parameter_input(value);
        let values = [(name, input)].into();
        let write = WriteParameters { values, keep: store, dry_run: false, raw, epoch: 0 };
        let server = Arc::clone(&self.server);
        let written = self.gateway().spawn(move |gateway| {
            server.with_lease(axis, |lease| {
                let write = WriteParameters { epoch: lease.epoch(), ..write };
                gateway.write_parameters(axis, &write).map(drop)
            })
        });
        Ok(RemoteRequest::command(written).into())
    }

    fn reading(&self, id: ParameterId, reply: Reply) -> Result<ReadValue, Error> {
        match reply {
            Reply::Reading(reading) => Ok(reading),
            Reply::Raw(_) => self.read(id),
        }
    }

    fn read(&self, id: ParameterId) -> Result<ReadValue, Error> {
        self.request_reading(id).map(parameter_reading)
    }

    fn read_each(&self, id: ParameterId) -> Result<Vec<(u32, ReadValue)>, Error> {
        Ok(vec![(self.info.number, self.read(id)?)])
    }

    fn read_data(&self, id: ParameterId) -> Result<Vec<u8>, Error> {
        let read = self.request_reading(id)?;
        match read.kind.as_str() {
            "text" => Ok(read.text.into_bytes()),
            "bytes" => {
                let bytes = read.text.split_whitespace();
                let bytes = bytes.map(|digits| u8::from_str_radix(digits, 16));
                let invalid =
                    |_| Error::usage("E257", "the gateway's bytes are not hexadecimal", "");
                bytes.collect::<Result<_, _>>().map_err(invalid)
            }
            _ => Err(Error::usage("E213", format!("`{}` is a number", read.name), "get it")),
        }
    }

    fn write_data(&self, _id: ParameterId, _data: &[u8]) -> Result<(), Error> {
        Err(not_on_gateway("writing text and bytes", ""))
    }

    fn plan_changes(&self, values: &[NamedValue]) -> Result<Vec<WriteChange>, Error> {
        let request = WriteParameters { dry_run: true, ..write_request(values, false)? };
        let changes = self.gateway().write_parameters(self.info.id, &request)?;
        let parameters = self.server.parameters(self.info.id)?;
        Ok(changes.into_iter().map(|change| write_change(change, parameters)).collect())
    }

    fn write_all(
        &self,
        values: &[NamedValue],
        store: bool,
        each: &mut dyn FnMut(&WriteChange) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let request = write_request(values, store)?;
        // Before the lease is acquired: other clients wait while it is held.
        let parameters = self.server.parameters(self.info.id)?;
        let changes = self.server.with_lease(self.info.id, |lease| {
            let request = WriteParameters { epoch: lease.epoch(), ..request };
            self.gateway().write_parameters(self.info.id, &request)
        })?;
        let mut changes = changes.into_iter().map(|change| write_change(change, parameters));
        // The gateway has written all of them.
        let _ = changes.try_for_each(|change| each(&change));
        Ok(())
    }
}

impl AxisMotion for RemoteAxis {
    fn unit_of(&self, verb: Verb, which: Argument) -> Option<Unit> {
        argument_unit(&self.info, verb, which)
    }

    fn argument(&self, verb: Verb, which: Argument, amount: &Amount) -> Result<f64, Error> {
        let unit = self.unit_of(verb, which);
        if unit.is_none() && self.has_verb(verb) {
            let word = crate::profile::argument_word(which);
            let (label, profile) = (&self.info.label, &self.info.profile);
            let what = format!("{label}: {}: {profile} takes no {word} with it", verb.name());
            return Err(Error::usage("E218", what, "leave it out"));
        }
        amount.in_si(unit)
    }

    fn start(&self, command: Command) -> Result<AxisRequest, Error> {
        Ok(RemoteRequest::command(self.start_verb(&command)?).into())
    }

    fn start_raw(&self, text: &str) -> Result<AxisRequest, Error> {
        let (server, axis, text) = (Arc::clone(&self.server), self.info.id, text.to_owned());
        let sent =
            self.gateway().spawn(move |_| server.with_lease(axis, move |lease| lease.raw(&text)));
        Ok(RemoteRequest::number(sent).into())
    }

    fn check_command(&self, command: Command) -> Result<(), Error> {
        Ok(self.check_verb(&command)?)
    }

    fn motion_state(&self, since: Instant, _velocity: bool) -> Result<MotionState, Error> {
        self.pushed_motion_state(since)
    }
}

impl AxisControl for RemoteAxis {
    fn arm(&self) -> Result<(), Error> {
        self.slot().arm()
    }

    fn disarm(&self) -> Result<(), Error> {
        self.slot().disarm()
    }

    fn is_armed(&self) -> bool {
        self.armed_lease().is_some_and(|lease| lease.check().is_ok())
    }

    fn check_control(&self) -> Result<(), Error> {
        self.check_lease()
    }

    fn stop(&self) -> Result<(), Error> {
        if !self.has_verb(Verb::Stop) {
            return Ok(stop_axes(self.gateway(), vec![self.info.id])?);
        }
        let mut pending = self.start_verb(&Command::new(Verb::Stop))?;
        match pending.wait(clock::scale_timeout(STOP_MAX))? {
            Some(()) => Ok(()),
            None => Err(self.late_error("stop")),
        }
    }

    fn release(&self) -> Result<(), Error> {
        let Some(lease) = self.armed_lease() else { return Ok(()) };
        let stopped = self.finish_stop(self.begin_stop());
        let disabled = if self.has_verb(Verb::Disable) && lease.check().is_ok() {
            let arguments = command_arguments(&Command::new(Verb::Disable));
            let within = clock::scale_timeout(REPLY_MAX);
            lease.run(Verb::Disable.name(), arguments, within).map_err(Error::from)
        } else {
            Ok(())
        };
        drop(lease);
        stopped.and(disabled).and(self.disarm())
    }
}

impl AxisReadings for RemoteAxis {
    fn signal_unit(&self, signal: Signal) -> String {
        let known = self.info.signals.iter().find(|known| known.signal == signal.name());
        known.map_or_else(String::new, |known| known.unit.clone())
    }

    fn signals(&self, signals: &[Signal]) -> Result<Vec<SignalReading>, Error> {
        if signals.is_empty() {
            return Ok(Vec::new());
        }
        let read = self.read_signals(signals)?;
        signals
            .iter()
            .map(|signal| {
                let found = read.iter().find(|reading| reading.signal == *signal).copied();
                found.ok_or_else(|| {
                    Error::from(GatewayError::new(
                        "E213",
                        format!("{}: the gateway sent no {}", self.info.label, signal.name()),
                    ))
                })
            })
            .collect()
    }

    fn signal_text(&self, signal: Signal) -> Result<Option<String>, Error> {
        if self.info.signals.iter().all(|known| known.signal != signal.name()) {
            return Ok(None);
        }
        let read = self.signals(&[signal])?;
        let value = read.first().map(|reading| reading.value).filter(|value| !value.is_nan());
        Ok(value.and_then(|value| self.format_signal(signal, value)))
    }

    fn format_signal(&self, signal: Signal, si: f64) -> Option<String> {
        Some(format_signal(&self.info, signal.name(), si, &self.signal_unit(signal)))
    }

    fn latest_value(&self, name: &str, hz: f64) -> Result<LatestValue, Error> {
        let is_signal = |known: &&SignalInfo| same_name(&known.signal, name);
        let signal = self.info.signals.iter().find(is_signal).map(|known| &*known.signal);
        let parameter = if signal.is_none() { Some(name) } else { None };
        let live = self.server.live_connection()?;
        let samples = live.subscribe(self.info.id, signal, parameter, hz)?;
        let unit = signal.and_then(|signal| drive_unit(&self.info, signal, samples.unit()));
        let (unit, si_factor) = match unit {
            Some(unit) => (unit.symbol().to_owned(), unit.si_factor()),
            None => (samples.unit().to_owned(), 1.0),
        };
        let periods = Duration::try_from_secs_f64(FRESH_PERIODS / hz).unwrap_or(Duration::MAX);
        let fresh = clock::scale_timeout(FRESH_MIN).max(periods);
        Ok(LatestValue::new(unit, move || {
            let last = samples.last(fresh)?;
            Ok(last.map_or(f64::NAN, |sample| sample.value / si_factor))
        }))
    }

    fn faults(&self) -> Result<Vec<FaultReport>, Error> {
        if self.info.signals.iter().any(|known| known.signal == Signal::Fault.name()) {
            self.read_signals(&[Signal::Fault])?;
        }
        let state = self.gateway().axis_state(self.info.id)?;
        Ok(state.faults.into_iter().map(FaultReport::from).collect())
    }

    fn device_details(&self) -> Result<Vec<DeviceDetail>, Error> {
        let details = self.gateway().device(self.info.id)?.into_iter();
        Ok(details.map(|item| DeviceDetail { name: item.name.into(), text: item.text }).collect())
    }

    fn watchdog(&self) -> Result<WatchdogReport, Error> {
        Ok(watchdog_report(self.gateway().watchdog(self.info.id)?))
    }

    fn set_watchdog(&self, after: Option<Duration>) -> Result<WatchdogReport, Error> {
        let (axis, after_ms) = (self.info.id, after.map(|after| after.as_secs_f64() * 1e3));
        let set = self.server.with_lease(axis, |lease| {
            let wanted = SetWatchdog { after_ms, epoch: lease.epoch() };
            self.gateway().set_watchdog(axis, &wanted)
        });
        Ok(watchdog_report(set?))
    }
}

impl AxisInterface for RemoteAxis {
    fn facts(&self) -> AxisFacts {
        axis_facts(&self.info)
    }

    fn remote(&self) -> Option<&RemoteAxis> {
        Some(self)
    }

    fn state(&self) -> Result<AxisSnapshot, Error> {
        Ok(axis_state(self.gateway().axis_state(self.info.id)?))
    }

    fn now(&self) -> Instant {
        clock::now()
    }

    fn sleep(&self, span: Duration) {
        clock::sleep_until(clock::now() + span);
    }
}

impl RemoteAxis {
    pub(super) fn late_error(&self, verb: &str) -> Error {
        let what = format!("{}: {verb} did not end in time", self.info.label);
        let late = GatewayError { executed: None, ..GatewayError::new("E101", what) };
        Error::from(late.hint("if the motor still turns, cut its supply"))
    }
}
