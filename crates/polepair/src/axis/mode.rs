//! Interprets a drive's state: name of the operation mode, and whether the motor moves.

use super::LocalAxis;
use crate::error::Error;
use polepair_core::axis::{AxisStatus, Reading, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::plan::{Operand, Step};
use polepair_core::profile::{Encoding, ParameterId, Signal};

impl LocalAxis {
    /// The parameter that selects the mode of operation for a verb, and its raw value: what the verb's
    /// plan writes before it waits for the mode. `None` where it waits for none.
    #[must_use]
    pub fn mode_for(&self, verb: Verb) -> Option<(ParameterId, i64)> {
        let display = self.profile.signal(Signal::Mode)?.parameter;
        let steps = self.profile.plan(verb)?.steps;
        steps.windows(2).rev().find_map(|pair| match *pair {
            [Step::Write(id, Operand::Constant(mode)), Step::Until { read, test, .. }]
                if read == display && test.passes(mode) =>
            {
                Some((id, mode))
            }
            _ => None,
        })
    }

    /// Writes the operation mode of a verb before the axis is enabled: some drives change their mode only
    /// without power. If the drive refuses it, the verb reports that.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn prepare_mode(&self, verb: Verb) -> Result<(), Error> {
        let (Some((id, mode)), Some(display)) =
            (self.mode_for(verb), self.profile.signal(Signal::Mode))
        else {
            return Ok(());
        };
        if self.read(display.parameter)? == mode {
            return Ok(());
        }
        match self.write(id, mode, false) {
            Err(Error::Failed { outcome: Outcome::NotDone(Failure::Refused { .. }), .. }) => Ok(()),
            written => written,
        }
    }

    /// The mode of operation that a state has, in the profile's words: those of the signal, then of
    /// its parameter; its number where it has no word, `None` while it was never read.
    #[must_use]
    pub fn mode(&self, state: &AxisStatus) -> Option<String> {
        let source = self.profile.signal(Signal::Mode)?;
        let reading = state.reading(Signal::Mode);
        reading.at?;
        let own = self.parameter(source.parameter).map_or(&[][..], |p| p.values);
        let mut names = source.values.iter().chain(own);
        let word = names.find(|(raw, _)| *raw == reading.raw).map(|(_, word)| *word);
        // Bits, as manuals write them.
        Some(word.map_or_else(
            || match reading.raw {
                raw @ ..=9 => raw.to_string(),
                raw => format!("{raw:X}h"),
            },
            str::to_owned,
        ))
    }

    /// Returns whether the motor moves, by the last readings: the drive reports a move, or the speed is above the limit
    /// of its stop. A drive's own flag often means only that a target is not reached. `None` until either was read.
    #[must_use]
    pub fn moving(&self, state: &AxisStatus) -> Option<bool> {
        let reading = state.reading(Signal::Moving);
        let reported_at = self.profile.signal(Signal::Moving).and(reading.at);
        let flag = reported_at.map(|_| reading.raw != 0);
        let turns =
            self.is_turning_in(state).map(|turns| turns && !self.is_within_one_count(state));
        match (flag, turns) {
            (None, None) => None,
            (flag, turns) => Some(flag == Some(true) || turns == Some(true)),
        }
    }

    /// The state with [`moving`](Self::moving) instead of the drive's own flag.
    pub(super) fn with_derived_moving(&self, mut state: AxisStatus) -> AxisStatus {
        let flag = state.reading(Signal::Moving);
        if flag.at.is_some() && flag.raw == 0 && self.moving(&state) == Some(true) {
            state.set_reading(Signal::Moving, Reading { raw: 1, value: 1.0, ..flag });
        }
        state
    }

    /// Returns whether a speed in counts is at most one count: an encoder between two counts reports this at standstill
    /// too.
    fn is_within_one_count(&self, state: &AxisStatus) -> bool {
        const COUNT: u64 = 1 << 16;
        let source = self.profile.signal(Signal::Velocity);
        let parameter = source.and_then(|source| self.parameter(source.parameter));
        parameter.is_some_and(|parameter| parameter.encoding == Encoding::Fixed)
            && state.reading(Signal::Velocity).raw.unsigned_abs() <= COUNT
    }
}
