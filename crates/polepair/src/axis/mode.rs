//! The mode of operation, in words.

use super::Axis;
use polepair_core::axis::State;
use polepair_core::profile::Signal;

impl Axis {
    /// The mode of operation that a state has, in the profile's words; its number where it has no
    /// word, `None` while it was never read.
    #[must_use]
    pub fn mode(&self, state: &State) -> Option<String> {
        let source = self.profile.signal(Signal::Mode)?;
        let reading = state.reading(Signal::Mode);
        reading.at?;
        let own = self.profile.parameter(source.parameter).map_or(&[][..], |p| p.values);
        let names = if source.values.is_empty() { own } else { source.values };
        let word = names.iter().find(|(raw, _)| *raw == reading.raw).map(|(_, word)| *word);
        Some(word.map_or_else(|| reading.raw.to_string(), str::to_owned))
    }
}
