//! Motion of a simulated CiA 402 drive: [`MotionAxis`] is the power state machine with the operation modes,
//! on a [`ServoShaft`](crate::plant::ServoShaft).
//!
//! Everything is in SI and independent of a family's objects and units, which [`MotionSettings`] provides.
//! Choices of the manufacturer are options in [`MotionQuirks`].
//!
//! Why: SIM-11, SIM-16.

mod homing;
mod interpolator;
mod motion_axis;
mod point;
mod power;
mod window_timer;

use crate::plant::Limits;

pub use homing::is_method;
pub use motion_axis::{MotionAxis, MotionContext, MotionEvent, MotionQuirks};
pub use power::PowerState;

/// Modes of operation (6060h).
pub mod modes {
    /// Profile position.
    pub const PROFILE_POSITION: i8 = 1;
    /// Velocity, the mode of inverters: a speed in rpm along a ramp.
    pub const VELOCITY: i8 = 2;
    /// Profile velocity.
    pub const PROFILE_VELOCITY: i8 = 3;
    /// Profile torque.
    pub const PROFILE_TORQUE: i8 = 4;
    /// Homing.
    pub const HOMING: i8 = 6;
    /// Interpolated position: records of the host, with the drive's own way between them.
    pub const INTERPOLATED_POSITION: i8 = 7;
    /// Cyclic synchronous position.
    pub const CYCLIC_POSITION: i8 = 8;
    /// Cyclic synchronous velocity.
    pub const CYCLIC_VELOCITY: i8 = 9;
    /// Cyclic synchronous torque.
    pub const CYCLIC_TORQUE: i8 = 10;
}

/// Deceleration of a drive to standstill.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Braking {
    /// Not at all: power is taken off.
    Coast,
    /// Along the ramp of the profile.
    Ramp,
    /// Along the ramp of the quick stop.
    Quick,
    /// A stop as hard as the current limit permits.
    Hard,
}

/// A window, and how long the value must be in it, or out of it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Window {
    /// Half of its width: rad or rad/s.
    pub width: f64,
    /// ms.
    pub ms: u32,
}

/// Homing settings.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct HomingSettings {
    /// Homing method (6098h).
    pub method: i8,
    /// Speed of the search for the switch, rad/s.
    pub fast: f64,
    /// Speed of the search for the zero, rad/s.
    pub slow: f64,
    /// Ramp, rad/s².
    pub acceleration: f64,
    /// From the home position to the zero position, rad.
    pub offset: f64,
}

/// Offsets added to cyclic commands.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct CyclicOffsets {
    /// 60B0h, rad.
    pub position: f64,
    /// 60B1h, rad/s.
    pub velocity: f64,
    /// 60B2h, share of the rated torque.
    pub torque: f64,
}

/// Limits of speed, torque and position.
pub trait MotionLimits {
    /// Speed and ramps of a profile (6081h, 6083h, 6084h; in the velocity mode 6046h, 6048h, 6049h).
    fn profile(&self) -> Limits;

    /// Torque slope (6087h), shares of the rated torque per second; 0 is at once.
    fn torque_slope(&self) -> f64;

    /// Ramp of the quick stop (6085h), rad/s².
    fn quick_stop(&self) -> f64;

    /// Speed at most (607Fh, 6080h), rad/s.
    fn velocity_max(&self) -> f64;

    /// Torque at most backward and forward (6072h, 60E1h, 60E0h), shares of the rated torque.
    fn torque_limits(&self) -> (f64, f64) {
        (f64::INFINITY, f64::INFINITY)
    }

    /// Least and greatest position (607Dh), rad.
    fn position_limits(&self) -> Option<(f64, f64)> {
        None
    }
}

/// Windows around targets and zero speed.
pub trait MotionWindows {
    /// Around the target (6067h, 6068h).
    fn position_window(&self) -> Window;

    /// Following error allowed (6065h, 6066h); infinite for any.
    fn following_window(&self) -> Window;

    /// Around the target speed (606Dh, 606Eh).
    fn velocity_window(&self) -> Window;

    /// Window of zero speed (606Fh, 6070h).
    fn standstill(&self) -> Window;
}

/// Reactions of the drive that end a motion.
pub trait StopReactions {
    /// Quick stop option (605Ah), and whether the drive stays in that state.
    fn quick_stop_option(&self) -> (Braking, bool) {
        (Braking::Quick, false)
    }

    /// Shutdown option (605Bh).
    fn shutdown_option(&self) -> Braking {
        Braking::Coast
    }

    /// Disable operation option (605Ch).
    fn disable_option(&self) -> Braking {
        Braking::Ramp
    }

    /// Halt option (605Dh).
    fn halt_option(&self) -> Braking {
        Braking::Ramp
    }

    /// Fault reaction option (605Eh).
    fn fault_option(&self) -> Braking {
        Braking::Coast
    }
}

/// Motion settings of the drive's objects, in SI. Positions are in the user's coordinates.
pub trait MotionSettings: MotionLimits + MotionWindows + StopReactions {
    /// Requested mode of operation (6060h).
    fn mode(&self) -> i8;

    /// Target position (607Ah), rad.
    fn target_position(&self) -> f64;

    /// Target velocity (60FFh, in the velocity mode 6042h), rad/s.
    fn target_velocity(&self) -> f64;

    /// Target torque (6071h), share of the rated torque.
    fn target_torque(&self) -> f64;

    /// Homing settings.
    fn homing(&self) -> HomingSettings;

    /// Record of the interpolated position mode that is in force (60C1h), rad.
    fn interpolation_target(&self) -> f64 {
        self.target_position()
    }

    /// Offsets added to cyclic commands.
    fn offsets(&self) -> CyclicOffsets {
        CyclicOffsets::default()
    }

    /// Time from one set-point of a cyclic mode to the next (60C2h), ms.
    fn cycle_ms(&self) -> u32 {
        1
    }

    /// A relative target counts from the set-point (1) or the motor (2), not from the target before
    /// (60F2h).
    fn relative_to(&self) -> u8 {
        0
    }
}
