//! The possible effect of a frame on its drive.

use crate::profile::{Parameter, Persistence};
use crate::station::RequestClass;

/// The effect that a frame may have on its drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Effect {
    /// To its motor and its settings.
    pub impact: Impact,
    /// True if it writes to permanent memory, or restores values from it.
    pub persistent: bool,
}

/// The effect on the motor and its settings, least severe first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Impact {
    /// None: a read, a reply, or a stop.
    Nothing,
    /// Changes of settings that move no motor.
    Settings,
    /// A start or change of motion, or power for a motor.
    Motion,
    /// Unknown: treated as the most severe.
    Unknown,
}

impl Effect {
    /// A read, a reply, or a stop.
    pub const NOTHING: Self = Self { impact: Impact::Nothing, persistent: false };
    /// A change of settings that move no motor.
    pub const SETTINGS: Self = Self { impact: Impact::Settings, persistent: false };
    /// A start or change of motion, or power for a motor.
    pub const MOTION: Self = Self { impact: Impact::Motion, persistent: false };
    /// Writes to permanent memory, or restores values from it.
    pub const PERSISTENT: Self = Self { impact: Impact::Settings, persistent: true };
    /// Unknown effect.
    pub const UNKNOWN: Self = Self { impact: Impact::Unknown, persistent: false };

    /// Effect of a request by its class, which states the treatment after silence.
    #[must_use]
    pub const fn from_class(class: RequestClass) -> Self {
        match class {
            RequestClass::Idempotent | RequestClass::Stop => Self::NOTHING,
            RequestClass::ReadBack => Self::SETTINGS,
            RequestClass::NoRetry => Self::MOTION,
        }
    }

    /// Effect of writing a parameter; `None` is one that no table has.
    #[must_use]
    pub fn from_write(parameter: Option<&Parameter>) -> Self {
        let Some(parameter) = parameter else { return Self::UNKNOWN };
        let stores = matches!(parameter.persistence, Persistence::Always | Persistence::UnlessRam);
        let act = if parameter.moves { Impact::Motion } else { Impact::Settings };
        Self { impact: act, persistent: stores }
    }

    /// The more severe of both effects.
    #[must_use]
    pub fn combine(self, other: Self) -> Self {
        Self {
            impact: self.impact.max(other.impact),
            persistent: self.persistent || other.persistent,
        }
    }
}
