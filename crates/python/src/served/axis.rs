//! One axis of a server, with the methods of a local one.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

use polepair::quantity;
use polepair_client::message::{
    ActiveFault, ArgumentInfo, AxisInfo, CommandArguments, ParameterInfo, ParameterInput as Said,
    ParameterReading, SignalValue, WriteParameters,
};
use polepair_client::{GatewayError, Lease, PendingOperation, display_unit};
use polepair_core::profile::same_name;
use polepair_core::time::Instant;
use polepair_link::clock;
use pyo3::prelude::*;

use super::request::{
    PendingAction, ServedAmount, ServedRead, ServedRequest, require_result, wait_end, wait_sliced,
};
use super::watch::ServedWatch;
use super::{ANSWER_MAX, RemoteServer, unsupported_error};
use crate::axis::{AxisStateTuple, PyAmount, PyParameter, parse_signal};
use crate::errors::{refused_to_py_error, to_py_error, usage_error};
use crate::process_local::ProcessLocal;
use crate::request::WAIT_SLICE;

/// How often a server sends a signal at most.
const HZ_MAX: f64 = 1000.0;

/// An axis of a server.
#[pyclass(frozen, name = "ServedAxis", module = "polepair._polepair")]
#[derive(Debug)]
pub struct ServedAxis {
    server: ProcessLocal<Arc<RemoteServer>>,
    info: AxisInfo,
}

/// Code, name, text, cause, remedy, and whether it is a warning only.
type RemoteFaultTuple = (u32, String, String, String, String, bool);

/// A raw value, or what the server is to make one of.
#[derive(FromPyObject, Debug)]
enum WriteValue {
    Amount(Py<ServedAmount>),
    Raw(i64),
}

impl From<&ParameterInfo> for PyParameter {
    fn from(info: &ParameterInfo) -> Self {
        let owned = |text: &String| Cow::Owned(text.clone());
        let words = info.word_values.iter().copied().zip(info.words.iter().map(owned));
        Self {
            name: owned(&info.name),
            symbol: owned(&info.symbol),
            about: owned(&info.about),
            unit: owned(&info.unit),
            raw_range: (info.raw_min, info.raw_max),
            raw_default: info.raw_default,
            readable: info.readable,
            writable: info.writable,
            persistence: owned(&info.persistence),
            moves: info.moves,
            words: words.collect(),
            section: owned(&info.group),
        }
    }
}

#[pymethods]
impl ServedAxis {
    #[getter]
    fn number(&self) -> u32 {
        self.info.number
    }

    #[getter]
    fn name(&self) -> &str {
        &self.info.name
    }

    #[getter]
    fn label(&self) -> &str {
        &self.info.label
    }

    #[getter]
    fn protocol(&self) -> &str {
        &self.info.protocol
    }

    /// The product's name and full title.
    #[getter]
    fn product(&self) -> (&str, &str) {
        (&self.info.profile, &self.info.drive)
    }

    /// What to check before and after the first motion.
    #[getter]
    fn caution(&self) -> &str {
        &self.info.caution
    }

    /// What the drive does when nobody talks to it: `none`, `fixed` with its seconds, or
    /// `configurable` by a parameter.
    #[getter]
    fn watchdog(&self) -> (&'static str, Option<f64>, Option<&str>) {
        match (self.info.watchdog_ms, self.info.watchdog_parameter.as_deref()) {
            (Some(after_ms), _) => ("fixed", Some(f64::from(after_ms) / 1e3), None),
            (None, Some(parameter)) => ("configurable", None, Some(parameter)),
            (None, None) => ("none", None, None),
        }
    }

    /// Whether its parameters are known without asking.
    #[getter]
    fn is_known(&self) -> bool {
        self.server.parameters[usize::from(self.info.id)].get().is_some()
    }

