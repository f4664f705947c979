//! Bytes to values and back (protocol manual, sections 1.2 to 4.3).
//!
//! ```text
//! host to drive  300 + id   command (two letters), sub-command (two bytes), data (four bytes or none)
//! drive to host  280 + id   the first four bytes again, and the value; or a report
//! ```
//! All big-endian. Where the manual contradicts itself, the reading is stated at the place and the
//! other one is a switch of the profile ([`Interpretation`](super::interpretation::Interpretation)).

use crate::error::WireError;
use crate::medium::Frame;

/// Identifier of frames to the drive of id 0; the id is added.
pub const TO_DRIVE: u16 = 0x300;
/// Identifier of frames from the drive of id 0; the id is added.
pub const TO_HOST: u16 = 0x280;
/// The highest id of a drive; the lowest is 1.
pub const ID_MAX: u8 = 127;
/// The value of a reply that means "not done" (section 1.3).
pub const REFUSED: u32 = 0xEEEE;
/// The slowest speed that VC takes, rpm; 0 stops (section 2.1).
pub const RPM_MIN: i32 = 30;
/// The farthest absolute position either way, tenths of a degree (section 4.1).
pub const POSITION_MAX: i32 = 1799;
/// Time of ST, ms; 0 turns it off (section 2.3).
pub const TIMEOUT_MS: core::ops::RangeInclusive<u16> = 100..=60_000;
/// The type of SP and RP that is the safe range of positions (section 4.1).
pub const RANGE_PARAMETER: u16 = CommandWord::LA.0;
/// Bit rates that CB takes, kbit/s (section 2.2). \[I\] 666, 333, 83, 66 and 33 are those of the
/// manual's list that have a fraction: 666.66 …
pub const BIT_RATES: [u16; 19] =
    [1000, 800, 666, 500, 400, 333, 250, 200, 150, 125, 100, 83, 80, 66, 50, 40, 33, 20, 10];

/// A command word: two letters, the first one first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct CommandWord(pub u16);

/// Data of a command and of its reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CommandKind {
    /// Four bytes; the reply has a value.
    Query,
    /// Four bytes; the reply repeats them.
    Order,
    /// Eight bytes, the last four of them zero.
    Zeros,
    /// Eight bytes with a value.
    Set,
}

impl CommandWord {
    /// Signal, percent.
    pub const TC: Self = Self::of(*b"TC");
    /// Speed, rpm.
    pub const VC: Self = Self::of(*b"VC");
    /// Reads the speed, rpm.
    pub const QV: Self = Self::of(*b"QV");
    /// Reads the current, 0.1 A.
    pub const QC: Self = Self::of(*b"QC");
    /// Reads the voltage, 0.1 V.
    pub const QP: Self = Self::of(*b"QP");
    /// Reads the motor's temperature, °C.
    pub const QT: Self = Self::of(*b"QT");
    /// Reads the driver's temperature, °C. Its letters are reversed against QT: so printed.
    pub const EQ: Self = Self::of(*b"EQ");
    /// Reads the faults.
    pub const EF: Self = Self::of(*b"EF");
    /// Clears faults.
    pub const CF: Self = Self::of(*b"CF");
    /// Ends ML and MM.
    pub const MQ: Self = Self::of(*b"MQ");
    /// Current and speed every second.
    pub const ML: Self = Self::of(*b"ML");
    /// Current and speed every 100 ms.
    pub const MM: Self = Self::of(*b"MM");
    /// The id from the next start on.
    pub const CI: Self = Self::of(*b"CI");
    /// The bit rate from the next start on, kbit/s.
    pub const CB: Self = Self::of(*b"CB");
    /// Stops after this time in ms without a command.
    pub const ST: Self = Self::of(*b"ST");
    /// Format of the replies to TC and VC.
    pub const VM: Self = Self::of(*b"VM");
    /// Reports that are sent by themselves from power-up on.
    pub const SR: Self = Self::of(*b"SR");
    /// Reads all faults since the start.
    pub const FR: Self = Self::of(*b"FR");
    /// Writes an internal parameter.
    pub const SP: Self = Self::of(*b"SP");
    /// Reads an internal parameter.
    pub const RP: Self = Self::of(*b"RP");
    /// Goes to an absolute position.
    pub const LA: Self = Self::of(*b"LA");
    /// Reads the absolute position, 0.1°.
    pub const QA: Self = Self::of(*b"QA");
    /// Makes this the absolute zero.
    pub const AZ: Self = Self::of(*b"AZ");
    /// Goes so far: each one adds.
    pub const LR: Self = Self::of(*b"LR");
    /// Reads the relative position, 0.1°.
    pub const QR: Self = Self::of(*b"QR");
    /// Makes this the relative zero.
    pub const RZ: Self = Self::of(*b"RZ");
    /// Clears the relative position.
    pub const RC: Self = Self::of(*b"RC");
    /// Emergency stop.
    pub const LS: Self = Self::of(*b"LS");

