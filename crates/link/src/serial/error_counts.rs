//! Error counters of a serial driver: lost and damaged characters. Linux only.
#![allow(unsafe_code)]

use std::os::fd::OwnedFd;

/// `struct serial_icounter_struct` of `linux/serial.h`, 20 words.
type IcounterStruct = [u32; 20];

const FRAME: usize = 6;
const OVERRUN: usize = 7;
const PARITY: usize = 8;
const BUFFER_OVERRUN: usize = 10;

/// Characters since the driver began to count, modulo 2³².
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ErrorCounts {
    /// Bytes dropped because they were not read in time.
    lost: u32,
    /// With a wrong stop or parity bit.
    damaged: u32,
}

impl ErrorCounts {
    /// Counts of the driver so far; zero where it does not count (ptys).
    pub(super) fn read_from(fd: &OwnedFd) -> Self {
        Self::from_icounter(&read_icounter(fd).unwrap_or_default())
    }

    fn from_icounter(counter: &IcounterStruct) -> Self {
        Self {
            lost: counter_sum(OVERRUN, BUFFER_OVERRUN, counter),
            damaged: counter_sum(FRAME, PARITY, counter),
        }
    }

    /// Lost and damaged characters since `earlier`.
    pub(super) fn since(self, earlier: Self) -> (u64, u64) {
        let lost = self.lost.wrapping_sub(earlier.lost);
        let damaged = self.damaged.wrapping_sub(earlier.damaged);
        (lost.into(), damaged.into())
    }
}

fn counter_sum(one: usize, other: usize, counter: &[u32; 20]) -> u32 {
    counter[one].wrapping_add(counter[other])
}

fn read_icounter(fd: &OwnedFd) -> Option<IcounterStruct> {
    use rustix::ioctl::{Opcode, Updater, ioctl};
    /// Number of the request on these processors; others have another.
    const TIOCGICOUNT: Opcode = 0x545D;
    if !cfg!(all(
        target_os = "linux",
        any(
            target_arch = "x86_64",
            target_arch = "x86",
            target_arch = "aarch64",
            target_arch = "arm",
            target_arch = "riscv64"
        )
    )) {
        return None;
    }
    let mut counter: IcounterStruct = [0; 20];
    // SAFETY: TIOCGICOUNT writes one serial_icounter_struct through the pointer; `counter` is as
    // large, and any bits are valid integers.
    let result = unsafe { ioctl(fd, Updater::<TIOCGICOUNT, IcounterStruct>::new(&mut counter)) };
    result.ok().map(|()| counter)
}

#[cfg(test)]
mod tests {
    use super::{BUFFER_OVERRUN, ErrorCounts, FRAME, OVERRUN, PARITY};

    #[test]
    fn counts_are_taken_from_where_they_stood_and_go_round() {
        let mut counter = [0; 20];
        (counter[OVERRUN], counter[FRAME]) = (u32::MAX, 7);
        let before = ErrorCounts::from_icounter(&counter);
        (counter[OVERRUN], counter[BUFFER_OVERRUN]) = (1, 3);
        (counter[FRAME], counter[PARITY]) = (8, 2);
        assert_eq!(ErrorCounts::from_icounter(&counter).since(before), (5, 3));
    }

    #[test]
    fn a_port_without_counters_lost_nothing() {
        use crate::{LinkIo as _, Losses, pty::Pty, serial};
        let pty = Pty::open(None).expect("a pty");
        let line = polepair_core::medium::SerialLine::new_8n1(921_600);
        let port = serial::open(pty.path(), line).expect("a port");
        assert_eq!(port.losses(), Losses::default());
    }
}