    /// Every parameter.
    fn parameters(&self, py: Python<'_>) -> PyResult<Vec<PyParameter>> {
        let id = self.info.id;
        self.query_server(py, move |joined| joined.parameters(id).map(drop))?;
        self.run_detached(py, |joined| {
            Ok(joined.parameters(id)?.iter().map(PyParameter::from).collect())
        })
    }

    /// Whether there is a parameter of that name.
    fn has(&self, py: Python<'_>, name: &str) -> PyResult<bool> {
        let id = self.info.id;
        self.query_server(py, move |joined| joined.parameters(id).map(drop))?;
        let has = |its: &ParameterInfo| same_name(&its.name, name) || same_name(&its.symbol, name);
        self.run_detached(py, |joined| Ok(joined.parameters(id)?.iter().any(has)))
    }

    /// The number of the parameter of that name, or at that address.
    fn find(&self, py: Python<'_>, name: &str) -> PyResult<u16> {
        let (id, name) = (self.info.id, name.to_owned());
        self.query_server(py, move |joined| {
            let has =
                |its: &ParameterInfo| same_name(&its.name, &name) || same_name(&its.symbol, &name);
            let at = joined.parameters(id)?.iter().position(has);
            if let Some(at) = at.and_then(|at| u16::try_from(at).ok()) {
                return Ok(at);
            }
            if let Some(at) = joined.find_address(id, &name) {
                return Ok(at);
            }
            // The server knows addresses, and the nearest name.
            joined.gateway.parameter(id, &name)?;
            joined.add_address(id, name)
        })
    }

    /// Begins to read a parameter.
    fn start_read(&self, py: Python<'_>, id: u16) -> PyResult<ServedRequest> {
        let (axis, name) = (self.info.id, self.parameter_name(py, id)?);
        let read = self
            .server
            .in_own_process(py)?
            .gateway
            .spawn(move |gateway| gateway.parameter(axis, &name));
        Ok(ServedRequest::new(PendingAction::Read(read)))
    }

    /// Begins to write a parameter.
    fn start_write(
        &self,
        py: Python<'_>,
        id: u16,
        wanted: WriteValue,
        keep: bool,
    ) -> PyResult<ServedRequest> {
        self.begin_write(py, id, &wanted, keep)
            .map(|written| ServedRequest::new(PendingAction::Command(written)))
    }

    /// Begins a request in the protocol's own text.
    #[pyo3(signature = (said, id=None))]
    fn start_raw(
        &self,
        py: Python<'_>,
        said: &Bound<'_, PyAny>,
        id: Option<u32>,
    ) -> PyResult<ServedRequest> {
        self.begin_raw(py, said, id)
            .map(|pending| ServedRequest::new(PendingAction::Number(pending)))
    }

    /// Reads a parameter by name, raw.
    fn read_raw(&self, py: Python<'_>, name: &str) -> PyResult<i64> {
        let (axis, name) = (self.info.id, name.to_owned());
        let joined = self.server.in_own_process(py)?;
        let read = joined.gateway.spawn(move |gateway| gateway.parameter(axis, &name));
        let read = wait_end(py, read)?;
        raw_number(py, &read)
    }

    /// Writes a parameter by name, raw.
    fn write_raw(&self, py: Python<'_>, name: &str, raw: i64) -> PyResult<()> {
        let id = self.find(py, name)?;
        let written = self.begin_write(py, id, &WriteValue::Raw(raw), false)?;
        wait_end(py, written)
    }

    /// Sends a request in the protocol's own text, and waits for the answer.
    #[pyo3(signature = (said, id=None))]
    fn raw(&self, py: Python<'_>, said: &Bound<'_, PyAny>, id: Option<u32>) -> PyResult<i64> {
        let pending = self.begin_raw(py, said, id)?;
        wait_end(py, pending)
    }

