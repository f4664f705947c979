//! Captures of motor-drive buses: reading them, cutting them into frames, explaining every frame.
//!
//! ```text
//!   read      bytes of a file, in any of eight formats, to records; damage named by its place
//!    └ wire   per link: reassembly, resynchronisation, echo, requests and their replies
//!       └ Dissector (core's registry)   what the frame says by itself
//!          └ session                    what its conversation tells: values, states, faults, oddities
//!             ├ jsonl | text            one object, or one line, a frame
//!             └ filter, summary, diff, plot   what a person asks of all of them
//!   judge     which protocol a capture speaks, when nobody says
//! ```
//!
//! What a frame means by itself is known by the dissectors of [`polepair_core::proto`]; only
//! [`session`] knows protocols by name.
//!
//! ```
//! use polepair_capture::{Decoder, Rules};
//!
//! let mut decoder = Decoder::new(Rules::default());
//! decoder.feed(b"(1700000000.000500) can0 123#0102\n", &mut |event| {
//!     assert_eq!((event.link, event.id), ("can0", Some(0x123)));
//! });
//! decoder.finish(&mut |_| ());
//! assert_eq!(decoder.tally().damaged, 0);
//! ```
#![forbid(unsafe_code)]

mod batch;
mod changes;
mod conversation;
mod date;
mod decoder;
pub mod diff;
mod explained;
mod filter;
mod follow;
mod format;
pub mod jsonl;
mod judge;
#[cfg(test)]
mod made;
mod page;
pub mod parallel;
pub mod plot;
mod put;
mod read;
mod record;
mod rules;
pub mod session;
mod stamp;
mod stream;
pub mod summary;
pub mod text;
mod write;

pub use batch::{Batch, Decoded, Plain, Said, Voice};
pub use changes::{Changes, about, meaning};
pub use decoder::{Decoder, Event, Wrong};
pub use explained::{CAN_FD, ERROR_FRAME, Explained, Item, ItemValue};
pub use filter::{Filter, FilterError, Glob};
pub use follow::{Follow, Next};
pub use format::{Format, Packing};
pub use judge::{Judge, Verdict};
pub use read::{Bad, Damage, Place, Reader, Scan, Tally, parse, unpacked};
pub use record::{Data, ErrorFrame, Fd, Record};
pub use rules::{Rule, RuleError, Rules, Scope, nearest};
pub use stamp::Stamp;
pub use write::{WriteError, Writer};

#[cfg(test)]
mod tests;
