//! The logs that are decoded, written line by line.

use std::fmt::Write as _;

/// A log of each kind of traffic that hosts and drives have.
#[derive(Clone, Copy, Debug)]
pub struct LogKind {
    /// Name in outputs and on the command line.
    pub name: &'static str,
    /// The protocol, as it is stated to a decoder.
    pub protocol: &'static str,
    write: fn(&mut Log, u64),
    /// Frames that come once at the head.
    head: fn(&mut Log),
}

/// All kinds.
pub const KINDS: [LogKind; 6] = [
    LogKind { name: "mapped", protocol: "canopen", write: Log::process_cycle, head: Log::map_all },
    LogKind { name: "unmapped", protocol: "canopen", write: Log::process_cycle, head: no_head },
    LogKind { name: "sdo", protocol: "canopen", write: Log::sdo_cycle, head: no_head },
    LogKind { name: "thruster", protocol: "thruster", write: Log::thruster_cycle, head: no_head },
    LogKind { name: "tmcl", protocol: "tmcl", write: Log::tmcl_cycle, head: no_head },
    LogKind { name: "modbus", protocol: "modbus-rtu", write: Log::modbus_cycle, head: no_head },
];

impl LogKind {
    /// A log of that many frames, nearly.
    pub fn log(self, frames: usize) -> String {
        let mut log = Log {
            text: String::new(),
            us: 1_700_000_000_000_000,
            frames: 0,
            seed: 88_172_645_463_325_252,
        };
        (self.head)(&mut log);
        let mut cycle = 0;
        while log.frames < frames {
            (self.write)(&mut log, cycle);
            cycle += 1;
        }
        log.text
    }
}

fn no_head(_: &mut Log) {}

struct Log {
    text: String,
    us: u64,
    frames: usize,
    seed: u64,
}

impl Log {
    fn random(&mut self) -> u64 {
        self.seed ^= self.seed << 13;
        self.seed ^= self.seed >> 7;
        self.seed ^= self.seed << 17;
        self.seed >> 16
    }

    fn begin_line(&mut self, link: &str) {
        let (seconds, us) = (self.us / 1_000_000, self.us % 1_000_000);
        let _ = write!(self.text, "({seconds:010}.{us:06}) {link} ");
    }

    fn end_line(&mut self) {
        self.text.push('\n');
        self.us += 115 + (self.random() & 15);
        self.frames += 1;
    }

    fn frame(&mut self, id: u32, data: &[u8]) {
        self.begin_line("can0");
        let _ = write!(self.text, "{id:03X}#");
        data.iter().for_each(|byte| _ = write!(self.text, "{byte:02X}"));
        self.end_line();
    }

    fn bytes(&mut self, arrow: char, data: &[u8]) {
        self.begin_line("tty0");
        self.text.push(arrow);
        data.iter().for_each(|byte| _ = write!(self.text, " {byte:02X}"));
        self.end_line();
        self.us += 800;
    }

