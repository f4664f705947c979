//! One program for all tests of this crate from outside: DESIGN.md says why.

mod authority;
mod bench;
mod captures;
mod journal;
mod live;
mod look;
mod openapi;
mod owed;
mod patience;
mod site;
mod telemetry;
mod threats;
