//! The power state machine of CiA 402: states and commands of the controlword.

/// A state of the power drive system.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PowerState {
    /// Switched on, power disabled: after power-on.
    SwitchOnDisabled,
    /// Ready to switch on.
    Ready,
    /// Switched on, not yet enabled.
    SwitchedOn,
    /// Operation enabled: the motor obeys.
    Enabled,
    /// A quick stop is running or has ended.
    QuickStop,
    /// Comes to rest because of a fault.
    FaultReaction,
    /// Power is off because of a fault.
    Fault,
}

impl PowerState {
    /// Bits 0 to 3, 5 and 6 of the statusword.
    #[must_use]
    pub const fn bits(self) -> u16 {
        match self {
            Self::SwitchOnDisabled => 0x40,
            Self::Ready => 0x21,
            Self::SwitchedOn => 0x23,
            Self::Enabled => 0x27,
            Self::QuickStop => 0x07,
            Self::FaultReaction => 0x0F,
            Self::Fault => 0x08,
        }
    }

    /// The power stage is on.
    #[must_use]
    pub const fn has_power(self) -> bool {
        matches!(self, Self::Enabled | Self::QuickStop | Self::FaultReaction)
    }
}

/// Command of a controlword.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PowerCommand {
    /// `x0000110`: to ready.
    Shutdown,
    /// `x0000111`: to switched on; from enabled it disables operation.
    SwitchOn,
    /// `x0001111`.
    Enable,
    /// `xxxxxx0x`.
    DisableVoltage,
    /// `xxxxx01x`.
    QuickStop,
}

impl PowerCommand {
    /// The command in the lower bits of `control`; of bit 7 only the rising edge counts.
    #[must_use]
    pub const fn of(control: u16) -> Self {
        match control & 0x0F {
            low if low & 0x02 == 0 => Self::DisableVoltage,
            low if low & 0x04 == 0 => Self::QuickStop,
            low if low & 0x01 == 0 => Self::Shutdown,
            low if low & 0x08 == 0 => Self::SwitchOn,
            _ => Self::Enable,
        }
    }
}

/// Change of state by a command.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StateChange {
    /// Nothing.
    None,
    /// Another state at once.
    To(PowerState),
    /// Operation begins.
    Enable,
    /// Operation ends: the axis stops first, as 605Bh (shutdown) or 605Ch (disable) select.
    LeaveOperation(PowerState),
    /// The quick stop begins.
    QuickStop,
}

/// Transitions 2 to 12 and 16 of the standard. `stays` means that a quick stop may be left for operation
/// (605Ah = 5 to 8), `in_turn` that ready is not left for enabled in one step.
#[must_use]
pub const fn change_for(
    state: PowerState,
    power_command: PowerCommand,
    stays: bool,
    in_turn: bool,
) -> StateChange {
    use PowerCommand as O;
    use PowerState as S;
    match (state, power_command) {
        (S::SwitchOnDisabled, O::Shutdown) => StateChange::To(S::Ready),
        (S::Ready, O::SwitchOn) => StateChange::To(S::SwitchedOn),
        (S::Ready, O::Enable) if in_turn => StateChange::To(S::SwitchedOn),
        (S::Ready | S::SwitchedOn, O::Enable) => StateChange::Enable,
        (S::QuickStop, O::Enable) if stays => StateChange::Enable,
        (S::SwitchedOn, O::Shutdown) => StateChange::To(S::Ready),
        (S::Ready | S::SwitchedOn, O::DisableVoltage | O::QuickStop) => {
            StateChange::To(S::SwitchOnDisabled)
        }
        (S::Enabled, O::SwitchOn) => StateChange::LeaveOperation(S::SwitchedOn),
        (S::Enabled, O::Shutdown) => StateChange::LeaveOperation(S::Ready),
        (S::Enabled, O::QuickStop) => StateChange::QuickStop,
        (S::Enabled | S::QuickStop, O::DisableVoltage) => StateChange::To(S::SwitchOnDisabled),
        _ => StateChange::None,
    }
}