    fn write(&mut self, node: u32, index: u16, sub: u8, raw: u32, len: u8) {
        let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), raw.to_le_bytes());
        self.frame(0x600 + node, &[0x23 | (4 - len) << 2, low, high, sub, a, b, c, d]);
        self.frame(0x580 + node, &[0x60, low, high, sub, 0, 0, 0, 0]);
    }

    fn read(&mut self, node: u32, index: u16, raw: i32) {
        let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), raw.to_le_bytes());
        self.frame(0x600 + node, &[0x40, low, high, 0, 0, 0, 0, 0]);
        self.frame(0x580 + node, &[0x43, low, high, 0, a, b, c, d]);
    }

    fn map(&mut self, node: u32, index: u16, entries: &[u32]) {
        self.write(node, index, 0, 0, 1);
        for (sub, entry) in (1..).zip(entries) {
            self.write(node, index, sub, *entry, 4);
        }
        self.write(node, index, 0, entries.len() as u32, 1);
    }

    fn map_all(&mut self) {
        for node in 1..=16 {
            self.map(node, 0x1600, &[0x6040_0010, 0x607A_0020]);
            self.map(node, 0x1A00, &[0x6041_0010, 0x6064_0020, 0x60F4_0010]);
            self.map(node, 0x1A01, &[0x606C_0020, 0x6077_0010]);
        }
    }

    /// Sixteen CANopen drives at 1 kHz: SYNC, RPDO1, TPDO1 and TPDO2, heartbeats and reads of objects between.
    fn process_cycle(&mut self, cycle: u64) {
        self.frame(0x80, &[]);
        for node in 1..=16 {
            let position = (self.random() % 100_000) as u32;
            let [a, b, c, d] = position.to_le_bytes();
            self.frame(0x200 + node, &[0x0F, 0, a, b, c, d]);
            let error = self.random() as u8;
            self.frame(0x180 + node, &[0x37, 0x16, a, b, c, d, error, 0]);
            let [e, f, ..] = (self.random() as u32).to_le_bytes();
            self.frame(0x280 + node, &[e, f, 0, 0, f, 0]);
        }
        if cycle % 100 < 16 {
            self.frame(0x701 + (cycle % 100) as u32, &[5]);
        }
        self.read(1 + (cycle % 16) as u32, 0x6064, 0x0403_0201);
    }

    /// A host that asks sixteen drives for position, velocity and torque.
    fn sdo_cycle(&mut self, _: u64) {
        for node in 1..=16 {
            let values = [self.random() % 100_000, self.random() % 3_000, self.random() % 400];
            for (index, value) in [0x6064, 0x606C, 0x6077].into_iter().zip(values) {
                self.read(node, index, value as i32 - 200);
            }
        }
    }

    /// Four thrusters that are asked for speed, faults, current and voltage.
    fn thruster_cycle(&mut self, _: u64) {
        for node in 1..=4 {
            let values = [self.random() % 3_000, 0, self.random() % 250, 470 + self.random() % 20];
            for (word, value) in [b"QV", b"EF", b"QC", b"QP"].into_iter().zip(values) {
                self.frame(0x300 + node, &[word[0], word[1], 0, 0]);
                let [a, b, c, d] = (value as u32).to_be_bytes();
                self.frame(0x280 + node, &[word[0], word[1], 0, 0, a, b, c, d]);
            }
        }
    }

    /// A module that is asked for the position and the speed of its motor.
    fn tmcl_cycle(&mut self, _: u64) {
        let values = [self.random() % 2_000_000, self.random() % 4_000];
        for (kind, value) in [1, 3].into_iter().zip(values) {
            let [a, b, c, d] = (value as i32 - 1000).to_be_bytes();
            self.bytes('>', &summed([1, 6, kind, 0, 0, 0, 0, 0]));
            self.bytes('<', &summed([2, 1, 100, 6, a, b, c, d]));
        }
    }

    /// A TS drive that is asked for its position, in two registers.
    fn modbus_cycle(&mut self, _: u64) {
        let [a, b, c, d] = ((self.random() % 2_000_000) as i32 - 1000).to_be_bytes();
        self.bytes('>', &checked(&[1, 3, 0x10, 0x2E, 0, 2]));
        self.bytes('<', &checked(&[1, 3, 4, c, d, a, b]));
    }
}

/// Nine bytes of TMCL: the last is the sum of the others.
fn summed(body: [u8; 8]) -> [u8; 9] {
    let mut bytes = [0; 9];
    bytes[..8].copy_from_slice(&body);
    bytes[8] = body.iter().fold(0, |sum, byte| sum + *byte as u16) as u8;
    bytes
}

/// A Modbus RTU frame: its CRC goes out low byte first.
fn checked(body: &[u8]) -> Vec<u8> {
    let mut crc = 0xFFFF_u16;
    for byte in body {
        crc ^= u16::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xA001 } else { crc >> 1 };
        }
    }
    [body, &crc.to_le_bytes()].concat()
}
