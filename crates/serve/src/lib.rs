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
mod auth;
pub mod bench;
mod connections;
mod error;
mod guard;
pub mod journal;
mod live;
mod metrics;
mod options;
mod page;
pub mod server;
mod tls;
mod token;

pub use api::{AccessRule, ApiRoute, BODY_MAX, ROUTES, openapi_json};
pub use auth::TRIES_MAX;
pub use error::SetupError;
pub use message::PORT;
pub use message::scope::{self, Scope, Scopes};
pub use options::ServerOptions;
pub use polepair_messages as message;
pub use server::{GatewayServer, ShutdownHandle};
