//! Mounting of a motor in its machine: travel of a turn, direction, limits.
//!
//! ```toml
//! [[link.drive]]
//! name = "x"
//! profile = "tmcm-171"
//! gear = 4                        # turns of the motor for one turn of its load
//! lead = "5 mm"                   # travel of one such turn: the axis then moves along a line
//! counts = 4096                   # counts a turn of the motor, where the profile knows no unit
//! direction = "inverted"          # the motor's forward is the machine's backward
//! limits = { position = ["0 mm", "300 mm"], velocity = "50 mm/s", torque = "2 A" }
//! ```
//!
//! Why: MOVE-5.

use crate::quantity;
use crate::toml_file::{FileError, FileLocation, Located, TomlTable};
use polepair_core::axis::Verb;
use polepair_core::plan::{Argument, Operand, Step};
use polepair_core::profile::{AxisKind, Parameter, ParameterId, Profile, Signal};
use polepair_core::units::Unit;
use std::sync::Arc;

/// Keys of a drive's table for its mounting.
pub(crate) const KEYS: [&str; 5] = ["lead", "gear", "counts", "direction", "limits"];
const LIMIT_KEYS: [&str; 3] = ["position", "velocity", "torque"];

/// Mounting of one drive from a file. Lengths and speeds are those of the machine, in SI.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Mounting {
    /// Location of the drive in the file.
    pub(crate) location: FileLocation,
    /// Travel of a turn behind the gear, m.
    pub(crate) lead: Option<f64>,
    /// Turns of the motor for one behind the gear.
    pub(crate) gear: f64,
    /// Counts a turn of the motor.
    pub(crate) counts: Option<f64>,
    /// The motor's forward is the machine's backward.
    pub(crate) inverted: bool,
    /// Least and greatest position.
    pub(crate) position: Option<Located<(f64, f64)>>,
    /// Greatest speed, either way.
    pub(crate) velocity: Option<Located<f64>>,
    /// Maximum torque in both directions, or the drive's substitute.
    pub(crate) torque: Option<Located<f64>>,
}

impl Mounting {
    /// Reads the mounting from a drive's table; `None` if it has none.
    pub(crate) fn from_table(
        node: &TomlTable<'_, '_>,
        profile: &'static Profile,
    ) -> Result<Option<Arc<Self>>, FileError> {
        if !KEYS.iter().any(|key| node.has(key)) {
            return Ok(None);
        }
        let inverted = match node.text("direction")? {
            None => false,
            Some(found) => found.try_map(|word| match word.as_str() {
                "normal" => Ok(false),
                "inverted" => Ok(true),
                other => {
                    let near = crate::spelling::suggestion(other, ["normal", "inverted"]);
                    Err(format!("`{other}` is not `normal` or `inverted`{near}"))
                }
            })?,
        };
        let mut made = Self {
            location: node.location(),
            lead: read_lead(node, profile)?,
            gear: positive_number(node, "gear")?.unwrap_or(1.0),
            counts: read_counts(node, profile)?,
            inverted,
            position: None,
            velocity: None,
            torque: None,
        };
        if let Some(limits) = node.table("limits", &LIMIT_KEYS)? {
            made.read_limits(&limits, profile)?;
        }
        Ok(Some(Arc::new(made)))
    }

    fn read_limits(
        &mut self,
        node: &TomlTable<'_, '_>,
        profile: &'static Profile,
    ) -> Result<(), FileError> {
        let linear = self.is_linear(profile);
        let (way, speed) = if linear {
            (Unit::Millimetre, Unit::MillimetrePerSecond)
        } else {
            (Unit::Degree, Unit::Rpm)
        };
        let ends = node.texts("position")?;
        if node.has("position") {
            let [low, high] = &ends[..] else {
                let reason = "`position` is two ends: [\"0 mm\", \"300 mm\"]";
                return Err(node.location().error(reason));
            };
            let place = low.location.clone();
            let value = (parse_amount(low.clone(), way)?, parse_amount(high.clone(), way)?);
            // Swapped ends would forbid every position.
            if value.0 >= value.1 {
                return Err(place.error("the first end of `position` is the lower one"));
            }
            self.position = Some(Located { value, location: place });
        }
        self.velocity = symmetric_limit(node, "velocity", speed)?;
        if node.has("torque") {
            let unit = destination(profile, Verb::Torque, Argument::Torque)
                .flatten()
                .and_then(|id| profile.parameter(id));
            let Some(unit) = unit.map(|parameter| parameter.unit) else {
                let reason = format!("`{}` takes no torque", profile.name);
                return Err(node.location().error(reason));
            };
            self.torque = symmetric_limit(node, "torque", unit)?;
        }
        Ok(())
    }

    /// Returns whether the axis goes along a line.
    pub(crate) fn is_linear(&self, profile: &Profile) -> bool {
        self.lead.is_some() || profile.axis == AxisKind::Linear
    }
}

