//! The device: its end of the bus, its objects, and the drive, if any.

use super::{AXIS_TAGS, DataSheet, FactoryValue, PDOS_MAX, STORED_TAG_FIRST};
use polepair_core::convert::tail;
use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::proto::canopen::device::{
    CanEndpoint, DomainObjects, Firmware, NodeClock, NodeIdentity, NodeStorage, Quirks,
    SettingsGroup,
};
use polepair_core::proto::canopen::emcy::Emergency;
use polepair_core::proto::canopen::nmt::NmtState;
use polepair_core::proto::canopen::od::Dictionary;
use polepair_core::proto::canopen::sdo::AbortCode;
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};
use polepair_drives::cia402::drive::Drive;
use polepair_drives::cia402::objects::stored;
use polepair_drives::surroundings::{Act, GroundTruth, SurroundingsControl};
use std::sync::Arc;

/// Bytes that one object takes at most.
const BYTES_MAX: u32 = 4 << 20;
/// Bytes that all objects of a device hold at most.
const ALL_BYTES_MAX: usize = 32 << 20;
/// Bit rate from the factory, bit/s.
const BIT_RATE: u32 = 500_000;
/// The only bit of 1001h that every device has: something is wrong.
const GENERIC_ERROR: u8 = 1;

/// A simulated device of a [`DataSheet`].
#[derive(Debug)]
pub struct DataSheetDevice {
    end: CanEndpoint<PDOS_MAX>,
    node: DataSheetNode,
}

impl DataSheetDevice {
    /// The device of that sheet, just powered. A node-ID outside 1 to 127 waits for LSS.
    #[must_use]
    pub fn new(sheet: Arc<DataSheet>, node: u8, serial: u32) -> Self {
        let options = Quirks { lss: sheet.has_lss, ..Quirks::STRICT };
        let mut node = DataSheetNode::new(sheet, node, serial);
        Self { end: CanEndpoint::new(options, &mut node), node }
    }
}

/// Everything but the protocol.
#[derive(Debug)]
struct DataSheetNode {
    data_sheet: Arc<DataSheet>,
    /// One for each axis.
    drives: Vec<Drive>,
    values: Vec<ObjectValue>,
    stored: Vec<ObjectValue>,
    /// Bytes of the running write, and their object.
    write_buffer: Vec<u8>,
    /// Fault of a device without motor, and the last reported one.
    fault: u16,
    reported_fault: u16,
    /// Node-ID and bit rate from the next reset on; kept over power-off.
    link_settings: (u8, u32),
    stored_link_settings: (u8, u32),
    serial: u32,
    flash_writes: u64,
}

/// Value of a cell.
#[derive(Clone, Debug)]
enum ObjectValue {
    Number(u64),
    Bytes(Vec<u8>),
}

impl ObjectValue {
    fn from_factory(holds: &FactoryValue, node: u8) -> Self {
        match holds {
            FactoryValue::Unset => Self::Number(0),
            FactoryValue::Number(number) => Self::Number(number.cast_unsigned()),
            FactoryValue::PlusNodeId(number) => {
                Self::Number(number.wrapping_add(node.into()).cast_unsigned())
            }
            FactoryValue::Bytes(bytes) => Self::Bytes(bytes.clone()),
        }
    }

    fn bytes(&self) -> &[u8] {
        match self {
            Self::Number(_) => &[],
            Self::Bytes(bytes) => bytes,
        }
    }
}

/// Returns whether storing that group stores an object.
const fn is_in_group(index: u16, group: SettingsGroup) -> bool {
    match group {
        SettingsGroup::All => true,
        SettingsGroup::Communication => matches!(index, 0x1000..=0x1FFF),
        SettingsGroup::Application => matches!(index, 0x6000..=0x9FFF),
    }
}

impl DataSheetNode {
    fn new(data_sheet: Arc<DataSheet>, node: u8, serial: u32) -> Self {
        let values: Vec<ObjectValue> = data_sheet
            .stored_objects
            .iter()
            .map(|cell| ObjectValue::from_factory(&cell.default, node))
            .collect();
        Self {
            drives: data_sheet
                .axes
                .iter()
                .map(|axis| Drive::new(node, serial, BIT_RATE).with_objects(axis.objects.clone()))
                .collect(),
            stored: values.clone(),
            values,
            write_buffer: Vec::new(),
            fault: 0,
            reported_fault: 0,
            link_settings: (node, BIT_RATE),
            stored_link_settings: (node, BIT_RATE),
            serial,
            flash_writes: 0,
            data_sheet,
        }
    }

