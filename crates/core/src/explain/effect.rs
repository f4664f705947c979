//! What a frame may do to the drive that it is sent to.

use crate::profile::{Parameter, Persistence};
use crate::station::Class;

/// What a frame may do to the drive that it is sent to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Effect {
    /// To its motor and its settings.
    pub act: Act,
    /// It writes permanent memory, or brings back what is kept there.
    pub keeps: bool,
}

/// What a frame may do to a motor and its settings, the harmless first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Act {
    /// Nothing: it asks, it answers, or it brings a motor to rest.
    Nothing,
    /// It changes settings that move no motor.
    Sets,
    /// It may start or change motion, or power a motor.
    Moves,
    /// Nobody can tell: to be held for the worst.
    Unknown,
}

impl Effect {
    /// It asks, it answers, or it brings a motor to rest.
    pub const NOTHING: Self = Self { act: Act::Nothing, keeps: false };
    /// It changes settings that move no motor.
    pub const SETS: Self = Self { act: Act::Sets, keeps: false };
    /// It may start or change motion, or power a motor.
    pub const MOVES: Self = Self { act: Act::Moves, keeps: false };
    /// It writes permanent memory, or brings back what is kept there.
    pub const KEEPS: Self = Self { act: Act::Sets, keeps: true };
    /// Nobody can tell.
    pub const UNKNOWN: Self = Self { act: Act::Unknown, keeps: false };

    /// Of a request by what may be done with it after silence.
    #[must_use]
    pub const fn of_class(class: Class) -> Self {
        match class {
            Class::Idempotent | Class::Stop => Self::NOTHING,
            Class::Confirm => Self::SETS,
            Class::Never => Self::MOVES,
        }
    }

    /// Of writing a parameter; `None` is one that no table has.
    #[must_use]
    pub fn of_writing(parameter: Option<&Parameter>) -> Self {
        let Some(parameter) = parameter else { return Self::UNKNOWN };
        let keeps = matches!(parameter.persistence, Persistence::Always | Persistence::UnlessRam);
        let act = if parameter.moves { Act::Moves } else { Act::Sets };
        Self { act, keeps }
    }

    /// Of both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self { act: self.act.max(other.act), keeps: self.keeps || other.keeps }
    }
}

#[cfg(test)]
mod tests;
