//! Paths that a drive stores, and their registers (TS manual V2 §2.6.1).
//!
//! The manual's figures of the definition words are missing. Their digits are read as decimal, A at the
//! right, B with two digits: `C*1000 + B*10 + A` `[I]`. As BCD the homing word would not fit into 16 bits.

/// Number of paths.
pub const PATH_MAX: u8 = 32;

/// Type of a path, digit A of definition word 1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PathType {
    /// Turn at a speed: for ever, or for a time counted from the trigger.
    Speed,
    /// Go and stop.
    Single,
    /// Go, wait, and go on with the next path.
    Auto,
    /// A digit that the manual does not name: the path does nothing. Zero is that of an empty path.
    Unknown(u8),
}

impl PathType {
    /// Digit A of definition word 1.
    #[must_use]
    pub const fn digit(self) -> u8 {
        match self {
            Self::Speed => 1,
            Self::Single => 2,
            Self::Auto => 3,
            Self::Unknown(digit) => digit,
        }
    }

    /// True for a path that ends at a position.
    #[must_use]
    pub const fn is_positioning(self) -> bool {
        matches!(self, Self::Single | Self::Auto)
    }
}

/// End of a path.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PathEnd {
    /// At the coordinate.
    Coordinate,
    /// At the last command's end plus the coordinate.
    LastCommand,
    /// At the present position plus the coordinate.
    Feedback,
}

/// A path: a motion, and the one that follows it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PathDefinition {
    /// Type.
    pub kind: PathType,
    /// AutoLoadIndex: the next path, 1 to 32.
    pub next: Option<u8>,
    /// End of the path.
    pub end: PathEnd,
    /// True if it may interrupt the running path.
    pub interrupts: bool,
    /// Coordinate in thousandths of the mechanics' unit.
    pub thousandths: i32,
    /// Motor speed, rpm.
    pub rpm: u16,
    /// Ta, ms from rest to `rpm`.
    pub acceleration_ms: u16,
    /// Td, ms from `rpm` to rest.
    pub deceleration_ms: u16,
    /// Delay, ms.
    pub delay_ms: u16,
    /// Ts, ms; 0 for a trapezoid.
    pub s_ms: u16,
}

/// Greatest coordinate, thousandths: tens in 16 bits with a sign, and what they leave.
pub const COORDINATE_MAX: i32 = i16::MAX as i32 * 10_000 + 9_999;

impl PathDefinition {
    /// A path that was never set.
    pub const EMPTY: Self = Self {
        kind: PathType::Unknown(0),
        next: None,
        end: PathEnd::LastCommand,
        interrupts: false,
        thousandths: 0,
        rpm: 0,
        acceleration_ms: 0,
        deceleration_ms: 0,
        delay_ms: 0,
        s_ms: 0,
    };

    /// From its eight registers and its S-time.
    #[must_use]
    pub fn decode(words: [u16; 8], s_ms: u16) -> Self {
        let [first, tens, rest, rpm, acceleration_ms, deceleration_ms, delay_ms, second] = words;
        Self {
            kind: decode_kind(first),
            next: decode_next(first).or(decode_next(second)),
            end: decode_end(first, second),
            interrupts: second % 10 == 1,
            thousandths: decode_thousandths(tens, rest),
            rpm,
            acceleration_ms,
            deceleration_ms,
            delay_ms,
            s_ms,
        }
    }

    /// The eight registers; the S-time has a place of its own. Both definition words name the next path.
    #[must_use]
    pub fn encode(&self) -> [u16; 8] {
        let (first_end, second_end) = match self.end {
            PathEnd::Coordinate => (1, 0),
            PathEnd::LastCommand => (0, 1),
            PathEnd::Feedback => (0, 2),
        };
        let next = u16::from(self.next.unwrap_or(0));
        let [tens, rest] = encode_thousandths(self.thousandths);
        [
            first_end * 1000 + next * 10 + u16::from(self.kind.digit()),
            tens,
            rest,
            self.rpm,
            self.acceleration_ms,
            self.deceleration_ms,
            self.delay_ms,
            second_end * 1000 + next * 10 + u16::from(self.interrupts),
        ]
    }

    /// True for a path without a type: nothing else of it counts.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        matches!(self.kind, PathType::Unknown(0))
    }

    /// Turns of the motor that the coordinate means: travel × Fn_205 ÷ Fn_206. `None` when the
    /// ratio has a zero in it.
    #[must_use]
    pub fn turns(&self, motor_turns: u16, travel: u16) -> Option<f64> {
        let units = f64::from(self.thousandths) / 1000.0;
        (motor_turns != 0 && travel != 0)
            .then(|| units * f64::from(motor_turns) / f64::from(travel))
    }
}

/// Returns whether an S-time fits an acceleration time: Ta/2 must be greater than Ts, or Ts is 0.
#[must_use]
pub const fn s_time_fits(acceleration_ms: u16, s_ms: u16) -> bool {
    s_ms == 0 || (acceleration_ms as u32) > 2 * s_ms as u32
}

const fn decode_kind(first: u16) -> PathType {
    match first % 10 {
        1 => PathType::Speed,
        2 => PathType::Single,
        3 => PathType::Auto,
        other => PathType::Unknown(other as u8),
    }
}

/// Digit pair B. Both words have one; the first that names a path counts `[I]`.
fn decode_next(word: u16) -> Option<u8> {
    let index = (word / 10 % 100) as u8;
    (1..=PATH_MAX).contains(&index).then_some(index)
}

/// Digit C of both words: the first selects absolute or relative, the second the base of a relative path. One whose
/// second word is "the coordinate itself" goes from the last command's end `[I]`.
const fn decode_end(first: u16, second: u16) -> PathEnd {
    match (first / 1000 % 10, second / 1000 % 10) {
        (1, _) => PathEnd::Coordinate,
        (_, 2) => PathEnd::Feedback,
        _ => PathEnd::LastCommand,
    }
}

/// Two signed words, tens and thousandths, added `[I]`.
fn decode_thousandths(tens: u16, rest: u16) -> i32 {
    i32::from(tens as i16) * 10_000 + i32::from(rest as i16)
}

/// Two signed words of the same sign: tens, and the thousandths below.
const fn encode_thousandths(thousandths: i32) -> [u16; 2] {
    [(thousandths / 10_000) as i16 as u16, (thousandths % 10_000) as i16 as u16]
}