    fn advance(&mut self, now: Instant) {
        self.drives.iter_mut().for_each(|drive| drive.advance(now));
    }

    fn reload_values(&mut self) {
        self.values.clone_from(&self.stored);
        (self.fault, self.reported_fault) = (0, 0);
    }

    fn power_cycle(&mut self) {
        self.reload_values();
        self.link_settings = self.stored_link_settings;
        self.drives.iter_mut().for_each(Drive::power_cycle);
    }

    fn value_mut(&mut self, tag: u16) -> Option<&mut ObjectValue> {
        self.values.get_mut(usize::from(tag.checked_sub(STORED_TAG_FIRST)?))
    }

    /// The axis that a tag belongs to, and the tag of its drive.
    fn drive_mut(&mut self, tag: u16) -> Option<(&mut Drive, u16)> {
        let drive = self.drives.get_mut(usize::from(tag / AXIS_TAGS))?;
        Some((drive, tag % AXIS_TAGS))
    }

    /// Returns whether an axis supports a mode by the sheet.
    fn has_mode(&self, axis: u16, mode: i8) -> bool {
        let bit = u32::try_from(mode).ok().filter(|mode| (1..=32).contains(mode));
        let modes = self.data_sheet.axes.get(usize::from(axis)).map_or(0, |axis| axis.modes);
        modes == 0 || mode == 0 || bit.is_some_and(|mode| modes >> (mode - 1) & 1 != 0)
    }
}

impl NodeIdentity for DataSheetNode {
    fn node_id(&self) -> u8 {
        self.link_settings.0
    }

    fn bit_rate(&self) -> u32 {
        self.link_settings.1
    }

    fn serial(&self) -> u32 {
        self.serial
    }

    fn set_node_id(&mut self, node: u8) {
        self.link_settings.0 = node;
    }

    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        self.link_settings.1 = bit_rate;
        true
    }

    fn store_link(&mut self) -> bool {
        self.flash_writes += 1;
        self.stored_link_settings = self.link_settings;
        true
    }
}

impl DomainObjects for DataSheetNode {
    fn length(&mut self, tag: u16) -> u32 {
        self.value_mut(tag).map_or(0, |cell| cell.bytes().len() as u32)
    }

    fn read(&mut self, tag: u16, offset: u32, out: &mut [u8]) {
        let Some(cell) = self.value_mut(tag) else { return };
        let rest = tail(cell.bytes(), offset as usize);
        out.iter_mut().zip(rest).for_each(|(index, byte)| *index = *byte);
    }

    fn begin_write(&mut self, _tag: u16, size: Option<u32>) -> Result<(), AbortCode> {
        self.write_buffer.clear();
        let held: usize = self.values.iter().map(|value| value.bytes().len()).sum();
        let has_room = BYTES_MAX as usize <= ALL_BYTES_MAX.saturating_sub(held);
        let fits = size.is_none_or(|size| size <= BYTES_MAX) && has_room;
        if fits { Ok(()) } else { Err(AbortCode::MEMORY) }
    }

    fn write(&mut self, _tag: u16, offset: u32, data: &[u8]) -> Result<(), AbortCode> {
        let end = (offset as usize).saturating_add(data.len());
        if end > BYTES_MAX as usize {
            return Err(AbortCode::MEMORY);
        }
        // A block that is sent again begins where it began before.
        self.write_buffer.truncate(offset as usize);
        self.write_buffer.extend_from_slice(data);
        Ok(())
    }

    fn finish_write(&mut self, _now: Instant, tag: u16, _size: u32) -> Result<(), AbortCode> {
        let written = std::mem::take(&mut self.write_buffer);
        if let Some(cell) = self.value_mut(tag) {
            // At the end only: a download that breaks off leaves the old value.
            *cell = ObjectValue::Bytes(written);
        }
        Ok(())
    }
}

impl NodeStorage for DataSheetNode {
    fn store(&mut self, group: SettingsGroup) {
        self.flash_writes += 1;
        for ((cell, value), stored) in
            self.data_sheet.stored_objects.iter().zip(&self.values).zip(&mut self.stored)
        {
            if is_in_group(cell.index, group) {
                stored.clone_from(value);
            }
        }
        self.drives.iter_mut().for_each(|drive| drive.store(group));
    }