    /// Reads text or bytes of a parameter.
    fn read_data(&self, py: Python<'_>, id: u16) -> PyResult<Vec<u8>> {
        let (axis, name) = (self.info.id, self.parameter_name(py, id)?);
        let joined = self.server.in_own_process(py)?;
        let read = joined.gateway.spawn(move |gateway| gateway.parameter(axis, &name));
        let read = wait_end(py, read)?;
        match read.kind.as_str() {
            "text" => Ok(read.text.into_bytes()),
            "bytes" => read.text.split(' ').map(|digits| parse_byte(py, digits)).collect(),
            _ => Err(usage_error(py, "E213", &format!("`{}` is a number", read.name), "get it")),
        }
    }

    /// A server writes numbers only.
    #[expect(clippy::unused_self, reason = "a local axis writes them")]
    fn write_data(&self, py: Python<'_>, id: u16, data: &[u8]) -> PyResult<()> {
        let _ = (id, data);
        let what = "a server writes no text and no bytes";
        Err(usage_error(py, "E257", what, "open the link in this program"))
    }

    /// What the server is to make a raw value of.
    #[expect(clippy::unused_self, reason = "a local axis looks into its profile")]
    fn raw_of(&self, _id: u16, amount: PyAmount) -> ServedAmount {
        ServedAmount(match amount {
            PyAmount::Number(number) => Said::Number(number),
            PyAmount::Text(text) => Said::Text(text),
        })
    }

    /// What was read as value, unit, word and text.
    #[expect(clippy::unused_self, reason = "a local axis looks into its profile")]
    fn value(&self, _id: u16, read: &ServedRead) -> (f64, String, Option<String>, String) {
        let read = &read.0;
        let value = read.value.unwrap_or(f64::NAN);
        (value, read.unit.clone(), read.word.clone(), read.text.clone())
    }

