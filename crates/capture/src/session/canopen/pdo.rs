//! Which PDOs there are, and what they carry: by the objects 1400h to 1BFFh that the capture shows
//! being written or read, else by the data sheet or profile, else as drives usually have it.

use core::fmt;
use std::sync::Arc;

use polepair_core::drives;
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cob::Cob;
use polepair_core::proto::canopen::explain::{say, usual_mapping};
use polepair_core::proto::canopen::pdo::{CobId, Entry};
use polepair_core::proto::canopen::sdo::Object;

use super::mapping::{ENTRIES_MAX, Mapping};
use super::meaning::Book;
use super::process::Process;
use crate::explained::Explained;
use crate::session::{Notice, Oddity, Quality};

/// PDOs of one link that are known; a capture with more is hostile.
const PDOS_MAX: usize = 2048;
/// PDOs of a node with an identifier by default.
const BY_DEFAULT: u16 = 4;

/// One PDO of one node.
#[derive(Debug)]
pub(super) struct Pdo {
    pub node: u8,
    /// From the node.
    pub told: bool,
    /// From 1.
    pub number: u16,
    cob: Option<CobId>,
    count: Option<u8>,
    entries: Vec<Option<Entry>>,
    /// The node started again since: what was written may be lost.
    stale: bool,
    /// `None` while it has to be worked out.
    laid: Option<Laid>,
    /// Its wrong length was told.
    pub accused: bool,
    /// A frame was as long as the mapping: it is this node's.
    fitted: bool,
}

/// What frames of a length are read by.
#[derive(Debug)]
struct Laid {
    process: Option<Arc<Process>>,
    /// The length that it was concluded from, where it was.
    by_len: Option<u8>,
    /// Nobody knows what they hold, and no words are wanted.
    blank: bool,
}

/// What is known beside the node's own objects.
#[derive(Clone, Copy)]
pub(super) struct Beside<'a> {
    pub book: Book<'a>,
    /// The node is a drive by CiA 402.
    pub drive: bool,
    /// No words are wanted.
    pub bare: bool,
}

impl Pdo {
    fn new(node: u8, told: bool, number: u16) -> Self {
        let (cob, count, entries) = (None, None, Vec::new());
        let (stale, laid, accused, fitted) = (false, None, false, false);
        Self { node, told, number, cob, count, entries, stale, laid, accused, fitted }
    }

    /// Works out what a frame with so many bytes says.
    pub fn map(&mut self, len: u8, beside: &Beside<'_>) {
        let fits = |laid: &Laid| laid.by_len.is_none_or(|by| by == len);
        if !self.laid.as_ref().is_some_and(fits) {
            self.laid = Some(self.lay(len, beside));
        }
    }

    /// That by which the last frame was read.
    pub fn last(&self) -> Option<&Arc<Process>> {
        self.laid.as_ref()?.process.as_ref()
    }

    /// That by which a frame with so many bytes is read, where one as long was and nothing changed.
    #[inline]
    pub fn settled(&self, len: u8) -> Option<&Arc<Process>> {
        let fits = |laid: &&Laid| (self.fitted || laid.blank) && !self.accused;
        let laid = self.laid.as_ref().filter(fits)?;
        let process = laid.process.as_ref()?;
        let need = process.mapping().bytes();
        let right = len == need || (!self.told && len > need) || laid.blank;
        (right && laid.by_len.is_none_or(|by| by == len)).then_some(process)
    }

    /// Says what bytes are by the mapping. False where there is none, or they are too few for it.
    pub fn say(
        &mut self,
        bytes: &[u8],
        profile: Option<&'static Profile>,
        said: &mut Explained,
    ) -> bool {
        let name = self.name();
        let laid = self.laid.as_mut().and_then(|laid| laid.process.as_mut());
        let long = |process: &&mut Arc<Process>| bytes.len() >= process.mapping().bytes().into();
        let Some(process) = laid.filter(long) else { return false };
        Process::word(process, super::word(bytes), || name.to_string(), profile);
        process.say(bytes, said);
        true
    }

    /// What it is called: `TPDO1`.
    pub const fn name(&self) -> Called {
        Called { told: self.told, number: self.number }
    }

    /// Looks whether a frame of so many bytes is as long as its mapping: one that the capture shows,
    /// or a data sheet's, once a frame fitted it; until then the node may be another product. Who
    /// receives may be sent more.
    pub fn measure(&mut self, len: u8, notices: &mut Vec<Notice>) {
        let known = self.laid.as_ref().filter(|laid| !laid.blank);
        let Some(process) = known.and_then(|laid| laid.process.as_ref()) else { return };
        let mapping = process.mapping();
        let (need, good) = (mapping.bytes(), mapping.quality() == Quality::Good);
        let wrong = len < need || (self.told && len > need);
        self.fitted |= !wrong;
        let known = good && (self.fitted || self.is_captured());
        if !wrong || !known {
            self.accused &= wrong;
            return;
        }
        if !core::mem::replace(&mut self.accused, true) {
            let text = format!("{} has {len} bytes, mapped are {need}", self.name());
            notices.push(super::odd(Oddity::Length, self.node, text));
        }
    }

    /// The capture shows how it is mapped.
    const fn is_captured(&self) -> bool {
        self.count.is_some() && !self.stale
    }

    /// What a mapping hangs on changed.
    pub fn forget(&mut self) {
        (self.laid, self.accused, self.fitted) = (None, false, false);
    }

    /// The node started again.
    pub fn restart(&mut self) {
        if self.count.is_some() {
            (self.stale, self.laid) = (true, None);
        }
    }

