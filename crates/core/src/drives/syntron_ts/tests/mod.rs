//! The family against its manual.
