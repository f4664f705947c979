//! Joins a running gateway (`polepair serve`) instead of fighting it for the port.
//!
//! ```text
//!   Gateway   asks, one request each (REST)          bench, state, parameters, stop
//!    └ Live   stays (WebSocket)                      telemetry, leases
//!       └ Lease   an axis that is ours               commands, each at most once
//! ```
//!
//! Everything blocks its caller and nobody else: one thread of its own keeps leases, hears
//! telemetry, and notices when the server is gone. All that goes wrong is a [`Refused`], whether the
//! gateway said it or nobody answered; [`Refused::executed`] says whether a drive may have done what
//! was asked.
#![forbid(unsafe_code)]

mod address;
mod gateway;
mod lease;
mod live;
mod pick;
mod rest;
mod secret;
mod tls;
mod wire;

pub use gateway::{Gateway, Options};
pub use lease::{Lease, Pending};
pub use live::{Frames, Live, Watched};
pub use pick::{ALL, linked, pick, pick_each, unit};
pub use polepair_messages as message;
pub use polepair_messages::Refused;
pub use secret::state_folder;
