//! One program for all tests of this crate from outside (BUILD-1).

mod authority;
mod bench;
mod captures;
mod journal;
mod live;
mod look;
mod openapi;
mod patience;
mod pending_stops;
#[cfg(unix)]
mod search;
mod site;
mod telemetry;
mod threats;
