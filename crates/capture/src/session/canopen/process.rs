//! What frames of one PDO say, put together from its mapping: nothing of it hangs on anything but
//! their bytes, so that whoever writes lines or columns may do so later, and on another thread.

use std::sync::Arc;

use polepair_core::explain::Sink as _;
use polepair_core::profile::Profile;

use super::mapping::{Mapping, Place};
use super::power::Power;
use super::wording::Wording;
use crate::explained::Explained;
use crate::session::{Notice, Quality, Signal};

/// Process data of one PDO, as they are mapped.
#[derive(Clone, Debug)]
pub struct Process {
    node: u8,
    mapping: Mapping,
    /// The node tells its states by values of it.
    told: bool,
    watched: Vec<Place>,
    /// The mapping in words, once they are wanted.
    wording: Option<Wording>,
}

impl Process {
    pub(super) fn new(node: u8, told: bool, mapping: Mapping) -> Self {
        let watches = |place: &&Place| told && place.is_watched();
        let watched = mapping.places().iter().filter(watches).copied().collect();
        Self { node, mapping, told, watched, wording: None }
    }

    /// Whose they are.
    #[must_use]
    pub fn axis(&self) -> u32 {
        self.node.into()
    }

    /// Where their values lie.
    #[must_use]
    pub const fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// How far they can be trusted.
    #[must_use]
    pub const fn quality(&self) -> Quality {
        self.mapping.quality()
    }

    pub(crate) const fn wording(&self) -> Option<&Wording> {
        self.wording.as_ref()
    }

    /// Puts words together for what these bytes hold, where there are none yet.
    pub(super) fn word(
        this: &mut Arc<Self>,
        data: u64,
        name: impl FnOnce() -> String,
        profile: Option<&'static Profile>,
    ) {
        let known = |wording: &Wording| wording.knows(&this.mapping, data);
        if !this.wording.as_ref().is_some_and(known) {
            let Self { mapping, wording, .. } = Arc::make_mut(this);
            let wording = wording.get_or_insert_with(|| Wording::new(name(), mapping, profile));
            wording.learn(mapping, data);
        }
    }

    /// A state is told by that value of it.
    pub(super) const fn watches(&self, place: &Place) -> bool {
        self.told && place.is_watched()
    }

    /// Nothing changes by these values: neither a state nor the words that are known.
    pub(super) fn is_settled(&self, data: u64, power: &mut Power) -> bool {
        let known = self.wording.as_ref().is_none_or(|words| words.knows(&self.mapping, data));
        known && self.watched.iter().all(|place| power.stays(place.object, place.exact(data)))
    }

    /// Says what bytes are.
    pub(crate) fn say(&self, bytes: &[u8], said: &mut Explained) {
        said.axis(self.axis());
        if let Some(wording) = &self.wording {
            wording.say(&self.mapping, bytes, said);
        }
    }

    /// A value that they hold.
    pub(crate) fn signal(&self, place: &Place, exact: i64, value: f64) -> Notice {
        let (Place { name, unit, .. }, axis, exact) = (*place, self.axis(), Some(exact));
        let quality = self.quality();
        Notice::Signal(Signal { axis, name, value, exact, unit, quality, request: None })
    }
}
