//! The known state of an axis, with the age of its values.

use crate::profile::Signal;
use crate::time::Instant;

/// One value of an axis and its age.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Reading {
    /// SI value; flags are 0 or 1, codes and modes are themselves. NaN while a parameter that the
    /// scale depends on was never read.
    pub value: f64,
    /// Raw value.
    pub raw: i64,
    /// Time at which its reply arrived; `None` before the first.
    pub at: Option<Instant>,
}

/// An error that a drive reported by itself. Whether it stopped the drive is in the drive's state.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Emergency {
    /// Code as in [`Fault::code`](crate::profile::Fault::code); never 0.
    pub code: u32,
    /// Time at which the message arrived.
    pub at: Instant,
}

/// Result of a stop for the drive's own program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ProgramEnd {
    /// None ran.
    NoneRan,
    /// One that may have run was ended: the drive does not report whether one runs.
    MayHaveRun,
    /// One ran, and was ended.
    Ended,
}

/// Report of an axis' last motion. Positions are raw.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MotionReport {
    /// Address of the drive: of a group, each has a report of its own.
    pub address: u32,
    /// Position before the command.
    pub start: Option<i64>,
    /// Position at the last reading.
    pub position: Option<i64>,
    /// Target position.
    pub target: Option<i64>,
    /// The drive's own report that the motion is over.
    pub flag: Option<bool>,
    /// The position is within the window of the target.
    pub arrived: bool,
}

/// State of an axis as last read. No value is newer than its `at`.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct AxisStatus {
    readings: [Reading; Signal::COUNT],
    /// True if motion commands are allowed.
    pub armed: bool,
    /// Writes to permanent memory that this lane made.
    pub flash_writes: u32,
    /// Value of the parameter that selects RAM or permanent memory before this lane changed it
    /// ([`RamMode`](crate::profile::RamMode)); `None` if it is as it was.
    pub ram_mode_before: Option<i64>,
    /// Result of the last stop for the drive's own program; `None` where the drive runs no programs, was
    /// not asked, or did not reply.
    pub program_end: Option<ProgramEnd>,
    /// The last stop found that the drive stored requests as instructions of a program, and ended that: the program
    /// is incomplete.
    pub store_ended: bool,
    /// A motion was sent, and since then it was not acknowledged that the axis arrived, was stopped or
    /// was switched off. It stays when the link is lost: then the motor may turn.
    pub motion_active: bool,
    /// The last error that the drive reported by itself; `None` before the first. It stays when the error is gone.
    pub emergency: Option<Emergency>,
}

impl AxisStatus {
    /// Nothing known, disarmed.
    pub const UNKNOWN: Self = Self {
        readings: [Reading { value: 0.0, raw: 0, at: None }; Signal::COUNT],
        armed: false,
        flash_writes: 0,
        ram_mode_before: None,
        program_end: None,
        store_ended: false,
        motion_active: false,
        emergency: None,
    };

    /// The last reading of a signal.
    #[must_use]
    pub const fn reading(&self, signal: Signal) -> Reading {
        self.readings[signal as usize]
    }

    /// Notes a reading.
    pub const fn set_reading(&mut self, signal: Signal, reading: Reading) {
        self.readings[signal as usize] = reading;
    }
}
