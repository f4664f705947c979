//! Details of a missing reply: counts of received frames, the likely cause, and what to try.
//!
//! Why: REQ-4.

use polepair_core::station::Counters;
use std::borrow::Cow;
use std::fmt;

/// Frames received during a request without a reply, repeats included. All are 0 if nothing was received;
/// 65535 means at least that many.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
#[non_exhaustive]
pub struct NoReplyDetails {
    /// Frames with a wrong checksum, here or reported by the drive.
    pub corrupt: u16,
    /// Fitting answers that came sooner than the line's rate lets them, and were not believed.
    pub early: u16,
    /// Answers that came when their time was over.
    pub late: u16,
    /// Times that the drive acknowledged.
    pub acknowledged: u16,
    /// Acknowledgements by another drive in its place, a relay that passes messages on.
    pub relayed: u16,
    /// Answers as lines of text.
    pub texts: u16,
    /// Frames of other drives, or to other questions.
    pub foreign: u16,
    /// Frames among them with a matching reply, but from another address than the requested one.
    pub misaddressed: u16,
    /// Destination of the drive's replies instead of this host: its host address, or the CAN id of its
    /// replies.
    pub other_host: Option<u16>,
    /// Address of a drive that replied to a request for another address.
    pub other_address: Option<u16>,
    /// Our own bytes or frames.
    pub echoed: u16,
    /// Bytes that belong to no frame.
    pub bytes: u16,
}

/// Kind of the wire between this computer and the drives.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
#[non_exhaustive]
pub enum Wiring {
    /// A serial line at a port.
    #[default]
    SerialLine,
    /// A serial line at a serial server.
    SerialServer,
    /// A server that has the protocol itself.
    Network,
    /// A CAN bus.
    CanBus,
}

impl Wiring {
    /// Remedy where no frame came from any address.
    #[must_use]
    pub const fn hint(self) -> &'static str {
        match self {
            Self::SerialLine => {
                "power, wiring (A and B may be swapped), and the baud rate in the URL"
            }
            Self::SerialServer => {
                "power and wiring behind the serial server (A and B may be swapped), and its baud rate"
            }
            Self::Network => {
                "the server is there: check the unit numbers, and whether it is a serial server, \
                 which passes Modbus RTU on: `modbus-rtu+tcp://`"
            }
            Self::CanBus => {
                "power, the bit rate in the URL, and on a cable CAN_H, CAN_L and a 120 ohm resistor at \
                 both ends"
            }
        }
    }
}

/// Likely cause, the most certain first.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum NoReplyCause {
    /// Nothing came.
    NothingReceived,
    /// The drive is in ASCII mode.
    Text,
    /// Another drive acknowledged in its place.
    Relayed,
    /// The drive acknowledged, and did not reply.
    Acknowledged,
    /// Answers came too soon to be believed.
    Early,
    /// Answers had wrong checks.
    Corrupt,
    /// Answers came too late.
    Late,
    /// Others spoke.
    Foreign,
    /// Bytes came that are none of the protocol's.
    Noise,
    /// Our own bytes came back, and nothing else.
    Echo,
}

/// Hint for a scan in which a drive acknowledged requests, and no axis replied.
pub const ACKNOWLEDGES: &str = "a drive acknowledges: its axis ID is none of these; `--ids \
     FIRST-LAST` tries others, and its host ID may not be this host's";

impl NoReplyDetails {
    /// Details by the counters.
    #[must_use]
    pub const fn from_counters(counted: &Counters) -> Self {
        Self {
            corrupt: saturate_u16(counted.corrupt),
            early: saturate_u16(counted.early),
            late: saturate_u16(counted.late.saturating_sub(counted.early)),
            acknowledged: saturate_u16(counted.acknowledged),
            relayed: saturate_u16(counted.relayed),
            texts: saturate_u16(counted.texts),
            foreign: saturate_u16(counted.foreign),
            misaddressed: saturate_u16(counted.misaddressed),
            other_host: match counted.other_host {
                Some(host) => Some(saturate_u16(host as u64)),
                None => None,
            },
            other_address: match counted.other_address {
                Some(address) => Some(saturate_u16(address as u64)),
                None => None,
            },
            echoed: saturate_u16(counted.echoed),
            bytes: saturate_u16(counted.skipped),
        }
    }

