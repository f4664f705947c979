//! The verbs of an axis and their arguments.

/// Arguments of a command.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Argument {
    /// Target position or distance.
    Target,
    /// Velocity.
    Velocity,
    /// Acceleration.
    Acceleration,
    /// Deceleration, if it differs from the acceleration.
    Deceleration,
    /// With how much torque.
    Torque,
    /// Jerk time: the time in which the acceleration builds up.
    JerkTime,
    /// Cycle period.
    Period,
    /// Number of a path that is stored in the drive.
    Path,
}

/// Commands of an axis. A profile has a plan for each verb that its drive supports.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[non_exhaustive]
pub enum Verb {
    /// Powers the motor and holds the present position.
    Enable,
    /// Take power off the motor.
    Disable,
    /// Come to rest along the ramp and stay powered where the drive can.
    Stop,
    /// Come to rest as fast as the drive can.
    QuickStop,
    /// Clear faults.
    Clear,
    /// Turn at a speed.
    Velocity,
    /// Turn with a torque.
    Torque,
    /// Go to a position.
    MoveTo,
    /// Go so far.
    MoveBy,
    /// Go so far from the last target, reached or not.
    MoveOn,
    /// Go to a position along an S-curve, where acceleration has no steps.
    CurveTo,
    /// Go so far along an S-curve.
    CurveBy,
    /// Runs a path that is stored in the drive, and those that it leads to.
    RunPath,
    /// Find the reference position.
    Home,
    /// Wait until the last move or homing is done. Moves nothing.
    Reached,
    /// Give its time to the other drives of its bus, again and again.
    GiveTime,
    /// Give its time no more.
    WithholdTime,
    /// Sends its position to the axis that will follow it, again and again.
    SendPosition,
    /// Ends the sending of its position.
    WithholdPosition,
    /// Follows the position that another axis sends, by a ratio.
    FollowGear,
    /// Follows the position that another axis sends, by a table.
    FollowCam,
    /// Put the settings into permanent memory.
    Store,
    /// Powers the motor at the present position, ready to follow positions cycle by cycle.
    FollowPosition,
    /// Prepares to follow speeds cycle by cycle.
    FollowVelocity,
    /// Prepares to follow torques cycle by cycle.
    FollowTorque,
    /// Take back what following needed of the drive. Moves nothing.
    Unfollow,
    /// Make ready to go to a position, and wait for [`Begin`](Self::Begin).
    PrepareTo,
    /// Make ready to go so far, and wait for [`Begin`](Self::Begin).
    PrepareBy,
    /// Let every drive of the bus that was made ready begin at once.
    Begin,
    /// Checks that the drive has started the prepared motion.
    Begun,
}

impl Verb {
    /// Every verb.
    pub const ALL: [Self; 30] = [
        Self::Enable,
        Self::Disable,
        Self::Stop,
        Self::QuickStop,
        Self::Clear,
        Self::Velocity,
        Self::Torque,
        Self::MoveTo,
        Self::MoveBy,
        Self::MoveOn,
        Self::CurveTo,
        Self::CurveBy,
        Self::RunPath,
        Self::Home,
        Self::Reached,
        Self::GiveTime,
        Self::WithholdTime,
        Self::SendPosition,
        Self::WithholdPosition,
        Self::FollowGear,
        Self::FollowCam,
        Self::Store,
        Self::FollowPosition,
        Self::FollowVelocity,
        Self::FollowTorque,
        Self::Unfollow,
        Self::PrepareTo,
        Self::PrepareBy,
        Self::Begin,
        Self::Begun,
    ];

