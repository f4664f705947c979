//! Captures of motor-drive buses: reading them, cutting them into frames, explaining every frame.
//!
//! ```text
//!   read      bytes of a file, in any of eight formats, to records; damage named by its place
//!    └ wire   per link: reassembly, resynchronisation, echo, requests and their replies
//!       └ Dissector (core's registry)   meaning of the frame by itself
//!          └ session                    results of its conversation: values, states, faults, anomalies
//!             ├ jsonl | text            one object, or one line, a frame
//!             └ filter, summary, diff, plot   what a person asks of all of them
//!   detector  the protocol of a capture that states none; reads ahead of the decoder
//! ```
//!
//! The meaning of a single frame is known by the dissectors of [`polepair_core::proto`]; only [`session`] knows
//! protocols by name.
//!
//! ```
//! use polepair_capture::{CaptureDecoder, Rules};
//!
//! let mut decoder = CaptureDecoder::new(Rules::default());
//! decoder.feed(b"(1700000000.000500) can0 123#0102\n", &mut |event| {
//!     assert_eq!((event.link, event.id), ("can0", Some(0x123)));
//! });
//! decoder.finish(&mut |_| ());
//! assert_eq!(decoder.statistics().damaged, 0);
//! ```
#![forbid(unsafe_code)]

mod batch;
mod byte_changes;
mod conversation;
mod date;
mod decoder;
mod defect;
mod detection;
mod detector;
pub mod diff;
mod explanation;
mod filter;
#[cfg(test)]
mod fixtures;
mod follow;
mod format;
mod intern;
pub mod jsonl;
mod line_buffer;
mod line_layout;
mod number_text;
pub mod parallel;
pub mod plot;
mod read;
mod record;
mod remark;
mod rules;
pub mod session;
mod stream;
pub mod summary;
pub mod text;
mod timestamp;
mod write;

pub use batch::{
    AnswerFrame, CompactFrame, FrameBatch, FrameBuffers, FrameRun, FrameTemplate, TemplateContent,
};
pub use byte_changes::{ByteChanges, meaning_text, visit_frame_key};
pub use decoder::{CaptureDecoder, DecodedFrame, TimeReversal};
pub use defect::FrameDefect;
pub use detection::LinkDetection;
pub use detector::ProtocolDetector;
pub use explanation::{CAN_FD, ERROR_FRAME, Explanation, ExplanationField, ExplanationValue};
pub use filter::{FilterError, FrameFilter, Glob};
pub use follow::{FollowEvent, FollowReader};
pub use format::{CaptureFormat, Compression, UnsupportedFile};
pub use number_text::plural;
pub use read::{
    CapturePosition, CaptureReader, Damage, LineScan, LogTimes, ReadError, ReadOptions,
    ReadStatistics, read_first_record, unpack_bounded,
};
pub use record::{CanErrorFrame, FdFrame, Record, RecordData};
pub use remark::Remark;
pub use rules::{Rule, RuleError, RuleScope, Rules, nearest_word};
pub use timestamp::Timestamp;
pub use write::{CaptureWriter, WriteError};

#[cfg(test)]
mod tests;
