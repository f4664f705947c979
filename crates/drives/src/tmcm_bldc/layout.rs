//! Numbers of the parameters that the module itself uses, by their names in the profile.

use super::units;
use polepair_core::profile::Profile;

macro_rules! roles {
    ($($(#[$doc:meta])* $role:ident: $($name:literal)|+;)+) => {
        /// Meaning of an axis parameter.
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        pub enum Role { $($(#[$doc])* $role,)+ }

        /// Each meaning with the names that the maker's library has for it.
        const NAMES: &[(Role, &[&str])] = &[$((Role::$role, &[$($name),+]),)+];
    };
}

roles! {
    /// Writing it starts a move.
    TargetPosition: "target position";
    /// Writing it sets the counter.
    ActualPosition: "actual position";
    /// Position of the ramp.
    RampPosition: "ramp position";
    /// Writing it turns the motor.
    TargetVelocity: "target velocity";
    /// Measured speed.
    ActualVelocity: "actual velocity";
    /// Speed of the ramp.
    RampVelocity: "ramp velocity";
    /// Limit of the speed while positioning.
    MaxVelocity: "max velocity";
    /// Slope of the ramp.
    MaxAcceleration: "max acceleration";
    /// 0: no ramp.
    EnableRamp: "enable ramp";
    /// Writing it regulates a current.
    TargetTorque: "target torque";
    /// Measured current.
    ActualTorque: "actual torque";
    /// Limit of the current.
    MaxCurrent: "max current";
    /// Status flags.
    Flags: "status flags";
    /// Supply voltage.
    Supply: "supply voltage";
    /// Temperature of the power stage.
    Temperature: "driver temperature";
    /// 1 when the last move has arrived.
    Reached: "position reached flag";
    /// Counts of a turn.
    Scaler: "position scaler";
    /// Encoder counts of a turn.
    EncoderSteps: "encoder steps" | "absolute encoder steps";
    /// Poles of the motor.
    Poles: "motor poles";
    /// Pole pairs of the motor.
    PolePairs: "motor pole pairs";
    /// Sensor of the commutation.
    Commutation: "commutation mode";
    /// Arrived at most so far from the target.
    ReachedDistance: "target reached distance" | "position reached distance";
    /// Arrived at most at this speed.
    ReachedVelocity: "target reached velocity" | "position reached velocity";
    /// Halted below this speed.
    HaltedVelocity: "motor halted velocity" | "halted velocity";
    /// 0: the power stage is off.
    Driver: "enable driver";
}

const ROLES: usize = NAMES.len();

/// Factory values that the profile does not state. \[I\]
pub const FACTORY: &[(Role, i32)] = &[
    (Role::MaxVelocity, 4000),
    (Role::MaxAcceleration, 2000),
    (Role::EnableRamp, 1),
    (Role::MaxCurrent, 2000),
    (Role::Scaler, 65_536),
    (Role::EncoderSteps, 4096),
    (Role::Poles, 8),
    (Role::PolePairs, 4),
    (Role::ReachedDistance, 5),
    (Role::ReachedVelocity, 500),
    (Role::HaltedVelocity, 5),
    (Role::Driver, 1),
];

/// Numbers by meaning.
#[derive(Clone, Debug)]
pub struct Layout {
    numbers: [Option<u8>; ROLES],
    roles: [Option<Role>; 256],
}

impl Layout {
    /// The numbers in a profile.
    pub fn new(profile: &'static Profile) -> Self {
        let mut new = Self { numbers: [None; ROLES], roles: [None; 256] };
        for (role, names) in NAMES {
            let named = names.iter().find_map(|name| profile.find_parameter(name));
            let found = named.and_then(|id| profile.parameter(id)).filter(|found| found.space == 0);
            // Numbers above 255 belong to linear axes, which are not simulated.
            let Some(number) = found.and_then(|found| u8::try_from(found.index).ok()) else {
                continue;
            };
            new.numbers[*role as usize] = Some(number);
            new.roles[usize::from(number)] = Some(*role);
        }
        new
    }

    /// Number of a meaning, where the module has it.
    pub const fn number(&self, role: Role) -> Option<u8> {
        self.numbers[role as usize]
    }

    /// Meaning of a number.
    pub const fn role(&self, number: u8) -> Option<Role> {
        self.roles[number as usize]
    }

    /// Value of a meaning among the settings of a motor.
    pub fn value(&self, role: Role, settings: &[i32; 256]) -> Option<i32> {
        self.number(role).map(|number| settings[usize::from(number)])
    }

    /// The commutation mode of a new module: by the encoder.
    pub const fn encoder_commutation(&self) -> i32 {
        // The maker's library has three lists of modes. Only servo modules without a scaler have block
        // commutation by hall sensors at 3, and the encoder behind it.
        match (self.number(Role::Poles), self.number(Role::Scaler)) {
            (Some(_), _) => 7,
            (None, Some(_)) => 3,
            (None, None) => 4,
        }
    }

    /// Counts of a turn by the settings of a motor.
    pub fn counts(&self, settings: &[i32; 256]) -> u32 {
        let value = |role| self.value(role, settings);
        let mode = value(Role::Commutation).unwrap_or_default();
        let by_hall =
            self.number(Role::Poles).is_some() && units::HALL_MODES.contains(&mode.into());
        let hall = |poles: i32| poles.saturating_mul(units::HALL_COUNTS as i32);
        let counts = match value(Role::Scaler) {
            Some(scaler) => Some(scaler),
            None if by_hall => value(Role::Poles).map(hall),
            None => value(Role::EncoderSteps),
        };
        // A count of zero would make the position meaningless; the module keeps a usable one. [I]
        counts.filter(|counts| *counts > 0).map_or(4096, i32::unsigned_abs)
    }
}
