//! Values that were read and written: signals by the profile's names, faults in words, states.

use std::cell::Cell;

use polepair_core::profile::{
    Fault as Known, ObjectKey, Parameter, ParameterId, Profile, Severity, Signal as Source,
    SignalSource,
};

use super::{AXES_MAX, anomaly};
use crate::explanation::{Explanation, StoredFrameValue, StoredValueSource};
use crate::session::{
    AnomalyKind, ChangeNotice, FaultNotice, InternedName, ObservedFrame, Quality, SessionNotice,
    SignalNotice, intern,
};

/// States, faults and factors that are remembered.
const KNOWN_MAX: usize = 4 * AXES_MAX;
/// A time that is less than before by more than this went back: a counter that wraps does not.
const WRAP: i64 = 1 << 31;

/// Known values of the axes of a link.
#[derive(Debug, Default)]
pub(super) struct ValueTracker {
    skips_signals: bool,
    profile: Option<&'static Profile>,
    /// Parameters that others are scaled by.
    factors: Vec<ParameterId>,
    /// Uses of the parameters that were seen.
    uses: Vec<ParameterUse>,
    /// Raw values of parameters that others are scaled by, of each motor of each axis.
    factor_values: Vec<((u32, u8, ObjectKey), i64)>,
    /// States of axes, by their subject.
    states: Vec<((u32, InternedName), InternedName)>,
    /// Faults that are there.
    faults: Vec<(u32, u32)>,
    /// Each drive's own time.
    times: Vec<(u32, i64)>,
}

/// Use of a parameter by the profile: looked up once, because a poll reads the same ones again and again.
#[derive(Debug)]
struct ParameterUse {
    parameter: &'static Parameter,
    /// Key of its value, if others are scaled by it.
    factor: Option<ObjectKey>,
    /// Signals that it has, with their names.
    sources: Vec<(&'static SignalSource, Option<InternedName>)>,
}

impl ParameterUse {
    fn new(
        parameter: &'static Parameter,
        profile: &'static Profile,
        factors: &[ParameterId],
    ) -> Self {
        let factor = factors.iter().find(|id| is_parameter(**id, profile, parameter));
        let sources = profile.signals.iter();
        let sources = sources.filter(|it| is_parameter(it.parameter, profile, parameter));
        Self {
            parameter,
            factor: factor.map(|id| object_key(profile, *id)),
            sources: sources.map(|source| (source, signal_name(profile, source))).collect(),
        }
    }
}

/// A value with all its properties.
#[derive(Clone, Copy)]
struct ObservedValue<'a> {
    frame_value: &'a StoredFrameValue,
    axis: u32,
    quality: Quality,
    request: Option<u64>,
}

impl ValueTracker {
    /// A tracker, without notices of values if `skips_signals`.
    pub fn new(skips_signals: bool) -> Self {
        Self { skips_signals, ..Self::default() }
    }

    /// Reports the values of a frame.
    pub fn handle_values(
        &mut self,
        observed: &ObservedFrame<'_>,
        explanation: &Explanation,
        quality: Quality,
        request: Option<u64>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let readings = explanation.frame_values();
        let (false, Some(axis)) = (readings.is_empty(), explanation.axis) else { return };
        self.set_profile(observed.profile);
        for stored_frame_value in readings {
            let found = ObservedValue { frame_value: stored_frame_value, axis, quality, request };
            match stored_frame_value.source {
                StoredValueSource::Named(_) if self.skips_signals => {}
                StoredValueSource::Named(word) => {
                    notices.push(found.signal_notice(
                        word,
                        stored_frame_value.raw as f64,
                        "",
                        quality,
                    ));
                }
                StoredValueSource::Parameter(parameter) => {
                    let sure = match quality {
                        Quality::Good if !observed.profile_stated => Quality::Inferred,
                        other => other,
                    };
                    self.report_parameter(
                        parameter,
                        ObservedValue { quality: sure, ..found },
                        notices,
                    );
                }
            }
        }
    }

    fn set_profile(&mut self, profile: Option<&'static Profile>) {
        if profile_address(self.profile) == profile_address(profile) {
            return;
        }
        self.profile = profile;
        self.uses.clear();
        let parameters =
            profile.into_iter().flat_map(|p| p.parameters.iter().map(move |one| (p, one)));
        self.factors = parameters.flat_map(|(p, one)| one.scale.inputs(p)).collect();
        self.factors.sort_unstable();
        self.factors.dedup();
    }

