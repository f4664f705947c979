//! Runs of paths on a drive, and the measurement of their end.

use std::f64::consts::TAU;

use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_drives::stored_paths::{PathEnd, PathType};

use super::{PathChainEnd, PathTable};
use crate::error::{Error, Exit};
use crate::interface::Axis;

/// Distance from the expected end that counts as arrived, turns of the motor: 1 degree.
const ARRIVED_WITHIN: f64 = 1.0 / 360.0;

/// The measured end of a run.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct PathArrival {
    /// Position after the run, in the unit of the mechanics.
    pub position: f64,
    /// Position at which the paths end; `None` where that depends on the time for which a motor turned.
    pub expected: Option<f64>,
}

impl Axis {
    /// Starts a path that is stored in the drive, by its number. The axis must be armed. Paths that follow are started
    /// by the drive itself.
    ///
    /// # Errors
    /// [`Error::Unsupported`] `E218` for a drive without paths, `E216` for a number that no path has, `E219` for an
    /// unarmed axis; others by source.
    pub fn run_path(&self, number: u8) -> Result<(), Error> {
        self.run(Command { path: Some(number.into()), ..Command::new(Verb::RunPath) })
    }
}

impl PathTable {
    /// Reads the position of a drive, in the unit of the mechanics. It is that of the motor, whatever a file of
    /// machines makes of it.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a drive that reports none; others by source.
    pub fn position(&self, axis: &Axis) -> Result<f64, Error> {
        let profile = crate::profile::find_shipped(&axis.facts().profile);
        let source = profile.and_then(|profile| profile.signal(Signal::Position));
        let parameter = profile.zip(source).and_then(|(p, source)| p.parameter(source.parameter));
        let Some(parameter) = parameter.filter(|it| it.scale.is_constant()) else {
            let what = format!("{}: its position has no constant scale", axis.label());
            return Err(Error::usage("E218", what, "run paths of a SYNTRON TS over Modbus"));
        };
        let raw = axis.get_raw(parameter.name)?;
        let turns = raw as f64 * parameter.scale.factor * parameter.unit.si_factor() / TAU;
        Ok(turns * self.unit_per_turn())
    }

    /// Position at which a run ends that begins at `from`, in the unit of the mechanics. A path relative to the last
    /// command's end counts from `from` if it is the first. `None` where a motor turns for a time, or does not stop.
    #[must_use]
    pub fn expected_end(&self, start: u8, from: f64) -> Option<f64> {
        let chain = self.chain(start);
        if chain.end != PathChainEnd::Stops {
            return None;
        }
        chain.numbers.iter().try_fold(from, |at, number| {
            let path = self.path(*number);
            let coordinate = f64::from(path.thousandths) / 1000.0;
            match (path.kind, path.end) {
                (PathType::Speed | PathType::Unknown(_), _) => None,
                (_, PathEnd::Coordinate) => Some(coordinate),
                (_, PathEnd::LastCommand | PathEnd::Feedback) => Some(at + coordinate),
            }
        })
    }

    /// Measures the end of a run that began at `from`, once the axis is at rest.
    ///
    /// # Errors
    /// [`Error::MotionEnded`] `E106` if the axis is elsewhere than its paths end; others by source.
    pub fn check_arrival(&self, axis: &Axis, start: u8, from: f64) -> Result<PathArrival, Error> {
        let (position, expected) = (self.position(axis)?, self.expected_end(start, from));
        let window = ARRIVED_WITHIN * self.unit_per_turn();
        match expected {
            Some(end) if (position - end).abs() > window => {
                let unit = self.unit.symbol();
                Err(Error::MotionEnded {
                    code: "E106",
                    what: format!(
                        "{}: the paths end at {end:.3} {unit}, and it is at {position:.3} {unit}",
                        axis.label()
                    ),
                    why: "A limit, another path or another master ended them, or a relative path \
                          counted from elsewhere."
                        .to_owned(),
                    hint: "look at its inputs and faults: polepair info URL".to_owned(),
                    exit: Exit::Negative,
                })
            }
            _ => Ok(PathArrival { position, expected }),
        }
    }

    fn unit_per_turn(&self) -> f64 {
        f64::from(self.travel) / f64::from(self.motor_turns.max(1))
    }
}