fn read_lead(node: &TomlTable<'_, '_>, profile: &Profile) -> Result<Option<f64>, FileError> {
    let Some(found) = node.text("lead")? else { return Ok(None) };
    if profile.axis == AxisKind::Linear {
        return Err(found.location.error(format!("`{}` has no turns: it is linear", profile.name)));
    }
    let location = found.location.clone();
    let lead = parse_amount(found, Unit::Millimetre)?;
    if lead > 0.0 {
        return Ok(Some(lead));
    }
    Err(location.error("`lead` must be more than 0; `direction` inverts an axis"))
}

/// Refused where the profile knows the unit: two scales would be one too many.
fn read_counts(
    node: &TomlTable<'_, '_>,
    profile: &'static Profile,
) -> Result<Option<f64>, FileError> {
    let Some(counts) = positive_number(node, "counts")? else { return Ok(None) };
    let known = profile.signal(Signal::Position).and_then(|s| profile.parameter(s.parameter));
    match known.map(|parameter| parameter.unit) {
        Some(unit) if unit != Unit::None => {
            let (name, unit) = (profile.name, unit.symbol());
            let reason = format!("`{name}` reports its position in {unit}: leave `counts` out");
            Err(node.location().error(reason))
        }
        _ => Ok(Some(counts)),
    }
}

fn positive_number(node: &TomlTable<'_, '_>, key: &str) -> Result<Option<f64>, FileError> {
    let Some(found) = node.float(key)? else { return Ok(None) };
    found
        .try_map(|number| {
            if number > 0.0 {
                Ok(number)
            } else {
                Err(format!("`{key}` is {number}; it must be more than 0"))
            }
        })
        .map(Some)
}

/// A limit either way.
fn symmetric_limit(
    node: &TomlTable<'_, '_>,
    key: &str,
    unit: Unit,
) -> Result<Option<Located<f64>>, FileError> {
    let Some(found) = node.text(key)? else { return Ok(None) };
    let position = found.location.clone();
    let value = parse_amount(found, unit)?;
    if value > 0.0 {
        return Ok(Some(Located { value, location: position }));
    }
    Err(position.error(format!("`{key}` applies to both directions: it must be more than 0")))
}

/// An amount with a unit, as something that is shown in `unit`.
fn parse_amount(found: Located<String>, unit: Unit) -> Result<f64, FileError> {
    found.try_map(|text| {
        let measure = quantity::parse(&text).map_err(|error| error.to_string())?;
        // A bare number could be millimetres, turns or counts: in a limit that is not left to chance.
        if measure.quantity.is_none() && unit != Unit::None {
            return Err(format!("`{text}`: add a unit, such as {}", unit.symbol()));
        }
        measure.in_unit(unit).map_err(|error| {
            let hint = error.hint();
            let hint = if hint.is_empty() { String::new() } else { format!("; {hint}") };
            format!("`{text}`: {error}{hint}")
        })
    })
}

/// Destination of an argument in a plan: a parameter or, inner `None`, a request of its own. `None` if the plan does
/// not use it.
pub(crate) fn destination(
    profile: &Profile,
    verb: Verb,
    which: Argument,
) -> Option<Option<ParameterId>> {
    find_operand(profile, verb, which).map(|(_, id)| id)
}

/// Returns whether a plan writes the time of a ramp for an argument that is an acceleration.
pub(crate) fn is_ramp_time(profile: &Profile, verb: Verb, which: Argument) -> bool {
    let found = find_operand(profile, verb, which);
    matches!(found, Some((Operand::OptionalRampTime { .. }, _)))
}

fn find_operand(
    profile: &Profile,
    verb: Verb,
    which: Argument,
) -> Option<(Operand, Option<ParameterId>)> {
    let mut operands = profile.plan(verb)?.steps.iter().flat_map(Step::operands);
    operands.find(|(operand, _)| operand.argument() == Some(which))
}

/// Role of a parameter in the motion of its axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum MotionRole {
    /// A position, or how far.
    Position,
    /// A velocity; its sign is the direction.
    Velocity,
    /// Speed in either direction.
    Speed,
    /// Change of the speed.
    Acceleration,
    /// A torque, or its substitute.
    Torque,
}

impl MotionRole {
    /// Role of a verb's argument.
    pub(crate) fn of_argument(
        verb: Verb,
        which: Argument,
        written: Option<&Parameter>,
    ) -> Option<Self> {
        Some(match which {
            Argument::Target => Self::Position,
            // Some drives search for their reference backwards at a negative speed.
            Argument::Velocity if verb == Verb::Home => match written {
                Some(parameter) if parameter.min < 0 => Self::Velocity,
                _ => Self::Speed,
            },
            Argument::Velocity if verb == Verb::Velocity => Self::Velocity,
            Argument::Velocity => Self::Speed,
            Argument::Acceleration | Argument::Deceleration => Self::Acceleration,
            Argument::Torque => Self::Torque,
            Argument::JerkTime | Argument::Period | Argument::Path => return None,
        })
    }

    /// Returns whether the sign is turned with the direction of the axis.
    const fn is_signed(self) -> bool {
        matches!(self, Self::Position | Self::Velocity | Self::Torque)
    }