    /// Every command of the manual: its letters, its kind and its effect.
    pub const ALL: [(Self, CommandKind, &'static str); 28] = {
        use CommandKind::{Order, Query, Set, Zeros};
        [
            (Self::TC, Set, "signal control"),
            (Self::VC, Set, "speed control"),
            (Self::QV, Query, "read speed"),
            (Self::QC, Query, "read current"),
            (Self::QP, Query, "read voltage"),
            (Self::QT, Query, "read motor temperature"),
            (Self::EQ, Query, "read driver temperature"),
            (Self::EF, Query, "read faults"),
            (Self::CF, Order, "clear faults"),
            (Self::MQ, Order, "request mode: stop sending by itself"),
            (Self::ML, Order, "low-speed mode: current and speed every second"),
            (Self::MM, Order, "medium-speed mode: current and speed every 100 ms"),
            (Self::CI, Set, "id from the next start on"),
            (Self::CB, Set, "bit rate from the next start on"),
            (Self::ST, Set, "stop when no command comes"),
            (Self::VM, Set, "what TC and VC are answered with"),
            (Self::SR, Set, "what is sent by itself from power-up on"),
            (Self::FR, Query, "read all faults since the start"),
            (Self::SP, Set, "write internal parameter"),
            (Self::RP, Query, "read internal parameter"),
            (Self::LA, Set, "go to absolute position"),
            (Self::QA, Query, "read absolute position"),
            (Self::AZ, Zeros, "absolute zero is here"),
            (Self::LR, Set, "go by a relative way"),
            (Self::QR, Query, "read relative position"),
            (Self::RZ, Zeros, "relative zero is here"),
            (Self::RC, Zeros, "clear relative position"),
            (Self::LS, Zeros, "emergency stop"),
        ]
    };

    /// The command of these letters.
    #[must_use]
    pub const fn of(letters: [u8; 2]) -> Self {
        Self(u16::from_be_bytes(letters))
    }

    /// Shape and meaning, if the manual has it.
    #[must_use]
    pub fn definition(self) -> Option<(CommandKind, &'static str)> {
        let entry = Self::ALL.iter().find(|(command, ..)| *command == self);
        entry.map(|(_, shape, text)| (*shape, *text))
    }

    /// The two letters; `??` for bytes that are none.
    #[must_use]
    pub fn letters(&self) -> Letters {
        let [a, b] = self.0.to_be_bytes();
        Letters(if is_letters(a, b) { [a, b] } else { *b"??" })
    }

    /// Parses a command of two letters, in any case.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let [a, b] = <[u8; 2]>::try_from(text.as_bytes()).ok()?;
        let command = Self::of([a.to_ascii_uppercase(), b.to_ascii_uppercase()]);
        command.definition().map(|_| command)
    }

    /// True for commands that set the output: TC and VC, whose replies VM sets.
    #[must_use]
    pub const fn is_output(self) -> bool {
        matches!(self, Self::TC | Self::VC)
    }

    /// True for commands that need an encoder (section 1.2, note).
    #[must_use]
    pub const fn is_position(self) -> bool {
        matches!(
            self,
            Self::LA | Self::QA | Self::AZ | Self::LR | Self::QR | Self::RZ | Self::RC | Self::LS
        )
    }
}

/// Two letters as text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Letters([u8; 2]);

impl Letters {
    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(&self.0).unwrap_or("??")
    }
}

const fn is_letters(a: u8, b: u8) -> bool {
    a.is_ascii_uppercase() && b.is_ascii_uppercase()
}

