//! One program for all tests of this crate from outside: DESIGN.md says why.

mod bare_metal;
mod canopen_pair;
