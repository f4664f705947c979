//! Arguments of verbs: converts units and raw numbers to the operands of a plan.

use super::LocalAxis;
use crate::amount::Amount;
use crate::error::Error;
use crate::profile::argument_word;
use crate::{mounting, paths, quantity};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::{Argument, Operand, Step};
use polepair_core::profile::{AxisKind, Parameter};
use polepair_core::units::Unit;

impl LocalAxis {
    /// The SI value of a verb's argument: text must have a unit that fits the drive's parameter.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217`, also for text where the profile does not have the parameter's unit; `E218` where the
    /// drive carries out the verb without such an argument.
    pub fn argument(&self, verb: Verb, which: Argument, amount: &Amount) -> Result<f64, Error> {
        let planned = self.profile.plan(verb).is_some();
        if planned && mounting::destination(self.profile, verb, which).is_none() {
            let (label, name) = (self.label(), verb.name());
            let word = argument_word(which);
            let what = format!("{label}: {name}: {} takes no {word} with it", self.profile.name);
            return Err(Error::usage("E218", what, "leave it out"));
        }
        let Amount::Text(text) = amount else { return amount.in_si(self.unit_of(verb, which)) };
        self.check_scale(verb, which, text)?;
        if let Some(turned) = self.turn_of_length(verb, which, text)? {
            return Ok(turned);
        }
        let value = amount.in_si(self.unit_of(verb, which))?;
        if value != 0.0 {
            self.check_unit(verb, which, text)?;
        }
        Ok(value)
    }

    /// The turn of the motor, SI, for a length along mechanics whose travel the drive stores (TS manual V2 §2.6.2,
    /// Fn_205 and Fn_206). `None` for anything else, and where a file mounts the axis.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` where the travel is that of the factory, which is none in mm; reading it.
    pub fn turn_of_length(
        &self,
        verb: Verb,
        which: Argument,
        text: &str,
    ) -> Result<Option<f64>, Error> {
        let Some(unit) = self.unit_of(verb, which).filter(|unit| !unit.is_linear()) else {
            return Ok(None);
        };
        let measure = quantity::parse(text)?;
        let is_length = measure.linear && measure.quantity == Some(unit.quantity());
        if !is_length || self.own_mounting().is_some() {
            return Ok(None);
        }
        let Some([turns, travel]) = paths::mechanics(self)? else { return Ok(None) };
        // The drive does not store whether its travel is in mm or degrees: the factory's is a turn of 360.
        if travel <= 0 || turns <= 0 || travel == 360 * turns {
            let what = format!(
                "{}: Fn_205 = {turns} and Fn_206 = {travel} are no travel in mm, so {text} is no turn of \
                 the motor",
                self.label()
            );
            let hint = "set Fn_205 (motor turns) and Fn_206 (mm that the mechanics move in them), \
                        or give an angle";
            return Err(Error::usage("E217", what, hint));
        }
        #[allow(clippy::cast_precision_loss, reason = "the registers have 16 bits")]
        let per_metre = turns as f64 * std::f64::consts::TAU / (travel as f64 / 1000.0);
        Ok(Some(measure.si * per_metre))
    }

    /// Refuses a value with a unit for an argument that has none by the drive's own objects.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217`.
    pub fn check_scale(&self, verb: Verb, which: Argument, text: &str) -> Result<(), Error> {
        let has_unit = quantity::parse(text)?.quantity.is_some();
        let id = mounting::destination(self.profile, verb, which).flatten();
        match id.filter(|_| has_unit).and_then(|id| self.unit_problem(id)) {
            Some(what) => Err(Error::usage("E217", what, "give the drive's own number (--raw)")),
            None => Ok(()),
        }
    }

    /// Refuses a value for an argument without a unit in the profile: its size is unknown.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217`.
    pub fn check_unit(&self, verb: Verb, which: Argument, text: &str) -> Result<(), Error> {
        let Some(parameter) = self.destination(verb, which).flatten() else { return Ok(()) };
        let known = self.mounted_unit(verb, which, parameter.unit) != Unit::None;
        if known || matches!(which, Argument::JerkTime | Argument::Period | Argument::Path) {
            return Ok(());
        }
        let (name, profile) = (parameter.name, self.profile.name);
        let what =
            format!("the profile {profile} does not state the unit of `{name}`: what is {text}?");
        let hint = "give the drive's own number (--raw), or state unit and scale in the profile";
        Err(Error::usage("E217", what, hint))
    }

    /// The SI value of a verb's argument that is given as the drive's own number.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` where the verb has no parameter for it, or its scale is not known; what
    /// reading the parameters brings that the scale depends on.
    pub fn raw_argument(&self, verb: Verb, which: Argument, raw: i64) -> Result<f64, Error> {
        let id = mounting::destination(self.profile, verb, which).flatten();
        let id = id.ok_or_else(|| self.refused_argument("accepts no raw number there", verb))?;
        let value = self.value(id, raw)?;
        let si = value.value * value.unit.si_factor();
        if si.is_finite() {
            Ok(si)
        } else {
            Err(self.refused_argument("has a value with an unknown scale", verb))
        }
    }

