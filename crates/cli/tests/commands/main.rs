//! One program for all tests of this crate from outside (BUILD-1).
//!
//! A program of its own: its tests start processes, so they have a step of their own (BUILD-3).

mod asking;
mod broken;
mod by_number;
mod can;
mod canopen;
mod captures;
mod completions;
mod config;
mod conversations;
mod couple;
mod decode;
mod docs;
mod doctor;
mod errors;
mod evidence;
mod field;
mod foreign_text;
mod fuzz;
mod gateway;
mod groups;
mod joined;
mod line_rate;
mod monitor;
mod motions;
mod pinned_json;
mod planted;
mod program;
mod rack;
mod readdress;
mod record;
mod record_in_drive;
mod recording;
mod replay;
mod run;
mod sim;
mod stop;
mod thruster;
mod tml;
mod truth;
mod units;
mod written;
