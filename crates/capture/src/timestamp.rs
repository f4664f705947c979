//! Time stamps of captures, exact to the nanosecond.

/// Nanoseconds since the capture's epoch, as its lines state them.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Debug)]
pub struct Timestamp(pub u64);

const NS: u64 = 1_000_000_000;

impl Timestamp {
    /// Reads `1700000000.000500`; digits beyond the ninth are cut off.
    #[must_use]
    pub fn parse(text: &[u8]) -> Option<Self> {
        let dot = text.iter().position(|c| *c == b'.').unwrap_or(text.len());
        let seconds = digits(&text[..dot])?;
        let fraction = text.get(dot + 1..).unwrap_or(b"");
        let mut ns = 0;
        let mut weight = NS;
        for digit in fraction {
            if !digit.is_ascii_digit() {
                return None;
            }
            weight /= 10;
            ns += u64::from(digit - b'0') * weight;
        }
        Some(Self(seconds.checked_mul(NS)?.checked_add(ns)?))
    }

    /// Adds nanoseconds.
    #[must_use]
    pub const fn plus(self, ns: u64) -> Self {
        Self(self.0.saturating_add(ns))
    }

    /// Nanoseconds since `earlier`, zero when that is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

fn digits(text: &[u8]) -> Option<u64> {
    if text.is_empty() {
        return None;
    }
    text.iter().try_fold(0u64, |sum, c| {
        let digit = c.is_ascii_digit().then(|| u64::from(c - b'0'))?;
        sum.checked_mul(10)?.checked_add(digit)
    })
}

/// Writes seconds with as many decimals as they need, one at least: `1700000000.0005`.
impl core::fmt::Display for Timestamp {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let (seconds, mut rest, mut width) = (self.0 / NS, self.0 % NS, 9);
        while width > 1 && rest.is_multiple_of(10) {
            rest /= 10;
            width -= 1;
        }
        write!(f, "{seconds}.{rest:0width$}")
    }
}