/// A request to a drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Request {
    /// Command.
    pub command: CommandWord,
    /// Speed of LA and LR, type of SP and RP, else zero.
    pub sub: u16,
    /// The last four bytes, if it has them.
    pub data: Option<u32>,
}

impl Request {
    /// A command alone, in four bytes or eight as the manual prints it.
    #[must_use]
    pub fn without_value(command: CommandWord) -> Self {
        let zeros = matches!(command.definition(), Some((CommandKind::Zeros, _)));
        Self { command, sub: 0, data: zeros.then_some(0) }
    }

    /// A command with a value in 16 bits; the two bytes before them are zero, as printed for TC -5.
    #[must_use]
    pub const fn with_value(command: CommandWord, value: u16) -> Self {
        Self { command, sub: 0, data: Some(value as u32) }
    }

    /// The last four bytes as a number; zero for a request of four bytes, which the drive takes as such (`[I]`: the
    /// manual prints both lengths for the same commands).
    #[must_use]
    pub const fn value(&self) -> u32 {
        match self.data {
            Some(value) => value,
            None => 0,
        }
    }

    /// The frame to the drive of that id.
    #[must_use]
    pub fn frame(&self, id: u8) -> Frame {
        let head = (u64::from(self.command.0) << 48) | (u64::from(self.sub) << 32);
        let data = (head | u64::from(self.value())).to_be_bytes();
        let len = if self.data.is_some() { 8 } else { 4 };
        Frame::standard(TO_DRIVE + u16::from(id & ID_MAX), &data[..len])
    }

    /// Reads data bytes.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`] for other lengths than four and eight.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let (head, tail) = match data {
            [a, b, c, d] => ([*a, *b, *c, *d], None),
            [a, b, c, d, e, f, g, h] => ([*a, *b, *c, *d], Some([*e, *f, *g, *h])),
            other => return Err(wrong_length(other.len())),
        };
        let [a, b, c, d] = head;
        let (command, sub) = (CommandWord::of([a, b]), u16::from_be_bytes([c, d]));
        Ok(Self { command, sub, data: tail.map(u32::from_be_bytes) })
    }
}

fn wrong_length(len: usize) -> WireError {
    let found = len as u16;
    match found {
        0..4 => WireError::Short { need: 4, found },
        4..8 => WireError::Short { need: 8, found },
        _ => WireError::Long { need: 8, found },
    }
}

/// The usual reply: the request's first four bytes and a value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Reply {
    /// The command that it answers.
    pub command: CommandWord,
    /// The request's sub-command.
    pub sub: u16,
    /// The value written or read, or [`REFUSED`].
    pub data: u32,
}

impl Reply {
    /// The frame from the drive of that id.
    #[must_use]
    pub fn frame(&self, id: u8) -> Frame {
        let head = (u64::from(self.command.0) << 48) | (u64::from(self.sub) << 32);
        drive_frame(id, head | u64::from(self.data))
    }
}

fn drive_frame(id: u8, data: u64) -> Frame {
    Frame::standard(TO_HOST + u16::from(id & ID_MAX), &data.to_be_bytes())
}

/// One of the three frames of VM and SR, with its header (sections 2.4, 2.5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ReportFrame {
    /// First letter of the reported command: T, V, or A for a report that the drive sends by itself.
    pub source: u8,
    /// Number of the part: 1, 2 or 3.
    pub part: u8,
    /// The six bytes behind the header, as three words.
    pub words: [u16; 3],
}

impl ReportFrame {
    /// First letter of reports that SR switches on.
    pub const UNSOLICITED: u8 = b'A';

    /// Which part carries the value that a query reads; `None` where none does.
    #[must_use]
    pub const fn part_with(query: CommandWord) -> Option<u8> {
        match query {
            CommandWord::QV | CommandWord::QP | CommandWord::QC => Some(1),
            CommandWord::EF | CommandWord::QT | CommandWord::EQ => Some(2),
            CommandWord::QA | CommandWord::QR => Some(3),
            _ => None,
        }
    }

    /// The frame from the drive of that id.
    #[must_use]
    pub fn frame(&self, id: u8) -> Frame {
        let [a, b, c] = self.words.map(u64::from);
        let header = u64::from(u16::from_be_bytes([self.source, self.part]));
        drive_frame(id, header << 48 | a << 32 | b << 16 | c)
    }
}