    fn restore(&mut self, group: SettingsGroup) {
        self.flash_writes += 1;
        for (cell, stored) in self.data_sheet.stored_objects.iter().zip(&mut self.stored) {
            if is_in_group(cell.index, group) {
                *stored = ObjectValue::from_factory(&cell.default, self.link_settings.0);
            }
        }
        for (drive, axis) in self.drives.iter_mut().zip(&self.data_sheet.axes) {
            drive.set_reset_objects(axis.objects.clone());
        }
    }
}

impl NodeClock for DataSheetNode {}

impl Firmware for DataSheetNode {
    fn dictionary(&self) -> &'static Dictionary {
        self.data_sheet.dictionary
    }

    fn get(&mut self, tag: u16) -> u64 {
        match self.value_mut(tag) {
            Some(ObjectValue::Number(value)) => *value,
            Some(ObjectValue::Bytes(_)) => 0,
            None => self.drive_mut(tag).map_or(0, |(drive, tag)| drive.get(tag)),
        }
    }

    fn set(&mut self, now: Instant, tag: u16, value: u64) -> Result<(), AbortCode> {
        if let Some(cell) = self.value_mut(tag) {
            *cell = ObjectValue::Number(value);
            return Ok(());
        }
        if tag % AXIS_TAGS == stored::MODE && !self.has_mode(tag / AXIS_TAGS, value as i8) {
            return Err(AbortCode::VALUE);
        }
        let (drive, tag) = self.drive_mut(tag).ok_or(AbortCode::STATE)?;
        drive.set(now, tag, value)
    }

    fn handle_sync(&mut self, now: Instant) {
        self.drives.iter_mut().for_each(|drive| drive.handle_sync(now));
    }

    fn handle_nmt_state(&mut self, now: Instant, state: NmtState) {
        self.drives.iter_mut().for_each(|drive| drive.handle_nmt_state(now, state));
    }

    fn reset(&mut self, now: Instant) {
        self.reload_values();
        self.drives.iter_mut().for_each(|drive| drive.reset(now));
    }

    fn handle_link_loss(&mut self, now: Instant) {
        self.drives.iter_mut().for_each(|drive| drive.handle_link_loss(now));
    }

    fn error_register(&self) -> u8 {
        let own = if self.fault == 0 { 0 } else { GENERIC_ERROR };
        self.drives.iter().fold(own, |register, drive| register | drive.error_register())
    }

    fn poll_emergency(&mut self) -> Option<Emergency> {
        if !self.drives.is_empty() {
            return self.drives.iter_mut().find_map(Firmware::poll_emergency);
        }
        let news = self.reported_fault != self.fault;
        self.reported_fault = self.fault;
        news.then(|| Emergency { code: self.fault, ..Emergency::default() })
    }
}

impl Timed for DataSheetDevice {
    fn handle_timeout(&mut self, now: Instant) {
        self.node.advance(now);
        self.end.handle_timeout(now, &mut self.node);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let due = self.node.drives.iter().filter_map(Drive::next_due).min();
        earliest(self.end.poll_timeout(), due)
    }
}

impl polepair_drives::SimulatedDevice for DataSheetDevice {
    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Station<Can> for DataSheetDevice {
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

impl SurroundingsControl for DataSheetDevice {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        let flash_writes = self.node.flash_writes;
        match self.node.drives.first_mut() {
            Some(drive) => GroundTruth { flash_writes, ..drive.ground_truth(now) },
            None => GroundTruth {
                fault: self.node.fault.into(),
                flash_writes,
                ..GroundTruth::default()
            },
        }
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        match (act, self.node.drives.first_mut()) {
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

    fn motor_truth(&mut self, now: Instant, motor: u8) -> Option<GroundTruth> {
        if motor == 0 {
            return Some(self.ground_truth(now));
        }
        let flash_writes = self.node.flash_writes;
        let drive = self.node.drives.get_mut(usize::from(motor))?;
        Some(GroundTruth { flash_writes, ..drive.ground_truth(now) })
    }

    fn act_on_motor(&mut self, now: Instant, motor: u8, act: Act) -> bool {
        match self.node.drives.get_mut(usize::from(motor)) {
            Some(drive) if motor > 0 && act != Act::PowerCycle => drive.act(now, act),
            _ => self.act(now, act),
        }
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.node.drives.iter_mut().find_map(Drive::take_notice)
    }
}
