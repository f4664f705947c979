//! Joins a running gateway (`polepair serve`) instead of fighting it for the port.
//!
//! ```text
//!   Gateway   asks, one request each (REST)          bench, state, parameters, stop
//!    └ LiveConnection   stays (WebSocket)                      telemetry, leases
//!       └ Lease   an axis that is ours               commands, each at most once
//! ```
//!
//! Everything blocks its caller and nobody else: one thread of its own keeps leases, hears
//! telemetry, and notices when the server is gone. All that goes wrong is a [`GatewayError`], whether the
//! gateway said it or nobody answered; [`GatewayError::executed`] says whether a drive may have done what
//! was asked.
#![forbid(unsafe_code)]

mod address;
mod dialer;
mod gateway;
mod lease;
mod live;
mod rest;
mod secret;
mod select;
mod tls;

pub use gateway::{Gateway, GatewayOptions};
pub use lease::{Lease, PendingOperation};
pub use live::{FrameStream, LiveConnection, SampleStream};
pub use polepair_messages as message;
pub use polepair_messages::GatewayError;
pub use secret::state_folder;
pub use select::{ALL, display_unit, find_link, select_axes, select_each};
