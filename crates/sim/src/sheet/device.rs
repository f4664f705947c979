//! The device: the node's end of the bus, its cells, and the drive where there is one.

use super::{CELLS, Holds, PDOS_MAX, Sheet};
use polepair_core::drives;
use polepair_core::drives::bench::{Act, Bench, Truth};
use polepair_core::drives::cia402::drive::Drive;
use polepair_core::drives::cia402::objects::kept;
use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::proto::canopen::device::{CanEnd, Firmware, Group, Options};
use polepair_core::proto::canopen::emcy::Emergency;
use polepair_core::proto::canopen::nmt::State;
use polepair_core::proto::canopen::od::Dictionary;
use polepair_core::proto::canopen::sdo::Abort;
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};
use std::sync::Arc;

/// Bytes that one object takes at most.
const BYTES_MAX: u32 = 4 << 20;
/// Bytes that all objects of a device hold at most.
const ALL_BYTES_MAX: usize = 32 << 20;
/// Bit rate from the factory, bit/s.
const BIT_RATE: u32 = 500_000;
/// The only bit of 1001h that every device has: something is wrong.
const GENERIC_ERROR: u8 = 1;

/// A simulated device of a [`Sheet`].
#[derive(Debug)]
pub struct Device {
    end: CanEnd<PDOS_MAX>,
    node: Node,
}

impl Device {
    /// That device, just powered. A node-ID outside 1 to 127 waits for LSS.
    #[must_use]
    pub fn new(sheet: Arc<Sheet>, node: u8, serial: u32) -> Self {
        let options = Options { lss: sheet.has_lss, ..Options::STRICT };
        let mut node = Node::new(sheet, node, serial);
        Self { end: CanEnd::new(options, &mut node), node }
    }
}

/// Everything but the protocol.
#[derive(Debug)]
struct Node {
    sheet: Arc<Sheet>,
    drive: Option<Drive>,
    values: Vec<Value>,
    stored: Vec<Value>,
    /// What is being written, and where.
    written: Vec<u8>,
    /// A fault of a device without motor, and the one that was told.
    fault: u16,
    told: u16,
    /// In force from the next reset on, and over power-off: node-ID and bit rate.
    link: (u8, u32),
    stored_link: (u8, u32),
    serial: u32,
    flash_writes: u64,
}

/// What a cell holds.
#[derive(Clone, Debug)]
enum Value {
    Number(u64),
    Bytes(Vec<u8>),
}

impl Value {
    fn of(holds: &Holds, node: u8) -> Self {
        match holds {
            Holds::Nothing => Self::Number(0),
            Holds::Number(number) => Self::Number(number.cast_unsigned()),
            Holds::PlusNode(number) => {
                Self::Number(number.wrapping_add(node.into()).cast_unsigned())
            }
            Holds::Bytes(bytes) => Self::Bytes(bytes.clone()),
        }
    }

    fn bytes(&self) -> &[u8] {
        match self {
            Self::Number(_) => &[],
            Self::Bytes(bytes) => bytes,
        }
    }
}

/// Whether storing that group stores an object.
const fn is_of(index: u16, group: Group) -> bool {
    match group {
        Group::All => true,
        Group::Communication => matches!(index, 0x1000..=0x1FFF),
        Group::Application => matches!(index, 0x6000..=0x9FFF),
    }
}

impl Node {
    fn new(sheet: Arc<Sheet>, node: u8, serial: u32) -> Self {
        let values: Vec<Value> =
            sheet.cells.iter().map(|cell| Value::of(&cell.holds, node)).collect();
        let drive = sheet.drive.clone();
        let drive = drive.map(|objects| Drive::new(node, serial, BIT_RATE).with(objects));
        Self {
            drive,
            stored: values.clone(),
            values,
            written: Vec::new(),
            fault: 0,
            told: 0,
            link: (node, BIT_RATE),
            stored_link: (node, BIT_RATE),
            serial,
            flash_writes: 0,
            sheet,
        }
    }

    fn advance(&mut self, now: Instant) {
        if let Some(drive) = &mut self.drive {
            drive.advance(now);
        }
    }

    fn start_anew(&mut self) {
        self.values.clone_from(&self.stored);
        (self.fault, self.told) = (0, 0);
    }

    fn power_cycle(&mut self) {
        self.start_anew();
        self.link = self.stored_link;
        if let Some(drive) = &mut self.drive {
            drive.power_cycle();
        }
    }

    fn cell(&mut self, tag: u16) -> Option<&mut Value> {
        self.values.get_mut(usize::from(tag.checked_sub(CELLS)?))
    }

    /// Whether the sheet says that the drive knows a mode.
    fn has_mode(&self, mode: i8) -> bool {
        let bit = u32::try_from(mode).ok().filter(|mode| (1..=32).contains(mode));
        let modes = self.sheet.modes;
        modes == 0 || mode == 0 || bit.is_some_and(|mode| modes >> (mode - 1) & 1 != 0)
    }
}

