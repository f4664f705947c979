//! PDOs and their content: from objects 1400h to 1BFFh in the capture, else from the data sheet or profile,
//! else by the usual default.

use core::fmt;
use std::sync::Arc;

use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cia402::OperationMode;
use polepair_core::proto::canopen::cob::Cob;
use polepair_core::proto::canopen::explain::{default_mapping, meanings};
use polepair_core::proto::canopen::pdo::{CobId, MappingEntry};
use polepair_core::proto::canopen::sdo::ObjectIndex;

use super::mapping::{ENTRIES_MAX, Mapping};
use super::meaning::ObjectLookup;
use super::process_data::ProcessData;
use crate::explanation::Explanation;
use crate::session::{AnomalyKind, Quality, SessionNotice};

/// PDOs of one link that are known; a capture with more is hostile.
const PDOS_MAX: usize = 2048;
/// PDOs of a node with an identifier by default.
const BY_DEFAULT: u16 = 4;

/// One PDO of one node.
#[derive(Debug)]
pub(super) struct Pdo {
    pub node: u8,
    /// From the node.
    pub from_node: bool,
    /// From 1.
    pub number: u16,
    cob: Option<CobId>,
    count: Option<u8>,
    entries: Vec<Option<MappingEntry>>,
    /// The node started again since: written values may be lost.
    stale: bool,
    /// `None` while it has to be worked out.
    resolved: Option<ResolvedMapping>,
    /// True if its wrong length was reported.
    pub length_reported: bool,
    /// A frame was as long as the mapping: it is this node's.
    length_matched: bool,
}

/// Mapping for frames of one length.
#[derive(Debug)]
struct ResolvedMapping {
    process_data: Option<Arc<ProcessData>>,
    /// The length that it was concluded from, where it was.
    inferred_len: Option<u8>,
    /// True if their content is unknown: what they hold counts for nothing but the text.
    unmapped: bool,
}

/// Knowledge beside the node's own objects.
#[derive(Clone, Copy)]
pub(super) struct MappingContext<'a> {
    pub lookup: ObjectLookup<'a>,
    /// The node is a drive by CiA 402.
    pub is_drive: bool,
    /// No words are wanted.
    pub values_only: bool,
}

impl Pdo {
    fn new(node: u8, from_node: bool, number: u16) -> Self {
        let (cob, count, entries) = (None, None, Vec::new());
        let (stale, resolved, length_reported, length_matched) = (false, None, false, false);
        Self {
            node,
            from_node,
            number,
            cob,
            count,
            entries,
            stale,
            resolved,
            length_reported,
            length_matched,
        }
    }

    /// Resolves the mapping for frames of this length.
    pub fn resolve_mapping(&mut self, len: u8, beside: &MappingContext<'_>) {
        let fits = |laid: &ResolvedMapping| laid.inferred_len.is_none_or(|by| by == len);
        if !self.resolved.as_ref().is_some_and(fits) {
            self.resolved = Some(self.build_mapping(len, beside));
        }
    }

    /// Mapping of the last frame.
    pub fn process_data(&self) -> Option<&Arc<ProcessData>> {
        self.resolved.as_ref()?.process_data.as_ref()
    }

    /// Mapping for a frame of `len` bytes, if the last frame was as long and nothing changed.
    #[inline]
    pub fn matching_process_data(&self, len: u8) -> Option<&Arc<ProcessData>> {
        let laid = self
            .resolved
            .as_ref()
            .filter(|laid| (self.length_matched || laid.unmapped) && !self.length_reported)?;
        let process = laid.process_data.as_ref()?;
        let need = process.mapping().bytes();
        // A receiver takes the bytes that it has mapped and ignores the rest (CiA 301).
        let right = len == need || (!self.from_node && len > need) || laid.unmapped;
        (right && laid.inferred_len.is_none_or(|by| by == len)).then_some(process)
    }

    /// Explains bytes by the mapping. False without one, or with too few bytes for it.
    pub fn explain(
        &mut self,
        bytes: &[u8],
        profile: Option<&'static Profile>,
        mode: OperationMode,
        explanation: &mut Explanation,
    ) -> bool {
        let name = self.name();
        let laid = self.resolved.as_mut().and_then(|laid| laid.process_data.as_mut());
        let long =
            |process: &&mut Arc<ProcessData>| bytes.len() >= process.mapping().bytes().into();
        let Some(process) = laid.filter(long) else { return false };
        let data = super::bytes_to_word(bytes);
        ProcessData::learn_text(process, data, || name.to_string(), profile, mode);
        process.explain(bytes, explanation);
        true
    }

