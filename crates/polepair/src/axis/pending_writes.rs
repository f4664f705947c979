//! Writes of values together with their scales, such as an electronic gear and a position.
//!
//! A drive receives raw numbers. Their meaning depends on the scale that is valid at that time, so the new
//! scale is used for the conversion.

use super::LocalAxis;
use crate::amount::{Amount, Value, misfit_error};
use crate::error::Error;
use polepair_core::profile::{NoScale, Parameter, ParameterId};
use polepair_core::units::Unit;

/// Raw values that are to be written before others.
#[derive(Clone, Debug, Default)]
pub struct PendingWrites(Vec<(ParameterId, i64)>);

impl PendingWrites {
    /// Takes one more in.
    pub fn insert(&mut self, id: ParameterId, raw: i64) {
        self.0.retain(|(other, _)| *other != id);
        self.0.push((id, raw));
    }

    fn get(&self, id: ParameterId) -> Option<i64> {
        self.0.iter().find(|(other, _)| *other == id).map(|(_, raw)| *raw)
    }
}

impl LocalAxis {
    /// Returns whether other parameters are scaled by this one: it is written before they are converted.
    #[must_use]
    pub fn scales(&self, id: ParameterId) -> bool {
        let mut scales = self.profile.parameters.iter().map(|parameter| parameter.scale);
        scales.any(|scale| scale.inputs(self.profile).any(|input| input == id))
    }

    /// The raw value that an amount means for a parameter after the pending writes.
    ///
    /// # Errors
    /// As [`raw_of`](Self::raw_of).
    pub fn raw_of_after(
        &self,
        id: ParameterId,
        amount: &Amount,
        pending: &PendingWrites,
    ) -> Result<i64, Error> {
        let Some(parameter) = self.rescaled(id, pending) else { return self.raw_of(id, amount) };
        let (unit, step) = (self.unit(id), self.raw_step_after(parameter, pending)?);
        amount.resolve(parameter, unit)?.into_raw(
            parameter,
            unit,
            |si| parameter.encoding.raw(si * self.factor(id) / step),
            || {
                if parameter.encoding.raw(0.0 / step).is_some() {
                    return misfit_error(parameter, amount);
                }
                let what = format!("`{}`: its scale would be zero or nothing", parameter.name);
                Error::usage("E217", what, "write what it is scaled by with another value")
            },
        )
    }

    /// A raw value of a parameter in its unit, after the pending writes.
    ///
    /// # Errors
    /// As [`value`](Self::value).
    pub fn value_after(
        &self,
        id: ParameterId,
        raw: i64,
        pending: &PendingWrites,
    ) -> Result<Value, Error> {
        let value = self.value(id, raw)?;
        let Some(parameter) = self.rescaled(id, pending) else { return Ok(value) };
        let (unit, factor) = (self.unit(id), self.factor(id));
        let step = self.raw_step_after(parameter, pending)? / factor / unit.si_factor();
        let number = parameter.encoding.number(raw);
        Ok(Value { value: number * step, step: step.abs(), ..value })
    }

    /// The parameter, if the pending writes change its scale.
    fn rescaled(&self, id: ParameterId, pending: &PendingWrites) -> Option<&'static Parameter> {
        let parameter = self.parameter(id)?;
        let mut factors = parameter.scale.inputs(self.profile);
        let touched = factors.any(|factor| pending.get(factor).is_some());
        touched.then_some(parameter)
    }

    /// The drive's SI value of one raw unit, after the pending writes.
    fn raw_step_after(&self, parameter: &Parameter, pending: &PendingWrites) -> Result<f64, Error> {
        let mut inputs = Vec::new();
        for id in parameter.scale.inputs(self.profile) {
            let raw = match pending.get(id) {
                Some(raw) => Some(raw),
                None => self.read_optional(id)?,
            };
            inputs.push((id, raw));
        }
        let signed = parameter.encoding.is_signed();
        let scale = parameter
            .scale
            .compute(self.profile, signed, &|id| inputs.iter().find(|(input, _)| *input == id)?.1);
        let scale = scale.map_err(|NoScale(why)| {
            let what = format!("`{}` would have no unit: {why}", parameter.name);
            Error::usage("E217", what, "write what it is scaled by with another value")
        })?;
        let unit = if parameter.unit == Unit::None { 1.0 } else { parameter.unit.si_factor() };
        Ok(scale.factor * unit)
    }
}
