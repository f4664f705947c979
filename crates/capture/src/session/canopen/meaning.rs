//! The meaning of an object: signal name, unit, scale, sign.

use std::collections::HashMap;

use polepair_core::profile::{Encoding, ParameterId, Profile, Signal};
use polepair_core::proto::canopen::explain::meanings;
use polepair_core::proto::canopen::sdo::ObjectIndex;

use crate::session::{InternedName, intern};

/// Values of objects that are kept of one node, for scales that hang on them.
pub(super) const VALUES_MAX: usize = 1024;

/// One reading of an object: the number, or a flag in it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct ObjectMeaning {
    pub name: InternedName,
    pub unit: InternedName,
    pub factor: f64,
    pub signed: bool,
    /// Encoding of a floating-point number; `None` for an integer.
    pub real: Option<Encoding>,
    /// Bits that count.
    pub mask: i64,
    /// Value at which the flag is set; `None` for a number.
    pub equals: Option<i64>,
}

impl ObjectMeaning {
    /// The number that an integer on the wire is, in the unit.
    pub fn value(&self, exact: i64) -> f64 {
        self.real.map_or(exact as f64, |encoding| encoding.number(exact)) * self.factor
    }
}

/// Source of the meanings of a node's objects.
#[derive(Clone, Copy)]
pub(super) struct ObjectLookup<'a> {
    pub profile: Option<&'static Profile>,
    /// Last known values of the node's objects.
    pub values: &'a HashMap<ObjectIndex, i64>,
}

impl ObjectLookup<'_> {
    /// The number that an object is, and then the flags in it that are signals.
    pub fn meanings(&self, object: ObjectIndex) -> Vec<ObjectMeaning> {
        let mut all = vec![self.number_meaning(object)];
        all.extend(self.enabled_flag(object));
        all
    }

    /// Meaning of an object as a number.
    pub fn number_meaning(&self, object: ObjectIndex) -> ObjectMeaning {
        let (unit, factor) = self.scale(object).unwrap_or(("", 1.0));
        let signed = meanings::is_signed(object, self.profile);
        ObjectMeaning {
            name: self.object_name(object),
            unit,
            factor,
            signed,
            real: self.real_encoding(object),
            mask: -1,
            equals: None,
        }
    }

    fn real_encoding(&self, object: ObjectIndex) -> Option<Encoding> {
        let (profile, id) = self.parameter(object)?;
        profile.parameter(id).map(|p| p.encoding).filter(|encoding| encoding.is_real())
    }

    /// The flag of a statusword that the motor is powered.
    fn enabled_flag(&self, object: ObjectIndex) -> Option<ObjectMeaning> {
        let (mask, equals) = match meanings::canopen_profile(self.profile) {
            Some(profile) => {
                let source = profile.signal(Signal::Enabled)?;
                let from = profile.parameter(source.parameter)?;
                let here = ObjectIndex::new(from.index, from.space) == object;
                (source.mask, source.equals.filter(|_| here)?)
            }
            None if object == ObjectIndex::new(0x6041, 0) => (0x6F, 0x27),
            None => return None,
        };
        let name = "State/Enabled";
        Some(ObjectMeaning {
            name,
            unit: "",
            factor: 1.0,
            signed: false,
            real: None,
            mask,
            equals: Some(equals),
        })
    }

    /// `Actual/Position` where the object is an axis' signal, else the parameter's or the standard's
    /// name, else its number.
    fn object_name(&self, object: ObjectIndex) -> InternedName {
        let ObjectIndex { index, sub } = object;
        if let Some((profile, id)) = self.parameter(object) {
            let source = profile
                .signals
                .iter()
                .find(|s| s.parameter == id && s.mask == -1 && s.equals.is_none());
            let word = source.and_then(|source| axis_signal_name(source.signal));
            // Profiles have no signal for it.
            let torque = (object == TARGET_TORQUE).then_some("Setpoint/Torque");
            return word.or(torque).unwrap_or(profile.parameters[usize::from(id.0)].name);
        }
        let known = CIA402_NAMES.iter().find(|(known, _)| *known == index && sub == 0);
        match (known, meanings::object_name(object, self.profile)) {
            (Some((_, word)), _) => word,
            (None, "") => intern(&format!("0x{index:04X}:{sub}")),
            (None, standard) if sub == 0 => standard,
            (None, standard) => intern(&format!("{standard} 0x{index:04X}:{sub}")),
        }
    }

    fn parameter(&self, object: ObjectIndex) -> Option<(&'static Profile, ParameterId)> {
        let profile = meanings::canopen_profile(self.profile)?;
        let at =
            profile.parameters.iter().position(|p| ObjectIndex::new(p.index, p.space) == object)?;
        Some((profile, ParameterId(at as u16)))
    }

    /// Unit and factor; none while what the scale hangs on is not known.
    fn scale(&self, object: ObjectIndex) -> Option<(InternedName, f64)> {
        let (profile, id) = self.parameter(object)?;
        let parameter = profile.parameter(id)?;
        let read = |id: ParameterId| {
            let of = profile.parameter(id)?;
            self.values.get(&ObjectIndex::new(of.index, of.space)).copied()
        };
        let signed = parameter.encoding.is_signed();
        let scale = parameter.scale.compute(profile, signed, &read).ok()?;
        Some((parameter.unit.symbol(), scale.factor))
    }
}

/// The word for a signal of an axis; `None` for those that are no number.
const fn axis_signal_name(signal: Signal) -> Option<InternedName> {
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

const TARGET_TORQUE: ObjectIndex = ObjectIndex::new(0x6071, 0);

/// Meanings of CiA 402's objects, without a profile.
const CIA402_NAMES: [(u16, InternedName); 11] = [
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
