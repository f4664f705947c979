//! One axis: parameters, verbs, events.

use std::borrow::Cow;
use std::time::Duration;

use polepair::{Amount, LocalAxis as Inner, RunningRequest, faults, start_together};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::{self, Access, ParameterId, Signal, Watchdog};
use pyo3::prelude::*;
use pyo3::pybacked::{PyBackedBytes, PyBackedStr};

use crate::errors::{to_py_error, usage_error};
use crate::events::PyEvents;
use crate::guard;
use crate::process_local::ProcessLocal;
use crate::request::{PyRequest, WAIT_SLICE};
use crate::served;

/// An axis of a link.
#[pyclass(frozen, name = "Axis", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyAxis(ProcessLocal<Inner>);

impl From<Inner> for PyAxis {
    fn from(axis: Inner) -> Self {
        Self(axis.into())
    }
}

/// What a drive has, as its profile says it.
#[pyclass(frozen, get_all, name = "Parameter", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyParameter {
    /// The name that users type.
    pub name: Cow<'static, str>,
    /// What the manual calls it.
    pub symbol: Cow<'static, str>,
    /// What it does.
    pub about: Cow<'static, str>,
    /// Its unit; empty for none.
    pub unit: Cow<'static, str>,
    /// Least and greatest raw value.
    pub raw_range: (i64, i64),
    /// Raw value from the factory.
    pub raw_default: Option<i64>,
    /// It can be read.
    pub readable: bool,
    /// It can be written.
    pub writable: bool,
    /// What a written value survives: volatile, storable, always, unless-ram.
    pub persistence: Cow<'static, str>,
    /// Writing it may move the motor.
    pub moves: bool,
    /// Names of raw values.
    pub words: Vec<(i64, Cow<'static, str>)>,
    /// Where it stands in the manual.
    pub section: Cow<'static, str>,
}

