//! Common parts of all CiA 402 drives: states of the statusword, commands of the controlword, modes.

use super::sdo::ObjectIndex;

/// Controlword.
pub const CONTROLWORD: ObjectIndex = ObjectIndex::new(0x6040, 0);
/// Statusword.
pub const STATUSWORD: ObjectIndex = ObjectIndex::new(0x6041, 0);
/// Device type; the lower half is the device profile.
pub const DEVICE_TYPE: ObjectIndex = ObjectIndex::new(0x1000, 0);
/// The device profile's number, as the device type has it.
pub const PROFILE_NUMBER: u16 = 402;

/// The states of the power drive system (CiA 402-2, finite state automaton).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum DriveState {
    /// Self-test after power-on.
    NotReady,
    /// No power may be switched on.
    SwitchOnDisabled,
    /// Power may be switched on.
    Ready,
    /// Power is on, the motor is not.
    SwitchedOn,
    /// The motor is powered and obeys.
    Enabled,
    /// The drive brakes, or holds after braking.
    QuickStop,
    /// A fault happened, it brakes.
    FaultReaction,
    /// A fault.
    Fault,
    /// A statusword that the standard does not have.
    Other(u16),
}

impl DriveState {
    /// The state in a statusword. Bits without a part in it, voltage enabled among them, do not count, so the
    /// TS's words with bit 4 (0x0050, 0x0031, 0x0033, 0x0037) are read too.
    #[must_use]
    pub const fn of(statusword: u16) -> Self {
        match statusword & 0x4F {
            0x00 => Self::NotReady,
            0x40 => Self::SwitchOnDisabled,
            0x0F => Self::FaultReaction,
            0x08 => Self::Fault,
            _ => match statusword & 0x6F {
                0x21 => Self::Ready,
                0x23 => Self::SwitchedOn,
                0x27 => Self::Enabled,
                0x07 => Self::QuickStop,
                _ => Self::Other(statusword),
            },
        }
    }

    /// The standard's word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotReady => "not ready to switch on",
            Self::SwitchOnDisabled => "switch on disabled",
            Self::Ready => "ready to switch on",
            Self::SwitchedOn => "switched on",
            Self::Enabled => "operation enabled",
            Self::QuickStop => "quick stop active",
            Self::FaultReaction => "fault reaction active",
            Self::Fault => "fault",
            Self::Other(_) => "no state of the standard",
        }
    }
}

/// The command in a controlword, by its bits 0 to 3 and 7.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum ControlCommand {
    /// To ready to switch on.
    Shutdown,
    /// To switched on; from operation enabled back to it.
    SwitchOn,
    /// To operation enabled.
    Enable,
    /// Power off at once.
    DisableVoltage,
    /// Brake.
    QuickStop,
    /// Forget the fault, when bit 7 was clear before.
    ResetFault,
}

impl ControlCommand {
    /// The command in a controlword.
    #[must_use]
    pub const fn of(controlword: u16) -> Self {
        match controlword & 0x8F {
            bits if bits & 0x80 != 0 => Self::ResetFault,
            bits if bits & 0x02 == 0 => Self::DisableVoltage,
            bits if bits & 0x04 == 0 => Self::QuickStop,
            bits if bits & 0x01 == 0 => Self::Shutdown,
            bits if bits & 0x08 == 0 => Self::SwitchOn,
            _ => Self::Enable,
        }
    }

    /// The standard's word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Shutdown => "shutdown",
            Self::SwitchOn => "switch on",
            Self::Enable => "enable operation",
            Self::DisableVoltage => "disable voltage",
            Self::QuickStop => "quick stop",
            Self::ResetFault => "fault reset",
        }
    }
}

/// Modes of operation (object 6060h).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum OperationMode {
    /// None.
    None,
    /// Profile position.
    ProfilePosition,
    /// Velocity of frequency converters.
    Velocity,
    /// Profile velocity.
    ProfileVelocity,
    /// Profile torque.
    ProfileTorque,
    /// Homing.
    Homing,
    /// Interpolated position.
    Interpolated,
    /// Cyclic synchronous position.
    CyclicPosition,
    /// Cyclic synchronous velocity.
    CyclicVelocity,
    /// Cyclic synchronous torque.
    CyclicTorque,
    /// The manufacturer's own, or reserved.
    Other(i8),
}

impl From<i8> for OperationMode {
    fn from(number: i8) -> Self {
        match number {
            0 => Self::None,
            1 => Self::ProfilePosition,
            2 => Self::Velocity,
            3 => Self::ProfileVelocity,
            4 => Self::ProfileTorque,
            6 => Self::Homing,
            7 => Self::Interpolated,
            8 => Self::CyclicPosition,
            9 => Self::CyclicVelocity,
            10 => Self::CyclicTorque,
            other => Self::Other(other),
        }
    }
}

impl From<OperationMode> for i8 {
    fn from(mode: OperationMode) -> Self {
        match mode {
            OperationMode::None => 0,
            OperationMode::ProfilePosition => 1,
            OperationMode::Velocity => 2,
            OperationMode::ProfileVelocity => 3,
            OperationMode::ProfileTorque => 4,
            OperationMode::Homing => 6,
            OperationMode::Interpolated => 7,
            OperationMode::CyclicPosition => 8,
            OperationMode::CyclicVelocity => 9,
            OperationMode::CyclicTorque => 10,
            OperationMode::Other(other) => other,
        }
    }
}