    /// Forgets the words that are those of another mode.
    pub fn set_mode(&mut self, mode: OperationMode) {
        let process = self.resolved.as_mut().and_then(|laid| laid.process_data.as_mut());
        process.into_iter().for_each(|process| ProcessData::set_mode(process, mode));
    }

    /// Name of the PDO: `TPDO1`.
    pub const fn name(&self) -> PdoName {
        PdoName { from_node: self.from_node, number: self.number }
    }

    /// Compares the length of a frame with its mapping: one in the capture, or a data sheet's once a frame matched it;
    /// until then the node may be another product. A receiver may be sent more bytes.
    pub fn check_length(&mut self, len: u8, notices: &mut Vec<SessionNotice>) {
        let known = self.resolved.as_ref().filter(|laid| !laid.unmapped);
        let Some(process) = known.and_then(|laid| laid.process_data.as_ref()) else { return };
        let mapping = process.mapping();
        let (need, good) = (mapping.bytes(), mapping.quality() == Quality::Good);
        let wrong = len < need || (self.from_node && len > need);
        self.length_matched |= !wrong;
        let known = good && (self.length_matched || self.is_captured());
        if !wrong || !known {
            self.length_reported &= wrong;
            return;
        }
        if !core::mem::replace(&mut self.length_reported, true) {
            let text = format!("{} has {len} bytes, mapped are {need}", self.name());
            notices.push(super::anomaly(AnomalyKind::Length, self.node, text));
        }
    }

    /// The capture shows how it is mapped.
    const fn is_captured(&self) -> bool {
        self.count.is_some() && !self.stale
    }

    /// Clears the mapping after a change of its sources.
    pub fn clear_mapping(&mut self) {
        (self.resolved, self.length_reported, self.length_matched) = (None, false, false);
    }

    /// The node started again.
    pub fn mark_stale(&mut self) {
        if self.count.is_some() {
            (self.stale, self.resolved) = (true, None);
        }
    }

    fn build_mapping(&self, len: u8, beside: &MappingContext<'_>) -> ResolvedMapping {
        let book = &beside.lookup;
        if let Some((entries, quality)) = self.stated_entries(book.profile) {
            let process = self.new_process_data(Mapping::new(&entries, book, quality));
            return ResolvedMapping { process_data: process, inferred_len: None, unmapped: false };
        }
        let usual = || default_mapping(self.default_cob().filter(|_| beside.is_drive)?, len);
        let known = self.count.is_some() || self.entries.iter().any(Option::is_some);
        // Half a captured mapping is worth more than a usual one that contradicts it.
        let usual = if known { None } else { usual() };
        let entries: Vec<MappingEntry> =
            usual.iter().flat_map(|map| map.fields()).map(|(e, _)| e).collect();
        let process = self.new_process_data(Mapping::new(&entries, book, Quality::Inferred));
        let unmapped = process.is_none();
        let process = process.or_else(|| {
            if beside.values_only {
                self.new_process_data(Some(Mapping::empty()))
            } else {
                self.supposed_process_data(len, book)
            }
        });
        ResolvedMapping { process_data: process, inferred_len: Some(len), unmapped }
    }

    /// Process data of unknown content whose text is the dissector's: by the usual mapping, if their length is its.
    fn supposed_process_data(&self, len: u8, book: &ObjectLookup<'_>) -> Option<Arc<ProcessData>> {
        let cob = self.default_cob().filter(|_| len > 0)?;
        let id = u32::from(cob.id());
        if pdo_cob_id(self) != Some(id) {
            return None;
        }
        let map = default_mapping(cob, len);
        let entries: Vec<MappingEntry> =
            map.iter().flat_map(|map| map.fields()).map(|(entry, _)| entry).collect();
        let mapping = Mapping::supposed(&entries, book, len);
        let process = ProcessData::new(self.node, self.name(), mapping);
        Some(Arc::new(process.with_supposed_text(id, self.mapping_index())))
    }

    /// Index of the object with its mapping.
    const fn mapping_index(&self) -> u16 {
        debug_assert!(self.number > 0, "PDOs are counted from 1");
        (if self.from_node { 0x1A00 } else { 0x1600 }) + (self.number - 1)
    }

    fn new_process_data(&self, mapping: Option<Mapping>) -> Option<Arc<ProcessData>> {
        Some(Arc::new(ProcessData::new(self.node, self.name(), mapping?)))
    }

