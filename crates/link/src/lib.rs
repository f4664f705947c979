//! The operating system's side of polepair: ports, sockets, threads and the clock.
//!
//! ```text
//!   Connection      one lock, one leader: tickets made waitable        serve   a simulated drive
//!        │                                                               │     on a real wire
//!        └──────────────────────── Link<M> ──────────────────────────────┘
//!              serial · tcp · pty · Tapped (a trace) · whatever `sim` puts here
//! ```
//!
//! Nothing here knows a protocol. Only [`clock`] reads the time, only this crate sleeps or spawns.
#![deny(unsafe_code)]

pub mod clock;
pub mod connection;
#[cfg(unix)]
mod descriptor;
pub mod error;
pub mod link;
pub mod ports;
#[cfg(unix)]
pub mod pty;
pub mod serial;
pub mod serve;
pub mod tap;
pub mod tcp;
pub mod wake;

pub use connection::{AnyLane, Connection, Interrupter, Pending, Waited};
pub use error::{Cause, LinkError};
pub use link::{Link, Received};
pub use ports::{Port, ports};
pub use serve::{Wire, serve};
pub use tap::{Direction, Tap, Tapped};
pub use wake::Waker;

#[cfg(all(test, unix))]
mod tests;
