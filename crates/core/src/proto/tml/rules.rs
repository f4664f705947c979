//! Messages that a wire forbids, with a text for the user (TML communication manual, chapters 2 to 5).
//! Hosts and encoders check them before a byte is sent.

use super::technocan;
use super::wire::{IdCode, Message};
use crate::error::Unsupported;

/// A wire with its rules.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum TmlWire {
    /// RS-232 or Ethernet: one drive, which relays to the others on its CAN bus.
    Rs232,
    /// RS-485: many drives, one of which may send at a time.
    Rs485,
    /// CAN with 29-bit identifiers.
    TmlCan,
    /// CAN with 11-bit identifiers.
    TechnoCan,
}

/// A rule that a message breaks.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum WireRule {
    /// GiveMeData is for one axis.
    GiveMeDataToGroup,
    /// Nothing that is answered goes to a group on RS-485.
    Rs485AnswersFromGroup,
    /// On RS-485 no drive sends by itself.
    Rs485Unsolicited,
    /// On RS-232 the host has its drive's axis ID.
    Rs232HostId,
    /// On RS-485 and CAN the host has an axis ID of its own.
    OwnHostId,
    /// TechnoCAN has no identifiers for multiples of 32.
    TechnoCanAxis,
    /// TechnoCAN has five groups.
    TechnoCanGroups,
    /// TechnoCAN has room for three data words.
    TechnoCanWords,
    /// No drive receives TakeData2 on TechnoCAN, so no relay passes it on.
    TechnoCanRelay,
    /// The instruction lacks data words that the wire needs.
    Incomplete,
}

impl WireRule {
    /// The rule, and what to do instead.
    #[must_use]
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::GiveMeDataToGroup => {
                "GiveMeData is for one axis; ask a group with GiveMeData2 (??NAME)"
            }
            Self::Rs485AnswersFromGroup => {
                "on RS-485 no request for data goes to a group: the answers would collide; ask \
                 the axes one by one"
            }
            Self::Rs485Unsolicited => {
                "on RS-485 no drive speaks unasked: leave SRL_MASK, SRH_MASK and MER_MASK at zero, \
                 use no SEND, and poll instead"
            }
            Self::Rs232HostId => {
                "on RS-232 the host ID equals the axis ID of the drive that is connected; leave \
                 host= out, or name that drive first"
            }
            Self::OwnHostId => {
                "on RS-485 and CAN the host needs an axis ID that no drive has; choose another host="
            }
            Self::TechnoCanAxis => {
                "on TechnoCAN no axis ID is a multiple of 32; give the drive one from 1 to 31"
            }
            Self::TechnoCanGroups => "TechnoCAN has groups 1 to 5 only",
            Self::TechnoCanWords => {
                "on TechnoCAN an instruction has at most three data words, PVTP and TakeData \
                 excepted; use a shorter form"
            }
            Self::TechnoCanRelay => {
                "behind a TechnoCAN relay nothing comes from groups or unasked: no drive receives \
                 TakeData2, so no relay passes it on; ask each axis with GiveMeData"
            }
            Self::Incomplete => "the instruction lacks data words",
        }
    }
}

impl From<WireRule> for Unsupported {
    fn from(rule: WireRule) -> Self {
        Self::Forbidden(rule.sentence())
    }
}

impl TmlWire {
    /// Returns whether the host's own ID has the host bit set: it shares its drive's axis ID.
    #[must_use]
    pub const fn shares_drive_id(self) -> bool {
        matches!(self, Self::Rs232)
    }

    /// The ID code by which drives answer to the host.
    #[must_use]
    pub const fn host_id_code(self, host: u8) -> IdCode {
        IdCode { group: false, id: host, host: self.shares_drive_id() }
    }

    /// Returns whether a drive acknowledges a message to `to`. On RS-485 neither groups nor axis ID 0 \[I\]: all would
    /// send at once.
    #[must_use]
    pub const fn acknowledges(self, to: IdCode) -> bool {
        match self {
            Self::Rs232 => true,
            Self::Rs485 => !to.group && to.id != 0,
            Self::TmlCan | Self::TechnoCan => false,
        }
    }

    /// Checks whether drives may send by themselves (SRL_MASK and its like, SEND).
    ///
    /// # Errors
    /// [`WireRule::Rs485Unsolicited`].
    pub const fn check_unsolicited(self) -> Result<(), WireRule> {
        match self {
            Self::Rs485 => Err(WireRule::Rs485Unsolicited),
            _ => Ok(()),
        }
    }

    /// Checks whether a host of this ID can reach a drive on the wire itself: the connected one on RS-232,
    /// any on the others.
    ///
    /// # Errors
    /// [`WireRule::Rs232HostId`], [`WireRule::OwnHostId`].
    pub const fn check_host_id(self, host: u8, drive: u8) -> Result<(), WireRule> {
        let same = match self {
            Self::TechnoCan => host % 32 == drive % 32,
            _ => host == drive,
        };
        match (self, same) {
            (Self::Rs232, false) => Err(WireRule::Rs232HostId),
            (Self::Rs485 | Self::TmlCan | Self::TechnoCan, true) => Err(WireRule::OwnHostId),
            _ => Ok(()),
        }
    }

    /// Checks whether a message may be sent on this wire.
    ///
    /// # Errors
    /// The rule that it breaks.
    pub fn check(self, message: &Message) -> Result<(), WireRule> {
        let Message { to, instruction } = message;
        let many = to.group || to.id == 0;
        match instruction.opcode & 0xFE00 {
            0xB000 if to.group => return Err(WireRule::GiveMeDataToGroup),
            _ if self == Self::Rs485 && many && is_request(instruction.opcode) => {
                return Err(WireRule::Rs485AnswersFromGroup);
            }
            _ => {}
        }
        match self {
            Self::TechnoCan => technocan::encode(message).map(drop),
            _ => Ok(()),
        }
    }
}

/// Returns whether drives reply to an instruction of this opcode with data (type B).
#[must_use]
pub const fn is_request(opcode: u16) -> bool {
    matches!(opcode & 0xF800, 0xA000) // GetTMLData, 16 and 32 bits, both pages
        || matches!(opcode & 0xFC00, 0xB000) // GiveMeData, GiveMeData2
        || matches!(opcode, 0xD600 | 0xD801) // PING, GETVERSION
        || opcode & 0xFF9F == 0xDA10 // checksums, of each memory
}

/// After these a drive does not answer where it was: RESET, AXISID, baud and bit rates.
#[must_use]
pub(super) const fn breaks_contact(opcode: u16) -> bool {
    matches!(opcode, 0x0402 | 0x0801 | 0x0901 | 0x0820 | 0x0920 | 0x0804)
}

/// Returns whether an instruction of this opcode sets the motion's mode (MCR).
#[must_use]
pub(super) const fn sets_mode(opcode: u16) -> bool {
    opcode == 0x5909
}
