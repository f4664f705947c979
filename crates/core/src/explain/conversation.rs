//! The role of a frame in its conversation, and its values.

use super::{Direction, RawFrame};
use crate::convert::ascii_text;
use crate::profile::{Parameter, Profile};

/// The conversation around a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct ConversationContext<'a> {
    /// Direction of the frame, if known.
    pub direction: Option<Direction>,
    /// The last request on the line that is not answered yet.
    pub open_request: Option<RawFrame<'a>>,
    /// The last request to the axis that [set its reply format](super::FrameConversation::sets_reply_format).
    pub format_request: Option<RawFrame<'a>>,
    /// The product's tables.
    pub profile: Option<&'static Profile>,
}

/// Role of a frame in its conversation.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum FrameRole {
    /// Unknown, or not part of an exchange.
    #[default]
    Unrelated,
    /// A request from a host, and the replies that it expects.
    Request(ReplyExpectation),
    /// From a drive: it has understood a request.
    Acknowledgement,
    /// From a drive: the answer to a request.
    Answer,
    /// A message from a drive: a reply, or sent by itself.
    Report,
}

impl FrameRole {
    /// The direction that follows from the role.
    #[must_use]
    pub const fn direction(self) -> Option<Direction> {
        match self {
            Self::Unrelated => None,
            Self::Request(_) => Some(Direction::ToDrive),
            Self::Acknowledgement | Self::Answer | Self::Report => Some(Direction::ToHost),
        }
    }
}

/// The replies that a request expects.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ReplyExpectation {
    /// Acknowledgements.
    pub acks: ReplyCount,
    /// Answers.
    pub answers: ReplyCount,
}

impl ReplyExpectation {
    /// One answer.
    pub const ONE_ANSWER: Self = Self { acks: ReplyCount::Zero, answers: ReplyCount::Exactly(1) };
    /// Nothing that is sure to come.
    pub const UNKNOWN: Self = Self { acks: ReplyCount::Zero, answers: ReplyCount::Unknown };
    /// Nothing.
    pub const NONE: Self = Self { acks: ReplyCount::Zero, answers: ReplyCount::Zero };
}

/// The number of replies that a request expects.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum ReplyCount {
    /// None.
    #[default]
    Zero,
    /// Any number; not known in advance.
    Unknown,
    /// Exactly this number.
    Exactly(u8),
}

/// A value that a frame carries.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FrameValue<'a> {
    /// Source of the value.
    pub source: ValueSource<'a>,
    /// The integer on the wire.
    pub raw: i64,
    /// True for a write by the host, false for a report by the drive.
    pub written: bool,
    /// Motor of the axis' address, if one address has several.
    pub motor: u8,
}

/// The source of a value.
#[derive(Clone, Copy, Debug)]
pub enum ValueSource<'a> {
    /// A parameter of the profile.
    Parameter(&'static Parameter),
    /// The protocol's name of it, where no profile has one.
    Named(&'a str),
}

impl PartialEq for ValueSource<'_> {
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
pub enum SequencePosition {
    /// The sequence restarts: the next number may be any.
    Restart,
    /// The number of this one, and after how many it begins anew.
    Number(u32, u32),
}

/// A short text on the stack, for subjects without a name.
#[derive(Clone, Copy, Debug)]
pub struct ShortText {
    bytes: [u8; Self::MAX],
    len: usize,
}

impl ShortText {
    /// Longest label; what does not fit is cut.
    pub const MAX: usize = 40;

    /// Makes it from a displayed value.
    #[must_use]
    pub fn from_display(text: impl core::fmt::Display) -> Self {
        let mut label = Self { bytes: [0; Self::MAX], len: 0 };
        // Text that does not fit is cut.
        let _ = core::fmt::Write::write_fmt(&mut label, format_args!("{text}"));
        label
    }

    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        ascii_text(&self.bytes[..self.len])
    }
}

impl core::fmt::Write for ShortText {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        let buffer = self.bytes.get_mut(self.len..self.len + text.len()).ok_or(core::fmt::Error)?;
        buffer.copy_from_slice(text.as_bytes());
        self.len += text.len();
        Ok(())
    }
}
