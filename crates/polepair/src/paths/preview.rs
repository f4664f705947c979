//! Paths on the model of drive and motor, before anything moves.

use std::time::Duration;

use polepair_drives::PathModel;

use super::{PathTable, PathUnit};
use crate::error::Error;

/// Time between two points, if there are few.
const STEP: Duration = Duration::from_millis(1);
/// Points of a preview at most: further ones are taken less often.
const POINTS_MAX: usize = 20_000;

/// A run of paths on the model.
#[derive(Clone, PartialEq, Debug)]
pub struct PathPreview {
    /// Points, by time.
    pub points: Vec<PreviewPoint>,
    /// End of the run.
    pub end: PreviewEnd,
    /// Unit of the positions.
    pub unit: PathUnit,
}

/// A point of a preview.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct PreviewPoint {
    /// Time from the trigger.
    pub time: Duration,
    /// Position, in the unit of the mechanics.
    pub position: f64,
    /// Speed of the motor, rpm.
    pub speed: f64,
}

/// End of a preview.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum PreviewEnd {
    /// The last path has ended.
    Stopped,
    /// The time was over, and a path runs.
    Running,
    /// The model of the drive has this alarm.
    Alarm(&'static str),
}

impl PathPreview {
    /// Time of the run.
    #[must_use]
    pub fn duration(&self) -> Duration {
        self.points.last().map_or(Duration::ZERO, |point| point.time)
    }

    /// Position at its end, in the unit of the mechanics.
    #[must_use]
    pub fn end_position(&self) -> f64 {
        self.points.last().map_or(f64::NAN, |point| point.position)
    }

    /// Least and greatest position.
    #[must_use]
    pub fn travel(&self) -> (f64, f64) {
        let positions = self.points.iter().map(|point| point.position);
        positions
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
    }
}

impl PathTable {
    /// Runs a path, and those that it leads to, on the model of the drive with a motor of the size of a TS, without a
    /// load. It begins at `from`, thousandths of the unit, and ends after `within` at the latest.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` for a path that the drive would refuse.
    pub fn preview(&self, start: u8, from: i32, within: Duration) -> Result<PathPreview, Error> {
        let refused = |_| {
            let what = "the model of the drive refuses these paths";
            Error::usage("E217", what, "`polepair paths check FILE` names what is wrong")
        };
        let mut model = PathModel::new(self.motor_turns, self.travel).map_err(refused)?;
        if from != 0 {
            model.go_to(from).map_err(refused)?;
        }
        for (number, path) in &self.paths {
            model.write_path(*number, path).map_err(refused)?;
        }
        model.trigger(start).map_err(refused)?;
        Ok(record(model, within, self.unit))
    }
}

fn record(mut model: PathModel, within: Duration, unit: PathUnit) -> PathPreview {
    let (mut time, mut every) = (Duration::ZERO, 1);
    let mut points = vec![PreviewPoint::of(&model, time)];
    while model.is_running() && time < within {
        for _ in 0..every {
            model.advance(STEP);
        }
        time += STEP * every;
        points.push(PreviewPoint::of(&model, time));
        if points.len() > POINTS_MAX {
            // Half of the points are left, so that a long run fits.
            let mut number = 0;
            points.retain(|_| {
                number += 1;
                number % 2 == 1
            });
            every *= 2;
        }
    }
    let end = match model.alarm() {
        Some(text) => PreviewEnd::Alarm(text),
        None if model.is_running() => PreviewEnd::Running,
        None => PreviewEnd::Stopped,
    };
    PathPreview { points, end, unit }
}

impl PreviewPoint {
    fn of(model: &PathModel, time: Duration) -> Self {
        Self { time, position: model.position(), speed: model.rpm() }
    }
}