    fn lay(&self, len: u8, beside: &Beside<'_>) -> Laid {
        let book = &beside.book;
        if let Some((entries, quality)) = self.stated(book.profile) {
            let process = self.process(Mapping::new(&entries, book, quality));
            return Laid { process, by_len: None, blank: false };
        }
        let usual = || usual_mapping(self.default_cob().filter(|_| beside.drive)?, len);
        let known = self.count.is_some() || self.entries.iter().any(Option::is_some);
        let usual = if known { None } else { usual() };
        let entries: Vec<Entry> =
            usual.iter().flat_map(|map| map.fields()).map(|(e, _)| e).collect();
        let process = self.process(Mapping::new(&entries, book, Quality::Inferred));
        let blank = process.is_none() && beside.bare;
        let process = if blank { self.process(Some(Mapping::none())) } else { process };
        Laid { process, by_len: Some(len), blank }
    }

    fn process(&self, mapping: Option<Mapping>) -> Option<Arc<Process>> {
        Some(Arc::new(Process::new(self.node, self.told, mapping?)))
    }

    /// Its entries, of the capture where that has them, else as the profile says they are at first.
    fn stated(&self, profile: Option<&'static Profile>) -> Option<(Vec<Entry>, Quality)> {
        let index = if self.told { 0x1A00 } else { 0x1600 } + (self.number - 1);
        let default = |sub| default(profile, Object::new(index, sub));
        let mut captured = self.is_captured();
        let count = self.count.or_else(|| u8::try_from(default(0)?).ok())?;
        let mut entries = Vec::new();
        for sub in 1..=count {
            let own = self.entries.get(usize::from(sub) - 1).copied().flatten();
            captured &= own.is_some();
            let known = own.or_else(|| Some(Entry::from(u32::try_from(default(sub)?).ok()?)));
            entries.push(known?);
        }
        let sheet = profile.is_some_and(|profile| !is_built_in(profile)) && !self.stale;
        Some((entries, if captured || sheet { Quality::Good } else { Quality::Inferred }))
    }

    /// Whose identifier it has while nobody moves it.
    pub fn default_cob(&self) -> Option<Cob> {
        let number = u8::try_from(self.number).ok().filter(|_| self.number <= BY_DEFAULT)?;
        Some(if self.told { Cob::Tpdo(number, self.node) } else { Cob::Rpdo(number, self.node) })
    }

    /// Takes what an object of it holds.
    fn learn(&mut self, mapping: bool, sub: u8, raw: u32) {
        match (mapping, sub) {
            (false, 1) => self.cob = Some(CobId(raw)),
            (false, _) => return,
            (true, 0) => {
                self.count = u8::try_from(raw).ok().filter(|n| usize::from(*n) <= ENTRIES_MAX)
            }
            (true, sub) if usize::from(sub) <= ENTRIES_MAX => {
                let at = usize::from(sub) - 1;
                self.entries.resize(self.entries.len().max(at + 1), None);
                self.entries[at] = Some(Entry::from(raw));
            }
            _ => return,
        }
        self.stale = false;
        self.forget();
    }
}

/// The name of a PDO.
#[derive(Clone, Copy)]
pub(super) struct Called {
    told: bool,
    number: u16,
}

impl fmt::Display for Called {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}PDO{}", if self.told { 'T' } else { 'R' }, self.number)
    }
}

/// What a profile says that an object is at first.
fn default(profile: Option<&'static Profile>, object: Object) -> Option<i64> {
    say::parameter(object, profile)?.default
}

/// Whether a profile is of a product and not of the device that a data sheet describes.
fn is_built_in(profile: &'static Profile) -> bool {
    drives::profiles().iter().any(|known| core::ptr::eq(*known, profile))
}

/// The PDOs of a link.
#[derive(Debug, Default)]
pub(super) struct Pdos {
    pub all: Vec<Pdo>,
}

/// Where a PDO went: `None` when it is switched off.
pub(super) struct Moved {
    pub at: usize,
    pub from: Option<u32>,
    pub to: Option<u32>,
}

impl Pdos {
    /// Where a PDO stands; it is made if there is room.
    pub fn at(&mut self, node: u8, told: bool, number: u16) -> Option<usize> {
        let same = |p: &Pdo| (p.node, p.told, p.number) == (node, told, number);
        let known = self.all.iter().position(same);
        known.or_else(|| {
            (self.all.len() < PDOS_MAX).then(|| {
                self.all.push(Pdo::new(node, told, number));
                self.all.len() - 1
            })
        })
    }

    /// Takes what an object of a node holds, and tells if a PDO has another identifier now.
    pub fn learn(&mut self, node: u8, object: Object, raw: u32) -> Option<Moved> {
        let (told, mapping) = match object.index {
            0x1400..=0x15FF => (false, false),
            0x1600..=0x17FF => (false, true),
            0x1800..=0x19FF => (true, false),
            0x1A00..=0x1BFF => (true, true),
            _ => return None,
        };
        let at = self.at(node, told, (object.index & 0x1FF) + 1)?;
        let pdo = &mut self.all[at];
        let id = |pdo: &Pdo| match pdo.cob {
            Some(cob) => Some(cob.id()).filter(|_| cob.is_valid()),
            None => pdo.default_cob().map(|cob| cob.id().into()),
        };
        let from = id(pdo);
        pdo.learn(mapping, object.sub, raw);
        let to = id(pdo);
        (from != to || (!mapping && object.sub == 1)).then_some(Moved { at, from, to })
    }

    /// Those of a node.
    pub fn of(&mut self, node: u8) -> impl Iterator<Item = &mut Pdo> {
        self.all.iter_mut().filter(move |pdo| pdo.node == node)
    }
}
