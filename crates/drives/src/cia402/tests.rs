//! The family against the standard, object by object over the bus.

extern crate std;

use core::f64::consts::TAU;
use std::vec::Vec;

use super::device::Device;
use super::drive::Drive;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_core::medium::Frame;
use polepair_core::proto::canopen::od::ValueType;
use polepair_core::proto::canopen::sdo::{
    AbortCode, ExpeditedData, ObjectIndex, SdoReply, SdoRequest,
};
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;

mod cyclic;
mod faults;
mod homing;
mod interpolation;
mod modes;
mod power;
mod units;

/// A drive in a test, operational.
struct DriveFixture {
    device: Device,
    now: Instant,
    received: Vec<Frame>,
}

impl DriveFixture {
    fn new() -> Self {
        let device = Device::new(Drive::new(2, 7, 500_000));
        let mut fixture = Self { device, now: Instant(1_000_000_000), received: Vec::new() };
        fixture.send(Frame::standard(0, &[1, 2]));
        fixture.received.clear();
        fixture
    }

    /// A fixture with the motor powered in this mode.
    fn enabled(mode: i8) -> Self {
        let mut fixture = Self::new();
        fixture.write(0x6060, 0, mode.into());
        fixture.enable();
        fixture
    }

    fn enable(&mut self) {
        for word in [6, 7, 15] {
            self.control(word);
        }
    }

    fn send(&mut self, frame: Frame) {
        self.device.handle_input(self.now, &frame);
        self.drain();
    }

    fn drain(&mut self) {
        let mut out = Frame::default();
        while self.device.poll_transmit(self.now, &mut out).is_some() {
            self.received.push(out);
        }
    }

    fn request(&mut self, request: SdoRequest) -> SdoReply {
        self.received.clear();
        self.send(request.emit(2));
        let reply = self.received.iter().find(|frame| frame.id == 0x582);
        SdoReply::of(reply.unwrap().data)
    }

    fn try_write(&mut self, index: u16, sub: u8, value: i64) -> Result<(), AbortCode> {
        let entry = super::objects::DICTIONARY.find(index, sub).unwrap();
        let short = ExpeditedData { bits: value as u32, len: entry.kind.bytes().unwrap() };
        match self.request(SdoRequest::Write(ObjectIndex::new(index, sub), short)) {
            SdoReply::Written(..) => Ok(()),
            SdoReply::Abort(_, abort) => Err(abort),
            other => panic!("{other:?}"),
        }
    }

    fn write(&mut self, index: u16, sub: u8, value: i64) {
        let done = self.try_write(index, sub, value);
        assert_eq!(done, Ok(()), "{index:04X}:{sub} = {value}");
    }

    fn read(&mut self, index: u16, sub: u8) -> i64 {
        let entry = super::objects::DICTIONARY.find(index, sub).unwrap();
        match self.request(SdoRequest::Read(ObjectIndex::new(index, sub))) {
            SdoReply::Value(_, short) => ValueType::number(entry.kind, short.bits.into()),
            other => panic!("{other:?}"),
        }
    }

    fn control(&mut self, word: u16) {
        self.write(0x6040, 0, word.into());
    }

    fn status(&mut self) -> u16 {
        self.read(0x6041, 0) as u16
    }

    fn position(&mut self) -> i64 {
        self.read(0x6064, 0)
    }

    /// Hands over a set-point: bits 4 and `more` up, then down.
    fn hand_over_point(&mut self, target: i64, more: u16) {
        self.write(0x607A, 0, target);
        self.control(0x1F | more);
        self.control(0x0F | more);
    }

    fn advance(&mut self, ms: u32) {
        for _ in 0..ms {
            self.now = self.now.plus_ms(1);
            self.device.handle_timeout(self.now);
            self.drain();
        }
    }

    fn sync(&mut self) {
        self.send(Frame::standard(0x80, &[]));
    }

    /// Waits for a bit of the statusword.
    fn wait_for_bit(&mut self, bit: u16, within_ms: u32) {
        for _ in 0..within_ms {
            if self.status() >> bit & 1 != 0 {
                return;
            }
            self.advance(1);
        }
        panic!("bit {bit} not set: {:04X} at {}", self.status(), self.position());
    }

    fn act(&mut self, act: Act) {
        assert!(self.device.act(self.now, act), "{act:?}");
    }

    fn truth(&mut self) -> GroundTruth {
        self.device.ground_truth(self.now)
    }

    /// Turns a second of the motor.
    fn turns(&mut self) -> f64 {
        self.truth().velocity / TAU
    }

    fn is_at(&mut self, position: i64) {
        let found = self.position();
        assert!((found - position).abs() <= 10, "at {found}, not {position}");
    }
}
