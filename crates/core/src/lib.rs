//! Motor drives, from both ends of the wire, without I/O.
//!
//! ```text
//!   Axes            what the layers above hold: axis verbs, parameters, outcomes
//!    └ lane         one host and the axes it serves; runs plans
//!       ├ Driver    one protocol's translation of parameters, per axis
//!       └ Host      one protocol's commanding end     ┐ both are a Station<M>
//!         ~~~~ wire ~~~~                              │ on a Medium: Stream or Can
//!         device    one protocol's obeying end        ┘
//!          └ Firmware   what a simulated drive does
//!             └ plant   its motor and load
//! ```
//!
//! Time, randomness and I/O are arguments: see [`station::Station`]. Facts about drives are data:
//! see [`profile::Profile`].
#![no_std]
#![forbid(unsafe_code)]

#[allow(unused_extern_crates, reason = "lane and mux allocate at set-up")]
extern crate alloc;

pub mod axis;
pub mod cam_table;
pub mod convert;
pub mod data_logger;
pub mod error;
pub mod escape;
pub mod explain;
pub mod judge;
pub mod lane;
pub mod medium;
pub mod mux;
mod parameter_id;
pub mod plan;
pub mod plant;
pub mod profile;
pub mod program;
pub mod proto;
pub mod station;
pub mod stream;
pub mod time;
pub mod units;
pub mod verb;
