//! What came back of a question that brought no answer: silence is said only where there was silence.
//!
//! Why: REQ-4.

use polepair_core::station::Counters;
use std::fmt;

/// What came while a question without an answer was on the wire, its repeats included. All are 0
/// where nothing came; 65535 stands for more as well.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
#[non_exhaustive]
pub struct Heard {
    /// Frames whose check failed, here or by what the drive says of a request.
    pub corrupt: u16,
    /// Fitting answers that came sooner than the line's rate lets them, and were not believed.
    pub early: u16,
    /// Answers that came when their time was over.
    pub late: u16,
    /// Times that the drive acknowledged.
    pub acknowledged: u16,
    /// Times that another drive acknowledged in its place, which passes on what is for it.
    pub relayed: u16,
    /// Answers as lines of text.
    pub texts: u16,
    /// Frames of other drives, or to other questions.
    pub foreign: u16,
    /// Our own bytes or frames.
    pub echoed: u16,
    /// Bytes that belong to no frame.
    pub bytes: u16,
}

/// What it most likely was, the surest first.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Silence {
    /// Nothing came.
    Complete,
    /// The drive speaks text.
    Text,
    /// Another drive acknowledged in its place.
    Relayed,
    /// It acknowledged, and did not answer.
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

impl Heard {
    /// What was counted meanwhile.
    #[must_use]
    pub const fn of(counted: &Counters) -> Self {
        Self {
            corrupt: few(counted.corrupt),
            early: few(counted.early),
            late: few(counted.late.saturating_sub(counted.early)),
            acknowledged: few(counted.acknowledged),
            relayed: few(counted.relayed),
            texts: few(counted.texts),
            foreign: few(counted.foreign),
            echoed: few(counted.echoed),
            bytes: few(counted.skipped),
        }
    }

    /// What kind of silence it is.
    #[must_use]
    pub const fn silence(&self) -> Silence {
        match *self {
            Self { texts: 1.., .. } => Silence::Text,
            Self { early: 1.., .. } => Silence::Early,
            Self { corrupt: 1.., .. } => Silence::Corrupt,
            Self { acknowledged: 1.., .. } => Silence::Acknowledged,
            Self { relayed: 1.., .. } => Silence::Relayed,
            Self { late: 1.., .. } => Silence::Late,
            Self { bytes: 1.., .. } => Silence::Noise,
            Self { foreign: 1.., .. } => Silence::Foreign,
            Self { echoed: 1.., .. } => Silence::Echo,
            _ => Silence::Complete,
        }
    }

    /// Whether nothing at all came.
    #[must_use]
    pub const fn is_nothing(&self) -> bool {
        matches!(self.silence(), Silence::Complete)
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
            echoed: self.echoed.saturating_add(other.echoed),
            bytes: self.bytes.saturating_add(other.bytes),
        }
    }

    /// What of it came from somebody else than the address that was asked: a drive acknowledges for those
    /// behind it, and an adapter echoes, whoever is asked.
    pub(crate) const fn of_others(self) -> Self {
        Self { acknowledged: 0, relayed: 0, echoed: 0, ..self }
    }

    /// What to try.
    #[must_use]
    pub const fn hint(&self) -> &'static str {
        match self.silence() {
            Silence::Complete => {
                "check power, wiring, baud rate and address; `polepair scan` looks for other addresses"
            }
            Silence::Text => {
                "it is a module in ASCII mode: switch it off and on, or send it `BIN` from a terminal"
            }
            Silence::Relayed => {
                "the drive at the cable is there, the axis behind it is not: check its own power, its \
                 axis ID and the cable between the two"
            }
            Silence::Acknowledged => {
                "it hears us: see which host ID it answers to, and whether it needs more time \
                 (`?timeout=`)"
            }
            Silence::Early => {
                "a port without a real line behind it (USB) answers so; on a real line an older \
                 answer comes twice, or a second host asks"
            }
            Silence::Corrupt => {
                "noise, a missing terminator or common ground, two drives with one address, a baud \
                 rate that is a little off; `-v` shows the frames"
            }
            Silence::Late => "it needs more time: `?timeout=` allows more",
            Silence::Foreign => {
                "somebody else is there: check the address; `polepair scan` looks for others"
            }
            Silence::Noise => {
                "another baud rate or another protocol: `polepair doctor --try-bauds` asks at other \
                 rates; `-v` shows the bytes"
            }
            Silence::Echo => {
                "the adapter echoes, or a module in ASCII mode does, which is switched off and on; \
                 then check power, wiring and address"
            }
        }
    }
}

const fn few(count: u64) -> u16 {
    if count < u16::MAX as u64 { count as u16 } else { u16::MAX }
}

impl fmt::Display for Heard {
    /// All of it with its counts; `nothing came back` where nothing did.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kinds = [
            (self.texts, "line of text", "lines of text"),
            (self.early, "answer too soon to be believed", "answers too soon to be believed"),
            (self.corrupt, "frame with a wrong check", "frames with a wrong check"),
            (self.acknowledged, "acknowledgement", "acknowledgements"),
            (
                self.relayed,
                "acknowledgement by the drive at the cable",
                "acknowledgements by the drive at the cable",
            ),
            (self.late, "answer too late", "answers too late"),
            (
                self.foreign,
                "frame of others or to another question",
                "frames of others or to other questions",
            ),
            (self.echoed, "echo of our own", "echoes of our own"),
            (self.bytes, "byte of no frame", "bytes of no frame"),
        ];
        let mut came = kinds.into_iter().filter(|(count, ..)| *count > 0).peekable();
        if came.peek().is_none() {
            return f.write_str("nothing came back");
        }
        for (n, (count, one, more)) in came.enumerate() {
            let mark = if n == 0 { "" } else { ", " };
            write!(f, "{mark}{count} {}", if count == 1 { one } else { more })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_is_told_with_its_counts_and_what_to_try() {
        let counted = |change: fn(&mut Counters)| {
            let mut counters = Counters { sent: 3, resent: 2, silent: 1, ..Counters::default() };
            change(&mut counters);
            Heard::of(&counters)
        };
        for (heard, silence, said) in [
            (counted(|_| ()), Silence::Complete, "nothing came back"),
            (counted(|c| c.texts = 1), Silence::Text, "1 line of text"),
            (counted(|c| c.relayed = 2), Silence::Relayed, "2 acknowledgements by the drive at"),
            (counted(|c| c.acknowledged = 3), Silence::Acknowledged, "3 acknowledgements"),
            (counted(|c| (c.late, c.early) = (2, 2)), Silence::Early, "2 answers too soon"),
            (counted(|c| c.corrupt = 1), Silence::Corrupt, "1 frame with a wrong check"),
            (counted(|c| c.late = 1), Silence::Late, "1 answer too late"),
            (counted(|c| c.foreign = 4), Silence::Foreign, "4 frames of others"),
            (counted(|c| c.skipped = 7), Silence::Noise, "7 bytes of no frame"),
            (counted(|c| c.echoed = 9), Silence::Echo, "9 echoes of our own"),
        ] {
            assert_eq!(heard.silence(), silence);
            assert!(heard.to_string().starts_with(said), "{heard}");
            assert_eq!(heard.is_nothing(), silence == Silence::Complete);
            assert!(!heard.hint().is_empty());
        }
        let both = counted(|c| c.corrupt = 1).plus(counted(|c| c.skipped = 5));
        assert_eq!(both.to_string(), "1 frame with a wrong check, 5 bytes of no frame");
    }
}