    /// The word in profiles and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Enable => "enable",
            Self::Disable => "disable",
            Self::Stop => "stop",
            Self::QuickStop => "quick-stop",
            Self::Clear => "clear",
            Self::Velocity => "velocity",
            Self::Torque => "torque",
            Self::MoveTo => "move-to",
            Self::MoveBy => "move-by",
            Self::MoveOn => "move-on",
            Self::CurveTo => "curve-to",
            Self::CurveBy => "curve-by",
            Self::RunPath => "run-path",
            Self::Home => "home",
            Self::Reached => "reached",
            Self::GiveTime => "give-time",
            Self::WithholdTime => "withhold-time",
            Self::SendPosition => "send-position",
            Self::WithholdPosition => "withhold-position",
            Self::FollowGear => "follow-gear",
            Self::FollowCam => "follow-cam",
            Self::Store => "store",
            Self::FollowPosition => "follow-position",
            Self::FollowVelocity => "follow-velocity",
            Self::FollowTorque => "follow-torque",
            Self::Unfollow => "unfollow",
            Self::PrepareTo => "prepare-to",
            Self::PrepareBy => "prepare-by",
            Self::Begin => "begin",
            Self::Begun => "begun",
        }
    }

    /// True for what sets an axis in motion or powers it: it needs an armed axis.
    #[must_use]
    pub const fn needs_arming(self) -> bool {
        use Verb::{Begin, Enable, Home, PrepareBy, PrepareTo, RunPath, Torque, Velocity};
        matches!(self, Enable | Velocity | Torque | RunPath | Home | PrepareTo | PrepareBy | Begin)
            || self.is_move()
            || self.is_cyclic()
            || self.is_coupled()
    }

    /// True for what sets a motor going, or makes it ready to go at a signal.
    #[must_use]
    pub const fn starts_motion(self) -> bool {
        self.needs_arming() && !self.is_cyclic() && !matches!(self, Self::Enable)
    }

    /// True for verbs that end with the axis at rest or without power.
    #[must_use]
    pub const fn ends_motion(self) -> bool {
        self.is_stop() || matches!(self, Self::Home | Self::Reached)
    }

    /// True for what makes a drive follow set-points cycle by cycle.
    #[must_use]
    pub const fn is_cyclic(self) -> bool {
        matches!(self, Self::FollowPosition | Self::FollowVelocity | Self::FollowTorque)
    }

    /// True for what makes an axis follow another one.
    #[must_use]
    pub const fn is_coupled(self) -> bool {
        matches!(self, Self::FollowGear | Self::FollowCam)
    }

    /// True for verbs that go to a position or by a distance, and end at the target.
    #[must_use]
    pub const fn is_move(self) -> bool {
        use Verb::{CurveBy, CurveTo, MoveBy, MoveOn, MoveTo};
        matches!(self, MoveTo | MoveBy | MoveOn | CurveTo | CurveBy)
    }

    /// Returns whether the verb takes this argument. Arguments that it does not take are always absent.
    #[must_use]
    pub const fn accepts(self, argument: Argument) -> bool {
        use Argument::{Acceleration, Deceleration, Path, Period, Target, Torque, Velocity};
        match self {
            Self::Velocity => matches!(argument, Velocity | Acceleration | Deceleration),
            Self::Torque => matches!(argument, Torque),
            Self::MoveTo | Self::MoveBy => {
                matches!(argument, Target | Velocity | Acceleration | Deceleration | Path)
            }
            Self::MoveOn | Self::PrepareTo | Self::PrepareBy => {
                matches!(argument, Target | Velocity | Acceleration | Deceleration)
            }
            Self::CurveTo | Self::CurveBy => !matches!(argument, Torque | Period),
            Self::RunPath => matches!(argument, Path),
            Self::Home => matches!(argument, Velocity),
            Self::GiveTime | Self::FollowPosition | Self::FollowVelocity | Self::FollowTorque => {
                matches!(argument, Period)
            }
            _ => false,
        }
    }

    /// True for what takes motion out: it overtakes all else and ends what runs on the axis.
    #[must_use]
    pub const fn is_stop(self) -> bool {
        matches!(self, Self::Stop | Self::QuickStop | Self::Disable)
    }
}
