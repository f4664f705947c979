//! One node, asked frame by frame.

extern crate std;

use std::vec::Vec;

use super::*;
use crate::proto::canopen::od::{
    DefaultValue, ObjectAccess, ObjectEntry, PROTOCOL_TAG, ValueType, merge,
};
use crate::proto::canopen::sdo::{self, ExpeditedData, ObjectIndex, SdoReply, SdoRequest};

mod emergencies;
mod layer;
mod network;
mod process;
mod service;

/// A firmware with a few values and a file.
#[derive(Default)]
struct ToyFirmware {
    node: u8,
    kept_node: u8,
    bit_rate: u32,
    values: [u64; 8],
    file: Vec<u8>,
    syncs: u32,
    resets: u32,
    losses: u32,
    stored: Vec<SettingsGroup>,
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

const FIRST: [ObjectEntry; 2] = [
    ObjectEntry::new(0x1000, 0, ValueType::U32, ObjectAccess::RO, PROTOCOL_TAG, "device type")
        .with_default(0x1234_0192),
    ObjectEntry::new(0x1008, 0, ValueType::TEXT, ObjectAccess::RO, PROTOCOL_TAG, "device name")
        .with_default_value(DefaultValue::Text(NAME)),
];
const NAME: &str = "a name of several segments";
const APPLICATION: [ObjectEntry; 9] = [
    ObjectEntry::new(0x2000, 0, ValueType::U8, ObjectAccess::RW.mappable(), U8_AT, "u8"),
    ObjectEntry::new(0x2001, 0, ValueType::I16, ObjectAccess::RW.mappable(), I16_AT, "i16"),
    ObjectEntry::new(0x2002, 0, ValueType::U32, ObjectAccess::RW.mappable(), U32_AT, "u32"),
    ObjectEntry::new(0x2003, 0, ValueType::I32, ObjectAccess::RW.mappable(), I32_AT, "i32"),
    ObjectEntry::new(0x2004, 0, ValueType::U64, ObjectAccess::RW.mappable(), U64_AT, "u64"),
    ObjectEntry::new(0x2005, 0, ValueType::I16, ObjectAccess::RW, LIMITED_AT, "limited")
        .with_limits(-5, 5),
    ObjectEntry::new(0x2006, 0, ValueType::DOMAIN, ObjectAccess::RW, FILE_AT, "file"),
    ObjectEntry::new(0x2007, 0, ValueType::U16, ObjectAccess::RO.mappable(), RO_AT, "read only"),
    ObjectEntry::new(0x2008, 0, ValueType::U8, ObjectAccess::WO, WO_AT, "written only"),
];
const COMMUNICATION_LEN: usize = standard_len(4, 0);
const COMMUNICATION: [ObjectEntry; COMMUNICATION_LEN] = standard_entries(
    4,
    &[],
    &[
        (0x1018, 1, DefaultValue::Number(0x11)),
        (0x1018, 2, DefaultValue::Number(0x22)),
        (0x1018, 3, DefaultValue::Number(0x33)),
        (0x1018, 4, DefaultValue::Number(0x44)),
        (0x1800, 2, DefaultValue::Number(254)),
    ],
);
const PROTOCOL_LEN: usize = COMMUNICATION_LEN + FIRST.len();
static ENTRIES: [ObjectEntry; PROTOCOL_LEN + APPLICATION.len()] =
    merge(&merge::<PROTOCOL_LEN>(&FIRST, &COMMUNICATION), &APPLICATION);
static PLACES: [u16; 1024] = Dictionary::hash_slots(&ENTRIES);
static DICTIONARY: Dictionary = Dictionary::new(&ENTRIES, &PLACES);

impl NodeIdentity for ToyFirmware {
    fn node_id(&self) -> u8 {
        self.node
    }

    fn bit_rate(&self) -> u32 {
        self.bit_rate
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
}

impl DomainObjects for ToyFirmware {
    fn length(&mut self, _tag: u16) -> u32 {
        self.file.len() as u32
    }

    fn read(&mut self, _tag: u16, offset: u32, out: &mut [u8]) {
        out.copy_from_slice(&self.file[offset as usize..][..out.len()]);
    }

    fn begin_write(&mut self, _tag: u16, size: Option<u32>) -> Result<(), AbortCode> {
        self.file.clear();
        if size > Some(4 << 20) { Err(AbortCode::MEMORY) } else { Ok(()) }
    }