impl From<&'static profile::Parameter> for PyParameter {
    fn from(parameter: &'static profile::Parameter) -> Self {
        Self {
            name: parameter.name.into(),
            symbol: parameter.symbol.into(),
            about: parameter.about.into(),
            unit: parameter.unit.symbol().into(),
            raw_range: (parameter.min, parameter.max),
            raw_default: parameter.default,
            readable: parameter.access != Access::Write,
            writable: parameter.access != Access::Read,
            persistence: parameter.persistence.name().into(),
            moves: parameter.moves,
            words: parameter
                .values
                .iter()
                .map(|(raw, word)| (*raw, Cow::Borrowed(*word)))
                .collect(),
            section: parameter.section.into(),
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
    fn start(&self, axis: &Inner, id: Option<u32>) -> Result<RunningRequest, polepair::Error> {
        match self {
            Self::Text(text) => axis.start_raw(text),
            Self::Bytes(bytes) => axis.start_raw_bytes(bytes, id),
        }
    }
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
    fn label(&self) -> String {
        self.0.label()
    }

    #[getter]
    fn protocol(&self) -> &'static str {
        self.0.protocol()
    }

    /// The product's name and full title.
    #[getter]
    fn product(&self) -> (&'static str, &'static str) {
        (self.0.profile().name, self.0.profile().title)
    }

    /// What to check before and after the first motion.
    #[getter]
    fn caution(&self) -> &'static str {
        self.0.profile().caution
    }

    /// What the drive does when nobody talks to it: `none`, `fixed` with its seconds, `configurable` by
    /// a parameter, or `heartbeat` with the parameter that says whose, where this link sends one.
    #[getter]
    fn watchdog(&self) -> (&'static str, Option<f64>, Option<&'static str>) {
        let name = || {
            let id = self.0.watchdog_parameter();
            id.and_then(|id| self.0.parameter(id)).map(|parameter| parameter.name)
        };
        match self.0.profile().watchdog {
            Watchdog::None => ("none", None, None),
            Watchdog::Fixed { after_ms } => ("fixed", Some(f64::from(after_ms) / 1e3), None),
            Watchdog::Configurable { .. } => ("configurable", None, name()),
            Watchdog::Heartbeat { .. } => {
                ("heartbeat", None, if self.0.heartbeat().is_some() { name() } else { None })
            }
        }
    }

    /// Has the drive stop by itself after so many seconds of silence. Gives how it was set before, as
    /// names and raw values; nothing for what it does not tell.
    fn set_watchdog(&self, py: Python<'_>, seconds: f64) -> PyResult<Vec<(&'static str, i64)>> {
        let after = Duration::try_from_secs_f64(seconds)
            .map_err(|_| usage_error(py, "E216", &format!("{seconds} s is no time"), "say 0.5"))?;
        self.run_detached(py, |axis| {
            let before = axis.watchdog_setting()?.unwrap_or_default();
            axis.set_watchdog(Some(after))?;
            let name = |id| axis.parameter(id).map(|parameter| parameter.name);
            Ok(before.into_iter().filter_map(|(id, raw)| Some((name(id)?, raw))).collect())
        })
    }

    /// Whether its parameters are known without asking: always.
    #[getter]
    fn is_known(&self) -> bool {
        true
    }

    /// Begins `stop` or `disable` of what this program armed: on a link of one's own it has.
    fn start_own(&self, py: Python<'_>, verb: &str) -> PyResult<Option<PyRequest>> {
        self.start(py, verb, None, None, None, None, None, None).map(Some)
    }

    /// Every parameter.
    fn parameters(&self) -> Vec<PyParameter> {
        self.0.params().iter().map(PyParameter::from).collect()
    }

    /// Whether there is a parameter of that name.
    fn has(&self, name: &str) -> bool {
        self.0.find(name).is_ok()
    }

    /// The number of the parameter of that name, or at that address.
    fn find(&self, py: Python<'_>, name: &str) -> PyResult<u16> {
        self.inner(py)?.find(name).map(|id| id.0).map_err(|error| to_py_error(py, &error))
    }

    /// Begins to read a parameter.
    fn start_read(&self, py: Python<'_>, id: u16) -> PyResult<PyRequest> {
        self.start_request(py, |axis| axis.start_read(ParameterId(id)))
    }

    /// Begins to write a parameter.
    fn start_write(&self, py: Python<'_>, id: u16, raw: i64, keep: bool) -> PyResult<PyRequest> {
        self.start_request(py, |axis| axis.start_write(ParameterId(id), raw, keep))
    }

    /// Begins a request in the protocol's own text or bytes, on CAN with their identifier.
    #[pyo3(signature = (said, id=None))]
    fn start_raw(&self, py: Python<'_>, said: RawPayload, id: Option<u32>) -> PyResult<PyRequest> {
        self.start_request(py, |axis| said.start(axis, id))
    }

    /// Reads a parameter by name, raw.
    fn read_raw(&self, py: Python<'_>, name: &str) -> PyResult<i64> {
        self.run_request(py, |axis| axis.start_read(axis.find(name)?))
    }

    /// Writes a parameter by name, raw.
    fn write_raw(&self, py: Python<'_>, name: &str, raw: i64) -> PyResult<()> {
        self.run_request(py, |axis| axis.start_write(axis.find(name)?, raw, false)).map(drop)
    }

    /// Sends a request in the protocol's own text or bytes, and waits for the answer.
    #[pyo3(signature = (said, id=None))]
    fn raw(&self, py: Python<'_>, said: RawPayload, id: Option<u32>) -> PyResult<i64> {
        self.run_request(py, |axis| said.start(axis, id))
    }

    /// The raw value of an amount; may read what its scale depends on.
    fn raw_of(&self, py: Python<'_>, id: u16, amount: PyAmount) -> PyResult<i64> {
        let amount = Amount::from(amount);
        self.run_detached(py, |axis| axis.raw_of(ParameterId(id), &amount))
    }

    /// A raw value as value, unit, word and text; may read what its scale depends on.
    fn value(
        &self,
        py: Python<'_>,
        id: u16,
        raw: i64,
    ) -> PyResult<(f64, &'static str, Option<&'static str>, String)> {
        let value = self.run_detached(py, |axis| axis.value(ParameterId(id), raw))?;
        Ok((value.value, value.unit.symbol(), value.word, value.to_string()))
    }

    /// Reads text or bytes of a parameter, whatever its length.
    fn read_data(&self, py: Python<'_>, id: u16) -> PyResult<Vec<u8>> {
        self.run_detached(py, |axis| axis.read_data(ParameterId(id), true, &mut |_| {}))
    }

    /// Writes all bytes of a parameter of any length.
    fn write_data(&self, py: Python<'_>, id: u16, data: PyBackedBytes) -> PyResult<()> {
        self.run_detached(py, |axis| axis.write_data(ParameterId(id), &data, &mut |_| {}))
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
    ) -> PyResult<PyRequest> {
        let given = [target, velocity, acceleration, torque, jerk_time, deceleration];
        let command = self.parse_command(py, verb, given)?;
        self.start_request(py, |axis| axis.start(command))
    }

    /// What an amount is in SI, as an argument of a verb: `target`, `velocity`, `torque`.
    fn in_si(&self, py: Python<'_>, verb: &str, argument: &str, amount: PyAmount) -> PyResult<f64> {
        let mut given = [None, None, None, None, None, None];
        let places = ["target", "velocity", "acceleration", "torque"];
        let at = places.iter().position(|location| *location == argument).unwrap_or(0);
        given[at] = Some(amount);
        let Command { target, velocity, acceleration, torque, .. } =
            self.parse_command(py, verb, given)?;
        Ok([target, velocity, acceleration, torque][at].unwrap_or_default())
    }

    /// Lets motion commands through, or no longer. What is armed is stopped when the process ends.
    /// `Unsupported` E220 for an axis that is armed already.
    fn arm(&self, py: Python<'_>, armed: bool) -> PyResult<()> {
        if armed {
            self.run_detached(py, Inner::arm_exclusively)?;
            guard::register_armed(py, self.inner(py)?);
            return Ok(());
        }
        self.run_detached(py, |axis| {
            axis.arm(false);
            guard::unregister_armed(axis);
            Ok(())
        })
    }

    /// Whether motion commands are let through.
    #[getter]
    fn is_armed(&self, py: Python<'_>) -> PyResult<bool> {
        self.run_detached(py, |axis| Ok(axis.state().armed))
    }

    /// Listens to what happens to this axis and its link from now on.
    fn events(&self, py: Python<'_>) -> PyResult<PyEvents> {
        let events = self.run_detached(py, Inner::events)?;
        Ok(PyEvents::new(events, vec![self.0.in_own_process(py)?.clone()]))
    }

    /// Reads how what the drive sends by itself is laid out, as far as it is not known.
    fn learn(&self, py: Python<'_>) -> PyResult<()> {
        self.run_detached(py, Inner::read_event_layout)
    }

    /// Verbs that this drive has a plan for.
    fn verbs(&self) -> Vec<&'static str> {
        self.0.profile().plans.iter().map(|plan| plan.verb.name()).collect()
    }

    /// Signals that this drive tells, with their units.
    fn signals(&self) -> Vec<(&'static str, &'static str)> {
        let unit = |source: &profile::SignalSource| {
            let parameter = self.0.parameter(source.parameter);
            parameter.filter(|_| source.equals.is_none()).map_or("", |p| p.unit.symbol())
        };
        self.0.profile().signals.iter().map(|s| (s.signal.name(), unit(s))).collect()
    }

    /// The units in which signals are read, SI as people write it; empty for none.
    fn signal_units(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Vec<&'static str>> {
        let unit = |name: &String| Ok(self.0.signal_unit(parse_signal(py, name)?));
        names.iter().map(unit).collect()
    }

    /// Reads signals now, in SI.
    fn read_signals(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Vec<f64>> {
        let known = |name: &String| parse_signal(py, name);
        let signals: Vec<Signal> = names.iter().map(known).collect::<PyResult<_>>()?;
        let readings = self.run_detached(py, |axis| axis.signals(&signals))?;
        Ok(readings.into_iter().map(|reading| reading.value).collect())
    }

    /// Faults that are there now: code, text, cause, remedy, and whether the drive goes on.
    fn faults(&self, py: Python<'_>) -> PyResult<Vec<FaultTuple>> {
        let code = self.run_detached(py, |axis| match axis.provides_signal(Signal::Fault)? {
            true => Ok(axis.signals(&[Signal::Fault])?[0].raw),
            false => Ok(0),
        })?;
        let code = u32::try_from(code).unwrap_or_default();
        Ok(faults(self.0.profile(), code).into_iter().map(fault_tuple).collect())
    }

    /// What is known without asking.
    fn state(&self, py: Python<'_>) -> PyResult<AxisStateTuple> {
        self.run_detached(py, |axis| {
            let (state, now) = (axis.state(), axis.connection().now());
            let flag = |signal| {
                let known = axis.profile().signal(signal).and(state.reading(signal).at);
                known.map(|_| state.reading(signal).raw != 0)
            };
            let moving = axis.moving(&state);
            let readings = axis.profile().signals.iter().filter_map(|source| {
                let reading = state.reading(source.signal);
                let age = now.since(reading.at?).as_secs_f64();
                Some((source.signal.name().to_owned(), reading.value, age))
            });
            let (mode, enabled) = (axis.mode(&state), flag(Signal::Enabled));
            Ok((mode, enabled, state.armed, moving, readings.collect(), None))
        })
    }

    /// Seconds on the link's own clock.
    #[getter]
    fn now(&self, py: Python<'_>) -> PyResult<f64> {
        let now = self.run_detached(py, |axis| Ok(axis.connection().now()))?;
        Ok(now.since(polepair_core::time::Instant::ZERO).as_secs_f64())
    }

    /// Waits on the link's own clock: in virtual time it is over at once.
    fn sleep(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let mut left = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO);
        while left > Duration::ZERO {
            let slice = left.min(WAIT_SLICE);
            self.run_detached(py, |axis| {
                axis.sleep(slice);
                Ok(())
            })?;
            left -= slice;
            py.check_signals()?;
        }
        Ok(())
    }
}

