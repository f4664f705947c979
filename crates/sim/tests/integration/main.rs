//! One program for all tests of this crate from outside (BUILD-1).

mod canopen;
mod garbage;
mod mixed;
mod program;
mod rate;
mod tml;