    /// Refuses an S-time of half the acceleration time or more: the drive would refuse it in the middle of the plan.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` with both times.
    pub(super) fn check_s_time(&self, command: &Command) -> Result<(), Error> {
        let plan = self.profile.plan(command.verb);
        let (Some(s_time), Some(plan)) = (command.jerk_time, plan) else { return Ok(()) };
        let (mut ramp, mut is_limited) = (None, false);
        for step in plan.steps {
            let Step::Write(id, operand) = *step else { continue };
            let Some(parameter) = self.profile.parameter(id) else { continue };
            match operand {
                Operand::Constant(raw) if parameter.name.ends_with(" acceleration time") => {
                    ramp = Some(raw as f64 * parameter.unit.si_factor());
                }
                Operand::OptionalRampTime { argument: Argument::Acceleration, speed } => {
                    let rate = command.acceleration.filter(|rate| *rate > 0.0 && !command.raw);
                    ramp = rate.map(|rate| speed.of(command.velocity) / rate).or(ramp);
                }
                Operand::Argument(Argument::JerkTime) => {
                    is_limited = parameter.name.ends_with(" s-time");
                }
                _ => {}
            }
        }
        match ramp.filter(|ramp| is_limited && s_time >= ramp / 2.0) {
            None => Ok(()),
            Some(ramp) => {
                let (s_ms, ramp_ms) = ((s_time * 1e3).round(), (ramp * 1e3).round());
                let what = format!(
                    "{}: an S-time of {s_ms} ms needs a ramp of more than {} ms, and this one takes \
                     {ramp_ms} ms",
                    self.label(),
                    s_ms * 2.0
                );
                Err(Error::usage(
                    "E217",
                    what,
                    "a slower acceleration (--acc), or a shorter S-time",
                ))
            }
        }
    }

    fn refused_argument(&self, why: &str, verb: Verb) -> Error {
        let what = format!("{}: {} {why}", self.label(), verb.name());
        Error::usage("E217", what, "give it with a unit")
    }

    /// Objects that a drive with a data sheet lacks for a verb of its family, or for one of its arguments: `6099h:1
    /// (homing speed switch)`. Empty if none is known to be missing.
    #[must_use]
    pub fn missing_for(&self, verb: Verb, which: Option<Argument>) -> String {
        let family =
            polepair_drives::profiles().iter().find(|profile| profile.name == self.profile.family);
        let Some((family, plan)) = family.and_then(|family| Some((family, family.plan(verb)?)))
        else {
            return String::new();
        };
        let needed = plan.steps.iter().filter_map(|step| match (*step, which) {
            (Step::Write(id, operand), Some(which)) => {
                (operand.argument() == Some(which)).then_some(id)
            }
            (
                Step::Write(
                    id,
                    Operand::Constant(_) | Operand::Argument(_) | Operand::Magnitude(_),
                )
                | Step::Require { read: id, .. }
                | Step::Until { read: id, .. }
                | Step::Homed { read: id, .. },
                None,
            ) => Some(id),
            _ => None,
        });
        let mut missing = Vec::new();
        for parameter in needed.filter_map(|id| family.parameter(id)) {
            let key = (parameter.index, parameter.space);
            let text = format!("{} ({})", parameter.symbol, parameter.name);
            if self.profile.find_object(key).is_none() && !missing.contains(&text) {
                missing.push(text);
            }
        }
        missing.join(", ")
    }

    /// The unit in which an argument of a verb is shown and, where none is given, meant: that of the
    /// parameter which the plan writes, or the machine's where a file mounts the axis. `None` when
    /// the verb has no use for it.
    #[must_use]
    pub fn unit_of(&self, verb: Verb, which: Argument) -> Option<Unit> {
        let id = mounting::destination(self.profile, verb, which)?;
        if id.is_some_and(|id| self.is_unscaled(id)) {
            return Some(Unit::None);
        }
        let parameter = id.and_then(|id| self.parameter(id));
        let unit = if mounting::is_ramp_time(self.profile, verb, which) {
            Unit::RpmPerSecond
        } else {
            parameter.map_or(Unit::None, |parameter| parameter.unit)
        };
        let unit = self.mounted_unit(verb, which, unit);
        Some(if unit == Unit::None { customary_unit(self.profile.axis, which) } else { unit })
    }

    /// Destination of an argument in a plan: a parameter or, inner `None`, a request of its own. `None` if the plan
    /// does not use it.
    #[must_use]
    pub fn destination(&self, verb: Verb, which: Argument) -> Option<Option<&'static Parameter>> {
        let id = mounting::destination(self.profile, verb, which)?;
        Some(id.and_then(|id| self.parameter(id)))
    }
}

/// Customary unit for an axis of that kind.
const fn customary_unit(kind: AxisKind, argument: Argument) -> Unit {
    match (kind, argument) {
        (AxisKind::Rotary, Argument::Target) => Unit::Degree,
        (AxisKind::Rotary, Argument::Velocity) => Unit::Rpm,
        (AxisKind::Rotary, Argument::Acceleration | Argument::Deceleration) => Unit::RpmPerSecond,
        (AxisKind::Linear, Argument::Target) => Unit::Millimetre,
        (AxisKind::Linear, Argument::Velocity) => Unit::MillimetrePerSecond,
        (AxisKind::Linear, Argument::Acceleration | Argument::Deceleration) => {
            Unit::MillimetrePerSecondSquared
        }
        (AxisKind::Ratio, Argument::Target) => Unit::Percent,
        (_, Argument::JerkTime | Argument::Period) => Unit::Second,
        _ => Unit::None,
    }
}
