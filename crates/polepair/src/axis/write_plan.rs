//! Writes of several parameters together: each value is checked before the first one is written.

use polepair_core::error::Unsupported;
use polepair_core::profile::{Access, Parameter, ParameterId};

use super::{LocalAxis, PendingWrites};
use crate::amount::{Amount, Value, WriteValue};
use crate::error::Error;

/// A value for the parameter with a name.
#[derive(Clone, PartialEq, Debug)]
pub struct NamedValue {
    /// Our name, the maker's symbol, or an address.
    pub name: String,
    /// Value in words, in a unit, or raw.
    pub value: WriteValue,
}

/// A raw value that its parameter takes.
#[derive(Clone, Copy, Debug)]
pub struct PlannedWrite {
    /// Number of the parameter in the profile.
    pub id: ParameterId,
    /// Description of the parameter.
    pub parameter: &'static Parameter,
    /// Raw value to be written.
    pub raw: i64,
}

/// Writes in the order in which they are to be sent: those that scale others first.
#[derive(Clone, Debug, Default)]
pub struct WritePlan {
    /// Every write.
    pub writes: Vec<PlannedWrite>,
    /// All values together, which decide the scales after the writes.
    pending: PendingWrites,
}

/// Change of a parameter that a write makes.
#[derive(Clone, PartialEq, Debug)]
pub struct WriteChange {
    /// The parameter's name.
    pub name: String,
    /// Present value in [`unit`](Self::unit); `None` if it was not read, or cannot be.
    pub from: Option<f64>,
    /// `from` in words, with its unit, and the drive's own number where that is another one: `10 A (100)`.
    pub from_text: String,
    /// New value in [`unit`](Self::unit).
    pub to: f64,
    /// `to` in words, as `from_text`.
    pub to_text: String,
    /// New raw value; `None` on a gateway.
    pub raw: Option<i64>,
    /// Symbol of the unit; empty without one.
    pub unit: String,
    /// False if the present value was read and is the new one.
    pub is_changed: bool,
    /// True if the parameter can be read back.
    pub is_readable: bool,
}

impl LocalAxis {
    /// Checks values for several parameters together. A value is converted with the scale that it will have after the
    /// other writes. Nothing is written.
    ///
    /// # Errors
    /// As [`plan_write`](Self::plan_write), and `E213` for an unknown name.
    pub fn plan_writes(&self, values: &[NamedValue]) -> Result<WritePlan, Error> {
        let named = values.iter().map(|named| Ok((self.find(&named.name)?, named)));
        let mut named = named.collect::<Result<Vec<_>, Error>>()?;
        named.sort_by_key(|(id, _)| !self.scales(*id));
        let mut plan = WritePlan::default();
        for (id, NamedValue { name, value }) in named {
            plan.writes.push(self.plan_write(id, name, value, &mut plan.pending)?);
        }
        Ok(plan)
    }

    /// Checks a value for a parameter that the caller wrote as `name`, after the pending writes, and adds it to
    /// them.
    ///
    /// # Errors
    /// `E213` for an id that the drive does not have, `E214` for a parameter that can only be read, `E216` outside the
    /// limits, `E217` for a value without meaning; others by source.
    pub fn plan_write(
        &self,
        id: ParameterId,
        name: &str,
        value: &WriteValue,
        pending: &mut PendingWrites,
    ) -> Result<PlannedWrite, Error> {
        let parameter = self.required_parameter(id)?;
        if parameter.access == Access::Read {
            let what = format!("writing `{}`", parameter.name);
            return Err(self.unsupported_error(&what, Unsupported::ReadOnly(id)));
        }
        let raw = match value {
            WriteValue::Raw(raw) => *raw,
            WriteValue::Amount(Amount::Text(text)) if is_bit(parameter) && is_switch(text) => {
                i64::from(matches!(&**text, "on" | "true" | "yes"))
            }
            WriteValue::Amount(amount) => {
                let amount = self.amount_for_name(name, id, amount.clone())?;
                self.raw_of_after(id, &amount, pending)?
            }
        };
        if let Some(defect) = parameter.digit_defect(raw) {
            let what = format!("`{}` cannot be {raw}: {defect}", parameter.name);
            return Err(Error::usage("E216", what, parameter.about));
        }
        let is_raw = matches!(value, WriteValue::Raw(_));
        if !(parameter.allows(raw) || is_raw && parameter.allows_raw(raw)) {
            let what = format!(
                "`{}` takes {}, not {value}",
                parameter.name,
                self.limits_text(id, parameter)
            );
            let hint = format!("polepair params {} {:?}", self.profile.name, parameter.name);
            return Err(Error::usage("E216", what, hint));
        }
        pending.insert(id, raw);
        Ok(PlannedWrite { id, parameter, raw })
    }

