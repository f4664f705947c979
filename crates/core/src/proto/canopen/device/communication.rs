//! The communication objects: values, storage, and their entries in a dictionary.

use super::SettingsGroup;
use crate::proto::canopen::od::{
    DefaultValue, Dictionary, ObjectAccess, ObjectEntry, PROTOCOL_TAG, ValueType, key,
};
use crate::time::Instant;

/// Most nodes whose heartbeat is monitored (object 1016h).
pub const CONSUMERS_MAX: usize = 4;
/// Objects of a PDO at most: one a byte.
pub(super) const MAPPED_MAX: usize = super::super::pdo::MAPPED_MAX;
/// Time of writing flash, ms \[I\]: a power loss meanwhile leaves the previous content.
const STORE_MS: u32 = 20;

/// One PDO as its objects describe it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct PdoObjects {
    pub(super) cob: u32,
    pub(super) kind: u8,
    pub(super) inhibit: u16,
    pub(super) event: u16,
    pub(super) start: u8,
    pub(super) count: u8,
    pub(super) map: [u32; MAPPED_MAX],
}

/// All communication objects that can be written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct CommunicationObjects<const N: usize> {
    pub(super) sync_cob: u32,
    pub(super) sync_period_us: u32,
    pub(super) sync_window_us: u32,
    pub(super) sync_overflow: u8,
    pub(super) guard_ms: u16,
    pub(super) life_factor: u8,
    pub(super) time_cob: u32,
    pub(super) emcy_cob: u32,
    pub(super) emcy_inhibit: u16,
    pub(super) consumers: [u32; CONSUMERS_MAX],
    pub(super) heartbeat_ms: u16,
    pub(super) behaviour: [u8; 2],
    pub(super) rpdo: [PdoObjects; N],
    pub(super) tpdo: [PdoObjects; N],
}

impl<const N: usize> CommunicationObjects<N> {
    const NO_PDO: PdoObjects = PdoObjects {
        cob: 1 << 31,
        kind: 255,
        inhibit: 0,
        event: 0,
        start: 0,
        count: 0,
        map: [0; MAPPED_MAX],
    };

    /// Nothing configured.
    pub(super) const EMPTY: Self = Self {
        sync_cob: 0x80,
        sync_period_us: 0,
        sync_window_us: 0,
        sync_overflow: 0,
        guard_ms: 0,
        life_factor: 0,
        time_cob: 0x100,
        emcy_cob: 0x80,
        emcy_inhibit: 0,
        consumers: [0; CONSUMERS_MAX],
        heartbeat_ms: 0,
        behaviour: [0, 1],
        rpdo: [Self::NO_PDO; N],
        tpdo: [Self::NO_PDO; N],
    };

    /// Factory values, those of the dictionary's entries.
    pub(super) fn factory(dictionary: &Dictionary, node: u8) -> Self {
        let mut comm = Self { emcy_cob: 0x80 + u32::from(node), ..Self::EMPTY };
        let own = dictionary.entries().iter().filter(|entry| entry.tag == PROTOCOL_TAG);
        for entry in own {
            comm.set(entry.index(), entry.sub(), entry.default_bits(node));
        }
        comm
    }

    /// Sets a value without any check.
    pub(super) fn set(&mut self, index: u16, sub: u8, value: u64) {
        let consumer = usize::from(sub).wrapping_sub(1);
        match (index, sub) {
            (0x1005, _) => self.sync_cob = value as u32,
            (0x1006, _) => self.sync_period_us = value as u32,
            (0x1007, _) => self.sync_window_us = value as u32,
            (0x100C, _) => self.guard_ms = value as u16,
            (0x100D, _) => self.life_factor = value as u8,
            (0x1012, _) => self.time_cob = value as u32,
            (0x1014, _) => self.emcy_cob = value as u32,
            (0x1015, _) => self.emcy_inhibit = value as u16,
            (0x1016, 1..) if consumer < CONSUMERS_MAX => self.consumers[consumer] = value as u32,
            (0x1017, _) => self.heartbeat_ms = value as u16,
            (0x1019, _) => self.sync_overflow = value as u8,
            (0x1029, 1 | 2) => self.behaviour[consumer] = value as u8,
            _ => {
                if let Some(pdo) = self.pdo(index) {
                    pdo.set(index & 0x200 != 0, sub, value);
                }
            }
        }
    }

