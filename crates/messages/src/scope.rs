//! Scopes: five permissions of a token. None includes another.

use core::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One thing that a caller may be allowed to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// See: axes, values, frames, faults, the journal.
    Read,
    /// Stop motion of any client.
    Stop,
    /// Take an axis, arm it, move it.
    Move,
    /// Write parameters, and permanent memory if requested.
    Configure,
    /// Send frames and texts of a protocol as they are; no limits stand before these.
    Raw,
}

impl Scope {
    /// Every scope, from the mildest to the sharpest.
    pub const ALL: [Self; 5] = [Self::Read, Self::Stop, Self::Move, Self::Configure, Self::Raw];

    /// Name of the scope in options, tokens and messages.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Stop => "stop",
            Self::Move => "move",
            Self::Configure => "configure",
            Self::Raw => "raw",
        }
    }

    const fn bit(self) -> u8 {
        1 << self as u8
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A set of scopes; written as words with commas between them.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub struct Scopes(u8);

impl Scopes {
    /// None at all.
    pub const NONE: Self = Self(0);

    /// Returns whether `scope` is among them.
    #[must_use]
    pub const fn contains(self, scope: Scope) -> bool {
        self.0 & scope.bit() != 0
    }

    /// These and `scope`.
    #[must_use]
    pub const fn with(self, scope: Scope) -> Self {
        Self(self.0 | scope.bit())
    }

    /// The common scopes: a token grants no more than its server permits.
    #[must_use]
    pub const fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Iterates over the scopes, from the mildest to the sharpest.
    pub fn iter(self) -> impl Iterator<Item = Scope> {
        Scope::ALL.into_iter().filter(move |&scope| self.contains(scope))
    }
}

impl FromIterator<Scope> for Scopes {
    fn from_iter<I: IntoIterator<Item = Scope>>(scopes: I) -> Self {
        scopes.into_iter().fold(Self::NONE, Self::with)
    }
}

impl fmt::Display for Scopes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut between = "";
        for scope in self.iter() {
            write!(f, "{between}{scope}")?;
            between = ",";
        }
        Ok(())
    }
}

impl fmt::Debug for Scopes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Scopes({self})")
    }
}

impl FromStr for Scopes {
    type Err = UnknownScope;

    fn from_str(text: &str) -> Result<Self, UnknownScope> {
        text.split(',')
            .map(str::trim)
            .filter(|word| !word.is_empty())
            .map(|word| {
                Scope::ALL
                    .into_iter()
                    .find(|scope| scope.as_str() == word)
                    .ok_or_else(|| UnknownScope(word.into()))
            })
            .collect()
    }
}

/// A word that names no scope.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownScope(pub String);

impl fmt::Display for UnknownScope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}` is no scope; there are read, stop, move, configure and raw", self.0)
    }
}

impl std::error::Error for UnknownScope {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scope_grants_itself_and_no_other() {
        for granted in Scope::ALL {
            let scopes = Scopes::NONE.with(granted);
            for scope in Scope::ALL {
                assert_eq!(scopes.contains(scope), scope == granted, "{granted} and {scope}");
            }
        }
    }

    #[test]
    fn words_come_back_and_unknown_ones_are_named() {
        let scopes: Scopes = "stop, read".parse().unwrap();
        assert_eq!(scopes.to_string(), "read,stop");
        assert_eq!("".parse(), Ok(Scopes::NONE));
        assert_eq!("read,admin".parse::<Scopes>(), Err(UnknownScope("admin".into())));
    }

    #[test]
    fn a_token_grants_no_more_than_its_server() {
        let scopes: Scopes = "read,stop,move,raw".parse().unwrap();
        let server: Scopes = "read,stop,move,configure".parse().unwrap();
        assert_eq!(scopes.intersection(server).to_string(), "read,stop,move");
    }
}
