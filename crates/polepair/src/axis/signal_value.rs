//! Signals of an axis in the units of its drive, as people read them.

use polepair_core::profile::{Encoding, ParameterId, Signal, same_name};
use polepair_core::units::Unit;

use super::LocalAxis;
use crate::amount::Value;
use crate::error::Error;

impl LocalAxis {
    /// The signal with this name, if the drive's profile has a source for it, else the parameter with this name.
    ///
    /// # Errors
    /// `E213` with the nearest name.
    pub fn find_signal_or_parameter(
        &self,
        name: &str,
    ) -> Result<(ParameterId, Option<Signal>), Error> {
        let signal = Signal::ALL.into_iter().find(|signal| same_name(signal.name(), name));
        match signal.and_then(|signal| Some((self.profile.signal(signal)?.parameter, signal))) {
            Some((id, signal)) => Ok((id, Some(signal))),
            None => Ok((self.find(name)?, None)),
        }
    }

    /// Reads a signal in the drive's unit; `None` if the drive does not report it. Flags are 0 or 1, without a unit.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn signal_value(&self, signal: Signal) -> Result<Option<Value>, Error> {
        let Some(source) = self.profile.signal(signal) else { return Ok(None) };
        let id = source.parameter;
        let Some(raw) = self.read_optional(id)? else { return Ok(None) };
        let value = self.value(id, raw)?;
        let masked = value.raw & source.mask;
        let flag = source.is_flag().then(|| source.is_set(value.raw));
        Ok(Some(match flag {
            Some(false) if signal == Signal::Moving => {
                // The flag often means that a target is not reached: the speed shows it, too.
                if let Some(source) = self.profile.signal(Signal::Velocity) {
                    self.read_optional(source.parameter)?;
                }
                code_value(i64::from(self.moving(&self.state()) == Some(true)), value.encoding)
            }
            Some(is_set) => code_value(i64::from(is_set), value.encoding),
            None if source.mask == -1 => value,
            None => {
                let named = source.values.iter().find(|(raw, _)| *raw == masked);
                Value { word: named.map(|(_, word)| *word), ..code_value(masked, value.encoding) }
            }
        }))
    }
}

/// A flag or a code, which has no unit.
fn code_value(raw: i64, encoding: Encoding) -> Value {
    Value {
        raw,
        value: raw as f64,
        step: 1.0,
        unit: Unit::None,
        word: None,
        bits: &[],
        encoding,
        is_raw: true,
    }
}