    fn report_parameter(
        &mut self,
        parameter: &'static Parameter,
        found: ObservedValue<'_>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let Some(profile) = self.profile else { return };
        let known = self.uses.iter().position(|it| core::ptr::eq(it.parameter, parameter));
        let at = known.unwrap_or_else(|| {
            self.uses.push(ParameterUse::new(parameter, profile, &self.factors));
            self.uses.len() - 1
        });
        if let Some(object) = self.uses[at].factor {
            let key = (found.axis, found.frame_value.motor, object);
            replace_known(&mut self.factor_values, key, found.frame_value.raw);
        }
        if self.skips_signals && self.uses[at].sources.iter().all(|(_, name)| name.is_some()) {
            return;
        }
        // After the factor was noted: a parameter may scale itself.
        let (value, unit, quality) = self.scale_value(profile, parameter, &found);
        let mut named = false;
        for index in 0..self.uses[at].sources.len() {
            let (source, name) = self.uses[at].sources[index];
            match name {
                Some(word) => {
                    named = true;
                    let word = motor_name(word, found.frame_value.motor);
                    notices.push(found.signal_notice(word, value, unit, quality));
                }
                // A written value is an order, and no state of the drive.
                None if found.quality != Quality::BadCheck && !found.frame_value.written => {
                    self.report_state(profile, parameter, source, &found, notices);
                }
                None => {}
            }
        }
        if !named {
            let word = motor_name(parameter.name, found.frame_value.motor);
            notices.push(found.signal_notice(word, value, unit, quality));
        }
    }

    /// The value in the profile's unit; raw if it depends on parameters without a known value.
    fn scale_value(
        &self,
        profile: &'static Profile,
        parameter: &'static Parameter,
        found: &ObservedValue<'_>,
    ) -> (f64, InternedName, Quality) {
        let raw = parameter.encoding.number(found.frame_value.raw);
        let scale = parameter.scale;
        if scale.is_constant() {
            return (raw * scale.factor, parameter.unit.symbol(), found.quality);
        }
        let quality = Cell::new(found.quality);
        let direction = scale.negative.map(|(parameter, _)| parameter);
        let read = |id: ParameterId| {
            // A direction that was read for an earlier value may not be the one of this value.
            if Some(id) == direction {
                return None;
            }
            let key = (found.axis, found.frame_value.motor, object_key(profile, id));
            let known = self.factor_values.iter().find(|(of, _)| *of == key);
            if let Some((_, raw)) = known {
                return Some(*raw);
            }
            // A default from a data sheet is no reading; a doubt about the value itself weighs more.
            if quality.get() == Quality::Good {
                quality.set(Quality::Inferred);
            }
            profile.parameter(id)?.default
        };
        match scale.compute(profile, parameter.encoding.is_signed(), &read) {
            Ok(scale) => (raw * scale.factor, parameter.unit.symbol(), quality.get()),
            // Without its scale the raw value has no unit; a wrong one would be worse.
            Err(_) => (raw, "", found.quality),
        }
    }

    /// Reports the state in a register's value.
    fn report_state(
        &mut self,
        profile: &'static Profile,
        parameter: &'static Parameter,
        source: &SignalSource,
        found: &ObservedValue<'_>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let masked = found.frame_value.raw & source.mask;
        let part = found.frame_value.motor;
        match source.signal {
            Source::Fault => {
                let word = motor_name("State/FaultCode", part);
                notices.push(found.signal_notice(word, masked as f64, "", found.quality));
                self.report_faults(profile, found, notices);
            }
            Source::Enabled => {
                let on = source.is_set(found.frame_value.raw);
                let word = motor_name("State/Enabled", part);
                notices.push(found.signal_notice(word, f64::from(u8::from(on)), "", found.quality));
                let state = if on { "on" } else { "off" };
                self.report_change(found.axis, motor_name("power", part), state, notices);
            }
            Source::Mode => {
                let word = motor_name("State/Mode", part);
                notices.push(found.signal_notice(word, masked as f64, "", found.quality));
                let names = source.values.iter().chain(parameter.values);
                let known = names.into_iter().find(|(value, _)| *value == masked);
                let mode =
                    known.map_or_else(|| intern(&format!("mode {masked}")), |(_, word)| word);
                self.report_change(found.axis, motor_name("mode", part), mode, notices);
            }
            Source::Time => self.check_time(found, notices),
            _ => {}
        }
    }

    fn report_change(
        &mut self,
        axis: u32,
        what: InternedName,
        to: InternedName,
        notices: &mut Vec<SessionNotice>,
    ) {
        let from = replace_known(&mut self.states, (axis, what), to).unwrap_or("");
        if from != to {
            notices.push(SessionNotice::Change(ChangeNotice { axis: Some(axis), what, from, to }));
        }
    }

