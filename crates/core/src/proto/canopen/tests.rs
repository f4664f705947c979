//! Tests by subject.

mod codec;