    /// Kind of the silence.
    #[must_use]
    pub const fn cause(&self) -> NoReplyCause {
        match *self {
            Self { texts: 1.., .. } => NoReplyCause::Text,
            Self { early: 1.., .. } => NoReplyCause::Early,
            Self { corrupt: 1.., .. } => NoReplyCause::Corrupt,
            Self { acknowledged: 1.., .. } => NoReplyCause::Acknowledged,
            Self { relayed: 1.., .. } => NoReplyCause::Relayed,
            Self { late: 1.., .. } => NoReplyCause::Late,
            Self { bytes: 1.., .. } => NoReplyCause::Noise,
            Self { foreign: 1.., .. } => NoReplyCause::Foreign,
            Self { echoed: 1.., .. } => NoReplyCause::Echo,
            _ => NoReplyCause::NothingReceived,
        }
    }

    /// Returns whether nothing at all came.
    #[must_use]
    pub const fn is_nothing(&self) -> bool {
        matches!(self.cause(), NoReplyCause::NothingReceived)
    }

    /// Both together.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self {
            corrupt: self.corrupt.saturating_add(other.corrupt),
            early: self.early.saturating_add(other.early),
            late: self.late.saturating_add(other.late),
            acknowledged: self.acknowledged.saturating_add(other.acknowledged),
            relayed: self.relayed.saturating_add(other.relayed),
            texts: self.texts.saturating_add(other.texts),
            foreign: self.foreign.saturating_add(other.foreign),
            misaddressed: self.misaddressed.saturating_add(other.misaddressed),
            other_host: if self.other_host.is_some() { self.other_host } else { other.other_host },
            other_address: match self.other_address {
                Some(_) => self.other_address,
                None => other.other_address,
            },
            echoed: self.echoed.saturating_add(other.echoed),
            bytes: self.bytes.saturating_add(other.bytes),
        }
    }

    /// The frames of other devices than the requested address: acknowledgements of a relay and echoes of
    /// the adapter do not count.
    pub(crate) const fn only_foreign(self) -> Self {
        Self { acknowledged: 0, relayed: 0, echoed: 0, ..self }
    }

    /// Text for a relay that acknowledges while the axis is silent; `None` otherwise.
    pub(crate) fn relay_text(&self, relay: Option<u32>, axis: u32) -> Option<String> {
        let relay = relay.filter(|_| self.cause() == NoReplyCause::Relayed)?;
        Some(format!("relay {relay} acknowledges, axis {axis} is silent"))
    }

    /// Remedy to try.
    #[must_use]
    pub fn hint(&self) -> Cow<'static, str> {
        if let Some(host) = self.other_host {
            return format!(
                "the drive replies to host {host}: open it with `?host={host}`, then set its `host \
                 address`, on CAN its `can reply id`, to 2"
            )
            .into();
        }
        if let Some(address) = self.other_address {
            return format!("the drive here has address {address}: use `#{address}`").into();
        }
        self.cause_hint().into()
    }

    /// Remedy for the cause alone.
    const fn cause_hint(&self) -> &'static str {
        match self.cause() {
            NoReplyCause::NothingReceived => {
                "check power, wiring, baud rate and address; `polepair scan` looks for other \
                 addresses"
            }
            NoReplyCause::Text => {
                "it is a module in ASCII mode: switch it off and on, or send it `BIN` from a \
                 terminal"
            }
            NoReplyCause::Relayed => {
                "the drive or gateway at the cable replies, the axis behind it does not: check the axis' \
                 power, its number and the cable between the two"
            }
            NoReplyCause::Acknowledged => {
                "the drive at the cable receives the requests: its axis ID may be another \
                 (`polepair scan`), its host ID not this host's, or it needs more time \
                 (`?timeout=`). If it is a relay, add `?through=ID` with the relay's axis ID"
            }
            NoReplyCause::Early => {
                "a port without a real serial line (USB) replies this fast; on a real line an \
                 earlier reply was repeated, or a second host polls"
            }
            NoReplyCause::Corrupt => {
                "noise, a missing terminator or common ground, two drives with one address, a baud \
                 rate that is a little off; `-v` shows the frames"
            }
            NoReplyCause::Late => "it needs more time: increase `?timeout=`",
            NoReplyCause::Foreign => {
                "another device is on the bus: check the address; `polepair scan` finds other \
                 addresses"
            }
            NoReplyCause::Noise => {
                "another baud rate or another protocol: `polepair doctor URL --try-bauds` asks at \
                 other \
                 rates; `-v` shows the bytes"
            }
            NoReplyCause::Echo => {
                "the adapter echoes, or a module is in ASCII mode (switch it off and on); then \
                 check power, wiring and address"
            }
        }
    }
}