/// The one frame without a header: speed, voltage, current, status.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HeaderlessReport {
    /// Speed, rpm.
    pub rpm: i16,
    /// Voltage, 0.1 V.
    pub decivolt: u16,
    /// Current, 0.1 A.
    pub deciamp: i16,
    /// \[I\] The fault word.
    pub status: u16,
}

impl HeaderlessReport {
    /// The frame from the drive of that id.
    #[must_use]
    pub fn frame(&self, id: u8) -> Frame {
        let words = [self.rpm.cast_unsigned(), self.decivolt, self.deciamp.cast_unsigned()];
        let [a, b, c] = words.map(u64::from);
        drive_frame(id, a << 48 | b << 32 | c << 16 | u64::from(self.status))
    }
}

/// A frame from a drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DriveMessage {
    /// The usual reply.
    Reply(Reply),
    /// A report with a header.
    Report(ReportFrame),
    /// A report without one.
    Headerless(HeaderlessReport),
}

impl DriveMessage {
    /// Reads data bytes. A frame without a header begins with a speed: one that looks like two
    /// letters would be of 16,640 rpm and more, so letters are letters.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`] for another length than eight.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let found = data.len() as u16;
        let Some(bytes) = data.first_chunk::<8>().filter(|_| found == 8) else {
            return Err(match found {
                0..8 => WireError::Short { need: 8, found },
                _ => WireError::Long { need: 8, found },
            });
        };
        let all = u64::from_be_bytes(*bytes);
        let words = [(all >> 32) as u16, (all >> 16) as u16, all as u16];
        Ok(match *bytes {
            [of @ (b'T' | b'V' | ReportFrame::UNSOLICITED), part @ 1..=3, ..] => {
                Self::Report(ReportFrame { source: of, part, words })
            }
            [a, b, ..] if is_letters(a, b) => {
                let (command, sub) = (CommandWord::of([a, b]), words[0]);
                Self::Reply(Reply { command, sub, data: all as u32 })
            }
            [a, b, ..] => Self::Headerless(HeaderlessReport {
                rpm: i16::from_be_bytes([a, b]),
                decivolt: words[0],
                deciamp: words[1].cast_signed(),
                status: words[2],
            }),
        })
    }
}

/// The drive of a frame: `Ok` for a frame to it, `Err` for a frame from it.
#[must_use]
pub const fn node_of_id(id: u32) -> Option<Result<u8, u8>> {
    let number = (id & 0x7F) as u8;
    match id & !0x7F {
        0x300 if number > 0 => Some(Ok(number)),
        0x280 if number > 0 => Some(Err(number)),
        _ => None,
    }
}

/// Layout of a value in the four data bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Width {
    /// Signed 16 bits behind two zero bytes.
    Signed,
    /// Unsigned 16 bits behind two zero bytes.
    Unsigned,
    /// Signed 32 bits; a negative absolute position may have come in 16.
    Absolute,
    /// Signed 32 bits.
    Long,
}

impl CommandWord {
    /// Layout of its value.
    #[must_use]
    pub const fn width(self) -> Width {
        match self {
            Self::LA => Width::Absolute,
            Self::LR | Self::QR => Width::Long,
            Self::TC | Self::VC | Self::QV | Self::QC | Self::QT | Self::EQ | Self::QA => {
                Width::Signed
            }
            _ => Width::Unsigned,
        }
    }
}

impl Width {
    /// The value of data bytes. The manual states 32 bits and prints -5 as `00 00 FF FB`; a public driver
    /// sends `FF FF FF FB`: both are -5.
    #[must_use]
    pub const fn decode(self, data: u32) -> i64 {
        let low = data as u16;
        let short = data >> 16 == 0;
        match self {
            Self::Unsigned => data as i64,
            Self::Signed if short => low.cast_signed() as i64,
            Self::Absolute if short && low.cast_signed() as i32 >= -POSITION_MAX => {
                low.cast_signed() as i64
            }
            _ => data.cast_signed() as i64,
        }
    }

    /// The data bytes of a value as the manual prints them; wider ones where it does not fit.
    #[must_use]
    pub const fn encode(self, value: i64) -> u32 {
        match self {
            Self::Signed if value >= i16::MIN as i64 && value <= i16::MAX as i64 => {
                (value as i16).cast_unsigned() as u32
            }
            _ => value as u32,
        }
    }
}
