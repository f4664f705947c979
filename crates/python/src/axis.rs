//! One axis: parameters, verbs, events.

use std::borrow::Cow;
use std::time::Duration;

use polepair::interface::{AxisRequest, ParameterDescription, Reply, WatchdogKind, WriteValue};
use polepair::{Amount, Axis as Inner, Error, start_together};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::{ParameterId, Signal};
use pyo3::prelude::*;
use pyo3::pybacked::{PyBackedBytes, PyBackedStr};

use crate::blocking::{Blocking, WAIT_SLICE, wait_sliced};
use crate::drive_log::{self, DriveLogTuple, PyLogRequest};
use crate::errors::{to_py_error, usage_error};
use crate::events::PyEvents;
use crate::fault::{FaultTuple, fault_tuple};
use crate::guard;
use crate::process_local::ProcessLocal;
use crate::request::{PyReading, PyRequest};
use crate::watch::PyWatch;

/// Hint for bytes on a gateway.
const TEXT_HINT: &str = "send it as text of the protocol";
/// Hint for events on a gateway.
const EVENTS_HINT: &str = "watch signals, or read `state()` and `faults()` again";

/// An axis of a link.
#[pyclass(frozen, name = "Axis", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyAxis(ProcessLocal<Inner>);

impl From<Inner> for PyAxis {
    fn from(axis: Inner) -> Self {
        Self(axis.into())
    }
}

/// A parameter of a drive's profile.
#[pyclass(frozen, get_all, name = "Parameter", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyParameter {
    /// The name that users type.
    pub name: Cow<'static, str>,
    /// Designation in the manual.
    pub symbol: Cow<'static, str>,
    /// Description of the parameter.
    pub about: Cow<'static, str>,
    /// Unit of the parameter; empty for none.
    pub unit: Cow<'static, str>,
    /// Least and greatest raw value.
    pub raw_range: (i64, i64),
    /// Raw value from the factory.
    pub raw_default: Option<i64>,
    /// True if it can be read.
    pub readable: bool,
    /// True if it can be written.
    pub writable: bool,
    /// Persistence of a written value: volatile, storable, always, unless-ram.
    pub persistence: Cow<'static, str>,
    /// Writing it may move the motor.
    pub moves: bool,
    /// Names of raw values.
    pub words: Vec<(i64, Cow<'static, str>)>,
    /// Section of the manual.
    pub section: Cow<'static, str>,
}

#[pymethods]
impl PyParameter {
    fn __repr__(&self) -> String {
        let Self { name, symbol, unit, raw_range: (min, max), readable, writable, .. } = self;
        let symbol = if symbol.is_empty() { String::new() } else { format!(" ({symbol})") };
        let unit = if unit.is_empty() { String::new() } else { format!(" in {unit}") };
        let access = match (readable, writable) {
            (true, false) => ", read only",
            (false, true) => ", write only",
            _ => "",
        };
        format!("<Parameter {name}{symbol}{unit}: raw {min} to {max}{access}>")
    }
}

impl From<ParameterDescription> for PyParameter {
    fn from(described: ParameterDescription) -> Self {
        let ParameterDescription { name, symbol, about, unit, raw_range, raw_default, .. } =
            described;
        let ParameterDescription { readable, writable, persistence, moves, words, section, .. } =
            described;
        Self {
            name,
            symbol,
            about,
            unit,
            raw_range,
            raw_default,
            readable,
            writable,
            persistence,
            moves,
            words,
            section,
        }
    }
}

/// A number, SI or in a parameter's own unit; or text with a unit.
#[derive(FromPyObject, Debug)]
pub enum PyAmount {
    /// A number.
    Number(f64),
    /// Text.
    Text(String),
}

impl From<PyAmount> for Amount {
    fn from(given: PyAmount) -> Self {
        match given {
            PyAmount::Number(number) => Self::Number(number),
            PyAmount::Text(text) => Self::Text(text),
        }
    }
}

/// A request in a protocol's own words, or its own bytes.
#[derive(FromPyObject, Debug)]
pub enum RawPayload {
    /// `GAP 1`.
    Text(PyBackedStr),
    /// A whole frame.
    Bytes(PyBackedBytes),
}

