//! The possible effect of a frame on its drive.

use crate::profile::{Parameter, Persistence};
use crate::station::RequestClass;

/// The effect that a frame may have on its drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Effect {
    /// To its motor and its settings.
    pub impact: Impact,
    /// It writes to permanent memory, or restores values from it.
    pub persistent: bool,
}

/// The effect on the motor and its settings, least severe first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Impact {
    /// None: a read, a reply, or a stop.
    Nothing,
    /// It changes settings that move no motor.
    Settings,
    /// It may start or change motion, or power a motor.
    Motion,
    /// Unknown: treated as the most severe.
    Unknown,
}

impl Effect {
    /// A read, a reply, or a stop.
    pub const NOTHING: Self = Self { impact: Impact::Nothing, persistent: false };
    /// It changes settings that move no motor.
    pub const SETTINGS: Self = Self { impact: Impact::Settings, persistent: false };
    /// It may start or change motion, or power a motor.
    pub const MOTION: Self = Self { impact: Impact::Motion, persistent: false };
    /// Writes to permanent memory, or restores values from it.
    pub const PERSISTENT: Self = Self { impact: Impact::Settings, persistent: true };
    /// Unknown effect.
    pub const UNKNOWN: Self = Self { impact: Impact::Unknown, persistent: false };

    /// Of a request by what may be done with it after silence.
    #[must_use]
    pub const fn from_class(class: RequestClass) -> Self {
        match class {
            RequestClass::Idempotent | RequestClass::Stop => Self::NOTHING,
            RequestClass::ReadBack => Self::SETTINGS,
            RequestClass::NoRetry => Self::MOTION,
        }
    }

    /// Of writing a parameter; `None` is one that no table has.
    #[must_use]
    pub fn from_write(parameter: Option<&Parameter>) -> Self {
        let Some(parameter) = parameter else { return Self::UNKNOWN };
        let stores = matches!(parameter.persistence, Persistence::Always | Persistence::UnlessRam);
        let act = if parameter.moves { Impact::Motion } else { Impact::Settings };
        Self { impact: act, persistent: stores }
    }

    /// Of both.
    #[must_use]
    pub fn combine(self, other: Self) -> Self {
        Self {
            impact: self.impact.max(other.impact),
            persistent: self.persistent || other.persistent,
        }
    }
}
