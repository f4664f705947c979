//! Reduces the latency of FTDI adapters, which delay received bytes by up to 16 ms.
#![allow(unsafe_code)]

use std::os::fd::OwnedFd;

use rustix::ioctl::{Opcode, Updater, ioctl};

/// `struct serial_struct` of `linux/serial.h`, at most 72 bytes, with room to spare; `flags` is
/// its fifth word.
type SerialStruct = [u32; 32];

const FLAGS: usize = 4;
const ASYNC_LOW_LATENCY: u32 = 1 << 13;
/// Number of the request on x86, Arm and RISC-V; `mod serial` compiles this for no other.
const TIOCGSERIAL: Opcode = 0x541E;
const TIOCSSERIAL: Opcode = 0x541F;

/// Requests low latency. A device without it (ptys, adapters without a timer) refuses, which loses nothing.
pub(super) fn request_low_latency(fd: &OwnedFd) {
    let mut settings: SerialStruct = [0; 32];
    // SAFETY: TIOCGSERIAL writes one serial_struct through the pointer; `settings` is larger, and
    // any bits are valid integers.
    let asked = unsafe { ioctl(fd, Updater::<TIOCGSERIAL, SerialStruct>::new(&mut settings)) };
    if asked.is_err() || settings[FLAGS] & ASYNC_LOW_LATENCY != 0 {
        return;
    }
    settings[FLAGS] |= ASYNC_LOW_LATENCY;
    // SAFETY: TIOCSSERIAL reads one serial_struct through the pointer; `settings` is larger, is
    // initialised, and holds what TIOCGSERIAL gave.
    let _ = unsafe { ioctl(fd, Updater::<TIOCSSERIAL, SerialStruct>::new(&mut settings)) };
}