    /// Begins a verb. Arguments are SI numbers or text with a unit.
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
    ) -> PyResult<ServedRequest> {
        let argument = |name, given: Option<PyAmount>| {
            given.map(|given| self.amount_to_si(py, verb, name, &given)).transpose()
        };
        let arguments = CommandArguments {
            target: argument("target", target)?,
            velocity: argument("velocity", velocity)?,
            acceleration: argument("acceleration", acceleration)?,
            deceleration: argument("deceleration", deceleration)?,
            torque: argument("torque", torque)?,
            jerk_time: argument("jerk_time", jerk_time)?,
            period: None,
        };
        let started = self.run_detached(py, |joined| self.start_verb(joined, verb, arguments))?;
        Ok(ServedRequest::new(PendingAction::Command(started)))
    }

    /// What an amount is in SI, as an argument of a verb: `target`, `velocity`, `torque`.
    fn in_si(&self, py: Python<'_>, verb: &str, argument: &str, amount: PyAmount) -> PyResult<f64> {
        self.amount_to_si(py, verb, argument, &amount)
    }

    /// Takes the axis and lets motion through, or no longer and gives it back.
    fn arm(&self, py: Python<'_>, armed: bool) -> PyResult<()> {
        let (id, joined) = (self.info.id, self.server.in_own_process(py)?);
        // Whoever is interrupted and disarms comes after what was begun here.
        let change = require_result(
            py,
            wait_sliced(py, None, |slice| Ok(joined.lock_slot_within(id, slice))),
        )?;
        let done = move |_: &_| if armed { change.arm() } else { change.disarm() };
        wait_end(py, joined.gateway.spawn(done))
    }

    /// Whether motion commands of this program are let through.
    #[getter]
    fn is_armed(&self, py: Python<'_>) -> PyResult<bool> {
        let id = self.info.id;
        self.run_detached(py, |joined| {
            Ok(joined.armed_lease(id).is_some_and(|lease| lease.check().is_ok()))
        })
    }

    /// Begins `stop` or `disable` by the lease of who armed it here, so that nobody else's motion is
    /// stopped; `None` when nobody has armed it.
    fn start_own(&self, py: Python<'_>, verb: &str) -> PyResult<Option<ServedRequest>> {
        let id = self.info.id;
        let started = self.run_detached(py, |joined| {
            let Some(lease) = joined.armed_lease(id) else { return Ok(None) };
            lease.check()?;
            lease.start(verb, CommandArguments::default()).map(Some)
        })?;
        Ok(started.map(|started| ServedRequest::new(PendingAction::Command(started))))
    }

    fn events(&self, py: Python<'_>) -> PyResult<()> {
        Err(unsupported_error(
            py,
            "listening to events",
            "watch signals, or ask `state()` and `faults()` again",
        ))
    }

    /// Verbs that this drive has a plan for, and that a server lets through.
    fn verbs(&self) -> Vec<&str> {
        let verbs = self.info.verbs.iter().map(|info| &*info.verb);
        verbs.filter(|verb| !["arm", "disarm"].contains(verb)).collect()
    }

    /// Signals that this drive tells, with their SI units.
    fn signals(&self) -> Vec<(&str, &str)> {
        self.info.signals.iter().map(|signal| (&*signal.signal, &*signal.unit)).collect()
    }

    /// The units in which signals are read, SI as people write it; empty for none.
    fn signal_units(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Vec<&str>> {
        let unit = |name: &String| {
            let wanted = parse_signal(py, name)?.name();
            let signal_info = self.info.signals.iter().find(|signal| signal.signal == wanted);
            Ok(signal_info.map_or("", |signal| &*signal.unit))
        };
        names.iter().map(unit).collect()
    }

    /// Reads signals now, in SI.
    fn read_signals(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Vec<f64>> {
        if names.is_empty() {
            return Ok(Vec::new());
        }
        let axis = self.info.id;
        let read = self.server.in_own_process(py)?.gateway.spawn(move |gateway| {
            let words: Vec<String> = names.iter().map(|name| name.replace('_', " ")).collect();
            gateway.signals(axis, &words.iter().map(String::as_str).collect::<Vec<_>>())
        });
        let read = wait_end(py, read)?;
        Ok(read.into_iter().map(|read| read.value.unwrap_or(f64::NAN)).collect())
    }

    /// Faults that are there now: code, text, cause, remedy, and whether the drive goes on.
    fn faults(&self, py: Python<'_>) -> PyResult<Vec<RemoteFaultTuple>> {
        let axis = self.info.id;
        let pending = self.server.in_own_process(py)?.gateway.spawn(move |gateway| {
            gateway.signals(axis, &["fault"])?;
            Ok(gateway.axis_state(axis)?.faults)
        });
        let fault = |active_fault: ActiveFault| {
            (
                active_fault.code,
                active_fault.symbol,
                active_fault.name,
                active_fault.cause,
                active_fault.remedy,
                active_fault.warning,
            )
        };
        Ok(wait_end(py, pending)?.into_iter().map(fault).collect())
    }

    /// What the server knows of it.
    fn state(&self, py: Python<'_>) -> PyResult<AxisStateTuple> {
        let axis = self.info.id;
        let pending =
            self.server.in_own_process(py)?.gateway.spawn(move |gateway| gateway.axis_state(axis));
        let state = wait_end(py, pending)?;
        let reading =
            |read: SignalValue| (read.signal, read.value.unwrap_or(f64::NAN), read.age_ms / 1e3);
        let readings = state.signals.into_iter().map(reading).collect();
        let owner = state.lease.map(|lease| lease.owner);
        Ok((state.mode, state.enabled, state.armed, state.moving, readings, owner))
    }

    /// Watches signals, one row each `period` seconds, or as often as a server sends them; they come
    /// by themselves.
    fn watch(&self, py: Python<'_>, names: Vec<String>, period: f64) -> PyResult<ServedWatch> {
        if names.is_empty() {
            return Err(usage_error(py, "E213", "no signal is named", "name what to watch"));
        }
        if !(period.is_finite() && period >= 0.0) {
            let what = format!("a period of {period} s");
            return Err(usage_error(
                py,
                "E217",
                &what,
                "give seconds, or 0 for as often as can be",
            ));
        }
        let (axis, hz) = (self.info.id, (1.0 / period).min(HZ_MAX));
        let words: Vec<String> = names.iter().map(|name| name.replace('_', " ")).collect();
        let requests = self.query_server(py, move |joined| {
            let live = joined.live_connection()?;
            let watch = |word: &String| live.subscribe(axis, Some(word), None, hz).map(Arc::new);
            words.iter().map(watch).collect::<Result<Vec<_>, _>>()
        })?;
        Ok(ServedWatch::new(requests))
    }

    /// Seconds on this process' clock.
    #[getter]
    #[expect(clippy::unused_self, reason = "a local axis has its link's clock")]
    fn now(&self) -> f64 {
        clock::now().since(Instant::ZERO).as_secs_f64()
    }

    /// Waits.
    #[expect(clippy::unused_self, reason = "a local axis has its link's clock")]
    fn sleep(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let span = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO);
        let end = clock::now() + span;
        while clock::now() < end {
            py.detach(|| clock::sleep_until(end.min(clock::now() + WAIT_SLICE)));
            py.check_signals()?;
        }
        Ok(())
    }
}

