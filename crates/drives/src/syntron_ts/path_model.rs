//! The model of a drive that runs stored paths, without a wire.

use core::f64::consts::TAU;
use core::time::Duration;

use polepair_core::time::Instant;

use super::drive::{Drive, MODE_POSITION, RegisterError};
use super::options::Options;
use super::profile::SYNTRON_TS;
use super::registers::{dn_registers, fn_registers};
use crate::DeviceOptions;
use crate::stored_paths::{PathDefinition, PathEnd, PathType};

/// Time between two looks on the way to a start.
const STEP: Duration = Duration::from_millis(1);
/// Path by which the model goes to a start.
const SCRATCH: u8 = 32;

/// A drive with its motor, without a load, powered at coordinate 0.
#[derive(Debug)]
pub struct PathModel {
    drive: Drive,
    now: Instant,
    /// Units of the mechanics in a radian of the shaft.
    unit_per_rad: f64,
}

impl PathModel {
    /// A model whose mechanics move by `travel` in `motor_turns` turns of the motor.
    ///
    /// # Errors
    /// Numbers that the drive refuses: zeros.
    pub fn new(motor_turns: u16, travel: u16) -> Result<Self, RegisterError> {
        let options = DeviceOptions {
            address: None,
            wires: &[],
            standard: None,
            untimed: true,
            seed: 0,
            extra: &[],
        };
        let mut options =
            Options::from_device_options(&options, false).map_err(|_| RegisterError::Value)?;
        options.mode = MODE_POSITION;
        let mut drive = Drive::new(&SYNTRON_TS, options);
        drive.write(fn_registers::MOTOR_TURNS, &[motor_turns])?;
        drive.write(fn_registers::TRAVEL, &[travel])?;
        drive.write(fn_registers::ENABLE, &[1])?;
        let turns = f64::from(motor_turns) * TAU;
        Ok(Self { drive, now: Instant::ZERO, unit_per_rad: f64::from(travel) / turns })
    }

    /// Writes a path, 1 to 32.
    ///
    /// # Errors
    /// An S-time of half the acceleration time or more.
    pub fn write_path(&mut self, number: u8, path: &PathDefinition) -> Result<(), RegisterError> {
        let nth = u16::from(number) - 1;
        let s_time = fn_registers::S_TIMES + nth;
        // Not half of a ramp or more at any time.
        self.drive.write(s_time, &[0])?;
        self.drive.write(fn_registers::PATHS + 8 * nth, &path.encode())?;
        self.drive.write(s_time, &[path.s_ms])
    }

    /// Starts a path.
    ///
    /// # Errors
    /// A number that no path has.
    pub fn trigger(&mut self, number: u8) -> Result<(), RegisterError> {
        self.drive.write(fn_registers::PATH_NUMBER, &[number.into()])?;
        self.drive.write(fn_registers::PATH_TRIGGER, &[0])?;
        self.drive.write(fn_registers::PATH_TRIGGER, &[1])
    }

    /// Goes to a coordinate, in thousandths of the unit. It overwrites path 32.
    ///
    /// # Errors
    /// As the others; there are none for coordinates.
    pub fn go_to(&mut self, thousandths: i32) -> Result<(), RegisterError> {
        let quick = PathDefinition {
            kind: PathType::Single,
            end: PathEnd::Coordinate,
            thousandths,
            rpm: 3000,
            acceleration_ms: 200,
            deceleration_ms: 200,
            ..PathDefinition::EMPTY
        };
        self.write_path(SCRATCH, &quick)?;
        self.trigger(SCRATCH)?;
        while self.is_running() {
            self.advance(STEP);
        }
        self.write_path(SCRATCH, &PathDefinition::EMPTY)
    }

    /// Returns whether a path runs, and no alarm has ended it.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.drive.dn_value(dn_registers::PATH_STATE) == Some(1) && !self.drive.alarm().is_some()
    }

    /// Lets time pass.
    pub fn advance(&mut self, span: Duration) {
        self.now = self.now + span;
        self.drive.advance(self.now);
    }

    /// The alarm of the drive in words, if it has one.
    #[must_use]
    pub fn alarm(&self) -> Option<&'static str> {
        let alarm = Some(self.drive.alarm()).filter(|alarm| alarm.is_some())?;
        let mut faults = SYNTRON_TS.faults.iter();
        let known = faults.find(|fault| fault.code == u32::from(alarm.0));
        Some(known.map_or("unknown alarm", |fault| fault.text))
    }

    /// Position in the unit of the mechanics.
    #[must_use]
    pub fn position(&self) -> f64 {
        (self.drive.shaft().position() - self.drive.origin()) * self.unit_per_rad
    }

    /// Speed of the motor, rpm.
    #[must_use]
    pub fn rpm(&self) -> f64 {
        self.drive.shaft().velocity() * 60.0 / TAU
    }
}
