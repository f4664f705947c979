//! A Modbus drive that no family has: a bank of registers that obeys a user's profile.
//!
//! The plans are read backwards. What a plan writes last is its trigger: when a request writes that, the simulated
//! motor does what the verb means, with the arguments that the registers hold. The signals of the profile then show
//! what the motor does. So a profile can be tried before a real motor turns; whether it fits the real drive, only the
//! manual and the drive can show.

mod device;
mod motor;
mod triggers;

pub use device::ProfileDrive;
