//! One program for all tests of this crate from outside: DESIGN.md says why.

mod stress;