impl RawPayload {
    fn start(&self, axis: &Inner, id: Option<u32>) -> Result<AxisRequest, Error> {
        match self {
            Self::Text(text) if id.is_none() => axis.interface().start_raw(text),
            Self::Text(text) => axis
                .require_local("CAN identifiers of requests", TEXT_HINT)?
                .start_raw(text)
                .map(Into::into),
            Self::Bytes(bytes) => axis
                .require_local("bytes as requests", TEXT_HINT)?
                .start_raw_bytes(bytes, id)
                .map(Into::into),
        }
    }
}

/// A value to be written: a raw number, or what [`PyAxis::raw_of`] made of an amount.
#[derive(FromPyObject, Debug)]
pub enum WriteInput {
    /// An amount that the gateway converts.
    Amount(Py<PyWriteAmount>),
    /// A raw number.
    Raw(i64),
}

/// An amount that is converted where the drive's scale is known.
#[pyclass(frozen, name = "WriteAmount", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyWriteAmount(Amount);

impl WriteInput {
    fn into_value(self) -> WriteValue {
        match self {
            Self::Amount(amount) => WriteValue::Amount(amount.get().0.clone()),
            Self::Raw(raw) => WriteValue::Raw(raw),
        }
    }
}

/// A raw number, or a gateway's reading.
#[derive(FromPyObject, Debug)]
pub enum ReadInput {
    /// A gateway's reading.
    Reading(Py<PyReading>),
    /// A raw number.
    Raw(i64),
}

/// Result of [`PyAxis::raw_of`].
#[derive(IntoPyObject)]
pub enum WriteOutput {
    /// A raw number.
    Raw(i64),
    /// An amount that the gateway converts.
    Amount(PyWriteAmount),
}

impl PyAxis {
    /// The library's axis, in the process that opened its link.
    pub fn inner(&self, py: Python<'_>) -> PyResult<&Inner> {
        self.0.in_own_process(py)
    }
}

