//! Network management: commands and states (CiA 301, 7.2.8).

use super::cob;
use crate::error::WireError;
use crate::medium::Frame;

/// Command of the master.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum NmtCommand {
    /// To operational: process data flow.
    Start,
    /// To stopped: nothing but network management.
    Stop,
    /// To pre-operational: everything but process data.
    PreOperational,
    /// Resets the node as after power-on.
    ResetNode,
    /// The communication objects as after power-on.
    ResetCommunication,
    /// No command that the standard has.
    Other(u8),
}

impl From<u8> for NmtCommand {
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

impl From<NmtCommand> for u8 {
    fn from(command: NmtCommand) -> Self {
        match command {
            NmtCommand::Start => 1,
            NmtCommand::Stop => 2,
            NmtCommand::PreOperational => 128,
            NmtCommand::ResetNode => 129,
            NmtCommand::ResetCommunication => 130,
            NmtCommand::Other(other) => other,
        }
    }
}

impl NmtCommand {
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

/// State of a node.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum NmtState {
    /// The node has just booted.
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

impl From<u8> for NmtState {
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

impl From<NmtState> for u8 {
    fn from(state: NmtState) -> Self {
        match state {
            NmtState::BootUp => 0,
            NmtState::Stopped => 4,
            NmtState::Operational => 5,
            NmtState::PreOperational => 0x7F,
            NmtState::Other(other) => other,
        }
    }
}

impl NmtState {
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
pub struct NmtMessage {
    /// Command.
    pub command: NmtCommand,
    /// Node; 0 for all.
    pub node: u8,
}

impl NmtMessage {
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
