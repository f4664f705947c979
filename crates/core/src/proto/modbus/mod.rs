//! Modbus over a serial line: RTU and ASCII, both ends.

pub mod ascii;
pub mod device;
pub mod rtu;
pub mod wire;

#[cfg(test)]
mod tests;