    /// The value of an object that is kept here.
    pub(super) fn value(&mut self, index: u16, sub: u8) -> Option<u64> {
        let consumer = usize::from(sub).wrapping_sub(1);
        Some(match (index, sub) {
            (0x1005, _) => self.sync_cob.into(),
            (0x1006, _) => self.sync_period_us.into(),
            (0x1007, _) => self.sync_window_us.into(),
            (0x100C, _) => self.guard_ms.into(),
            (0x100D, _) => self.life_factor.into(),
            (0x1012, _) => self.time_cob.into(),
            (0x1014, _) => self.emcy_cob.into(),
            (0x1015, _) => self.emcy_inhibit.into(),
            (0x1016, 1..) => (*self.consumers.get(consumer)?).into(),
            (0x1017, _) => self.heartbeat_ms.into(),
            (0x1019, _) => self.sync_overflow.into(),
            (0x1029, 1 | 2) => self.behaviour[consumer].into(),
            _ => return self.pdo(index)?.value(index & 0x200 != 0, sub),
        })
    }

    /// The PDO that an object from 1400h to 1BFFh belongs to.
    pub(super) fn pdo(&mut self, index: u16) -> Option<&mut PdoObjects> {
        let number = usize::from(index & 0x1FF);
        match index {
            0x1400..=0x17FF => self.rpdo.get_mut(number),
            0x1800..=0x1BFF => self.tpdo.get_mut(number),
            _ => None,
        }
    }
}

impl PdoObjects {
    pub(super) const fn is_valid(&self) -> bool {
        self.cob >> 31 == 0
    }

    fn set(&mut self, mapping: bool, sub: u8, value: u64) {
        match (mapping, sub) {
            (false, 1) => self.cob = value as u32,
            (false, 2) => self.kind = value as u8,
            (false, 3) => self.inhibit = value as u16,
            (false, 5) => self.event = value as u16,
            (false, 6) => self.start = value as u8,
            (true, 0) => self.count = (value as u8).min(MAPPED_MAX as u8),
            (true, 1..) => {
                if let Some(index) = self.map.get_mut(usize::from(sub) - 1) {
                    *index = value as u32;
                }
            }
            _ => {}
        }
    }

    fn value(&self, mapping: bool, sub: u8) -> Option<u64> {
        Some(match (mapping, sub) {
            (false, 1) => self.cob.into(),
            (false, 2) => self.kind.into(),
            (false, 3) => self.inhibit.into(),
            (false, 5) => self.event.into(),
            (false, 6) => self.start.into(),
            (true, 0) => self.count.into(),
            (true, 1..) => (*self.map.get(usize::from(sub) - 1)?).into(),
            _ => return None,
        })
    }
}

/// Settings that survive power-off.
#[derive(Clone, Debug, Default)]
pub(super) struct SettingsStore<const N: usize> {
    stored: Option<StoredSettings<N>>,
    /// Being written: what, and when it is done.
    writing: Option<(SettingsGroup, Instant, StoredSettings<N>)>,
}

#[derive(Clone, Copy, Debug)]
struct StoredSettings<const N: usize> {
    node: u8,
    comm: CommunicationObjects<N>,
}

impl<const N: usize> SettingsStore<N> {
    /// Begins to write; a write under way then ends unwritten. Returns when it is done.
    pub(super) fn begin_write(
        &mut self,
        now: Instant,
        group: SettingsGroup,
        node: u8,
        comm: &CommunicationObjects<N>,
    ) -> Instant {
        let done = now.plus_ms(STORE_MS);
        // A copy: what is written meanwhile is not part of what is being stored.
        self.writing = Some((group, done, StoredSettings { node, comm: *comm }));
        done
    }

    /// Power is gone.
    pub(super) fn abort_write(&mut self) {
        self.writing = None;
    }

    /// Time at which the write to flash ends.
    pub(super) fn due(&self) -> Option<Instant> {
        self.writing.as_ref().map(|(_, done, _)| *done)
    }

    /// The writing is done: which settings the firmware has to store now.
    pub(super) fn finish_write(&mut self, now: Instant) -> Option<SettingsGroup> {
        let (group, ..) = self.writing.as_ref().filter(|(_, done, _)| *done <= now)?;
        let group = *group;
        let (.., stored_settings) = self.writing.take()?;
        if group != SettingsGroup::Application {
            self.stored = Some(stored_settings);
        }
        Some(group)
    }

    /// Back to the factory's.
    pub(super) fn restore(&mut self, group: SettingsGroup) {
        if group != SettingsGroup::Application {
            self.stored = None;
        }
    }

    /// Values after a reset. Identifiers with the node-ID in them follow it only if they have factory values: stored
    /// ones stay.
    pub(super) fn load(&self, dictionary: &Dictionary, node: u8) -> CommunicationObjects<N> {
        match self.stored {
            // Identifiers that were stored with another node-ID belong to that one.
            Some(stored_settings) if stored_settings.node == node => stored_settings.comm,
            _ => CommunicationObjects::factory(dictionary, node),
        }
    }
}

const RO: ObjectAccess = ObjectAccess::RO;
const RW: ObjectAccess = ObjectAccess::RW;