impl ServedAxis {
    pub(super) fn new(joined: &Arc<RemoteServer>, info: AxisInfo) -> Self {
        Self { server: Arc::clone(joined).into(), info }
    }

    /// Asks the server, while other threads go on and Ctrl-C is looked for.
    fn query_server<T: Clone + Send + 'static>(
        &self,
        py: Python<'_>,
        what: impl Send + FnOnce(&Arc<RemoteServer>) -> Result<T, GatewayError> + 'static,
    ) -> PyResult<T> {
        let joined = Arc::clone(self.server.in_own_process(py)?);
        wait_end(py, joined.gateway.clone().spawn(move |_| what(&joined)))
    }

    /// Does what may block for a moment, while other threads go on.
    fn run_detached<T: Send>(
        &self,
        py: Python<'_>,
        what: impl Send + FnOnce(&Arc<RemoteServer>) -> Result<T, GatewayError>,
    ) -> PyResult<T> {
        let joined = self.server.in_own_process(py)?;
        py.detach(|| what(joined)).map_err(|refused| refused_to_py_error(py, &refused))
    }

    /// Says a verb: by the lease that is held; what moves nothing goes without one.
    fn start_verb(
        &self,
        joined: &Arc<RemoteServer>,
        verb: &str,
        arguments: CommandArguments,
    ) -> Result<PendingOperation, GatewayError> {
        let Some(info) = self.info.verbs.iter().find(|info| info.verb == verb) else {
            let what = format!("{}: {} cannot {verb}", self.info.label, self.info.profile);
            return Err(GatewayError::new("E218", what).hint(format!("it can {:?}", self.verbs())));
        };
        let id = self.info.id;
        let held = joined.armed_lease(id);
        if ["stop", "quick-stop"].contains(&verb) {
            return match held.filter(|lease| lease.check().is_ok()) {
                Some(lease) => lease.start(verb, arguments),
                None => {
                    let joined = Arc::clone(joined);
                    // First the stop, then the question whether it was this axis.
                    Ok(joined.gateway.clone().spawn(move |gateway| {
                        RemoteServer::stop(gateway, vec![id])
                            .and_then(|()| joined.check_same_drives())
                    }))
                }
            };
        }
        if let Some(lease) = held {
            lease.check()?;
            return lease.start(verb, arguments);
        }
        // Who waits for somebody else's motion takes the axis from nobody.
        if info.moves || verb == "reached" {
            let what = format!("{}: {verb}: the axis is not armed", self.info.label);
            let hint = "arm it first: motion needs an armed axis";
            return Err(GatewayError::new("E219", what).hint(hint));
        }
        let (joined, verb) = (Arc::clone(joined), verb.to_owned());
        let run = move |lease: &Lease| lease.run(&verb, arguments, ANSWER_MAX);
        Ok(joined.gateway.clone().spawn(move |_| joined.with_lease(id, run)))
    }

    fn amount_to_si(
        &self,
        py: Python<'_>,
        verb: &str,
        name: &str,
        given: &PyAmount,
    ) -> PyResult<f64> {
        let text = match given {
            PyAmount::Number(number) if number.is_finite() => return Ok(*number),
            PyAmount::Number(number) => {
                return Err(usage_error(py, "E217", &format!("{number} is no finite number"), ""));
            }
            PyAmount::Text(text) => text,
        };
        let info = self.info.verbs.iter().find(|info| info.verb == verb);
        let is = |argument: &&ArgumentInfo| argument.name == name;
        let argument = info.and_then(|info| info.arguments.iter().find(is));
        let measure = quantity::parse(text);
        let si = measure.and_then(|measure| match argument {
            Some(argument) => measure.with_unit(display_unit(&argument.unit)),
            None => Ok(measure.si),
        });
        si.map_err(|error| to_py_error(py, &error))
    }

    fn parameter_name(&self, py: Python<'_>, id: u16) -> PyResult<String> {
        let axis = self.info.id;
        self.query_server(py, move |joined| {
            if let Some(address) = joined.address(id) {
                return Ok(address);
            }
            let parameter = joined.parameters(axis)?.get(usize::from(id));
            let none = || GatewayError::new("E213", format!("there is no parameter {id}"));
            parameter.map(|parameter| parameter.name.clone()).ok_or_else(none)
        })
    }

    fn begin_write(
        &self,
        py: Python<'_>,
        id: u16,
        wanted: &WriteValue,
        keep: bool,
    ) -> PyResult<PendingOperation> {
        let (axis, name) = (self.info.id, self.parameter_name(py, id)?);
        let (given, raw) = match wanted {
            WriteValue::Amount(amount) => (amount.get().0.clone(), false),
            // Every raw value of a drive is a whole number that a double has.
            WriteValue::Raw(raw) => (Said::Number(*raw as f64), true),
        };
        let joined = Arc::clone(self.server.in_own_process(py)?);
        let write =
            WriteParameters { values: [(name, given)].into(), keep, dry_run: false, raw, epoch: 0 };
        Ok(joined.gateway.clone().spawn(move |gateway| {
            joined.with_lease(axis, |lease| {
                let write = WriteParameters { epoch: lease.epoch(), ..write };
                gateway.write_parameters(axis, &write).map(drop)
            })
        }))
    }

    fn begin_raw(
        &self,
        py: Python<'_>,
        value: &Bound<'_, PyAny>,
        id: Option<u32>,
    ) -> PyResult<PendingOperation<i64>> {
        let Ok(text) = value.extract::<String>() else {
            return Err(unsupported_error(
                py,
                "sending bytes",
                "say it in the protocol's own text",
            ));
        };
        if id.is_some() {
            return Err(unsupported_error(
                py,
                "an identifier of one's own",
                "say it in the protocol's own text",
            ));
        }
        let (axis, joined) = (self.info.id, Arc::clone(self.server.in_own_process(py)?));
        let say = move |lease: &Lease| lease.raw(&text);
        Ok(joined.gateway.clone().spawn(move |_| joined.with_lease(axis, say)))
    }
}

/// The raw number in what a server read.
pub(super) fn raw_number(py: Python<'_>, read: &ParameterReading) -> PyResult<i64> {
    let what = || format!("`{}` is {}, no number", read.name, read.kind);
    let hint = "read_text or read_bytes reads it";
    read.raw.ok_or_else(|| usage_error(py, "E213", &what(), hint))
}

fn parse_byte(py: Python<'_>, digits: &str) -> PyResult<u8> {
    let wrong = |_| usage_error(py, "E257", "the server's bytes are no bytes", "");
    u8::from_str_radix(digits, 16).map_err(wrong)
}
