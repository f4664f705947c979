//! The source of a value's unit, or the reason why it has none.

use super::LocalAxis;
use crate::error::Error;
use polepair_core::profile::{NoScale, ParameterId, Scale, Signal};
use polepair_core::units::{Quantity, Unit};

impl LocalAxis {
    /// Returns whether a parameter is known to have no unit: it is then shown raw.
    pub(super) fn is_unscaled(&self, id: ParameterId) -> bool {
        self.scale_error(id).is_some()
    }

    fn scale_error(&self, id: ParameterId) -> Option<NoScale> {
        self.connection.with_axes(|axes, _| axes.scale_error(self.index, id))
    }

    /// The reason why a parameter has no unit although its profile has one, with the values of the drive's
    /// objects. `None` if it has a unit, and before it was read.
    #[must_use]
    pub fn unit_problem(&self, id: ParameterId) -> Option<String> {
        let (why, values) = self.unit_problem_parts(id)?;
        let name = self.parameter(id)?.name;
        let values = if values.is_empty() { values } else { format!(" ({values})") };
        Some(format!("{}: `{name}` has no unit: {why}{values}", self.label()))
    }

    /// The reason of [`unit_problem`](Self::unit_problem), and the values of the objects concerned.
    #[must_use]
    pub fn unit_problem_parts(&self, id: ParameterId) -> Option<(&'static str, String)> {
        let NoScale(why) = self.scale_error(id)?;
        Some((why, self.scale_inputs(id)))
    }

    /// Objects of the drive that determine the scale of a parameter: `608Fh:1 = 2000, 60A8h = FF410000h`. Missing ones
    /// are left out.
    #[must_use]
    pub fn scale_inputs(&self, id: ParameterId) -> String {
        let Some(parameter) = self.parameter(id) else { return String::new() };
        self.format_inputs(parameter.scale, parameter.scale.inputs(self.profile))
    }

    /// Source of the unit of a parameter, if a standard's rule computed it.
    #[must_use]
    pub fn scale_source(&self, id: ParameterId) -> Option<String> {
        let parameter = self.parameter(id)?;
        parameter.scale.rule?;
        let signed = parameter.encoding.is_signed();
        let scale = parameter
            .scale
            .compute(self.profile, signed, &|id| {
                self.connection.with_axes(|axes, _| axes.scale_input(self.index, id))
            })
            .ok()?;
        let objects = scale.from.iter().filter_map(|object| self.profile.find_object(*object));
        Some(self.format_inputs(parameter.scale, objects))
    }

    /// The values of a scale's inputs. What reads zero counts as absent, unless nothing else is there.
    fn format_inputs(&self, scale: Scale, ids: impl Iterator<Item = ParameterId>) -> String {
        let words = scale.rule.map_or(&[][..], |rule| rule.words);
        let read = ids.filter_map(|id| {
            let raw = self.connection.with_axes(|axes, _| axes.scale_input(self.index, id))?;
            Some((self.parameter(id)?, raw))
        });
        let mut read: Vec<_> = read.collect();
        if read.iter().any(|(_, raw)| *raw != 0) {
            read.retain(|(_, raw)| *raw != 0);
        }
        let shown = read.iter().map(|(parameter, raw)| {
            let symbol = parameter.symbol;
            if words.contains(&(parameter.index, parameter.space)) {
                format!("{symbol} = {raw:08X}h")
            } else {
                format!("{symbol} = {raw}")
            }
        });
        shown.collect::<Vec<_>>().join(", ")
    }

    /// Units by the drive's own objects, a line for each kind: `position` and `3600 a turn, from 60A8h = FF410000h`.
    /// Empty if the profile defines them.
    ///
    /// # Errors
    /// What reading these objects brings.
    pub fn describe_units(&self) -> Result<Vec<(&'static str, String)>, Error> {
        let mut parameters = self.profile.parameters.iter();
        let acceleration = parameters.position(|p| is_acceleration(p.unit.quantity()));
        let acceleration = acceleration.and_then(|at| u16::try_from(at).ok()).map(ParameterId);
        let kinds = [
            ("position", self.signal_parameter_id(Signal::Position)),
            ("velocity", self.signal_parameter_id(Signal::Velocity)),
            ("acceleration", acceleration),
        ];
        let mut lines = Vec::new();
        for (kind, id) in kinds {
            let Some((id, parameter)) = id.and_then(|id| Some((id, self.parameter(id)?))) else {
                continue;
            };
            if parameter.scale.rule.is_none() {
                continue;
            }
            let one = self.value(id, 1)?;
            let text = match (self.scale_error(id), self.scale_source(id)) {
                (Some(NoScale(why)), _) => format!("none: {why} ({})", self.scale_inputs(id)),
                (None, Some(from)) if one.unit == Unit::Turn => {
                    format!("{} a turn, from {from}", rounded(1.0 / one.value))
                }
                (None, Some(from)) => {
                    format!("1 is {} {}, from {from}", rounded(one.value), one.unit.symbol())
                }
                (None, None) => continue,
            };
            lines.push((kind, text));
        }
        Ok(lines)
    }

    fn signal_parameter_id(&self, signal: Signal) -> Option<ParameterId> {
        Some(self.profile.signal(signal)?.parameter)
    }
}

fn is_acceleration(quantity: Quantity) -> bool {
    quantity == Quantity::Acceleration
}

/// A number with as many digits as a float of 32 bits has.
fn rounded(value: f64) -> f32 {
    value as f32
}
