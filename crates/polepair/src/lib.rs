//! Talk to motor drives, and simulate them.
#![forbid(unsafe_code)]

mod file;
pub mod profile;
mod words;

pub use file::FileError;
pub use words::nearest;
