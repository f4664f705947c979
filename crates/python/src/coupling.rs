//! Coupling of axes: gears and cams.

use polepair::{Cam, CamPoint, Error, GearRatio, LocalAxis};
use pyo3::prelude::*;
use std::f64::consts::TAU;

use crate::axis::PyAxis;

const HINT: &str = "open the drives' link in this program";

/// A cam, as Python describes it: positions in rad.
#[derive(FromPyObject, Debug)]
#[pyo3(from_item_all)]
pub struct PyCam {
    points: Vec<[f64; 2]>,
    buffer: Option<(u16, u16)>,
    inferred: bool,
}

impl PyCam {
    fn to_cam(&self) -> Cam {
        let points = self
            .points
            .iter()
            .map(|[master, follower]| CamPoint { master: master / TAU, follower: follower / TAU });
        Cam {
            points: points.collect(),
            memory: self.buffer.map(|(first, last)| first..=last),
            accept_inferred: self.inferred,
        }
    }

    /// Lets an axis follow another one by this table.
    fn follow(&self, follower: &LocalAxis, master: &LocalAxis) -> Result<(), Error> {
        let plan = follower.plan_cam(master, &self.to_cam())?;
        follower.follow_cam(master, &plan)
    }
}

/// Lets an axis follow another one by a ratio: its turns to the master's turns.
#[pyfunction]
pub fn follow_gear(
    py: Python<'_>,
    follower: &PyAxis,
    master: &PyAxis,
    turns: i32,
    master_turns: i32,
) -> PyResult<()> {
    let ratio = GearRatio { follower: turns, master: master_turns };
    with_pair(py, follower, master, |axis, master| axis.follow_gear(master, ratio))
}

/// Lets an axis follow another one by a table.
#[pyfunction]
pub fn follow_cam(py: Python<'_>, follower: &PyAxis, master: &PyAxis, cam: PyCam) -> PyResult<()> {
    with_pair(py, follower, master, |axis, master| cam.follow(axis, master))
}

/// Ends the coupling to another axis.
#[pyfunction]
pub fn uncouple(py: Python<'_>, follower: &PyAxis, master: &PyAxis) -> PyResult<()> {
    with_pair(py, follower, master, LocalAxis::uncouple)
}

/// Does something with two axes of a wire of this program.
fn with_pair(
    py: Python<'_>,
    follower: &PyAxis,
    master: &PyAxis,
    work: impl Send + FnOnce(&LocalAxis, &LocalAxis) -> Result<(), Error>,
) -> PyResult<()> {
    let master = master.inner(py)?;
    follower.detach(py, move |axis| {
        let what = "coupling";
        work(axis.require_local(what, HINT)?, master.require_local(what, HINT)?)
    })
}
