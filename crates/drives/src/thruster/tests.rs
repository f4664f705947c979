//! The drives frame by frame, as a controller of another make would speak with them.

extern crate std;

mod axis;
mod faults;
mod moves;
mod wire;

use super::device::{Device, ThrusterFamily};
use super::profile;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, Frame};
use polepair_core::profile::Profile;
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;
use std::vec::Vec;

/// A drive at id 11 and a clock.
struct DriveFixture {
    device: Device,
    now: Instant,
}

/// Data bytes of a received frame, and the end of a refusal.
type Data = Vec<u8>;

impl DriveFixture {
    fn with(profile: &'static Profile, extra: &[(&'static str, &'static str)]) -> Self {
        let wires = &["thruster"];
        let options = DeviceOptions {
            address: Some(11),
            wires,
            standard: None,
            untimed: true,
            seed: 1,
            extra,
        };
        let device = ThrusterFamily::create_device(profile, &options).expect("known options");
        Self { device, now: Instant::ZERO }
    }

    fn thruster() -> Self {
        Self::with(&profile::THRUSTER, &[])
    }

    fn servo() -> Self {
        Self::with(&profile::THRUSTER_SERVO, &[])
    }

    /// A servo that turns without an end.
    fn endless() -> Self {
        Self::with(&profile::THRUSTER_SERVO, &[("ends", "none")])
    }

    /// Sends bytes to an id and gives what is answered.
    fn to(&mut self, id: u16, bytes: &[u8]) -> Vec<Frame> {
        self.device.handle_input(self.now, &Frame::standard(0x300 + id, bytes));
        self.sent()
    }

    fn sent(&mut self) -> Vec<Frame> {
        let (mut all, mut out) = (Vec::new(), Frame::default());
        while Station::<Can>::poll_transmit(&mut self.device, self.now, &mut out).is_some() {
            all.push(out);
        }
        all
    }

    /// Sends hexadecimal bytes and gives the data of the one answer.
    fn request(&mut self, text: &str) -> Data {
        let answers = self.to(11, &hex(text));
        assert_eq!(answers.len(), 1, "{text}: {answers:?}");
        assert_eq!(answers[0].id, 0x28B, "{text}");
        answers[0].bytes().to_vec()
    }

    /// Value that a query reads.
    fn value(&mut self, letters: &str) -> i16 {
        let mut bytes = letters.as_bytes().to_vec();
        bytes.extend([0, 0]);
        let answers = self.to(11, &bytes);
        let data = answers[0].bytes();
        assert_eq!(data[..4], bytes, "{letters}");
        i16::from_be_bytes([data[6], data[7]])
    }

    fn word(&mut self, letters: &str) -> u16 {
        self.value(letters).cast_unsigned()
    }

    /// Sends what must be repeated.
    fn ok(&mut self, text: &str) {
        let bytes = hex(text);
        let answer = self.request(text);
        assert_eq!(answer[..bytes.len()], bytes, "{text}: {answer:02X?}");
    }

    fn refused(&mut self, text: &str) {
        let answer = self.request(text);
        assert_eq!(answer[..4], hex(text)[..4], "{text}");
        assert_eq!(answer[4..], [0, 0, 0xEE, 0xEE], "{text}");
    }

    fn wait(&mut self, ms: u32) -> Vec<Frame> {
        let end = self.now.plus_ms(ms);
        let mut received = Vec::new();
        while let Some(at) = self.device.poll_timeout().filter(|at| *at <= end) {
            self.now = at.max(self.now);
            self.device.handle_timeout(self.now);
            received.extend(self.sent());
        }
        self.now = end;
        self.device.handle_timeout(self.now);
        received.extend(self.sent());
        received
    }

    fn act(&mut self, act: Act) {
        assert!(self.device.act(self.now, act), "{act:?}");
    }

    fn truth(&mut self) -> GroundTruth {
        self.device.ground_truth(self.now)
    }
}

fn hex(text: &str) -> Vec<u8> {
    text.split(' ').map(|byte| u8::from_str_radix(byte, 16).expect(text)).collect()
}