const fn own_entry(
    index: u16,
    sub: u8,
    kind: ValueType,
    access: ObjectAccess,
    name: &'static str,
) -> ObjectEntry {
    ObjectEntry::new(index, sub, kind, access, PROTOCOL_TAG, name)
}

/// Entries of an RPDO and a TPDO, with their mappings.
const PDO_ENTRIES: usize = 5 + 6 + 2 * (MAPPED_MAX + 1);

/// Returns whether the protocol itself stores that object, of a node with `pdos` PDOs each way, if the node's
/// dictionary has it: its entry then has the tag [`PROTOCOL_TAG`].
#[must_use]
pub const fn is_protocol_object(index: u16, sub: u8, pdos: u16) -> bool {
    if index >= 0x1400 && index < 0x1C00 {
        let (is_mapping, sends) = (index & 0x200 != 0, index >= 0x1800);
        let is_entry = matches!((is_mapping, sub), (true, 0..=8) | (false, 0..=3 | 5))
            || (sends && !is_mapping && sub == 6);
        return index & 0x1FF < pdos && is_entry;
    }
    let mut at = 0;
    while at < BASE_ENTRIES.len() {
        if BASE_ENTRIES[at].key() == key(index, sub) {
            return true;
        }
        at += 1;
    }
    index == 0x1003
}

/// Number of entries that [`standard_entries`] has for `pdos` PDOs each way, if `left_out` are left out.
#[must_use]
pub const fn standard_len(pdos: usize, left_out: usize) -> usize {
    BASE_ENTRIES.len() + pdos * PDO_ENTRIES - left_out
}

/// The communication objects from 1001h on, in order, with `pdos` PDOs each way. The objects named
/// in `left_out` are not there; `worths` are values from the factory that differ from the
/// standard's.
///
/// # Panics
/// When `LEN` is not the number of entries: at compile time where it is a constant.
#[must_use]
pub const fn standard_entries<const LEN: usize>(
    pdos: u16,
    left_out: &[u16],
    worths: &[(u16, u8, DefaultValue)],
) -> [ObjectEntry; LEN] {
    let mut list = EntryList { entries: [BASE_ENTRIES[0]; LEN], len: 0 };
    let mut at = 0;
    while at < BASE_ENTRIES.len() {
        if !is_in(BASE_ENTRIES[at].index(), left_out) {
            list = list.push(BASE_ENTRIES[at], worths);
        }
        at += 1;
    }
    list = list.push_communication(0x1400, 0x200, pdos, worths);
    list = list.push_mappings(0x1600, pdos, worths);
    list = list.push_communication(0x1800, 0x180, pdos, worths);
    list = list.push_mappings(0x1A00, pdos, worths);
    assert!(list.len == LEN, "LEN is not the number of entries");
    list.entries
}

struct EntryList<const LEN: usize> {
    entries: [ObjectEntry; LEN],
    len: usize,
}

impl<const LEN: usize> EntryList<LEN> {
    const fn push(mut self, entry: ObjectEntry, worths: &[(u16, u8, DefaultValue)]) -> Self {
        let mut entry = entry;
        let mut at = 0;
        while at < worths.len() {
            let (index, sub, worth) = worths[at];
            if index == entry.index() && sub == entry.sub() {
                entry = entry.with_default_value(worth);
            }
            at += 1;
        }
        self.entries[self.len] = entry;
        self.len += 1;
        self
    }

    const fn push_communication(
        mut self,
        base: u16,
        function: i64,
        pdos: u16,
        worths: &[(u16, u8, DefaultValue)],
    ) -> Self {
        let sends = base == 0x1800;
        let mut n = 0;
        while n < pdos {
            let cob = match n {
                0..=3 => DefaultValue::PlusNode(function + 0x100 * n as i64),
                _ => DefaultValue::Number(1 << 31),
            };
            let highest = if sends { 6 } else { 5 };
            let at = base + n;
            self = self.push(
                own_entry(at, 0, ValueType::U8, RO, "highest sub-index").with_default(highest),
                worths,
            );
            self = self.push(
                own_entry(at, 1, ValueType::U32, RW, "COB-ID").with_default_value(cob),
                worths,
            );
            self = self.push(
                own_entry(at, 2, ValueType::U8, RW, "transmission type").with_default(255),
                worths,
            );
            self = self.push(own_entry(at, 3, ValueType::U16, RW, "inhibit time"), worths);
            self = self.push(own_entry(at, 5, ValueType::U16, RW, "event timer"), worths);
            if sends {
                self = self.push(own_entry(at, 6, ValueType::U8, RW, "SYNC start value"), worths);
            }
            n += 1;
        }
        self
    }

