//! Faults by their error codes (CiA 402, object 603Fh).

/// An error code; 0 for none.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct FaultCode(pub u16);

impl FaultCode {
    /// None.
    pub const NONE: Self = Self(0);
    /// Overloaded for too long: the current's square over time.
    pub const OVERLOAD: Self = Self(0x2350);
    /// DC link over-voltage.
    pub const OVERVOLTAGE: Self = Self(0x3210);
    /// DC link under-voltage.
    pub const UNDERVOLTAGE: Self = Self(0x3220);
    /// Power stage too hot.
    pub const HOT: Self = Self(0x4310);
    /// Settings in permanent memory damaged.
    pub const DATA_STORAGE: Self = Self(0x5530);
    /// Motor blocked.
    pub const BLOCKED: Self = Self(0x7121);
    /// Commutation.
    pub const COMMUTATION: Self = Self(0x7122);
    /// Encoder.
    pub const ENCODER: Self = Self(0x7305);
    /// Heartbeat or guarding lost.
    pub const LINK: Self = Self(0x8130);
    /// Following error.
    pub const FOLLOWING: Self = Self(0x8611);

    /// Bits of the error register (1001h).
    #[must_use]
    pub const fn error_register(self) -> u8 {
        match self.0 >> 12 {
            0 => 0,
            2 => 0x03,
            3 => 0x05,
            4 => 0x09,
            8 if self.0 & 0xFF00 == 0x8600 => 0x21,
            8 => 0x11,
            _ => 0x81,
        }
    }

    /// Name of the fault for the bench.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OVERLOAD => "overload",
            Self::OVERVOLTAGE => "over-voltage",
            Self::UNDERVOLTAGE => "under-voltage",
            Self::HOT => "over-temperature",
            Self::DATA_STORAGE => "settings damaged",
            Self::BLOCKED => "motor blocked",
            Self::COMMUTATION => "commutation",
            Self::ENCODER => "encoder",
            Self::LINK => "link lost",
            Self::FOLLOWING => "following error",
            _ => "fault",
        }
    }
}