    fn write(&mut self, _tag: u16, offset: u32, data: &[u8]) -> Result<(), AbortCode> {
        assert_eq!(offset as usize, self.file.len());
        self.file.extend_from_slice(data);
        Ok(())
    }
}

impl NodeStorage for ToyFirmware {
    fn store(&mut self, group: SettingsGroup) {
        self.stored.push(group);
    }
}

impl NodeClock for ToyFirmware {
    fn set_time_of_day(&mut self, _now: Instant, time: TimeOfDay) {
        self.time = time;
    }

    fn time_of_day(&mut self, _now: Instant) -> Option<TimeOfDay> {
        Some(self.time)
    }
}

impl Firmware for ToyFirmware {
    fn dictionary(&self) -> &'static Dictionary {
        &DICTIONARY
    }

    fn get(&mut self, tag: u16) -> u64 {
        self.values[usize::from(tag)]
    }

    fn set(&mut self, _now: Instant, tag: u16, value: u64) -> Result<(), AbortCode> {
        self.values[usize::from(tag)] = value;
        Ok(())
    }

    fn handle_sync(&mut self, _now: Instant) {
        self.syncs += 1;
    }

    fn reset(&mut self, _now: Instant) {
        self.resets += 1;
        self.values = [0; 8];
    }

    fn handle_link_loss(&mut self, _now: Instant) {
        self.losses += 1;
    }

    fn error_register(&self) -> u8 {
        self.register
    }

    fn poll_emergency(&mut self) -> Option<Emergency> {
        self.emergencies.pop()
    }
}

/// A node in a test.
struct NodeFixture {
    toy: ToyFirmware,
    end: CanEndpoint,
    now: Instant,
}

impl NodeFixture {
    fn new() -> Self {
        Self::with(Quirks::STRICT)
    }

    fn with(options: Quirks) -> Self {
        let mut fixture = Self::at(5, options);
        assert_eq!(fixture.sent(), [frame(0x705, &[0])], "boot-up");
        fixture
    }

    fn at(node: u8, options: Quirks) -> Self {
        let mut toy = ToyFirmware { node, bit_rate: 500_000, ..ToyFirmware::default() };
        let end = CanEndpoint::new(options, &mut toy);
        Self { toy, end, now: Instant(1_000_000_000) }
    }

    fn operational() -> Self {
        let mut fixture = Self::new();
        fixture.receive(frame(0, &[1, 5]));
        fixture.sent();
        fixture
    }

    fn receive(&mut self, frame: Frame) {
        self.end.handle_input(self.now, &frame, &mut self.toy);
    }

    /// Everything that it sends now.
    fn sent(&mut self) -> Vec<Frame> {
        let next = |fixture: &mut Self| {
            let mut out = Frame::default();
            fixture.end.poll_transmit(fixture.now, &mut out, &mut fixture.toy).map(|_| out)
        };
        core::iter::from_fn(|| next(self)).collect()
    }

    /// Frames that it sends for one frame.
    fn answers(&mut self, frame: Frame) -> Vec<Frame> {
        self.receive(frame);
        self.sent()
    }

    fn advance_us(&mut self, us: u64) -> Vec<Frame> {
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

    fn advance(&mut self, ms: u64) -> Vec<Frame> {
        self.advance_us(ms * 1000)
    }

    fn request(&mut self, request: SdoRequest) -> SdoReply {
        let answers = self.answers(request.emit(5));
        assert_eq!(answers.len(), 1, "{request:?}: {answers:?}");
        assert_eq!(answers[0].id, 0x585);
        SdoReply::of(answers[0].data)
    }

    fn write(&mut self, index: u16, sub: u8, value: u32, len: u8) -> Result<(), AbortCode> {
        let object = ObjectIndex::new(index, sub);
        match self.request(SdoRequest::Write(object, ExpeditedData { bits: value, len })) {
            SdoReply::Written(of, 0) if of == object => Ok(()),
            SdoReply::Abort(of, abort) if of == object => Err(abort),
            other => panic!("{other:?}"),
        }
    }

    fn read(&mut self, index: u16, sub: u8) -> Result<u32, AbortCode> {
        let object = ObjectIndex::new(index, sub);
        match self.request(SdoRequest::Read(object)) {
            SdoReply::Value(of, short) if of == object => Ok(short.bits),
            SdoReply::Abort(of, abort) if of == object => Err(abort),
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

/// Identifier of the n-th TPDO of [`NodeFixture::map`].
const fn tpdo(n: u16) -> u16 {
    0x400 + n
}
