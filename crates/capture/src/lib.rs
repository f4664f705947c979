//! Captures of motor-drive buses: reading them, cutting them into frames, explaining every frame.
//!
//! ```text
//!   lines     candump and serial logs, damaged lines named by number
//!    └ wire   per link: reassembly, resynchronisation, echo, requests and their replies
//!       └ Dissector (core's registry)   what the frame says
//!          └ jsonl | text               one object, or one line, a frame
//!   judge     which protocol a capture speaks, when nobody says
//! ```
//!
//! No protocol is named here: what a frame means is known by the dissectors of
//! [`polepair_core::proto`].
//!
//! ```
//! use polepair_capture::{Decoder, Rules};
//!
//! let mut decoder = Decoder::new(Rules::default());
//! decoder.line(b"(1700000000.000500) can0 123#0102", &mut |event| {
//!     assert_eq!((event.link, event.id), ("can0", Some(0x123)));
//! });
//! decoder.finish(&mut |_| ());
//! assert!(decoder.damaged().is_empty());
//! ```
#![forbid(unsafe_code)]

mod candump;
mod conversation;
mod decoder;
mod explained;
mod follow;
pub mod jsonl;
mod judge;
mod line;
mod rules;
mod seriallog;
mod stamp;
mod stream;
pub mod text;

pub use decoder::{Damage, Decoder, Event, Wrong};
pub use explained::{Explained, Item, ItemValue};
pub use follow::{Follow, Next};
pub use judge::{Judge, Verdict};
pub use line::{BadLine, Data, Line, Lines, parse};
pub use rules::{Rule, RuleError, Rules, Scope, nearest};
pub use stamp::Stamp;

#[cfg(test)]
mod tests;
