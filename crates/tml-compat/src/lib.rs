//! `libTML_lib`: the functions of Technosoft's TML_LIB on Polepair, so that programs relink instead of being
//! rewritten. The header is `include/TML_lib.h`; `docs/guides/tml-lib.md` lists what differs.
//!
//! - A function returns `TRUE` when the drive has confirmed the command. Otherwise it returns `FALSE` and keeps a text
//!   for [`TS_GetLastErrorText`](session::TS_GetLastErrorText), of the calling thread.
//! - Each thread has its own channel and axis. A thread that has selected none uses what was selected last.
//! - Each motion function is a few instructions of TML, sent one after the other;
//!   [`TS_GetOutputOfExecute`](program::TS_GetOutputOfExecute) returns them. After a failed instruction, the rest
//!   is not sent.
//! - Units are the drive's: counts, counts per slow loop, counts per slow loop squared.
//! - Closing a channel, or leaving the program, stops no motor.
//!
//! Sources: public programs that call TML_LIB, for prototypes and constants; the vendor's TML_LIB_light and help
//! pages, for the instructions.
#![deny(unsafe_code)]
#![allow(non_snake_case, reason = "names are those of TML_LIB")]

mod call;
mod channel;
mod execute;

pub mod coupling;
pub mod event;
pub mod line;
mod logger;
pub mod memory;
pub mod message;
mod message_queue;
pub mod motion;
pub mod path;
pub mod power;
pub mod program;
pub mod session;
pub mod unsupported;
pub mod variable;

/// `TRUE` (1) or `FALSE` (0).
pub type Bool = std::ffi::c_int;
/// A text of the caller that ends with a zero byte.
pub type Text = *const std::ffi::c_char;