impl Firmware for Node {
    fn dictionary(&self) -> &'static Dictionary {
        self.sheet.dictionary
    }

    fn node_id(&self) -> u8 {
        self.link.0
    }

    fn bit_rate(&self) -> u32 {
        self.link.1
    }

    fn serial(&self) -> u32 {
        self.serial
    }

    fn get(&mut self, tag: u16) -> u64 {
        match self.cell(tag) {
            Some(Value::Number(value)) => *value,
            Some(Value::Bytes(_)) => 0,
            None => self.drive.as_mut().map_or(0, |drive| drive.get(tag)),
        }
    }

    fn set(&mut self, now: Instant, tag: u16, value: u64) -> Result<(), Abort> {
        if let Some(cell) = self.cell(tag) {
            *cell = Value::Number(value);
            return Ok(());
        }
        if tag == kept::MODE && !self.has_mode(value as i8) {
            return Err(Abort::VALUE);
        }
        self.drive.as_mut().map_or(Err(Abort::STATE), |drive| drive.set(now, tag, value))
    }

    fn length(&mut self, tag: u16) -> u32 {
        self.cell(tag).map_or(0, |cell| cell.bytes().len() as u32)
    }

    fn read(&mut self, tag: u16, offset: u32, out: &mut [u8]) {
        let Some(cell) = self.cell(tag) else { return };
        let rest = cell.bytes().get(offset as usize..).unwrap_or_default();
        out.iter_mut().zip(rest).for_each(|(place, byte)| *place = *byte);
    }

    fn begin(&mut self, _tag: u16, size: Option<u32>) -> Result<(), Abort> {
        self.written.clear();
        let held: usize = self.values.iter().map(|value| value.bytes().len()).sum();
        let room = BYTES_MAX as usize <= ALL_BYTES_MAX.saturating_sub(held);
        let fits = size.is_none_or(|size| size <= BYTES_MAX) && room;
        if fits { Ok(()) } else { Err(Abort::MEMORY) }
    }

    fn write(&mut self, _tag: u16, offset: u32, data: &[u8]) -> Result<(), Abort> {
        let end = (offset as usize).saturating_add(data.len());
        if end > BYTES_MAX as usize {
            return Err(Abort::MEMORY);
        }
        self.written.truncate(offset as usize);
        self.written.extend_from_slice(data);
        Ok(())
    }

    fn finish(&mut self, _now: Instant, tag: u16, _size: u32) -> Result<(), Abort> {
        let written = std::mem::take(&mut self.written);
        if let Some(cell) = self.cell(tag) {
            *cell = Value::Bytes(written);
        }
        Ok(())
    }

    fn synced(&mut self, now: Instant) {
        if let Some(drive) = &mut self.drive {
            drive.synced(now);
        }
    }

    fn entered(&mut self, now: Instant, state: State) {
        if let Some(drive) = &mut self.drive {
            drive.entered(now, state);
        }
    }

    fn reset(&mut self, now: Instant) {
        self.start_anew();
        if let Some(drive) = &mut self.drive {
            drive.reset(now);
        }
    }

    fn lost(&mut self, now: Instant) {
        if let Some(drive) = &mut self.drive {
            drive.lost(now);
        }
    }

    fn error_register(&self) -> u8 {
        let own = if self.fault == 0 { 0 } else { GENERIC_ERROR };
        self.drive.as_ref().map_or(own, Drive::error_register)
    }

    fn poll_emergency(&mut self) -> Option<Emergency> {
        if let Some(drive) = &mut self.drive {
            return drive.poll_emergency();
        }
        let news = self.told != self.fault;
        self.told = self.fault;
        news.then(|| Emergency { code: self.fault, ..Emergency::default() })
    }

    fn store(&mut self, group: Group) {
        self.flash_writes += 1;
        for ((cell, value), stored) in
            self.sheet.cells.iter().zip(&self.values).zip(&mut self.stored)
        {
            if is_of(cell.index, group) {
                stored.clone_from(value);
            }
        }
        if let Some(drive) = &mut self.drive {
            drive.store(group);
        }
    }

    fn restore(&mut self, group: Group) {
        self.flash_writes += 1;
        for (cell, stored) in self.sheet.cells.iter().zip(&mut self.stored) {
            if is_of(cell.index, group) {
                *stored = Value::of(&cell.holds, self.link.0);
            }
        }
        if let (Some(drive), Some(objects)) = (&mut self.drive, &self.sheet.drive) {
            drive.keep(objects.clone());
        }
    }

    fn set_node_id(&mut self, node: u8) {
        self.link.0 = node;
    }

    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        self.link.1 = bit_rate;
        true
    }

    fn store_link(&mut self) -> bool {
        self.flash_writes += 1;
        self.stored_link = self.link;
        true
    }
}

impl Timed for Device {
    fn handle_timeout(&mut self, now: Instant) {
        self.node.advance(now);
        self.end.handle_timeout(now, &mut self.node);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.end.poll_timeout(), self.node.drive.as_ref().and_then(Drive::due))
    }
}

impl drives::Device for Device {
    fn can(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Station<Can> for Device {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.node.advance(now);
        self.end.handle_input(now, unit, &mut self.node);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.node.advance(now);
        self.end.handle_line(now, event, &mut self.node);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        self.end.poll_transmit(now, out, &mut self.node)
    }

    fn line(&self) -> CanLine {
        self.end.line()
    }
}

impl Bench for Device {
    fn truth(&mut self, now: Instant) -> Truth {
        let flash_writes = self.node.flash_writes;
        match &mut self.node.drive {
            Some(drive) => Truth { flash_writes, ..drive.truth(now) },
            None => Truth { fault: self.node.fault.into(), flash_writes, ..Truth::default() },
        }
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        match (act, &mut self.node.drive) {
            (Act::PowerCycle, _) => {
                self.node.advance(now);
                self.node.power_cycle();
                self.end.power_cycle(now, &mut self.node);
                true
            }
            (act, Some(drive)) => drive.act(now, act),
            (Act::Fault(code), None) => {
                let code = u16::try_from(code);
                self.node.fault = code.unwrap_or(self.node.fault);
                code.is_ok()
            }
            _ => false,
        }
    }

    fn notice(&mut self) -> Option<&'static str> {
        self.node.drive.as_mut().and_then(Drive::take_notice)
    }
}
