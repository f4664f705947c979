//! The factor from raw values to a unit.

use super::{ParameterId, Profile};
use crate::plan::ParameterTest;

/// From raw to the parameter's unit: value = raw × factor × P(times) ÷ P(over) × rule.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Scale {
    /// Constant part.
    pub factor: f64,
    /// A parameter of the same drive that multiplies it.
    pub times: Option<ParameterId>,
    /// A parameter of the same drive that divides it.
    pub over: Option<ParameterId>,
    /// A standard's rule that computes the rest from further objects.
    pub rule: Option<&'static ScaleRule>,
    /// The value is negative while this test passes: of a drive with a magnitude and a direction beside it.
    pub negative: Option<(ParameterId, ParameterTest)>,
}

impl Scale {
    /// Raw is the value.
    pub const ONE: Self = Self { factor: 1.0, times: None, over: None, rule: None, negative: None };

    /// Returns whether it depends on no other parameter.
    #[must_use]
    pub const fn is_constant(&self) -> bool {
        self.times.is_none()
            && self.over.is_none()
            && self.rule.is_none()
            && self.negative.is_none()
    }

    /// The parameters of `profile` that it depends on.
    pub fn inputs(self, profile: &'static Profile) -> impl Iterator<Item = ParameterId> + use<> {
        let objects = self.rule.map_or(&[][..], |rule| rule.objects).iter();
        let by_rule = objects.filter_map(|object| profile.find_object(*object));
        let sign = self.negative.map(|(parameter, _)| parameter);
        [self.times, self.over, sign].into_iter().flatten().chain(by_rule)
    }

    /// The factor from raw to the parameter's unit. `read` gives the raw value of an input, `None` where
    /// the drive lacks it; `signed` is whether the parameter's raw values have a sign.
    ///
    /// # Errors
    /// [`NoScale`]: an input is missing or zero, or the inputs contradict each other.
    pub fn compute(
        self,
        profile: &'static Profile,
        signed: bool,
        read: &dyn Fn(ParameterId) -> Option<i64>,
    ) -> Result<ScaleRuleValue, NoScale> {
        let part = |id: Option<ParameterId>| match id {
            None => Ok(1.0),
            Some(id) => match read(id) {
                None | Some(0) => Err(NoScale("the setting that scales it is missing or zero")),
                Some(raw) => Ok(raw as f64),
            },
        };
        let sign = match self.negative {
            None => 1.0,
            Some((parameter, test)) => match read(parameter) {
                None => return Err(NoScale("the parameter with its direction is missing")),
                Some(raw) if test.passes(raw) => -1.0,
                Some(_) => 1.0,
            },
        };
        let plain = sign * self.factor * part(self.times)? / part(self.over)?;
        let Some(rule) = self.rule else { return Ok(ScaleRuleValue { factor: plain, from: &[] }) };
        let by_rule = (rule.compute)(&|key| profile.find_object(key).and_then(read), signed)?;
        Ok(ScaleRuleValue { factor: plain * by_rule.factor, ..by_rule })
    }
}

/// Index and space of a parameter: on CANopen index and sub-index.
pub type ObjectKey = (u16, u8);

/// Computes a factor from what reads objects. The flag is whether the scaled parameter has a sign.
pub type ComputeScale =
    fn(&dyn Fn(ObjectKey) -> Option<i64>, bool) -> Result<ScaleRuleValue, NoScale>;

/// A scale that a standard computes from several objects of the drive.
pub struct ScaleRule {
    /// The word in profiles: `cia402-position`.
    pub name: &'static str,
    /// The objects that it reads. A missing object counts as absent.
    pub objects: &'static [ObjectKey],
    /// Objects among them that are words of bytes, which people write in hexadecimal.
    pub words: &'static [ObjectKey],
    /// For a stepper motor: the full steps per turn that the rule assumes, and the object with the real
    /// number, where a drive has it.
    pub full_steps: Option<(f64, ObjectKey)>,
    /// The factor, of the raw values of these objects.
    pub compute: ComputeScale,
}

impl PartialEq for ScaleRule {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl core::fmt::Debug for ScaleRule {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name)
    }
}

/// The result of a scale rule.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ScaleRuleValue {
    /// From raw to the parameter's unit.
    pub factor: f64,
    /// The objects that a rule computed it from.
    pub from: &'static [ObjectKey],
}

/// Reason why a value has no unit, in words.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NoScale(pub &'static str);
