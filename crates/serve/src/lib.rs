//! The gateway: it opens links, owns them, and lets several people watch and one command each axis.
//!
//! Fieldbuses know no passwords; whoever is on the wire owns the motor. So what this crate lets
//! through is the only policy there is between a browser and a drive: [`scope`] says what a caller
//! may do at all, [`message`] what can be said, [`bench`] does it.
#![forbid(unsafe_code)]

pub mod bench;
pub mod message;
pub mod scope;

pub use bench::Bench;
pub use scope::{Scope, Scopes};
