//! Tests by subject.

mod axis;
mod codec;
mod host;
