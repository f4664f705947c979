//! The source of a value's unit, or the reason why it has none.

use super::LocalAxis;
use crate::error::Error;
use crate::url::AxisNumber;
use polepair_core::error::Unsupported;
use polepair_core::profile::{NoScale, Parameter, ParameterId, Scale, Signal};
use polepair_core::units::{Quantity, Unit};

/// Reads of a parameter that scales others until two agree.
const FACTOR_READS_MAX: usize = 3;

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

    /// Scales of a group that may not be asked, on RS-485, from the axes that are named besides.
    fn adopt_scales(&self, parameter: &'static Parameter) {
        let mut named = Vec::new();
        self.connection
            .with_axes(|axes, _| axes.visit_axes_alike(self.index, &mut |index| named.push(index)));
        for index in named {
            let named = Self { index, ..self.clone() };
            let mut inputs = parameter.scale.inputs(self.profile);
            // An axis that does not reply has no scale, and then none is adopted.
            let _ = inputs.try_for_each(|id| named.read_optional(id).map(drop));
        }
        self.connection.with_axes(|axes, _| axes.adopt_scales(self.index));
    }

    pub(super) fn read_factors(&self, parameter: &'static Parameter) -> Result<(), Error> {
        // A value that may belong to another request counts once it is read twice.
        for _ in 0..FACTOR_READS_MAX {
            let mut inputs = parameter.scale.inputs(self.profile);
            let read = inputs.try_for_each(|id| self.read_optional(id).map(drop));
            if read.is_err() && AxisNumber(self.number).is_group() {
                self.adopt_scales(parameter);
                if self.knows_factors(parameter) {
                    break;
                }
            }
            read?;
            if self.knows_factors(parameter) {
                break;
            }
        }
        Ok(())
    }

    /// The value of a reading; `None` for a group whose drives may not be asked: on RS-485 the answers would collide.
    ///
    /// # Errors
    /// That of the reading.
    pub fn unless_forbidden<T>(&self, read: Result<T, Error>) -> Result<Option<T>, Error> {
        let is_forbidden = |error: &Error| {
            matches!(error, Error::Unsupported { why: Unsupported::Forbidden(_), .. })
        };
        match read {
            Err(error) if AxisNumber(self.number).is_group() && is_forbidden(&error) => Ok(None),
            read => read.map(Some),
        }
    }

    pub(crate) fn read_unread_factors(&self, parameter: &'static Parameter) -> Result<(), Error> {
        if self.knows_factors(parameter) { Ok(()) } else { self.read_factors(parameter) }
    }

    pub(crate) fn knows_factors(&self, parameter: &'static Parameter) -> bool {
        let id = self.profile.parameters.iter().position(|p| std::ptr::eq(p, parameter));
        let id = id.and_then(|n| u16::try_from(n).ok()).map(ParameterId);
        let known =
            id.and_then(|id| self.connection.with_axes(|axes, _| axes.to_si(self.index, id, 0)));
        known.is_some()
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
