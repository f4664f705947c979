//! One program for all tests of this crate from outside: DESIGN.md says why.

mod canopen;
mod garbage;
mod mixed;
mod program;
mod rate;
mod tml;
