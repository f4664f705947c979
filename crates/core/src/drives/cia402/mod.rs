//! Drives that follow CiA 402.

pub mod profile;
