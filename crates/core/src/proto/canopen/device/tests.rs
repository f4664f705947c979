//! One node, asked frame by frame.

extern crate std;

use std::vec::Vec;

use super::*;
use crate::proto::canopen::od::{Access, Entry, OWN, Type, Worth, merge};
use crate::proto::canopen::sdo::{self, Object, Reply, Request, Short};

mod emergencies;
mod layer;
mod network;
mod process;
mod service;

/// A firmware with a few values and a file.
#[derive(Default)]
struct Toy {
    node: u8,
    kept_node: u8,
    bit_rate: u32,
    values: [u64; 8],
    file: Vec<u8>,
    syncs: u32,
    resets: u32,
    losses: u32,
    stored: Vec<Group>,
    time: TimeOfDay,
    emergencies: Vec<Emergency>,
    register: u8,
}

const U8_AT: u16 = 0;
const I16_AT: u16 = 1;
const U32_AT: u16 = 2;
const I32_AT: u16 = 3;
const U64_AT: u16 = 4;
const LIMITED_AT: u16 = 5;
const FILE_AT: u16 = 6;
const RO_AT: u16 = 7;
const WO_AT: u16 = 0;

const FIRST: [Entry; 2] = [
    Entry::new(0x1000, 0, Type::U32, Access::RO, OWN, "device type").worth(0x1234_0192),
    Entry::new(0x1008, 0, Type::TEXT, Access::RO, OWN, "device name").holding(Worth::Text(NAME)),
];
const NAME: &str = "a name of several segments";
const APPLICATION: [Entry; 9] = [
    Entry::new(0x2000, 0, Type::U8, Access::RW.mappable(), U8_AT, "u8"),
    Entry::new(0x2001, 0, Type::I16, Access::RW.mappable(), I16_AT, "i16"),
    Entry::new(0x2002, 0, Type::U32, Access::RW.mappable(), U32_AT, "u32"),
    Entry::new(0x2003, 0, Type::I32, Access::RW.mappable(), I32_AT, "i32"),
    Entry::new(0x2004, 0, Type::U64, Access::RW.mappable(), U64_AT, "u64"),
    Entry::new(0x2005, 0, Type::I16, Access::RW, LIMITED_AT, "limited").within(-5, 5),
    Entry::new(0x2006, 0, Type::DOMAIN, Access::RW, FILE_AT, "file"),
    Entry::new(0x2007, 0, Type::U16, Access::RO.mappable(), RO_AT, "read only"),
    Entry::new(0x2008, 0, Type::U8, Access::WO, WO_AT, "written only"),
];
const COMMUNICATION_LEN: usize = standard_len(4, 0);
const COMMUNICATION: [Entry; COMMUNICATION_LEN] = standard(
    4,
    &[],
    &[
        (0x1018, 1, Worth::Number(0x11)),
        (0x1018, 2, Worth::Number(0x22)),
        (0x1018, 3, Worth::Number(0x33)),
        (0x1018, 4, Worth::Number(0x44)),
        (0x1800, 2, Worth::Number(254)),
    ],
);
const PROTOCOL_LEN: usize = COMMUNICATION_LEN + FIRST.len();
static ENTRIES: [Entry; PROTOCOL_LEN + APPLICATION.len()] =
    merge(&merge::<PROTOCOL_LEN>(&FIRST, &COMMUNICATION), &APPLICATION);
static PLACES: [u16; 1024] = Dictionary::places(&ENTRIES);
static DICTIONARY: Dictionary = Dictionary::new(&ENTRIES, &PLACES);

impl Firmware for Toy {
    fn dictionary(&self) -> &'static Dictionary {
        &DICTIONARY
    }
    fn node_id(&self) -> u8 {
        self.node
    }
    fn bit_rate(&self) -> u32 {
        self.bit_rate
    }
    fn get(&mut self, tag: u16) -> u64 {
        self.values[usize::from(tag)]
    }
    fn set(&mut self, _now: Instant, tag: u16, value: u64) -> Result<(), Abort> {
        self.values[usize::from(tag)] = value;
        Ok(())
    }
    fn length(&mut self, _tag: u16) -> u32 {
        self.file.len() as u32
    }
    fn read(&mut self, _tag: u16, offset: u32, out: &mut [u8]) {
        out.copy_from_slice(&self.file[offset as usize..][..out.len()]);
    }
    fn begin(&mut self, _tag: u16, size: Option<u32>) -> Result<(), Abort> {
        self.file.clear();
        if size > Some(4 << 20) { Err(Abort::MEMORY) } else { Ok(()) }
    }
    fn write(&mut self, _tag: u16, offset: u32, data: &[u8]) -> Result<(), Abort> {
        assert_eq!(offset as usize, self.file.len());
        self.file.extend_from_slice(data);
        Ok(())
    }
    fn synced(&mut self, _now: Instant) {
        self.syncs += 1;
    }
    fn reset(&mut self, _now: Instant) {
        self.resets += 1;
        self.values = [0; 8];
    }
    fn lost(&mut self, _now: Instant) {
        self.losses += 1;
    }
    fn error_register(&self) -> u8 {
        self.register
    }
    fn poll_emergency(&mut self) -> Option<Emergency> {
        self.emergencies.pop()
    }
    fn store(&mut self, group: Group) {
        self.stored.push(group);
    }
    fn set_node_id(&mut self, node: u8) {
        self.node = node;
    }
    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        self.bit_rate = bit_rate;
        true
    }
    fn store_link(&mut self) -> bool {
        self.kept_node = self.node;
        true
    }
    fn clock(&mut self, _now: Instant, time: TimeOfDay) {
        self.time = time;
    }
    fn time_of_day(&mut self, _now: Instant) -> Option<TimeOfDay> {
        Some(self.time)
    }
}