    /// Caution for a raw value beyond limits that no manual states; `None` within them.
    #[must_use]
    pub fn beyond_limits(&self, write: &PlannedWrite) -> Option<String> {
        let PlannedWrite { id, parameter, raw } = *write;
        (!parameter.allows(raw)).then(|| {
            let limits = self.limits_text(id, parameter);
            let name = parameter.name;
            format!("`{name}`: {raw} raw is beyond {limits}, limits that no manual states")
        })
    }

    fn limits_text(&self, id: ParameterId, parameter: &Parameter) -> String {
        let limit = |raw| self.value(id, raw).map_or_else(|_| raw.to_string(), |v| v.to_string());
        format!("{} to {}", limit(parameter.min), limit(parameter.max))
    }

    /// The raw value of an amount, within the limits of its parameter.
    ///
    /// # Errors
    /// As [`raw_of`](Self::raw_of); `E216` outside the limits.
    pub fn raw_within_limits(&self, id: ParameterId, amount: &Amount) -> Result<i64, Error> {
        let (raw, parameter) = (self.raw_of(id, amount)?, self.required_parameter(id)?);
        if parameter.allows(raw) {
            return Ok(raw);
        }
        let what = format!("writing `{}`", parameter.name);
        let (min, max) = (parameter.min, parameter.max);
        let outside = Unsupported::OutOfRange { parameter: id, value: raw, min, max };
        Err(self.unsupported_error(&what, outside))
    }

    /// The change that a planned write makes; `reads` has the present value read for it.
    ///
    /// # Errors
    /// By source.
    pub fn planned_change(
        &self,
        plan: &WritePlan,
        write: &PlannedWrite,
        reads: bool,
    ) -> Result<WriteChange, Error> {
        let PlannedWrite { id, parameter, raw } = *write;
        let is_readable = parameter.access != Access::Write;
        let now = if reads && is_readable { Some(self.read(id)?) } else { None };
        let from = now.map(|raw| self.value(id, raw)).transpose()?;
        let to = self.value_after(id, raw, &plan.pending)?;
        Ok(WriteChange {
            name: parameter.name.to_owned(),
            from_text: from.as_ref().map_or_else(String::new, Value::text_with_own),
            from: from.map(|from| from.value).filter(|from| from.is_finite()),
            to: to.value,
            to_text: to.text_with_own(),
            raw: Some(raw),
            unit: to.unit.symbol().to_owned(),
            is_changed: now != Some(raw),
            is_readable,
        })
    }

    /// Refuses a plan with a write that may move the motor of an unarmed axis.
    ///
    /// # Errors
    /// `E219`.
    pub fn check_armed_for(&self, plan: &WritePlan) -> Result<(), Error> {
        match plan.writes.iter().find(|write| write.parameter.moves) {
            Some(write) if !self.state().armed => {
                let what = format!("writing `{}`", write.parameter.name);
                Err(self.unsupported_error(&what, Unsupported::NotArmed))
            }
            _ => Ok(()),
        }
    }
}

/// Returns whether a parameter is a bit without words of its own.
fn is_bit(parameter: &Parameter) -> bool {
    (parameter.min, parameter.max) == (0, 1) && parameter.values.is_empty()
}

fn is_switch(text: &str) -> bool {
    matches!(text, "on" | "true" | "yes" | "off" | "false" | "no")
}