    /// A drive's own time that goes back has begun anew.
    fn check_time(&mut self, found: &ObservedValue<'_>, notices: &mut Vec<SessionNotice>) {
        let (axis, now) = (found.axis, found.frame_value.raw & 0xFFFF_FFFF);
        let before = replace_known(&mut self.times, axis, now).unwrap_or(0);
        if now < before && before - now < WRAP {
            let text = format!(
                "axis {axis} counts its time from anew ({before}, then {now}): it started again"
            );
            notices.push(anomaly(AnomalyKind::Restart, Some(axis), text));
        }
    }

    /// Faults that came, and those that went.
    fn report_faults(
        &mut self,
        profile: &'static Profile,
        found: &ObservedValue<'_>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let (axis, raw) = (found.axis, found.frame_value.raw);
        let word = raw as u32;
        // Some drives report one code, others a word with a bit for each fault.
        let bits = profile.faults.iter().all(|fault| fault.code.is_power_of_two());
        let now: Vec<&'static Known> = profile
            .faults
            .iter()
            .filter(|fault| fault.severity != Severity::Note && has_fault(fault, bits, word))
            .collect();
        let code =
            |gone: u32| now.iter().any(|fault| fault.code == gone) || (!bits && gone == word);
        let (stay, gone): (Vec<_>, Vec<_>) =
            self.faults.drain(..).partition(|(of, was)| *of != axis || code(*was));
        self.faults = stay;
        for (_, code) in gone {
            let known = profile.faults.iter().find(|fault| fault.code == code);
            notices.push(fault_notice(axis, code, known, true));
        }
        let unknown = !bits && raw != 0 && now.is_empty();
        let fresh = now.iter().map(|fault| (fault.code, Some(*fault)));
        for (code, known) in fresh.chain(unknown.then_some((word, None))) {
            let there = self.faults.contains(&(axis, code));
            if !there && self.faults.len() < KNOWN_MAX {
                self.faults.push((axis, code));
                notices.push(fault_notice(axis, code, known, false));
            }
        }
    }
}

fn has_fault(fault: &Known, bits: bool, word: u32) -> bool {
    if bits { fault.code & word != 0 } else { fault.code == word }
}

fn is_parameter(id: ParameterId, profile: &Profile, parameter: &Parameter) -> bool {
    profile.parameter(id).is_some_and(|other| core::ptr::eq(other, parameter))
}

fn profile_address(profile: Option<&'static Profile>) -> Option<*const Profile> {
    profile.map(core::ptr::from_ref)
}

impl ObservedValue<'_> {
    fn signal_notice(
        &self,
        name: InternedName,
        value: f64,
        unit: InternedName,
        quality: Quality,
    ) -> SessionNotice {
        let exact = Some(self.frame_value.raw);
        let Self { axis, request, .. } = *self;
        SessionNotice::Signal(SignalNotice { axis, name, value, exact, unit, quality, request })
    }
}

/// Key of a parameter that does not depend on the order in a profile: drives of a link may have several.
fn object_key(profile: &'static Profile, id: ParameterId) -> ObjectKey {
    profile.parameter(id).map_or((0, 0), |parameter| (parameter.index, parameter.space))
}

fn signal_name(profile: &'static Profile, source: &SignalSource) -> Option<InternedName> {
    Some(match source.signal {
        Source::Position => "Actual/Position",
        Source::Velocity => "Actual/Velocity",
        // A current in the place of the torque is reported as current.
        Source::Torque if signal_parameter(Source::Current, profile) != Some(source.parameter) => {
            "Actual/Torque"
        }
        Source::Current => "Actual/Current",
        Source::Voltage => "Actual/Voltage",
        Source::Temperature => "Temp/Drive",
        Source::TargetPosition => "Setpoint/Position",
        Source::TargetVelocity => "Setpoint/Velocity",
        _ => return None,
    })
}

fn signal_parameter(signal: Source, profile: &Profile) -> Option<ParameterId> {
    profile.signal(signal).map(|source| source.parameter)
}

/// The name for one of several motors.
fn motor_name(word: InternedName, part: u8) -> InternedName {
    if part == 0 { word } else { intern(&format!("{word} {part}")) }
}

fn fault_notice(axis: u32, code: u32, known: Option<&'static Known>, gone: bool) -> SessionNotice {
    let (text, cause, remedy) = match known {
        Some(fault) => (fault.text, fault.cause, fault.remedy),
        None => (intern(&format!("fault 0x{code:04X}, which the profile does not name")), "", ""),
    };
    SessionNotice::Fault(FaultNotice { axis, code, text, cause, remedy, gone })
}

/// Sets the known value of an item, and returns the previous one.
fn replace_known<K: PartialEq, V: Copy>(known: &mut Vec<(K, V)>, of: K, value: V) -> Option<V> {
    if let Some((_, slot)) = known.iter_mut().find(|(other, _)| *other == of) {
        return Some(core::mem::replace(slot, value));
    }
    if known.len() < KNOWN_MAX {
        known.push((of, value));
    }
    None
}
