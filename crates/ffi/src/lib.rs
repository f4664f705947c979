//! libpolepair: the C interface of Polepair.
//!
//! The header `include/polepair.h` is generated from this crate, with the comments of its functions. Rules that
//! hold for all functions:
//!
//! - Handles are opaque. Each handle may be used by any thread; calls on one handle from several threads run at
//!   the same time, apart from the error that the handle keeps.
//! - A function returns a [`pp_status`]; results go through pointers. A failed call leaves its results alone.
//! - The handle keeps the last error; [`pp_link_error`](link::pp_link_error) and its siblings copy it.
//! - Text is UTF-8 with its length in bytes. [`PP_NTS`] as length means that the text ends at its first zero byte.
//! - Structs begin with their size, which the caller sets: a program that was built with an older header gets the
//!   fields that it knows.
//! - No panic crosses the interface, and a child process after `fork` is refused.
#![deny(unsafe_code)]
#![allow(non_camel_case_types, reason = "names are those of the C header")]

pub mod axis;
pub mod coupling;
pub mod drive_log;
pub mod error;
pub mod event;
mod fixed_text;
mod handle;
pub mod link;
mod link_events;
pub mod motion;
pub mod parameter;
pub mod request;
pub mod scan;
pub mod signal;
pub mod simulation;
mod text;
pub mod trace;
pub mod version;

pub use error::{pp_error, pp_status};

/// Length of a text that ends at its first zero byte.
pub const PP_NTS: usize = usize::MAX;
