//! Tests by subject.

mod codec;
mod driver;
mod host;
