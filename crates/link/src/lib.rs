//! The operating system's side of polepair: ports, sockets, threads and the clock.
//!
//! ```text
//!   Connection      a lane for many threads: one lock, one leader      serve   a simulated drive
//!        │                                                               │     on a real wire
//!        └──────────────────────── LinkIo<M> ──────────────────────────────┘
//!              serial · tcp · pty · TappedLink (a trace) · whatever `sim` puts here
//! ```
//!
//! ```
//! use polepair_link::tcp::{TcpLink, TcpServer};
//! use polepair_link::{LinkIo, Received, clock};
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
//! This crate knows no protocol. Only [`clock`] reads the time, and only this crate sleeps or spawns threads.
#![deny(unsafe_code)]

pub mod clock;
pub mod connection;
#[cfg(windows)]
pub mod console;
mod descriptor;
#[cfg(target_os = "linux")]
mod epoll_set;
pub mod error;
mod hex;
pub mod hub;
mod inbox;
pub mod link;
pub mod ports;
mod process;
#[cfg(unix)]
pub mod pty;
mod read_mode;
pub mod serial;
pub mod serve;
pub mod slcan;
#[cfg(target_os = "linux")]
pub mod socketcan;
pub mod socketcand;
#[cfg(target_os = "linux")]
mod sys;
#[cfg(windows)]
#[path = "sys_windows.rs"]
mod sys;
pub mod tap;
pub mod tcp;
pub mod udp;
pub mod waker;

pub use connection::{
    AnyLane, BorrowedLink, Connection, ConnectionEvent, Interrupter, ListenerGuard, Mailbox,
    PendingRequest, WaitResult,
};
pub use error::{Cause, LinkError};
pub use link::{LinkIo, Losses, Received};
pub use ports::{Port, PortKind, has_no_baud_rate, ports};
pub use process::{is_private_file, is_trusted_file, lower_priority, raise_file_limit};
pub use serve::{ServeHandle, ServeThread, StationAccess, serve};
pub use tap::{Tap, TapDirection, TappedLink};
pub use waker::LinkWaker;

#[cfg(all(test, unix))]
mod tests;