/// A node on a test's desk.
struct Desk {
    toy: Toy,
    end: CanEnd,
    now: Instant,
}

impl Desk {
    fn new() -> Self {
        Self::with(Options::STRICT)
    }

    fn with(options: Options) -> Self {
        let mut desk = Self::at(5, options);
        assert_eq!(desk.sent(), [frame(0x705, &[0])], "boot-up");
        desk
    }

    fn at(node: u8, options: Options) -> Self {
        let mut toy = Toy { node, bit_rate: 500_000, ..Toy::default() };
        let end = CanEnd::new(options, &mut toy);
        Self { toy, end, now: Instant(1_000_000_000) }
    }

    fn operational() -> Self {
        let mut desk = Self::new();
        desk.hear(frame(0, &[1, 5]));
        desk.sent();
        desk
    }

    fn hear(&mut self, frame: Frame) {
        self.end.handle_input(self.now, &frame, &mut self.toy);
    }

    /// Everything that it sends now.
    fn sent(&mut self) -> Vec<Frame> {
        let next = |desk: &mut Self| {
            let mut out = Frame::default();
            desk.end.poll_transmit(desk.now, &mut out, &mut desk.toy).map(|_| out)
        };
        core::iter::from_fn(|| next(self)).collect()
    }

    /// What it sends to one frame.
    fn answers(&mut self, frame: Frame) -> Vec<Frame> {
        self.hear(frame);
        self.sent()
    }

    fn pass_us(&mut self, us: u64) -> Vec<Frame> {
        let end = self.now.plus_ns(us * 1000);
        let mut all = Vec::new();
        while let Some(due) = self.end.poll_timeout().filter(|due| *due <= end) {
            self.now = self.now.max(due);
            self.end.handle_timeout(self.now, &mut self.toy);
            all.extend(self.sent());
        }
        self.now = end;
        self.end.handle_timeout(self.now, &mut self.toy);
        all.extend(self.sent());
        all
    }

    fn pass(&mut self, ms: u64) -> Vec<Frame> {
        self.pass_us(ms * 1000)
    }

    fn ask(&mut self, request: Request) -> Reply {
        let answers = self.answers(request.emit(5));
        assert_eq!(answers.len(), 1, "{request:?}: {answers:?}");
        assert_eq!(answers[0].id, 0x585);
        Reply::of(answers[0].data)
    }

    fn write(&mut self, index: u16, sub: u8, value: u32, len: u8) -> Result<(), Abort> {
        let object = Object::new(index, sub);
        match self.ask(Request::Write(object, Short { bits: value, len })) {
            Reply::Written(of, 0) if of == object => Ok(()),
            Reply::Abort(of, abort) if of == object => Err(abort),
            other => panic!("{other:?}"),
        }
    }

    fn read(&mut self, index: u16, sub: u8) -> Result<u32, Abort> {
        let object = Object::new(index, sub);
        match self.ask(Request::Read(object)) {
            Reply::Value(of, short) if of == object => Ok(short.bits),
            Reply::Abort(of, abort) if of == object => Err(abort),
            other => panic!("{other:?}"),
        }
    }

    /// Maps objects into a PDO as the standard wants it, and gives it its transmission type.
    fn map(&mut self, pdo: u16, kind: u8, objects: &[u32]) {
        let communication = 0x1400 + pdo;
        let cob = self.read(communication, 1).unwrap();
        self.write(communication, 1, cob | 1 << 31, 4).unwrap();
        self.write(communication, 2, kind.into(), 1).unwrap();
        self.write(communication + 0x200, 0, 0, 1).unwrap();
        for (n, object) in objects.iter().enumerate() {
            self.write(communication + 0x200, n as u8 + 1, *object, 4).unwrap();
        }
        self.write(communication + 0x200, 0, objects.len() as u32, 1).unwrap();
        self.write(communication, 1, cob & !(1 << 31), 4).unwrap();
        self.sent();
    }
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::standard(id, data)
}

fn remote(id: u16) -> Frame {
    Frame { id: id.into(), remote: true, ..Frame::default() }
}

/// As [`Desk::map`]'s PDO: the n-th that is sent.
const fn tpdo(n: u16) -> u16 {
    0x400 + n
}