    /// Entries of the capture if it has them, otherwise the defaults of the profile.
    fn stated_entries(
        &self,
        profile: Option<&'static Profile>,
    ) -> Option<(Vec<MappingEntry>, Quality)> {
        let index = self.mapping_index();
        let mut captured = self.is_captured();
        let count = self.count.or_else(|| u8::try_from(default_of_sub(0, profile, index)?).ok())?;
        let mut entries = Vec::new();
        for sub in 1..=count {
            let own = self.entries.get(usize::from(sub) - 1).copied().flatten();
            captured &= own.is_some();
            let known = own.or_else(|| {
                Some(MappingEntry::from(u32::try_from(default_of_sub(sub, profile, index)?).ok()?))
            });
            entries.push(known?);
        }
        // A data sheet describes this very device; a product's profile only its factory setting.
        let sheet = profile.is_some_and(|profile| !is_built_in(profile)) && !self.stale;
        Some((entries, if captured || sheet { Quality::Good } else { Quality::Inferred }))
    }

    /// Default owner of its identifier.
    pub fn default_cob(&self) -> Option<Cob> {
        let number = u8::try_from(self.number).ok().filter(|_| self.number <= BY_DEFAULT)?;
        Some(if self.from_node {
            Cob::Tpdo(number, self.node)
        } else {
            Cob::Rpdo(number, self.node)
        })
    }

    /// Takes what an object of it holds.
    fn learn_object(&mut self, mapping: bool, sub: u8, raw: u32) {
        match (mapping, sub) {
            (false, 1) => self.cob = Some(CobId(raw)),
            (false, _) => return,
            (true, 0) => {
                self.count = u8::try_from(raw).ok().filter(|n| usize::from(*n) <= ENTRIES_MAX)
            }
            (true, sub) if usize::from(sub) <= ENTRIES_MAX => {
                let at = usize::from(sub) - 1;
                self.entries.resize(self.entries.len().max(at + 1), None);
                self.entries[at] = Some(MappingEntry::from(raw));
            }
            _ => return,
        }
        self.stale = false;
        self.clear_mapping();
    }
}

fn default_of_sub(sub: u8, profile: Option<&'static Profile>, index: u16) -> Option<i64> {
    default_value(profile, ObjectIndex::new(index, sub))
}

/// The name of a PDO.
#[derive(Clone, Copy, Debug)]
pub(super) struct PdoName {
    pub from_node: bool,
    number: u16,
}

impl fmt::Display for PdoName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}PDO{}", if self.from_node { 'T' } else { 'R' }, self.number)
    }
}

/// Default of an object by a profile.
fn default_value(profile: Option<&'static Profile>, object: ObjectIndex) -> Option<i64> {
    meanings::find_parameter(object, profile)?.default
}

/// Returns whether a profile is of a product and not of the device that a data sheet describes.
fn is_built_in(profile: &'static Profile) -> bool {
    polepair_drives::profiles().iter().any(|known| core::ptr::eq(*known, profile))
}

/// The PDOs of a link.
#[derive(Debug, Default)]
pub(super) struct PdoTable {
    pub all: Vec<Pdo>,
}

/// New identifier of a PDO: `None` if it is disabled.
pub(super) struct PdoMove {
    pub index: usize,
    pub old_id: Option<u32>,
    pub new_id: Option<u32>,
}

impl PdoTable {
    /// Index of a PDO, which is added if there is room.
    pub fn find_or_add(&mut self, node: u8, reported: bool, number: u16) -> Option<usize> {
        let known = self
            .all
            .iter()
            .position(|p| (p.node, p.from_node, p.number) == (node, reported, number));
        known.or_else(|| {
            (self.all.len() < PDOS_MAX).then(|| {
                self.all.push(Pdo::new(node, reported, number));
                self.all.len() - 1
            })
        })
    }

    /// Learns the value of a node's object, and returns a PDO whose identifier changed.
    pub fn learn_object(&mut self, node: u8, object: ObjectIndex, raw: u32) -> Option<PdoMove> {
        let (reported, mapping) = match object.index {
            0x1400..=0x15FF => (false, false),
            0x1600..=0x17FF => (false, true),
            0x1800..=0x19FF => (true, false),
            0x1A00..=0x1BFF => (true, true),
            _ => return None,
        };
        let at = self.find_or_add(node, reported, (object.index & 0x1FF) + 1)?;
        let pdo = &mut self.all[at];
        let from = pdo_cob_id(pdo);
        pdo.learn_object(mapping, object.sub, raw);
        let to = pdo_cob_id(pdo);
        (from != to || (!mapping && object.sub == 1)).then_some(PdoMove {
            index: at,
            old_id: from,
            new_id: to,
        })
    }

    /// PDOs of a node.
    pub fn of_node(&mut self, node: u8) -> impl Iterator<Item = &mut Pdo> {
        self.all.iter_mut().filter(move |pdo| pdo.node == node)
    }
}

fn pdo_cob_id(pdo: &Pdo) -> Option<u32> {
    match pdo.cob {
        Some(cob) => Some(cob.id()).filter(|_| cob.is_valid()),
        None => pdo.default_cob().map(|cob| cob.id().into()),
    }
}