    const fn push_mappings(
        mut self,
        base: u16,
        pdos: u16,
        worths: &[(u16, u8, DefaultValue)],
    ) -> Self {
        let mut n = 0;
        while n < pdos {
            self = self.push(own_entry(base + n, 0, ValueType::U8, RW, "objects mapped"), worths);
            let mut sub = 1;
            while sub <= MAPPED_MAX as u8 {
                self = self
                    .push(own_entry(base + n, sub, ValueType::U32, RW, "mapped object"), worths);
                sub += 1;
            }
            n += 1;
        }
        self
    }
}

const fn is_in(index: u16, list: &[u16]) -> bool {
    let mut at = 0;
    while at < list.len() {
        if list[at] == index {
            return true;
        }
        at += 1;
    }
    false
}

/// Objects 1001h to 1200h as the standard has them.
const BASE_ENTRIES: [ObjectEntry; 40] = [
    own_entry(0x1001, 0, ValueType::U8, RO, "error register"),
    own_entry(0x1003, 0, ValueType::U8, RW, "number of errors"),
    own_entry(0x1003, 1, ValueType::U32, RO, "latest error"),
    own_entry(0x1003, 2, ValueType::U32, RO, "error before"),
    own_entry(0x1003, 3, ValueType::U32, RO, "error before"),
    own_entry(0x1003, 4, ValueType::U32, RO, "error before"),
    own_entry(0x1005, 0, ValueType::U32, RW, "COB-ID SYNC").with_default(0x80),
    own_entry(0x1006, 0, ValueType::U32, RW, "SYNC period"),
    own_entry(0x1007, 0, ValueType::U32, RW, "SYNC window"),
    own_entry(0x100C, 0, ValueType::U16, RW, "guard time"),
    own_entry(0x100D, 0, ValueType::U8, RW, "life time factor"),
    own_entry(0x1010, 0, ValueType::U8, RO, "store: highest sub-index").with_default(3),
    own_entry(0x1010, 1, ValueType::U32, RW, "store all"),
    own_entry(0x1010, 2, ValueType::U32, RW, "store communication"),
    own_entry(0x1010, 3, ValueType::U32, RW, "store application"),
    own_entry(0x1011, 0, ValueType::U8, RO, "restore: highest sub-index").with_default(3),
    own_entry(0x1011, 1, ValueType::U32, RW, "restore all"),
    own_entry(0x1011, 2, ValueType::U32, RW, "restore communication"),
    own_entry(0x1011, 3, ValueType::U32, RW, "restore application"),
    own_entry(0x1012, 0, ValueType::U32, RW, "COB-ID TIME").with_default(1 << 31 | 0x100),
    own_entry(0x1014, 0, ValueType::U32, RW, "COB-ID EMCY")
        .with_default_value(DefaultValue::PlusNode(0x80)),
    own_entry(0x1015, 0, ValueType::U16, RW, "EMCY inhibit time"),
    own_entry(0x1016, 0, ValueType::U8, RO, "heartbeats watched")
        .with_default(CONSUMERS_MAX as i64),
    own_entry(0x1016, 1, ValueType::U32, RW, "heartbeat watched"),
    own_entry(0x1016, 2, ValueType::U32, RW, "heartbeat watched"),
    own_entry(0x1016, 3, ValueType::U32, RW, "heartbeat watched"),
    own_entry(0x1016, 4, ValueType::U32, RW, "heartbeat watched"),
    own_entry(0x1017, 0, ValueType::U16, RW, "heartbeat time"),
    own_entry(0x1018, 0, ValueType::U8, RO, "identity: highest sub-index").with_default(4),
    own_entry(0x1018, 1, ValueType::U32, RO, "vendor-ID"),
    own_entry(0x1018, 2, ValueType::U32, RO, "product code"),
    own_entry(0x1018, 3, ValueType::U32, RO, "revision number"),
    own_entry(0x1018, 4, ValueType::U32, RO, "serial number"),
    own_entry(0x1019, 0, ValueType::U8, RW, "SYNC counter overflow").with_limits(0, 240),
    own_entry(0x1029, 0, ValueType::U8, RO, "error behaviour: highest sub-index").with_default(2),
    own_entry(0x1029, 1, ValueType::U8, RW, "after a communication error").with_limits(0, 2),
    own_entry(0x1029, 2, ValueType::U8, RW, "after a fault of the drive")
        .with_default(1)
        .with_limits(0, 2),
    own_entry(0x1200, 0, ValueType::U8, RO, "SDO server: highest sub-index").with_default(2),
    own_entry(0x1200, 1, ValueType::U32, RO, "COB-ID SDO request")
        .with_default_value(DefaultValue::PlusNode(0x600)),
    own_entry(0x1200, 2, ValueType::U32, RO, "COB-ID SDO reply")
        .with_default_value(DefaultValue::PlusNode(0x580)),
];
