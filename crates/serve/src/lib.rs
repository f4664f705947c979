//! The gateway: it opens links, owns them, and lets several people watch and one command each axis.
//!
//! Fieldbuses know no passwords; whoever is on the wire owns the motor. So what this crate lets
//! through is the only policy there is between a browser and a drive: [`scope`] says what a caller
//! may do at all, [`message`] what can be said. `guard` stands before every route of `api`;
//! [`journal`] keeps what was done; [`mod@bench`] does it, and knows no HTTP. [`server`] puts them
//! together.
//!
//! This is no certified safety function: hard-wire STO and emergency stop.
#![forbid(unsafe_code)]

mod api;
pub mod bench;
mod connections;
mod guard;
pub mod journal;
mod live;
mod metrics;
mod options;
mod page;
mod refusal;
pub mod server;
mod session;
mod tls;
mod token;

pub use api::{BODY_MAX, Needs, ROUTES, Route, description};
pub use message::PORT;
pub use message::scope::{self, Scope, Scopes};
pub use options::Options;
pub use polepair_messages as message;
pub use refusal::Refusal;
pub use server::{Server, Stopper};
pub use session::TRIES_MAX;