/// Mode, powered, armed, moving; signals with values and their age in seconds; who commands it.
pub type AxisStateTuple =
    (Option<String>, Option<bool>, bool, Option<bool>, Vec<(String, f64, f64)>, Option<String>);

/// A move of one axis: verb, target, velocity, acceleration.
type SyncedMove<'py> =
    (Bound<'py, PyAny>, String, Option<PyAmount>, Option<PyAmount>, Option<PyAmount>);

/// Starts moves of several axes of one wire at one signal on the bus.
#[pyfunction]
pub fn begin_together(py: Python<'_>, moves: Vec<SyncedMove<'_>>) -> PyResult<()> {
    let moves = moves.into_iter().map(|(axis, verb, target, velocity, acceleration)| {
        let Ok(axis) = axis.cast::<PyAxis>() else {
            let hint = "sync=False starts one after the other; or open the link in this program";
            return Err(served::unsupported_error(py, "a start at one signal", hint));
        };
        let axis = axis.get();
        let command =
            axis.parse_command(py, &verb, [target, velocity, acceleration, None, None, None])?;
        Ok((axis.0.in_own_process(py)?.clone(), command))
    });
    let moves = ProcessLocal::from(moves.collect::<PyResult<Vec<_>>>()?);
    py.detach(|| start_together(&moves)).map_err(|error| to_py_error(py, &error))
}

/// Code, name, text, cause, remedy, and whether it is a warning only.
pub type FaultTuple = (u32, &'static str, &'static str, &'static str, &'static str, bool);

/// A fault as a caller has it.
pub fn fault_tuple(of: &profile::Fault) -> FaultTuple {
    let warning = of.severity != profile::Severity::Fault;
    (of.code, of.name, of.text, of.cause, of.remedy, warning)
}

impl PyAxis {
    /// Does what may block, while other threads go on.
    fn run_detached<T: Send>(
        &self,
        py: Python<'_>,
        what: impl Send + FnOnce(&Inner) -> Result<T, polepair::Error>,
    ) -> PyResult<T> {
        let axis = self.0.in_own_process(py)?;
        py.detach(|| what(axis)).map_err(|error| to_py_error(py, &error))
    }

    /// Begins a request and waits for its end, in one turn where that comes soon.
    fn run_request(
        &self,
        py: Python<'_>,
        what: impl Send + FnOnce(&Inner) -> Result<RunningRequest, polepair::Error>,
    ) -> PyResult<i64> {
        let started = self.run_detached(py, |axis| {
            let mut running = what(axis)?;
            Ok(match running.wait(WAIT_SLICE)? {
                Some(raw) => Ok(raw),
                None => Err(running),
            })
        })?;
        started.or_else(|running| Ok(PyRequest::new(running).result(py, None)?.unwrap_or_default()))
    }

    /// A verb with what was given for it: target, velocity, acceleration, torque, jerk time,
    /// deceleration.
    fn parse_command(
        &self,
        py: Python<'_>,
        verb: &str,
        given: [Option<PyAmount>; 6],
    ) -> PyResult<Command> {
        let verb = Verb::ALL
            .into_iter()
            .find(|known| known.name() == verb)
            .ok_or_else(|| usage_error(py, "E217", &format!("there is no verb `{verb}`"), ""))?;
        let argument = |which, given: Option<PyAmount>| {
            let amount = given.map(Amount::from);
            let value = amount.map(|amount| self.0.argument(verb, which, &amount)).transpose();
            value.map_err(|error| to_py_error(py, &error))
        };
        let [target, velocity, acceleration, torque, jerk_time, deceleration] = given;
        Ok(Command {
            target: argument(Argument::Target, target)?,
            velocity: argument(Argument::Velocity, velocity)?,
            acceleration: argument(Argument::Acceleration, acceleration)?,
            deceleration: argument(Argument::Deceleration, deceleration)?,
            torque: argument(Argument::Torque, torque)?,
            jerk_time: argument(Argument::JerkTime, jerk_time)?,
            ..Command::new(verb)
        })
    }

    fn start_request(
        &self,
        py: Python<'_>,
        what: impl Send + FnOnce(&Inner) -> Result<RunningRequest, polepair::Error>,
    ) -> PyResult<PyRequest> {
        self.run_detached(py, what).map(PyRequest::new)
    }
}

/// Whether that is the name of a signal, which not every drive has.
#[pyfunction]
pub fn is_signal(name: &str) -> bool {
    find_signal(name).is_some()
}

fn find_signal(name: &str) -> Option<Signal> {
    let plain = name.replace('_', " ");
    Signal::ALL.into_iter().find(|signal| signal.name() == plain)
}

/// The signal of that name.
pub fn parse_signal(py: Python<'_>, name: &str) -> PyResult<Signal> {
    find_signal(name).ok_or_else(|| {
        let all: Vec<_> = Signal::ALL.iter().map(|signal| signal.name()).collect();
        let what = format!("there is no signal `{name}`");
        usage_error(py, "E213", &what, &format!("signals are {}", all.join(", ")))
    })
}
