//! The gateway: opens links, owns them, and lets several clients read and one client control each axis.
//!
//! Fieldbuses have no passwords, so this crate is the only access control between a browser and a drive.
//! [`scope`] is the permissions, [`message`] the messages. `guard` checks every route of `api`, [`journal`]
//! records actions, and [`mod@bench`] executes them without HTTP. [`server`] connects them.
//!
//! This is not a certified safety function: use hard-wired STO and an emergency stop.
#![forbid(unsafe_code)]

mod access;
mod api;
mod app_state;
mod auth;
pub mod bench;
mod broadcaster;
mod connections;
mod error;
mod guard;
mod hosts;
pub mod journal;
mod live;
mod metrics;
mod options;
mod page;
pub mod server;
#[cfg(feature = "tls")]
mod tls;
#[cfg(not(feature = "tls"))]
#[path = "tls_left_out.rs"]
mod tls;
mod token;

pub use access::AccessRule;
pub use api::{ApiRoute, BODY_MAX, ROUTES, openapi_json};
pub use auth::TRIES_MAX;
pub use error::SetupError;
pub use message::PORT;
pub use message::scope::{self, Scope, Scopes};
pub use options::ServerOptions;
pub use polepair_messages as message;
pub use server::{GatewayServer, ShutdownHandle};
