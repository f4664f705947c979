//! One program for all tests of this crate from outside (BUILD-1).
#![allow(clippy::unwrap_used, reason = "tests")]

// The one file that two crates' tests share: neither can have the other's tests as a dependency.
#[path = "../../../serve/tests/integration/authority/mod.rs"]
mod authority;
mod cut;
mod join;
mod one_interface;
