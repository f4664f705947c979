//! One program for all tests of this crate from outside (BUILD-1).

mod abi;
mod programs;
mod served;