#[pymethods]
impl PyAxis {
    #[getter]
    fn number(&self) -> u32 {
        self.0.number()
    }

    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }

    #[getter]
    fn label(&self) -> &str {
        self.0.label()
    }

    #[getter]
    fn protocol(&self) -> &str {
        &self.0.facts().protocol
    }

    /// Returns whether it belongs to a gateway.
    #[getter]
    fn is_remote(&self) -> bool {
        self.0.remote().is_some()
    }

    /// The product's name and full title.
    #[getter]
    fn product(&self) -> (&str, &str) {
        (&self.0.facts().profile, &self.0.facts().title)
    }

    /// Checks before and after the first motion.
    #[getter]
    fn caution(&self) -> &str {
        &self.0.facts().caution
    }

    /// Reaction of the drive when its host is silent: `none`, `fixed` with its seconds, `configurable` by a parameter,
    /// or `heartbeat` with the parameter for its sender, if this link sends one.
    #[getter]
    fn watchdog(&self) -> (&'static str, Option<f64>, Option<&str>) {
        match &self.0.facts().watchdog {
            WatchdogKind::None => ("none", None, None),
            WatchdogKind::Fixed(after) => ("fixed", Some(*after), None),
            WatchdogKind::Configurable(parameter) => ("configurable", None, Some(parameter)),
            WatchdogKind::Heartbeat(parameter) => ("heartbeat", None, parameter.as_deref()),
        }
    }

    /// Sets the drive's watchdog to `seconds` of silence. Returns the earlier setting as names and raw values; nothing
    /// if it cannot be read.
    fn set_watchdog(&self, py: Python<'_>, seconds: f64) -> PyResult<Vec<(String, i64)>> {
        let after = Duration::try_from_secs_f64(seconds)
            .map_err(|_| usage_error(py, "E216", &format!("{seconds} s is no time"), "say 0.5"))?;
        self.call(py, move |axis| {
            let before = match axis.local() {
                Some(local) => {
                    let name = |id| local.parameter(id).map(|its| its.name.to_owned());
                    let setting = local.watchdog_setting()?.into_iter().flatten();
                    setting.filter_map(|(id, raw)| Some((name(id)?, raw))).collect()
                }
                None => match axis.watchdog()?.parameter {
                    Some(name) => axis.get_raw(&name).map(|raw| (name, raw)).into_iter().collect(),
                    None => Vec::new(),
                },
            };
            axis.set_watchdog(Some(after))?;
            Ok(before)
        })
    }

    /// Returns whether its parameters are known without a request.
    #[getter]
    fn is_known(&self) -> bool {
        self.0.remote().is_none_or(|remote| remote.has_parameters())
    }

    /// Starts `stop` or `disable` of axes that this program armed; `None` if there are none.
    fn start_own(&self, py: Python<'_>, verb: &str) -> PyResult<Option<PyRequest>> {
        if self.0.remote().is_none() {
            return self.start(py, verb, None, None, None, None, None, None).map(Some);
        }
        let verb = parse_verb(py, verb)?;
        let started = self.detach(py, |axis| match axis.remote() {
            Some(remote) => remote.start_by_lease(verb),
            None => Ok(None),
        });
        Ok(started?.map(PyRequest::new))
    }

    /// Every parameter.
    fn parameters(&self, py: Python<'_>) -> PyResult<Vec<PyParameter>> {
        let described = self.call(py, Inner::parameters)?;
        Ok(described.into_iter().map(PyParameter::from).collect())
    }

    /// Returns whether there is a parameter of that name.
    fn has(&self, py: Python<'_>, name: &str) -> PyResult<bool> {
        let name = name.to_owned();
        self.call(py, move |axis| match axis.local() {
            Some(local) => Ok(local.find(&name).is_ok()),
            None => Ok(axis.parameters()?.iter().any(|its| its.is_called(&name))),
        })
    }

    /// The number of the parameter of that name, or at that address.
    fn find(&self, py: Python<'_>, name: &str) -> PyResult<u16> {
        let name = name.to_owned();
        self.call(py, move |axis| axis.find(&name).map(|id| id.0))
    }

    /// Starts to read a parameter.
    fn start_read(&self, py: Python<'_>, id: u16) -> PyResult<PyRequest> {
        self.start_request(py, |axis| axis.interface().start_read(ParameterId(id)))
    }

    /// Starts to write a parameter.
    fn start_write(
        &self,
        py: Python<'_>,
        id: u16,
        raw: WriteInput,
        keep: bool,
    ) -> PyResult<PyRequest> {
        let value = raw.into_value();
        self.start_request(py, |axis| axis.interface().start_write(ParameterId(id), &value, keep))
    }

    /// Starts a request in the protocol's own text or bytes, on CAN with their identifier.
    #[pyo3(signature = (said, id=None))]
    fn start_raw(&self, py: Python<'_>, said: RawPayload, id: Option<u32>) -> PyResult<PyRequest> {
        self.start_request(py, |axis| said.start(axis, id))
    }

    /// Reads a parameter by name, raw.
    fn read_raw(&self, py: Python<'_>, name: &str) -> PyResult<i64> {
        let reply = self.run_request(py, |axis| axis.interface().start_read(axis.find(name)?))?;
        reply.raw(name).map_err(|error| to_py_error(py, &error))
    }

    /// Writes a parameter by name, raw.
    fn write_raw(&self, py: Python<'_>, name: &str, raw: i64) -> PyResult<()> {
        self.run_request(py, |axis| {
            axis.interface().start_write(axis.find(name)?, &WriteValue::Raw(raw), false)
        })
        .map(drop)
    }

    /// Sends a request in the protocol's own text or bytes, and waits for the reply.
    #[pyo3(signature = (said, id=None))]
    fn raw(&self, py: Python<'_>, said: RawPayload, id: Option<u32>) -> PyResult<i64> {
        let reply = self.run_request(py, |axis| said.start(axis, id))?;
        reply.raw("the reply").map_err(|error| to_py_error(py, &error))
    }

    /// The raw value of an amount for the parameter that the caller wrote as `name`; may read what its scale
    /// depends on. A gateway converts it when it writes.
    fn raw_of(
        &self,
        py: Python<'_>,
        name: &str,
        id: u16,
        amount: PyAmount,
    ) -> PyResult<WriteOutput> {
        let amount = self.detach(py, |axis| {
            axis.interface().amount_for_name(name, ParameterId(id), amount.into())
        })?;
        if self.0.local().is_none() {
            return Ok(WriteOutput::Amount(PyWriteAmount(amount)));
        }
        let raw = self.detach(py, |axis| {
            axis.require_local("raw values", "")?.raw_of(ParameterId(id), &amount)
        });
        raw.map(WriteOutput::Raw)
    }

    /// A reading as value, unit, word and text; may read what its scale depends on.
    fn value(&self, py: Python<'_>, id: u16, read: ReadInput) -> PyResult<ValueTuple> {
        let reply = match read {
            ReadInput::Reading(reading) => Reply::Reading(reading.get().0.clone()),
            ReadInput::Raw(raw) => Reply::Raw(raw),
        };
        let read = self.detach(py, |axis| axis.interface().reading(ParameterId(id), reply))?;
        Ok((read.value, read.unit, read.word, read.text))
    }

    /// Reads text or bytes of a parameter, whatever its length.
    fn read_data(&self, py: Python<'_>, id: u16) -> PyResult<Vec<u8>> {
        self.call(py, move |axis| axis.interface().read_data(ParameterId(id)))
    }

    /// Writes all bytes of a parameter of any length.
    fn write_data(&self, py: Python<'_>, id: u16, data: PyBackedBytes) -> PyResult<()> {
        self.detach(py, |axis| axis.interface().write_data(ParameterId(id), &data))
    }

    /// Records in the drive's memory: interval in seconds, and name, SI unit and values of each variable.
    fn record_in_drive(
        &self,
        py: Python<'_>,
        request: PyLogRequest,
        start: Option<Py<PyAny>>,
    ) -> PyResult<DriveLogTuple> {
        drive_log::record(py, self, &request, start.as_ref())
    }

    /// Starts a verb. Arguments are SI numbers or text with a unit.
    #[pyo3(signature = (
        verb, target=None, velocity=None, acceleration=None, torque=None, jerk_time=None,
        deceleration=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "they are a command's")]
    fn start(
        &self,
        py: Python<'_>,
        verb: &str,
        target: Option<PyAmount>,
        velocity: Option<PyAmount>,
        acceleration: Option<PyAmount>,
        torque: Option<PyAmount>,
        jerk_time: Option<PyAmount>,
        deceleration: Option<PyAmount>,
    ) -> PyResult<PyRequest> {
        let given = [target, velocity, acceleration, torque, jerk_time, deceleration];
        let command = self.parse_command(py, verb, given)?;
        self.start_request(py, |axis| axis.start(command))
    }

    /// Converts an amount to SI, as an argument of a verb: `target`, `velocity`, `torque`.
    fn in_si(&self, py: Python<'_>, verb: &str, argument: &str, amount: PyAmount) -> PyResult<f64> {
        let mut given = [None, None, None, None, None, None];
        let places = ["target", "velocity", "acceleration", "torque"];
        let no_such = || usage_error(py, "E217", &format!("there is no argument `{argument}`"), "");
        let at = places.iter().position(|name| *name == argument).ok_or_else(no_such)?;
        given[at] = Some(amount);
        let Command { target, velocity, acceleration, torque, .. } =
            self.parse_command(py, verb, given)?;
        [target, velocity, acceleration, torque][at].ok_or_else(no_such)
    }

    /// Allows motion commands, or no longer. An axis that is armed on a wire of this program is stopped when the
    /// process ends. `Unsupported` E220 for an axis that is armed already.
    fn arm(&self, py: Python<'_>, armed: bool) -> PyResult<()> {
        let axis = self.inner(py)?;
        if let Some(remote) = axis.remote() {
            // An interrupted caller disarms after the requests that were begun here.
            let lock = wait_sliced(py, None, |slice| Ok(remote.lock_lease_within(slice)))?;
            let Some(lease) = lock else { return Ok(()) };
            return Blocking::start(remote.gateway(), move || {
                if armed { lease.arm() } else { lease.disarm() }
            })
            .wait(py);
        }
        self.detach(py, |axis| if armed { axis.arm() } else { axis.disarm() })?;
        if let Some(local) = axis.local() {
            if armed {
                guard::register_armed(py, local)
            } else {
                py.detach(|| guard::unregister_armed(local))
            }
        }
        Ok(())
    }

    /// Returns whether motion commands of this program are allowed.
    #[getter]
    fn is_armed(&self, py: Python<'_>) -> PyResult<bool> {
        self.detach(py, |axis| Ok(axis.is_armed()))
    }

    /// Listens to what happens to this axis and its link from now on.
    fn events(&self, py: Python<'_>) -> PyResult<PyEvents> {
        let events = self.detach(py, |axis| axis.require_local("events", EVENTS_HINT)?.events())?;
        let axes = self.inner(py)?.local().cloned().into_iter().collect();
        Ok(PyEvents::new(events, axes))
    }

    /// Reads how what the drive sends by itself is laid out, as far as it is not known.
    fn learn(&self, py: Python<'_>) -> PyResult<()> {
        self.detach(py, |axis| axis.require_local("events", EVENTS_HINT)?.read_event_layout())
    }

    /// Verbs of this drive.
    fn verbs(&self) -> Vec<&'static str> {
        self.0.facts().verbs.iter().map(|verb| verb.name()).collect()
    }

    /// Signals that this drive reports, with the units of its parameters; those of a gateway in SI.
    fn signals(&self) -> Vec<(&'static str, String)> {
        let unit = |signal: Signal| {
            let Some(local) = self.0.local() else { return self.0.signal_unit(signal) };
            let source = local.profile().signal(signal).filter(|source| !source.is_flag());
            let parameter = source.and_then(|source| local.parameter(source.parameter));
            parameter.map_or_else(String::new, |its| its.unit.symbol().to_owned())
        };
        self.0.facts().signals.iter().map(|signal| (signal.name(), unit(*signal))).collect()
    }

    /// The units in which signals are read, SI as people write it; empty for none.
    fn signal_units(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Vec<String>> {
        names.iter().map(|name| Ok(self.0.signal_unit(parse_signal(py, name)?))).collect()
    }

    /// Reads signals now, in SI.
    fn read_signals(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Vec<f64>> {
        let signals = parse_signals(py, &names)?;
        let readings = self.call(py, move |axis| axis.signals(&signals))?;
        Ok(readings.into_iter().map(|reading| reading.value).collect())
    }

    /// Active faults: code, text, cause, remedy, and whether the drive continues.
    fn faults(&self, py: Python<'_>) -> PyResult<Vec<FaultTuple>> {
        Ok(self.call(py, Inner::faults)?.into_iter().map(fault_tuple).collect())
    }

    /// The last known state, without a request to the drive.
    fn state(&self, py: Python<'_>) -> PyResult<AxisStateTuple> {
        let state = self.call(py, Inner::state)?;
        let readings = state
            .signals
            .into_iter()
            .map(|its| (its.signal.name().to_owned(), its.value, its.age.as_secs_f64()))
            .collect();
        Ok((state.mode, state.enabled, state.armed, state.moving, readings, state.owner))
    }

    /// Watches signals of a gateway's axis, a row each `period` seconds, or as often as it sends them.
    fn watch(&self, py: Python<'_>, names: Vec<String>, period: f64) -> PyResult<PyWatch> {
        let signals = parse_signals(py, &names)?;
        let Some(remote) = self.inner(py)?.remote().cloned() else {
            return Err(usage_error(py, "E257", "only a gateway has subscriptions", "use read()"));
        };
        let gateway = remote.gateway().clone();
        Blocking::start(&gateway, move || remote.subscribe(&signals, period).map(PyWatch::new))
            .wait(py)
    }

    /// Seconds on the link's clock.
    #[getter]
    fn now(&self, py: Python<'_>) -> PyResult<f64> {
        let now = self.detach(py, |axis| Ok(axis.now()))?;
        Ok(now.since(polepair_core::time::Instant::ZERO).as_secs_f64())
    }

    /// Waits on the link's clock: in virtual time it is over at once.
    fn sleep(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let mut left = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO);
        while left > Duration::ZERO {
            let slice = left.min(WAIT_SLICE);
            self.detach(py, |axis| {
                axis.sleep(slice);
                Ok(())
            })?;
            left -= slice;
            py.check_signals()?;
        }
        Ok(())
    }
}

