//! The operating system's side of polepair: ports, sockets, threads and the clock.
//!
//! ```text
//!   Connection      one lock, one leader: tickets made waitable        serve   a simulated drive
//!        │                                                               │     on a real wire
//!        └──────────────────────── Link<M> ──────────────────────────────┘
//!              serial · tcp · pty · Tapped (a trace) · whatever `sim` puts here
//! ```
//!
//! ```
//! use polepair_link::tcp::{TcpLink, TcpServer};
//! use polepair_link::{Link, Received, clock};
//!
//! let drive = TcpServer::bind("0")?; // a free port of this machine
//! let host = TcpLink::connect(&drive.address().to_string())?;
//! host.send(&[1, 2, 3])?;
//! let mut buffer = [0; 16];
//! let received = drive.receive(&mut buffer, clock::now().plus_ms(1000))?;
//! assert!(matches!(received, Received::Bytes { len: 3, .. }));
//! # Ok::<(), polepair_link::LinkError>(())
//! ```
//!
//! Nothing here knows a protocol. Only [`clock`] reads the time, only this crate sleeps or spawns.
#![deny(unsafe_code)]

pub mod clock;
pub mod connection;
#[cfg(unix)]
mod descriptor;
#[cfg(target_os = "linux")]
mod edge;
pub mod error;
mod hex;
#[cfg(unix)]
pub mod hub;
mod inbox;
mod limit;
pub mod link;
pub mod ports;
#[cfg(unix)]
pub mod pty;
pub mod serial;
pub mod serve;
pub mod slcan;
#[cfg(target_os = "linux")]
pub mod socketcan;
pub mod socketcand;
#[cfg(target_os = "linux")]
mod sys;
pub mod tap;
pub mod tcp;
#[cfg(unix)]
pub mod udp;
pub mod wake;

pub use connection::{
    AnyLane, Aside, Connection, Interrupter, Listening, Mailbox, Notice, Pending, Waited,
};
pub use error::{Cause, LinkError};
pub use limit::{is_private, open_files, stand_back};
pub use link::{Link, Losses, Received};
pub use ports::{Carries, Port, has_no_baud_rate, ports};
pub use serve::{Served, Stop, Wire, serve};
pub use tap::{Direction, Tap, Tapped};
pub use wake::Waker;

#[cfg(all(test, unix))]
mod tests;
