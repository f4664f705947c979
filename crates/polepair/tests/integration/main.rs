//! One program for all tests of this crate from outside (BUILD-1).

mod acts;
mod addresses;
mod arming;
mod brushless;
mod can;
mod can_ids;
mod early_ends;
mod events;
mod examples;
mod heard;
mod instruction_programs;
mod library;
mod look;
mod lss;
mod motors;
mod one_bus;
mod optional;
mod rack;
mod ramps;
mod safety;
mod scaled;
mod sheets;
mod standing;
mod timing;
mod urls;
mod watchdog;
