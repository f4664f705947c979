//! The family against its manual, register by register over the wire.

extern crate std;

use std::vec::Vec;

use super::SyntronTs;
use super::registers::fn_registers;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{STREAM_UNIT_MAX, Stream};
use polepair_core::proto::modbus::{ascii, rtu};
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;

mod alarms;
mod axis;
mod canopen;
mod homing;
mod panel;
mod paths;
mod plans;
mod speed;
mod wire;

type Device = <SyntronTs as Family>::Device;

const OPTIONS: DeviceOptions<'static> = DeviceOptions {
    address: None,
    wires: &["modbus-rtu"],
    standard: None,
    untimed: true,
    seed: 1,
    extra: &[],
};

/// A drive in a test.
struct DriveFixture {
    device: Device,
    now: Instant,
    unit: u8,
    ascii: bool,
}

impl DriveFixture {
    fn new() -> Self {
        Self::with(&[])
    }

    fn with(extra: &[(&str, &str)]) -> Self {
        let options = DeviceOptions { extra, ..OPTIONS };
        let device = SyntronTs::create_device(SyntronTs::profiles()[0], &options).unwrap();
        Self { device, now: Instant(1_000_000_000), unit: 1, ascii: false }
    }

    /// Sends a PDU and returns the answer's.
    fn request(&mut self, pdu: &[u8]) -> Option<Vec<u8>> {
        let mut frame = [0; STREAM_UNIT_MAX];
        let put = |out: &mut [u8]| {
            out[..pdu.len()].copy_from_slice(pdu);
            pdu.len()
        };
        let emit = if self.ascii {
            ascii::emit(self.unit, &mut frame, put)
        } else {
            rtu::emit(self.unit, &mut frame, put)
        };
        Station::<Stream>::handle_input(&mut self.device, self.now, &frame[..emit]);
        let reply = self.reply()?;
        if self.ascii {
            let bytes: Vec<u8> = reply[1..reply.len() - 2]
                .chunks(2)
                .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
                .collect();
            assert_eq!(ascii::lrc(&bytes[..bytes.len() - 1]), bytes[bytes.len() - 1]);
            return Some(bytes[1..bytes.len() - 1].to_vec());
        }
        let (unit, pdu) = rtu::decode(&reply).unwrap();
        assert_eq!(unit, self.unit);
        Some(pdu.to_vec())
    }

    /// Bytes that the drive sends within 50 ms.
    fn reply(&mut self) -> Option<Vec<u8>> {
        let mut out = [0; STREAM_UNIT_MAX];
        for _ in 0..50 {
            if let Some(len) =
                Station::<Stream>::poll_transmit(&mut self.device, self.now, &mut out)
            {
                return Some(out[..len].to_vec());
            }
            self.advance(1);
        }
        None
    }

    /// Writes a register; the exception code if it is refused.
    fn try_write(&mut self, number: u16, value: u16) -> Result<(), u8> {
        let ([a, b], [c, d]) = (number.to_be_bytes(), value.to_be_bytes());
        let request = [6, a, b, c, d];
        let reply = self.request(&request).unwrap();
        if reply == request { Ok(()) } else { Err(reply[1]) }
    }

    fn write(&mut self, number: u16, value: u16) {
        self.try_write(number, value).unwrap();
    }

    fn read(&mut self, address: u16) -> u16 {
        let [a, b] = address.to_be_bytes();
        let reply = self.request(&[3, a, b, 0, 1]).unwrap();
        assert_eq!(reply[..2], [3, 2], "{reply:X?}");
        u16::from_be_bytes([reply[2], reply[3]])
    }

    /// Encoder counts, from Dn_2E and Dn_2F.
    fn counts(&mut self) -> i32 {
        let reply = self.request(&[3, 0x10, 0x2E, 0, 2]).unwrap();
        i32::from_be_bytes([reply[4], reply[5], reply[2], reply[3]])
    }

    fn rpm(&mut self) -> i16 {
        self.read(0x1000) as i16
    }

    fn alarm(&mut self) -> u16 {
        self.read(0x1012)
    }

    fn busy(&mut self) -> bool {
        self.read(0x101C) == 1
    }

    fn advance(&mut self, ms: u32) {
        self.now = self.now.plus_ms(ms);
        self.device.handle_timeout(self.now);
    }

    /// Waits until no path and no homing runs.
    fn settle(&mut self, within_ms: u32) {
        for _ in 0..within_ms / 10 {
            if !self.busy() {
                // Friction lets go of the last counts slowly.
                self.advance(800);
                return;
            }
            self.advance(10);
        }
        panic!("still busy after {within_ms} ms, alarm {:04X}", self.alarm());
    }

    fn act(&mut self, act: Act) {
        assert!(self.device.act(self.now, act), "{act:?}");
    }

    fn truth(&mut self) -> GroundTruth {
        self.device.ground_truth(self.now)
    }

    fn shown(&mut self) -> std::string::String {
        let mut out = [0; 6];
        let len = self.device.panel_text(self.now, &mut out).unwrap();
        std::string::String::from_utf8(out[..len].to_vec()).unwrap()
    }

    /// A drive in internal position mode, powered, writes kept in RAM.
    fn positioning(extra: &[(&str, &str)]) -> Self {
        let mut fixture = Self::with(extra);
        fixture.write(fn_registers::MODE, 14);
        fixture.write(fn_registers::RAM_ONLY, 1);
        fixture.write(fn_registers::TRIGGER_SOURCE, 1);
        fixture.write(fn_registers::ENABLE, 1);
        fixture
    }

    /// Fills a path: definition 1, thousandths, rpm, Ta, Td, delay, definition 2.
    fn fill(&mut self, number: u16, first: u16, thousandths: i32, rpm: u16, rest: [u16; 4]) {
        let [ta, td, delay, second] = rest;
        let words = [
            first,
            (thousandths / 10_000) as i16 as u16,
            (thousandths % 10_000) as i16 as u16,
            rpm,
            ta,
            td,
            delay,
            second,
        ];
        let [a, b] = (fn_registers::PATHS + 8 * (number - 1)).to_be_bytes();
        let mut pdu = std::vec![16, a, b, 0, 8, 16];
        pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        assert_eq!(self.request(&pdu).unwrap(), [16, a, b, 0, 8]);
    }

    fn trigger(&mut self, number: u16) {
        self.write(fn_registers::PATH_NUMBER, number);
        self.write(fn_registers::PATH_TRIGGER, 1);
        self.write(fn_registers::PATH_TRIGGER, 0);
    }

    /// Asserts the position, to a few encoder counts.
    fn is_at(&mut self, counts: i32) {
        let found = self.counts();
        assert!((found - counts).abs() <= 5, "at {found}, not {counts}");
    }
}
