//! Decoded frames of one PDO. They depend on their bytes only, so lines or columns can be written later, on
//! another thread.

use core::fmt::Write as _;
use std::sync::Arc;

use polepair_core::explain::ExplainSink as _;
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cia402::OperationMode;

use super::annotate::explain_as_default;
use super::mapping::{MappedValue, Mapping};
use super::pdo::PdoName;
use super::power::PowerMonitor;
use super::process_text::ProcessText;
use crate::explanation::Explanation;
use crate::session::{Quality, SessionNotice, SignalNotice};

/// Process data of one PDO, as they are mapped.
#[derive(Clone, Debug)]
pub struct ProcessData {
    node: u8,
    name: PdoName,
    mapping: Mapping,
    /// True if the node reports its states by values of it.
    from_node: bool,
    state_values: Vec<MappedValue>,
    /// The mapping in words, once they are wanted.
    text: Option<ProcessText>,
    /// Set where the mapping is not known, and the text is the dissector's.
    supposed: Option<SupposedText>,
}

/// Key of the dissector's text for a frame.
#[derive(Clone, Copy, Debug)]
struct SupposedText {
    id: u32,
    /// Object that would state the mapping.
    mapping_index: u16,
    profile: Option<&'static Profile>,
}

impl ProcessData {
    pub(super) fn new(node: u8, name: PdoName, mapping: Mapping) -> Self {
        let from_node = name.from_node;
        let state_values = mapping
            .mapped_values()
            .iter()
            .filter(|mapped| from_node && mapped.tells_state())
            .copied()
            .collect();
        Self { node, name, mapping, from_node, state_values, text: None, supposed: None }
    }

    /// With the dissector's text for the identifier that they have; `mapping_index` is the object of their mapping.
    pub(super) fn with_supposed_text(mut self, id: u32, mapping_index: u16) -> Self {
        self.supposed = Some(SupposedText { id, mapping_index, profile: None });
        self
    }

    /// Axis of the process data.
    #[must_use]
    pub fn axis(&self) -> u32 {
        self.node.into()
    }

    /// Positions of their values.
    #[must_use]
    pub const fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// Quality of the values.
    #[must_use]
    pub const fn quality(&self) -> Quality {
        self.mapping.quality()
    }

    pub(crate) const fn text(&self) -> Option<&ProcessText> {
        self.text.as_ref()
    }

    /// Puts words together for what these bytes hold, where there are none yet.
    pub(super) fn learn_text(
        this: &mut Arc<Self>,
        data: u64,
        name: impl FnOnce() -> String,
        profile: Option<&'static Profile>,
        mode: OperationMode,
    ) {
        if !this.text.as_ref().is_some_and(|wording| wording.has_text(data)) {
            let Self { mapping, text, supposed, .. } = Arc::make_mut(this);
            let wording = text.get_or_insert_with(|| match supposed {
                Some(supposed) => {
                    supposed.profile = profile;
                    ProcessText::supposed(name(), mapping, profile, supposed.mapping_index)
                }
                None => ProcessText::new(name(), mapping, profile, mode),
            });
            wording.learn_text(data);
        }
    }

    /// Forgets the words that are those of another mode.
    pub(super) fn set_mode(this: &mut Arc<Self>, mode: OperationMode) {
        if this.text.is_some() && this.supposed.is_none() {
            Arc::make_mut(this).text.iter_mut().for_each(|wording| wording.set_mode(mode));
        }
    }

    /// Returns whether that value reports a state.
    pub(super) const fn tells_state(&self, mapped: &MappedValue) -> bool {
        self.from_node && mapped.tells_state()
    }

    /// Nothing changes by these values: neither a state nor the words that are known.
    pub(super) fn is_unchanged(&self, data: u64, power: &mut PowerMonitor) -> bool {
        let known = self.text.as_ref().is_none_or(|words| words.has_text(data));
        known
            && self
                .state_values
                .iter()
                .all(|mapped| power.accept_unchanged(mapped.object, mapped.exact(data)))
    }

    /// Explains bytes.
    pub(crate) fn explain(&self, bytes: &[u8], explanation: &mut Explanation) {
        if let Some(SupposedText { id, profile, .. }) = self.supposed {
            return explain_as_default(bytes, Some(id), profile, explanation);
        }
        explanation.axis(self.axis());
        match &self.text {
            Some(wording) => wording.explain(bytes, explanation),
            None => _ = write!(explanation.kind, "{}", self.name),
        }
    }

    /// A value that they hold.
    pub(crate) fn signal_notice(
        &self,
        mapped: &MappedValue,
        exact: i64,
        value: f64,
    ) -> SessionNotice {
        let (MappedValue { name, unit, .. }, axis, exact) = (*mapped, self.axis(), Some(exact));
        let quality = self.quality();
        SessionNotice::Signal(SignalNotice {
            axis,
            name,
            value,
            exact,
            unit,
            quality,
            request: None,
        })
    }
}
