//! What a frame is in its conversation, and the values that it carries.

use super::{Direction, Raw};
use crate::profile::{Parameter, Profile};

/// What is known of the conversation that a frame stands in.
#[derive(Clone, Copy, Debug, Default)]
pub struct Talk<'a> {
    /// Who sent the frame, if known.
    pub direction: Option<Direction>,
    /// The last request on the line that is not answered yet.
    pub open: Option<Raw<'a>>,
    /// The last request to the axis that [told how it answers](super::Dissector::forms).
    pub form: Option<Raw<'a>>,
    /// The product's tables.
    pub profile: Option<&'static Profile>,
}

/// What a frame is in its conversation.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Turn {
    /// Nobody can tell, or it belongs to no exchange.
    #[default]
    Aside,
    /// From a host: asks, and is owed so much.
    Asks(Awaits),
    /// From a drive: it has understood a request.
    Acknowledges,
    /// From a drive: the answer to a request.
    Answers,
    /// From a drive: the answer to a request, or told unasked.
    Tells,
}

impl Turn {
    /// Who sends such a frame.
    #[must_use]
    pub const fn speaker(self) -> Option<Direction> {
        match self {
            Self::Aside => None,
            Self::Asks(_) => Some(Direction::ToDrive),
            Self::Acknowledges | Self::Answers | Self::Tells => Some(Direction::ToHost),
        }
    }
}

/// What a request is owed.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Awaits {
    /// Acknowledgements.
    pub acks: Owed,
    /// Answers.
    pub answers: Owed,
}

impl Awaits {
    /// One answer.
    pub const ANSWER: Self = Self { acks: Owed::Nothing, answers: Owed::Exactly(1) };
    /// Nothing that is sure to come.
    pub const PERHAPS: Self = Self { acks: Owed::Nothing, answers: Owed::Perhaps };
    /// Nothing.
    pub const NOTHING: Self = Self { acks: Owed::Nothing, answers: Owed::Nothing };
}

/// How many frames a request is owed.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Owed {
    /// None.
    #[default]
    Nothing,
    /// Any number: nobody can tell how many.
    Perhaps,
    /// So many.
    Exactly(u8),
}

/// A value that a frame carries.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Reading<'a> {
    /// Of what.
    pub what: What<'a>,
    /// The integer on the wire.
    pub raw: i64,
    /// The host tells the drive, not the drive the host.
    pub written: bool,
    /// Which motor of the axis' address, where one address has several.
    pub part: u8,
}

/// What a value is of.
#[derive(Clone, Copy, Debug)]
pub enum What<'a> {
    /// A parameter of the profile.
    Parameter(&'static Parameter),
    /// What the protocol calls it, where no profile has it.
    Named(&'a str),
}

impl PartialEq for What<'_> {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Parameter(one), Self::Parameter(other)) => core::ptr::eq(*one, *other),
            (Self::Named(one), Self::Named(other)) => one == other,
            _ => false,
        }
    }
}

/// A place in a sequence of frames that go to an axis one after the other.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Place {
    /// Whatever was counted ends: the next one may have any number.
    Begins,
    /// The number of this one, and after how many it begins anew.
    Counts(u32, u32),
}

/// A short text on the stack, for the name of what has none.
#[derive(Clone, Copy, Debug)]
pub struct Label {
    bytes: [u8; Self::MAX],
    len: usize,
}

impl Label {
    /// Longest label; what does not fit is cut.
    pub const MAX: usize = 40;

    /// What is displayed.
    #[must_use]
    pub fn of(text: impl core::fmt::Display) -> Self {
        let mut label = Self { bytes: [0; Self::MAX], len: 0 };
        // What does not fit is cut.
        let _ = core::fmt::Write::write_fmt(&mut label, format_args!("{text}"));
        label
    }

    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(&self.bytes[..self.len]).unwrap_or("")
    }
}

impl core::fmt::Write for Label {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        let room = self.bytes.get_mut(self.len..self.len + text.len()).ok_or(core::fmt::Error)?;
        room.copy_from_slice(text.as_bytes());
        self.len += text.len();
        Ok(())
    }
}
