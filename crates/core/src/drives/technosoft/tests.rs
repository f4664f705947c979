//! The family against its manuals, over the wire.

extern crate std;

use std::vec::Vec;

use super::{Device, Technosoft};
use crate::drives::{DeviceOptions, Family};
use crate::medium::{STREAM_UNIT_MAX, Stream};
use crate::station::{Station, Timed};
use crate::time::Instant;

mod serial;

const OPTIONS: DeviceOptions<'static> =
    DeviceOptions { address: None, wires: &["tml"], untimed: true, seed: 1, extra: &[] };

const NOTHING: [u8; 0] = [];

/// A drive on a test's desk, its serial port connected.
struct Desk {
    device: Device,
    now: Instant,
}

impl Desk {
    fn new() -> Self {
        Self::with(&[])
    }

    fn with(extra: &[(&str, &str)]) -> Self {
        Self::at(None, extra)
    }

    fn at(address: Option<u32>, extra: &[(&str, &str)]) -> Self {
        let options = DeviceOptions { address, extra, ..OPTIONS };
        let device = Technosoft::device(Technosoft::profiles()[0], &options).unwrap();
        Self { device, now: Instant(1_000_000_000) }
    }

    /// Sends bytes and returns what the drive sends back at once.
    fn bytes(&mut self, bytes: &[u8]) -> Vec<u8> {
        Station::<Stream>::handle_input(&mut self.device, self.now, bytes);
        self.sent()
    }

    fn sent(&mut self) -> Vec<u8> {
        let (mut all, mut out) = (Vec::new(), [0; STREAM_UNIT_MAX]);
        while let Some(n) = Station::<Stream>::poll_transmit(&mut self.device, self.now, &mut out) {
            all.extend_from_slice(&out[..n]);
        }
        all
    }

    fn wait(&mut self, ms: u32) {
        self.now = self.now.plus_ms(ms);
        self.device.handle_timeout(self.now);
    }
}