    /// The units in which it is shown, along a line and turning.
    const fn units(self) -> Option<(Unit, Unit)> {
        match self {
            Self::Position => Some((Unit::Millimetre, Unit::Degree)),
            Self::Velocity | Self::Speed => Some((Unit::MillimetrePerSecond, Unit::Rpm)),
            Self::Acceleration => Some((Unit::MillimetrePerSecondSquared, Unit::RpmPerSecond)),
            Self::Torque => None,
        }
    }
}

/// Roles of a profile's motion parameters. All others are not touched by a mounting: they keep the motor's own unit.
pub(crate) fn motion_roles(profile: &Profile) -> Vec<(ParameterId, MotionRole)> {
    let mut roles: Vec<(ParameterId, MotionRole)> = Vec::new();
    let mut note = |id: ParameterId, role| {
        if roles.iter().all(|(other, _)| *other != id) {
            roles.push((id, role));
        }
    };
    for source in profile.signals.iter().filter(|s| !s.is_flag() && s.mask == -1) {
        match source.signal {
            Signal::Position | Signal::TargetPosition => {
                note(source.parameter, MotionRole::Position)
            }
            Signal::Velocity | Signal::TargetVelocity => {
                note(source.parameter, MotionRole::Velocity)
            }
            Signal::Torque => note(source.parameter, MotionRole::Torque),
            Signal::Current if is_torque_substitute(profile, source.parameter) => {
                note(source.parameter, MotionRole::Torque);
            }
            _ => {}
        }
    }
    // A speed that one verb gives a sign has one.
    let signed_first = Verb::ALL.into_iter().filter(|verb| *verb == Verb::Velocity);
    for verb in signed_first.chain(Verb::ALL) {
        for which in ARGUMENTS.into_iter().filter(|which| verb.accepts(*which)) {
            let Some(Some(id)) = destination(profile, verb, which) else { continue };
            if let Some(role) = MotionRole::of_argument(verb, which, profile.parameter(id)) {
                note(id, role);
            }
        }
    }
    roles
}

/// Returns whether a drive is given this current where others are given a torque: its sign is then that of the torque.
fn is_torque_substitute(profile: &Profile, current: ParameterId) -> bool {
    let given = destination(profile, Verb::Torque, Argument::Torque).flatten();
    given.is_some_and(|given| parameter_unit(given, profile) == parameter_unit(current, profile))
}

fn parameter_unit(id: ParameterId, profile: &Profile) -> Option<Unit> {
    profile.parameter(id).map(|parameter| parameter.unit)
}

pub(crate) const ARGUMENTS: [Argument; 5] = [
    Argument::Target,
    Argument::Velocity,
    Argument::Acceleration,
    Argument::Deceleration,
    Argument::Torque,
];

/// A mounting with its meaning for the parameters of one profile.
#[derive(Debug)]
pub(crate) struct ResolvedMounting {
    pub(crate) mounting: Arc<Mounting>,
    linear: bool,
    roles: Vec<(ParameterId, MotionRole)>,
}

impl ResolvedMounting {
    pub(crate) fn new(mounting: Arc<Mounting>, profile: &'static Profile) -> Self {
        let linear = mounting.is_linear(profile);
        Self { mounting, linear, roles: motion_roles(profile) }
    }

    pub(crate) fn role(&self, id: ParameterId) -> Option<MotionRole> {
        self.roles.iter().find(|(other, _)| *other == id).map(|(_, role)| *role)
    }

    /// Returns whether a value of that unit is scaled here: a share of the whole is not.
    fn scales(&self, role: MotionRole, unit: Unit) -> bool {
        let Some((linear, _)) = role.units() else { return false };
        match unit {
            Unit::None => self.mounting.counts.is_some(),
            unit => unit.quantity() == linear.quantity(),
        }
    }

    /// Displayed unit of a value whose profile states `unit`.
    pub(crate) fn unit(&self, role: MotionRole, unit: Unit) -> Unit {
        let Some((linear, rotary)) = role.units().filter(|_| self.scales(role, unit)) else {
            return unit;
        };
        match (self.linear, unit) {
            (true, _) => linear,
            (false, Unit::None) => rotary,
            (false, unit) => unit,
        }
    }

    /// Factor from a value of the machine to the drive's, both in SI.
    pub(crate) fn factor(&self, role: MotionRole, unit: Unit) -> f64 {
        const TURN: f64 = core::f64::consts::TAU;
        let Mounting { lead, gear, counts, inverted, .. } = &*self.mounting;
        let (lead, gear, counts, inverted) = (*lead, *gear, *counts, *inverted);
        // A magnitude has no direction that could be inverted.
        let sign = if inverted && role.is_signed() { -1.0 } else { 1.0 };
        if !self.scales(role, unit) {
            return sign;
        }
        let counts = counts.filter(|_| unit == Unit::None);
        debug_assert!(gear > 0.0 && lead.is_none_or(|lead| lead > 0.0));
        sign * gear * lead.map_or(1.0, |lead| TURN / lead) * counts.map_or(1.0, |c| c / TURN)
    }
}

#[cfg(test)]
mod tests;