const fn saturate_u16(count: u64) -> u16 {
    if count < u16::MAX as u64 { count as u16 } else { u16::MAX }
}

impl fmt::Display for NoReplyDetails {
    /// All of it with its counts; `nothing came back` where nothing did.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kinds = [
            (self.texts, "line of text", "lines of text"),
            (self.early, "reply too early to be valid", "replies too early to be valid"),
            (self.corrupt, "frame with a wrong checksum", "frames with a wrong checksum"),
            (self.acknowledged, "acknowledgement", "acknowledgements"),
            (
                self.relayed,
                "answer by the drive or gateway at the cable",
                "answers by the drive or gateway at the cable",
            ),
            (self.late, "answer too late", "answers too late"),
            (
                self.foreign,
                "frame of another device or for another request",
                "frames of other devices or for other requests",
            ),
            (self.echoed, "echo of a sent frame", "echoes of sent frames"),
            (self.bytes, "byte outside of a frame", "bytes outside of frames"),
        ];
        let mut came = kinds.into_iter().filter(|(count, ..)| *count > 0).peekable();
        if came.peek().is_none() {
            return f.write_str("nothing came back");
        }
        for (n, (count, one, more)) in came.enumerate() {
            let mark = if n == 0 { "" } else { ", " };
            write!(f, "{mark}{count} {}", if count == 1 { one } else { more })?;
        }
        if let Some(host) = self.other_host {
            write!(f, "; it replies to host {host}")?;
        }
        match self.other_address {
            Some(address) => write!(f, "; address {address} answers here"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_is_reported_with_its_counts_and_what_to_try() {
        let counted = |change: fn(&mut Counters)| {
            let mut counters = Counters { sent: 3, resent: 2, silent: 1, ..Counters::default() };
            change(&mut counters);
            NoReplyDetails::from_counters(&counters)
        };
        for (details, silence, output) in [
            (counted(|_| ()), NoReplyCause::NothingReceived, "nothing came back"),
            (counted(|c| c.texts = 1), NoReplyCause::Text, "1 line of text"),
            (
                counted(|c| c.relayed = 2),
                NoReplyCause::Relayed,
                "2 answers by the drive or gateway at",
            ),
            (counted(|c| c.acknowledged = 3), NoReplyCause::Acknowledged, "3 acknowledgements"),
            (counted(|c| (c.late, c.early) = (2, 2)), NoReplyCause::Early, "2 replies too early"),
            (counted(|c| c.corrupt = 1), NoReplyCause::Corrupt, "1 frame with a wrong checksum"),
            (counted(|c| c.late = 1), NoReplyCause::Late, "1 answer too late"),
            (counted(|c| c.foreign = 4), NoReplyCause::Foreign, "4 frames of other devices"),
            (
                counted(|c| (c.foreign, c.other_host) = (1, Some(5))),
                NoReplyCause::Foreign,
                "1 frame of another device or for another request; it replies to host 5",
            ),
            (counted(|c| c.skipped = 7), NoReplyCause::Noise, "7 bytes outside of frames"),
            (counted(|c| c.echoed = 9), NoReplyCause::Echo, "9 echoes of sent frames"),
        ] {
            assert_eq!(details.cause(), silence);
            assert!(details.to_string().starts_with(output), "{details}");
            assert_eq!(details.is_nothing(), silence == NoReplyCause::NothingReceived);
            assert!(!details.hint().is_empty());
        }
        let both = counted(|c| c.corrupt = 1).plus(counted(|c| c.skipped = 5));
        assert_eq!(both.to_string(), "1 frame with a wrong checksum, 5 bytes outside of frames");
    }
}
