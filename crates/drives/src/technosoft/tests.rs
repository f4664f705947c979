//! The family against its manuals, over the wire.

extern crate std;

use std::vec::Vec;

use super::{Device, Technosoft};
use crate::surroundings::{Act, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{STREAM_UNIT_MAX, Stream};
use polepair_core::proto::tml::online::OnlineMessage;
use polepair_core::proto::tml::serial::{self, ACK};
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message, low_first};
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;

mod contour;
mod garbage;
mod instructions;
mod motion;
mod notices;
mod points;
mod program;
mod protections;
mod relay;
mod setup;
mod sync;
mod wire;

const OPTIONS: DeviceOptions<'static> = DeviceOptions {
    address: None,
    wires: &["tml", "tmlcan"],
    standard: None,
    untimed: true,
    seed: 1,
    extra: &[],
};

const NOTHING: [u8; 0] = [];
/// Nothing that a test writes keeps the EEPROM busy for longer.
const EEPROM_MS_MAX: u32 = 100;

/// A drive in a test, its serial port connected.
struct DriveFixture {
    device: Device,
    now: Instant,
    /// Messages after acknowledgements, unasked.
    unsolicited: Vec<Message>,
}

impl DriveFixture {
    fn new() -> Self {
        Self::with(&[])
    }

    fn with(extra: &[(&str, &str)]) -> Self {
        Self::at(Some(255), extra)
    }

    fn at(address: Option<u32>, extra: &[(&str, &str)]) -> Self {
        let options = DeviceOptions { address, extra, ..OPTIONS };
        let device = Technosoft::create_device(Technosoft::profiles()[0], &options).unwrap();
        Self { device, now: Instant(1_000_000_000), unsolicited: Vec::new() }
    }

    /// With the line's own timing.
    fn timed() -> Self {
        let options = DeviceOptions { address: Some(255), untimed: false, ..OPTIONS };
        let device = Technosoft::create_device(Technosoft::profiles()[0], &options).unwrap();
        Self { device, now: Instant(1_000_000_000), unsolicited: Vec::new() }
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

    fn act(&mut self, act: Act) {
        assert!(self.device.act(self.now, act), "{act:?}");
    }

    /// Sends an instruction to the drive and expects its acknowledgement.
    fn send_instruction(&mut self, opcode: u16, words: &[u16]) {
        let answer = self.send(IdCode::axis(self.axis()), opcode, words);
        assert_eq!(answer.first(), Some(&ACK), "{opcode:04X} {words:04X?}");
        self.unsolicited.extend(messages(&answer[1..]));
    }

    fn send(&mut self, to: IdCode, opcode: u16, words: &[u16]) -> Vec<u8> {
        self.bytes(&frame(to, Instruction::new(opcode, words).unwrap()))
    }

    /// A 32-bit assignment to a short address.
    fn long(&mut self, address: u16, value: i32) {
        let opcode = 0x2400 | if address < 0x800 { 0 } else { 0x200 } | address & 0x1FF;
        self.send_instruction(opcode, &low_first(value.cast_unsigned()));
    }

    fn word(&mut self, address: u16, value: u16) {
        let opcode = 0x2000 | if address < 0x800 { 0 } else { 0x200 } | address & 0x1FF;
        self.send_instruction(opcode, &[value]);
    }

    fn fixed(&mut self, address: u16, value: f64) {
        self.long(address, (value * 65536.0) as i32);
    }

    /// GiveMeData of a word, as the host on RS-232 asks it.
    fn read(&mut self, address: u16) -> u16 {
        self.request(0xB004, address) as u16
    }

    fn read_long(&mut self, address: u16) -> i32 {
        self.request(0xB005, address).cast_signed()
    }

    fn read_fixed(&mut self, address: u16) -> f64 {
        f64::from(self.read_long(address)) / 65536.0
    }

    fn request(&mut self, opcode: u16, address: u16) -> u32 {
        let axis = self.axis();
        let host = IdCode::host_at(axis).word();
        let mut answer = self.send(IdCode::axis(axis), opcode, &[host, address]);
        // Its EEPROM may not be ready yet.
        for _ in 0..EEPROM_MS_MAX {
            if answer.len() > 1 {
                break;
            }
            self.wait(1);
            answer.extend(self.sent());
        }
        let messages = messages(&answer[1..]);
        match OnlineMessage::parse(&messages.last().expect("an answer").instruction) {
            Some(OnlineMessage::TakeData { value, .. }) => value,
            other => panic!("{other:?}"),
        }
    }

    fn axis(&self) -> u8 {
        self.device.drive.axis
    }

    /// ENDINIT and AXISON.
    fn axis_on(&mut self) {
        self.send_instruction(0x0020, &[]);
        self.send_instruction(0x0102, &[]);
        assert_eq!(self.read(0x090E), 0x8400);
    }

    fn mode_pp(&mut self) {
        self.send_instruction(0x5909, &[0xBFC1, 0x8701]);
    }

    fn update(&mut self) {
        self.send_instruction(0x0108, &[]);
    }

    /// A trapezoid to a position.
    fn move_to(&mut self, counts: i32) {
        self.long(0x029E, counts);
        self.mode_pp();
        self.send_instruction(0x5909, &[0xFFFF, 0x2000]);
        self.update();
    }
}

fn frame(to: IdCode, instruction: Instruction) -> Vec<u8> {
    let mut out = [0; serial::FRAME_MAX];
    let len = serial::encode(&Message { to, instruction }, &mut out);
    out[..len].to_vec()
}

/// The messages in what a drive sent.
fn messages(bytes: &[u8]) -> Vec<Message> {
    let mut deframer = serial::Deframer::new(serial::RecoveryPolicy::Drop);
    let mut found = Vec::new();
    for &byte in bytes {
        deframer.push(byte);
        if let Some(serial::SerialPiece::Message(message)) = deframer.next_piece() {
            found.push(message);
        }
    }
    found
}
