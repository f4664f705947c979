//! Network management: who may say what (CiA 301, 7.2.8).

use super::cob;
use crate::error::WireError;
use crate::medium::Frame;

/// What the master orders.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Command {
    /// To operational: process data flow.
    Start,
    /// To stopped: nothing but network management.
    Stop,
    /// To pre-operational: everything but process data.
    PreOperational,
    /// As after power-on.
    ResetNode,
    /// The communication objects as after power-on.
    ResetCommunication,
    /// No command that the standard has.
    Other(u8),
}

impl From<u8> for Command {
    fn from(specifier: u8) -> Self {
        match specifier {
            1 => Self::Start,
            2 => Self::Stop,
            128 => Self::PreOperational,
            129 => Self::ResetNode,
            130 => Self::ResetCommunication,
            other => Self::Other(other),
        }
    }
}

impl From<Command> for u8 {
    fn from(command: Command) -> Self {
        match command {
            Command::Start => 1,
            Command::Stop => 2,
            Command::PreOperational => 128,
            Command::ResetNode => 129,
            Command::ResetCommunication => 130,
            Command::Other(other) => other,
        }
    }
}

impl Command {
    /// The word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Stop => "stop",
            Self::PreOperational => "pre-operational",
            Self::ResetNode => "reset node",
            Self::ResetCommunication => "reset communication",
            Self::Other(_) => "unknown command",
        }
    }
}

/// What a node says of itself.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum State {
    /// It has just booted.
    BootUp,
    /// Nothing but network management.
    Stopped,
    /// Everything.
    Operational,
    /// Everything but process data.
    PreOperational,
    /// No state that the standard has.
    Other(u8),
}

impl From<u8> for State {
    /// Bit 7, the guarding toggle, does not count.
    fn from(byte: u8) -> Self {
        match byte & 0x7F {
            0 => Self::BootUp,
            4 => Self::Stopped,
            5 => Self::Operational,
            0x7F => Self::PreOperational,
            other => Self::Other(other),
        }
    }
}

impl From<State> for u8 {
    fn from(state: State) -> Self {
        match state {
            State::BootUp => 0,
            State::Stopped => 4,
            State::Operational => 5,
            State::PreOperational => 0x7F,
            State::Other(other) => other,
        }
    }
}

impl State {
    /// The word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::BootUp => "boot-up",
            Self::Stopped => "stopped",
            Self::Operational => "operational",
            Self::PreOperational => "pre-operational",
            Self::Other(_) => "unknown state",
        }
    }
}

/// An order to one node, or to all.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Order {
    /// What to do.
    pub command: Command,
    /// Who; 0 is everybody.
    pub node: u8,
}

impl Order {
    /// The frame that carries it.
    #[must_use]
    pub fn emit(self) -> Frame {
        Frame::standard(cob::NMT, &[self.command.into(), self.node])
    }

    /// Reads the data of a frame with identifier 0.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`]: two bytes are the whole order;
    /// [`WireError::Unexpected`] for a node above 127.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        match *data {
            [_, node] if node > super::NODE_MAX => {
                Err(WireError::Unexpected { at: 1, found: node })
            }
            [command, node] => Ok(Self { command: command.into(), node }),
            _ => Err(super::wrong_length(2, data)),
        }
    }
}
