//! Tests by subject.

mod axis;
mod codec;
mod explain;
mod host;
