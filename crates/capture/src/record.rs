//! A record of a capture: one CAN frame, or bytes of a serial line as they were read.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use crate::timestamp::Timestamp;

/// One record of a capture.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Record<'a> {
    /// Time; `None` if the capture has none.
    pub time: Option<Timestamp>,
    /// Link; `-` if the capture does not name it.
    pub link: &'a str,
    /// Sender, if the capture names it.
    pub direction: Option<Direction>,
    /// Content of the record.
    pub data: RecordData<'a>,
    /// Byte of the capture at which it begins; of the unpacked bytes, if the file is compressed.
    pub offset: u64,
}

/// Content of a record.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RecordData<'a> {
    /// Bytes of a serial line that were read at once.
    Bytes(&'a [u8]),
    /// A classic CAN frame.
    Frame(Frame),
    /// A CAN FD frame. No drive here uses it: it is kept and shown.
    Fd(FdFrame<'a>),
    /// Report of a CAN controller about its bus.
    Error(CanErrorFrame),
}

/// A CAN FD frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FdFrame<'a> {
    /// 11-bit or 29-bit identifier.
    pub id: u32,
    /// True for a 29-bit identifier.
    pub extended: bool,
    /// Flags as in Linux (`linux/can.h`): 1 bit-rate switch, 2 error state of the sender.
    pub flags: u8,
    /// 0 to 64 bytes.
    pub bytes: &'a [u8],
}

/// An error frame as Linux makes it (`linux/can/error.h`): what a controller saw, not a frame that
/// anybody sent.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct CanErrorFrame {
    /// Classes of error, a bit each.
    pub class: u32,
    /// Details, by class.
    pub data: [u8; 8],
}

/// Bit of an identifier that marks an error frame.
pub(crate) const ERROR_FLAG: u32 = 0x2000_0000;
/// Bit of an identifier that marks 29 bits.
pub(crate) const EXTENDED_FLAG: u32 = 0x8000_0000;
/// Bit of an identifier that marks a remote request.
pub(crate) const REMOTE_FLAG: u32 = 0x4000_0000;
/// The 29 bits of an identifier.
pub(crate) const ID_MASK: u32 = 0x1FFF_FFFF;
/// Identifiers of 11 bits end here.
pub(crate) const STANDARD_MAX: u32 = 0x7FF;

/// Lengths that a CAN FD frame may have beyond 8, by its length code from 9.
const FD_LENGTHS: [u8; 7] = [12, 16, 20, 24, 32, 48, 64];

/// Bytes of a CAN FD frame with that length code.
pub(crate) fn fd_len_from_dlc(code: u8) -> u8 {
    match code {
        0..=8 => code,
        _ => FD_LENGTHS[usize::from(code - 9).min(FD_LENGTHS.len() - 1)],
    }
}

/// Length code of a CAN FD frame of `length` bytes, or of the next longer one.
pub(crate) fn fd_dlc_from_len(length: usize) -> u8 {
    match length {
        0..=8 => length as u8,
        _ => 9 + FD_LENGTHS.iter().take_while(|n| usize::from(**n) < length).count().min(6) as u8,
    }
}

impl CanErrorFrame {
    /// Names of the classes, from bit 0.
    const CLASSES: [&'static str; 10] = [
        "transmit timeout",
        "arbitration lost",
        "controller",
        "protocol violation",
        "transceiver",
        "no acknowledge",
        "bus-off",
        "bus error",
        "restarted",
        "error counters",
    ];
    /// Controller states in byte 1, from bit 0.
    const CONTROLLER: [&'static str; 7] = [
        "receive buffer overflow",
        "transmit buffer overflow",
        "receive warning",
        "transmit warning",
        "receive passive",
        "transmit passive",
        "error active again",
    ];
    /// Class of errors that a controller reports.
    pub(crate) const CONTROLLER_CLASS: u32 = 4;
    /// The class of an error frame without details.
    pub(crate) const BUS_ERROR: u32 = 0x80;
    /// The class of a controller that is off the bus.
    pub(crate) const BUS_OFF: u32 = 0x40;
    /// The class of error counters, in bytes 6 (transmit) and 7 (receive).
    pub(crate) const COUNTERS: u32 = 0x200;
    /// State of a controller: warning, passive, and active again.
    pub(crate) const WARNING: u8 = 0x0C;
    pub(crate) const PASSIVE: u8 = 0x30;
    pub(crate) const ACTIVE: u8 = 0x40;

