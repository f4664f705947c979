//! Scopes that a request needs.

use std::fmt;

use crate::scope::{Scope, Scopes};

/// Scopes of which a lease needs one.
pub(crate) const LEASE_SCOPES: &[Scope] = &[Scope::Move, Scope::Configure, Scope::Raw];

/// Access rule of a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AccessRule {
    /// Not even a token.
    Public,
    /// One of these scopes.
    AnyOf(&'static [Scope]),
}

impl AccessRule {
    /// Returns whether these scopes are enough.
    #[must_use]
    pub fn is_met_by(self, scopes: Scopes) -> bool {
        match self {
            Self::Public => true,
            Self::AnyOf(any) => any.iter().any(|scope| scopes.contains(*scope)),
        }
    }
}

impl fmt::Display for AccessRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::AnyOf(any) = self else { return f.write_str("nothing") };
        let mut between = "";
        for scope in *any {
            write!(f, "{between}{scope}")?;
            between = " or ";
        }
        Ok(())
    }
}
