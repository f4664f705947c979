//! Simulated drives from outside the wire: acts, and the real state.

use std::time::Duration;

use polepair::simulate::{
    SimulatedMotor, Simulation as Inner, SimulationPace, act_of_value, parse_act, rack_of_words,
};
use polepair_core::medium::MediumKind;
use polepair_core::time::Instant;
use pyo3::prelude::*;

use crate::errors::{to_py_error, usage_error};
use crate::process_local::ProcessLocal;

/// The simulation behind a `sim:` link.
#[pyclass(frozen, name = "Simulation", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PySimulation(ProcessLocal<Inner>);

impl From<Inner> for PySimulation {
    fn from(simulation: Inner) -> Self {
        Self(simulation.into())
    }
}

/// True state of a motor, independent of the reports of its drive.
#[pyclass(frozen, get_all, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Truth {
    /// Shaft position since power-on, rad.
    position: f64,
    /// Shaft speed, rad/s.
    velocity: f64,
    /// Motor current, A.
    current: f64,
    /// Air-gap torque, N·m.
    torque: f64,
    /// Winding temperature, °C.
    winding: f64,
    /// The power stage is on.
    enabled: bool,
    /// The drive's fault code or bits, zero for none.
    fault: u32,
    /// Writes to flash or EEPROM since it was made.
    flash_writes: u64,
}

#[pymethods]
impl Truth {
    fn __repr__(&self) -> String {
        let Self { position, velocity, current, enabled, fault, .. } = self;
        let power = if *enabled { "powered" } else { "without power" };
        let fault = if *fault == 0 { String::new() } else { format!(", fault {fault}") };
        format!("<Truth {position:.3} rad, {velocity:.3} rad/s, {current:.3} A, {power}{fault}>")
    }
}

/// The one link that a word such as `cia402:1,2` means: whether it is a bus, its protocol's word, and
/// of each drive the product's name and the address.
#[pyfunction]
pub fn rack_of_word(py: Python<'_>, word: &str) -> PyResult<RackTuple> {
    let described = rack_of_words(&[word], 0).map_err(|error| to_py_error(py, &error))?;
    let link = &described.rack.links[0];
    let drives = link.drives.iter().map(|drive| (drive.profile.name, drive.address)).collect();
    Ok((link.wire.medium() == MediumKind::Can, described.wires[0].protocol, drives))
}

/// A bus or a line, protocol, and of each drive product and address.
type RackTuple = (bool, &'static str, Vec<(&'static str, Option<u32>)>);

#[pymethods]
impl PySimulation {
    /// Seconds since it began.
    #[getter]
    fn now(&self, py: Python<'_>) -> PyResult<f64> {
        let simulation = self.0.in_own_process(py)?;
        Ok(py.detach(|| simulation.now()).since(Instant::ZERO).as_secs_f64())
    }

    /// Returns whether its time passes only while a caller waits, and then at once.
    #[getter]
    fn is_virtual(&self) -> bool {
        self.0.pace() == SimulationPace::Virtual
    }

    /// Lets `seconds` pass: at once in virtual time, by sleeping in real time.
    fn run(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let simulation = self.0.in_own_process(py)?;
        let span = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO);
        py.detach(|| simulation.advance(span));
        Ok(())
    }

    /// Does something to a drive from outside; false where it has no such thing.
    fn act(
        &self,
        py: Python<'_>,
        link: usize,
        drive: usize,
        what: &str,
        value: f64,
        motor: u8,
    ) -> PyResult<bool> {
        let act =
            if what.contains('=') { parse_act(what) } else { act_of_value(what, Some(value)) };
        let act = act.map_err(|error| to_py_error(py, &error))?;
        let simulation = self.0.in_own_process(py)?;
        let motor = SimulatedMotor { link, drive, motor };
        Ok(py.detach(|| simulation.act_on_motor(motor, act)))
    }

    /// True state of a motor; links, drives and motors count from 0.
    fn truth(&self, py: Python<'_>, link: usize, drive: usize, motor: u8) -> PyResult<Truth> {
        let simulation = self.0.in_own_process(py)?;
        let which = SimulatedMotor { link, drive, motor };
        let truth = py.detach(|| simulation.motor_truth(which)).ok_or_else(|| {
            let what =
                format!("the simulation has no motor {motor} of drive {drive} on link {link}");
            usage_error(py, "E212", &what, "links, drives and motors count from 0")
        })?;
        Ok(Truth {
            position: truth.position,
            velocity: truth.velocity,
            current: truth.current,
            torque: truth.torque,
            winding: truth.winding,
            enabled: truth.enabled,
            fault: truth.fault,
            flash_writes: truth.flash_writes,
        })
    }
}
