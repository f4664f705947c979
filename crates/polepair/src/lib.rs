//! Controls motor drives of several makers, and simulates them.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let link = polepair::connect("sim:tmcl?axes=2&time=virtual")?;
//! for axis in link.axes() {
//!     println!("{}: {}", axis.label(), axis.facts().title);
//! }
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```
//!
//! A connection string names protocol, link and axes; see [`url`]. An [`Axis`] has parameters with units, and
//! the verbs of motion. All calls block, and may be used from any thread. An [`Error`] states its source, and
//! whether the drive may have executed the request.
#![forbid(unsafe_code)]

pub mod amount;
pub mod axis;
mod bus;
pub mod config;
pub mod connect;
mod detected_drive;
pub mod doctor;
mod duplicate_address;
pub mod eds;
pub mod error;
pub mod events;
mod faults;
mod identification;
mod identify;
pub mod instruction_program;
pub mod interface;
pub mod listen;
pub mod lss;
mod mounting;
pub mod no_reply;
pub mod paths;
pub mod profile;
mod profile_file;
pub mod program;
mod protocol_line;
pub mod quantity;
mod registry;
pub mod scan;
pub mod search;
pub mod settings;
pub mod simulate;
mod spelling;
pub mod stop;
mod tap;
mod toml_file;
pub mod url;
pub mod wire;

pub use amount::{Amount, Value, format_raw};
pub use axis::coupling::{Cam, CamPlan, CamPoint, GearRatio};
pub use axis::drive_log::{
    DriveLog, DriveLogCondition, DriveLogFacts, DriveLogPlan, DriveLogProgress, DriveLogRequest,
    DriveLogStage, LoggedVariable,
};
pub use axis::{CyclicAxes, LocalAxis, RunningReports, RunningRequest, start_together};
pub use bus::{BusLoadRange, frame_bits};
pub use connect::{Connector, LocalLink, connect_local};
pub use error::Error;
pub use events::{Event, Events};
pub use faults::{active_faults, faults};
pub use identification::Identification;
pub use instruction_program::InstructionProgram;
#[cfg(feature = "remote")]
pub use interface::remote;
pub use interface::{Armed, Axis, AxisInterface, Link, connect};
pub use no_reply::NoReplyDetails;
pub use profile_file::load_profile;
pub use program::Program;
pub use spelling::nearest;
pub use tap::AnyTap;
pub use toml_file::FileError;
pub use wire::{AnyLink, SentCounter};

/// The programs that the README shows are run.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