/// Value, unit, word, text.
type ValueTuple = (f64, Cow<'static, str>, Option<Cow<'static, str>>, String);

/// Mode, powered, armed, moving; signals with values and their age in seconds; who commands it.
pub type AxisStateTuple =
    (Option<String>, Option<bool>, bool, Option<bool>, Vec<(String, f64, f64)>, Option<String>);

/// A move of one axis: verb, target, velocity, acceleration.
type SyncedMove<'py> =
    (Bound<'py, PyAxis>, String, Option<PyAmount>, Option<PyAmount>, Option<PyAmount>);

/// Starts moves of several axes of one wire at one signal on the bus.
#[pyfunction]
pub fn begin_together(py: Python<'_>, moves: Vec<SyncedMove<'_>>) -> PyResult<()> {
    let moves = moves.into_iter().map(|(axis, verb, target, velocity, acceleration)| {
        let axis = axis.get();
        let hint = "sync=False starts one after the other; or open the link in this program";
        let local = axis.inner(py)?.require_local("a start at one signal", hint);
        let local = local.map_err(|error| to_py_error(py, &error))?.clone();
        let command =
            axis.parse_command(py, &verb, [target, velocity, acceleration, None, None, None])?;
        Ok((local, command))
    });
    let moves = ProcessLocal::from(moves.collect::<PyResult<Vec<_>>>()?);
    py.detach(|| start_together(&moves)).map_err(|error| to_py_error(py, &error))
}

impl PyAxis {
    /// Runs what ends soon, while other threads continue.
    pub fn detach<T: Send>(
        &self,
        py: Python<'_>,
        call: impl Send + FnOnce(&Inner) -> Result<T, Error>,
    ) -> PyResult<T> {
        let axis = self.inner(py)?;
        py.detach(|| call(axis)).map_err(|error| to_py_error(py, &error))
    }

    /// Runs a call that may wait for a gateway, while other threads continue and Ctrl-C is looked for.
    fn call<T: Send + 'static>(
        &self,
        py: Python<'_>,
        call: impl Send + FnOnce(&Inner) -> Result<T, Error> + 'static,
    ) -> PyResult<T> {
        let axis = self.inner(py)?.clone();
        let Some(gateway) = axis.remote().map(|remote| remote.gateway().clone()) else {
            return self.detach(py, call);
        };
        Blocking::start(&gateway, move || call(&axis)).wait(py)
    }

    /// Starts a request and waits for its end, in one turn if that comes soon.
    fn run_request(
        &self,
        py: Python<'_>,
        start: impl Send + FnOnce(&Inner) -> Result<AxisRequest, Error>,
    ) -> PyResult<Reply> {
        let started = self.detach(py, |axis| {
            let mut request = start(axis)?;
            Ok(match request.wait(WAIT_SLICE)? {
                Some(reply) => Ok(reply),
                None => Err(request),
            })
        })?;
        started.or_else(|request| PyRequest::new(request).finish(py))
    }

    /// A verb with its arguments: target, velocity, acceleration, torque, jerk time,
    /// deceleration.
    fn parse_command(
        &self,
        py: Python<'_>,
        verb: &str,
        given: [Option<PyAmount>; 6],
    ) -> PyResult<Command> {
        let verb = parse_verb(py, verb)?;
        let [target, velocity, acceleration, torque, jerk_time, deceleration] = given;
        Ok(Command {
            target: self.verb_argument(Argument::Target, target, verb, py)?,
            velocity: self.verb_argument(Argument::Velocity, velocity, verb, py)?,
            acceleration: self.verb_argument(Argument::Acceleration, acceleration, verb, py)?,
            deceleration: self.verb_argument(Argument::Deceleration, deceleration, verb, py)?,
            torque: self.verb_argument(Argument::Torque, torque, verb, py)?,
            jerk_time: self.verb_argument(Argument::JerkTime, jerk_time, verb, py)?,
            ..Command::new(verb)
        })
    }

    fn verb_argument(
        &self,
        which: Argument,
        given: Option<PyAmount>,
        verb: Verb,
        py: Python<'_>,
    ) -> Result<Option<f64>, PyErr> {
        let amount = given.map(Amount::from);
        let value = amount.map(|amount| self.0.argument(verb, which, &amount)).transpose();
        value.map_err(|error| to_py_error(py, &error))
    }

    pub fn start_request(
        &self,
        py: Python<'_>,
        start: impl Send + FnOnce(&Inner) -> Result<AxisRequest, Error>,
    ) -> PyResult<PyRequest> {
        self.detach(py, start).map(PyRequest::new)
    }
}

fn parse_verb(py: Python<'_>, verb: &str) -> PyResult<Verb> {
    let known = Verb::ALL.into_iter().find(|known| known.name() == verb);
    known.ok_or_else(|| usage_error(py, "E217", &format!("there is no verb `{verb}`"), ""))
}

/// Returns whether that is the name of a signal, which not every drive has.
#[pyfunction]
pub fn is_signal(name: &str) -> bool {
    find_signal(name).is_some()
}

fn find_signal(name: &str) -> Option<Signal> {
    let plain = name.replace('_', " ");
    Signal::from_name(&plain)
}

/// The signal of that name.
pub fn parse_signal(py: Python<'_>, name: &str) -> PyResult<Signal> {
    find_signal(name).ok_or_else(|| {
        let all: Vec<_> = Signal::ALL.iter().map(|signal| signal.name()).collect();
        let what = format!("there is no signal `{name}`");
        usage_error(py, "E213", &what, &format!("signals are {}", all.join(", ")))
    })
}

fn parse_signals(py: Python<'_>, names: &[String]) -> PyResult<Vec<Signal>> {
    names.iter().map(|name| parse_signal(py, name)).collect()
}
