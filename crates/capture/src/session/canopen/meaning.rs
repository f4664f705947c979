//! What an object is: its name as a signal, its unit, its scale and its sign.

use std::collections::HashMap;

use polepair_core::profile::{Parameter, ParameterId, Profile, Signal};
use polepair_core::proto::canopen::explain::say;
use polepair_core::proto::canopen::sdo::Object;

use crate::session::{Name, name};

/// Values of objects that are kept of one node, for scales that hang on them.
pub(super) const VALUES_MAX: usize = 1024;

/// One reading of an object: the number, or a flag in it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Meaning {
    pub name: Name,
    pub unit: Name,
    pub factor: f64,
    pub signed: bool,
    /// Bits that count.
    pub mask: i64,
    /// What they are where the flag is set; `None` for a number.
    pub equals: Option<i64>,
}

/// Where the meaning of a node's objects is looked up.
#[derive(Clone, Copy)]
pub(super) struct Book<'a> {
    pub profile: Option<&'static Profile>,
    /// What the node's objects were last seen to be.
    pub values: &'a HashMap<Object, i64>,
}

impl Book<'_> {
    /// The number that an object is, and then the flags in it that are signals.
    pub fn meanings(&self, object: Object) -> Vec<Meaning> {
        let mut all = vec![self.number(object)];
        all.extend(self.enabled(object));
        all
    }

    /// What an object is as a number.
    pub fn number(&self, object: Object) -> Meaning {
        let (unit, factor) = self.scale(object).unwrap_or(("", 1.0));
        let signed = say::signed(object, self.profile);
        Meaning { name: self.name(object), unit, factor, signed, mask: -1, equals: None }
    }

    /// The flag of a statusword that the motor is powered.
    fn enabled(&self, object: Object) -> Option<Meaning> {
        let (mask, equals) = match say::own(self.profile) {
            Some(profile) => {
                let source = profile.signal(Signal::Enabled)?;
                let from = profile.parameter(source.parameter)?;
                let here = Object::new(from.index, from.space) == object;
                (source.mask, source.equals.filter(|_| here)?)
            }
            None if object == Object::new(0x6041, 0) => (0x6F, 0x27),
            None => return None,
        };
        let name = "State/Enabled";
        Some(Meaning { name, unit: "", factor: 1.0, signed: false, mask, equals: Some(equals) })
    }

    /// `Actual/Position` where the object is an axis' signal, else the parameter's or the standard's
    /// name, else its number.
    fn name(&self, object: Object) -> Name {
        let Object { index, sub } = object;
        if let Some((profile, id)) = self.parameter(object) {
            let whole = |s: &&polepair_core::profile::SignalSource| {
                s.parameter == id && s.mask == -1 && s.equals.is_none()
            };
            let source = profile.signals.iter().find(whole);
            let word = source.and_then(|source| word(source.signal));
            // Profiles have no signal for it.
            let torque = (object == TARGET_TORQUE).then_some("Setpoint/Torque");
            return word.or(torque).unwrap_or(profile.parameters[usize::from(id.0)].name);
        }
        let known = STANDARD.iter().find(|(known, _)| *known == index && sub == 0);
        match (known, say::name(object, self.profile)) {
            (Some((_, word)), _) => word,
            (None, "") => name(&format!("0x{index:04X}:{sub}")),
            (None, standard) if sub == 0 => standard,
            (None, standard) => name(&format!("{standard} 0x{index:04X}:{sub}")),
        }
    }

    fn parameter(&self, object: Object) -> Option<(&'static Profile, ParameterId)> {
        let profile = say::own(self.profile)?;
        let same = |p: &Parameter| Object::new(p.index, p.space) == object;
        let at = profile.parameters.iter().position(same)?;
        Some((profile, ParameterId(at as u16)))
    }

    /// Unit and factor; none while what the scale hangs on is not known.
    fn scale(&self, object: Object) -> Option<(Name, f64)> {
        let (profile, id) = self.parameter(object)?;
        let parameter = profile.parameter(id)?;
        let value = |id: Option<ParameterId>| match id.and_then(|id| profile.parameter(id)) {
            None => Some(1.0),
            Some(of) => self.values.get(&Object::new(of.index, of.space)).map(|v| *v as f64),
        };
        let scale = &parameter.scale;
        let factor = scale.factor * value(scale.times)? / value(scale.over)?;
        factor.is_finite().then_some((parameter.unit.symbol(), factor))
    }
}

/// The word for a signal of an axis; `None` for those that are no number.
const fn word(signal: Signal) -> Option<Name> {
    Some(match signal {
        Signal::Position => "Actual/Position",
        Signal::Velocity => "Actual/Velocity",
        Signal::Torque => "Actual/Torque",
        Signal::Current => "Actual/Current",
        Signal::Voltage => "Actual/Voltage",
        Signal::Temperature => "Temp/Drive",
        Signal::TargetPosition => "Setpoint/Position",
        Signal::TargetVelocity => "Setpoint/Velocity",
        Signal::Fault => "State/FaultCode",
        Signal::Mode => "State/Mode",
        _ => return None,
    })
}

const TARGET_TORQUE: Object = Object::new(0x6071, 0);

/// What CiA 402's objects are, where no profile says.
const STANDARD: [(u16, Name); 11] = [
    (0x603F, "State/FaultCode"),
    (0x6061, "State/Mode"),
    (0x6064, "Actual/Position"),
    (0x606C, "Actual/Velocity"),
    (0x6071, "Setpoint/Torque"),
    (0x6077, "Actual/Torque"),
    (0x6078, "Actual/Current"),
    (0x6079, "Actual/Voltage"),
    (0x607A, "Setpoint/Position"),
    (0x60FF, "Setpoint/Velocity"),
    (0x6044, "Actual/Velocity"),
];
