//! Defects of a frame, or of bytes that are none.

use std::fmt;

use polepair_core::error::WireError;

/// Defect of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FrameDefect {
    /// A violation of its protocol.
    Wire(WireError),
    /// A failed check.
    BadCheck,
    /// These bytes are no frame.
    Stray(usize),
}

impl fmt::Display for FrameDefect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wire(error) => error.fmt(f),
            Self::BadCheck => f.write_str("frame: its check fails"),
            Self::Stray(count) => write!(f, "stray: {}", stray_text(*count)),
        }
    }
}

impl FrameDefect {
    /// Returns whether a check over its bytes fails.
    #[must_use]
    pub const fn is_bad_check(self) -> bool {
        matches!(self, Self::BadCheck | Self::Wire(WireError::Checksum { .. }))
    }
}

/// Bytes that are no frame, in words.
pub(crate) fn stray_text(count: usize) -> String {
    match count {
        1 => "1 byte that belongs to no frame".to_owned(),
        _ => format!("{count} bytes that belong to no frame"),
    }
}
