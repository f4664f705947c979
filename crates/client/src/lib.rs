//! Client of a running gateway (`polepair serve`), which owns the ports.
//!
//! ```text
//!   Gateway   one REST request for each call         bench, state, parameters, stop
//!    └ LiveConnection   a WebSocket                            telemetry, leases
//!       └ Lease   the lease of an axis               commands, each at most once
//! ```
//!
//! Calls block only their caller. One thread renews leases, receives telemetry, and detects a lost server. All
//! errors are [`GatewayError`], also for a missing reply. [`GatewayError::executed`] states whether a drive may
//! have executed the request.
#![forbid(unsafe_code)]

mod address;
mod dialer;
mod failure;
mod gateway;
mod lease;
mod live;
mod rest;
mod secret;
mod select;
mod server_stream;
#[cfg(feature = "tls")]
mod tls;
#[cfg(not(feature = "tls"))]
#[path = "tls_left_out.rs"]
mod tls;

pub use gateway::{Gateway, GatewayOptions};
pub use lease::{Lease, PendingOperation};
pub use live::{FrameStream, LiveConnection, SampleStream};
pub use polepair_messages as message;
pub use polepair_messages::GatewayError;
pub use secret::state_folder;
pub use select::{ALL, display_unit, find_link, select_axes, select_each};
