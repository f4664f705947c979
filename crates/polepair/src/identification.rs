//! Source of an axis' profile.

use std::fmt;

/// Source of an axis' profile.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Identification {
    /// From the connection string; no request was sent.
    Named,
    /// From the drive's reply.
    Queried {
        /// Version of the firmware, if the reply contains it.
        firmware: Option<String>,
    },
    /// A group: it cannot be asked and is taken for what the link's first axis is.
    Group,
    /// Something answers, and no profile that is known fits: the protocol's generic one serves.
    Generic {
        /// Profile of the known product with the nearest number, if the reply has one.
        nearest: Option<&'static str>,
    },
}

impl Identification {
    /// Returns whether the drive is not known.
    #[must_use]
    pub const fn is_generic(&self) -> bool {
        matches!(self, Self::Generic { .. })
    }
}

impl fmt::Display for Identification {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Named => f.write_str("named in the connection string"),
            Self::Queried { firmware: Some(firmware) } => write!(f, "firmware {firmware}"),
            Self::Queried { firmware: None } => f.write_str("from its reply"),
            Self::Group => f.write_str("a group: the profile of the link's first axis is used"),
            Self::Generic { nearest: None } => {
                f.write_str("unknown drive: the protocol's generic profile is used")
            }
            Self::Generic { nearest: Some(name) } => {
                write!(f, "unknown drive: the protocol's generic profile is used; nearest: {name}")
            }
        }
    }
}