    /// The state of a controller with these error counters.
    pub(crate) fn from_counters(transmit: u8, receive: u8) -> Self {
        let details = error_level(transmit, 0x08, 0x20) | error_level(receive, 0x04, 0x10);
        let details = if details == 0 { Self::ACTIVE } else { details };
        let class = Self::CONTROLLER_CLASS | Self::COUNTERS;
        Self { class, data: [0, details, 0, 0, 0, 0, transmit, receive] }
    }

    /// A controller with this state in byte 1.
    pub(crate) const fn from_state(details: u8) -> Self {
        Self { class: Self::CONTROLLER_CLASS, data: [0, details, 0, 0, 0, 0, 0, 0] }
    }

    /// Descriptions of the states, in words.
    pub fn descriptions(&self) -> impl Iterator<Item = &'static str> {
        let bits = |mask: u32, names: &'static [&'static str]| {
            names.iter().enumerate().filter(move |(bit, _)| mask >> bit & 1 == 1).map(|(_, n)| *n)
        };
        let details = if self.class & Self::CONTROLLER_CLASS == 0 { 0 } else { self.data[1] };
        let known = if details == 0 { self.class } else { self.class & !Self::CONTROLLER_CLASS };
        bits(known, &Self::CLASSES).chain(bits(u32::from(details), &Self::CONTROLLER))
    }
}

fn error_level(count: u8, warning: u8, passive: u8) -> u8 {
    match count {
        0..96 => 0,
        96..128 => warning,
        _ => passive,
    }
}

/// A CAN record but for the bytes of CAN FD, which stay where they were read.
#[derive(Clone, Copy, Debug)]
pub(crate) enum CanRecord {
    Frame(Frame),
    Error(CanErrorFrame),
    Fd { id: u32, extended: bool, flags: u8 },
}

impl CanRecord {
    /// The record's data.
    pub(crate) fn with_bytes(self, bytes: &[u8]) -> RecordData<'_> {
        match self {
            Self::Frame(frame) => RecordData::Frame(frame),
            Self::Error(error) => RecordData::Error(error),
            Self::Fd { id, extended, flags } => {
                RecordData::Fd(FdFrame { id, extended, flags, bytes })
            }
        }
    }
}

/// Link of a record whose capture names none.
pub(crate) const NO_LINK: &str = "-";

/// A classic frame from what most formats store.
pub(crate) fn classic_frame(id: u32, extended: bool, remote: bool, len: u8, bytes: &[u8]) -> Frame {
    let mut data = [0; 8];
    let len = len.min(8);
    if !remote {
        let have = bytes.len().min(usize::from(len));
        data[..have].copy_from_slice(&bytes[..have]);
    }
    Frame { id, extended, remote, len, data }
}

#[cfg(test)]
mod tests {
    use super::{CanErrorFrame, fd_dlc_from_len, fd_len_from_dlc};

    #[test]
    fn lengths_of_can_fd() {
        for code in 0..=15 {
            assert_eq!(fd_dlc_from_len(usize::from(fd_len_from_dlc(code))), code);
        }
        assert_eq!((fd_dlc_from_len(9), fd_dlc_from_len(33), fd_dlc_from_len(65)), (9, 14, 15));
    }

    #[test]
    fn error_frames_in_words() {
        let words = |class, detail| {
            let frame = CanErrorFrame { class, data: [0, detail, 0, 0, 0, 0, 0, 0] };
            frame.descriptions().collect::<Vec<_>>().join(", ")
        };
        assert_eq!(words(0x40, 0), "bus-off");
        assert_eq!(words(0x04, 0x30), "receive passive, transmit passive");
        assert_eq!(words(0xA8, 0), "protocol violation, no acknowledge, bus error");
    }
}
