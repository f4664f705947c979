//! One motor of the drive: its profile, and what its registers mean.

use super::triggers::{self, Reaction, Trigger, Written, lowest_bit, passing};
use core::f64::consts::TAU;
use polepair_core::plan::Argument;
use polepair_core::plant::{Limits, ServoShaft};
use polepair_core::profile::{
    Access, AxisKind, IdentityQuery, Parameter, ParameterId, Profile, Signal, SignalSource,
};
use polepair_core::proto::modbus::encoding::{REGISTERS_MAX, decode, encode, register_count};
use polepair_core::proto::modbus::wire::Space;
use polepair_core::verb::Verb;
use std::collections::BTreeMap;

/// Rated current of the motor, A.
const RATED_CURRENT: f64 = 12.7;
/// Speed and ramp where the command states none, rad/s and rad/s².
const SPEED: f64 = 300.0 * TAU / 60.0;
const RAMP: f64 = 1000.0 * TAU / 60.0;
/// A linear axis goes so far at each turn, m.
const LEAD: f64 = 0.01;
/// Slower than this is standstill, rad/s.
const REST: f64 = 0.02;

/// Registers, coils and inputs, by space and address. All motors share them.
pub(super) type Registers = BTreeMap<(u8, u16), u16>;

/// A motor and its profile.
#[derive(Debug)]
pub(super) struct MotorUnit {
    profile: &'static Profile,
    /// Last values of parameters that can only be written: such words may share a register.
    hidden: BTreeMap<ParameterId, i64>,
    triggers: Vec<Trigger>,
    reactions: Vec<Reaction>,
    /// The motion that runs: a changed argument changes it.
    active: Option<usize>,
    pub shaft: ServoShaft,
    pub fault: i64,
    pub starts: u64,
}

impl MotorUnit {
    /// The motor of a profile, without power.
    pub(super) fn new(profile: &'static Profile) -> Self {
        let (triggers, reactions) = triggers::read(profile);
        Self {
            profile,
            hidden: BTreeMap::new(),
            triggers,
            reactions,
            active: None,
            shaft: ServoShaft::new(RATED_CURRENT, u32::MAX),
            fault: 0,
            starts: 0,
        }
    }

    /// Gives power: its registers have their first values.
    pub(super) fn power_up(&mut self, registers: &mut Registers) {
        self.hidden.clear();
        (self.active, self.fault) = (None, 0);
        self.shaft = ServoShaft::new(RATED_CURRENT, u32::MAX);
        self.set_speed(None);
        if self.trigger_of(Verb::Enable).is_none() {
            self.shaft.power_on();
        }
        for id in self.ids() {
            let parameter = self.parameter(id);
            let first = parameter.default.unwrap_or(0);
            let (low, high) = (parameter.min.min(parameter.max), parameter.max);
            self.store(registers, id, first.clamp(low, high));
        }
        let identity = self.profile.identity.and_then(|identity| match identity.query {
            IdentityQuery::Parameter(id) => Some((id, identity.equals)),
            IdentityQuery::Text(_) => None,
        });
        if let Some((id, raw)) = identity {
            self.store(registers, id, raw);
        }
        for reaction in self.reactions.clone().iter().filter(|reaction| reaction.after.is_none()) {
            self.show(registers, reaction);
        }
    }

    /// Lets time pass.
    pub(super) fn run(&mut self, ticks: u64) {
        if self.shaft.is_resting() {
            self.shaft.pass_rest(ticks);
        } else {
            (0..ticks).for_each(|_| self.shaft.tick());
        }
    }

    /// Makes a state true that a plan waits for.
    fn show(&mut self, registers: &mut Registers, reaction: &Reaction) {
        let raw = passing(reaction.test, self.value(registers, reaction.shown_by));
        self.store(registers, reaction.shown_by, raw);
    }

    fn ids(&self) -> impl Iterator<Item = ParameterId> + use<> {
        (0..self.profile.parameters.len() as u16).map(ParameterId)
    }

    fn parameter(&self, id: ParameterId) -> &'static Parameter {
        &self.profile.parameters[usize::from(id.0)]
    }

    fn value(&self, registers: &Registers, id: ParameterId) -> i64 {
        let parameter = self.parameter(id);
        if parameter.access == Access::Write {
            return self.hidden.get(&id).copied().unwrap_or(0);
        }
        let mut words = [0; REGISTERS_MAX];
        for (word, at) in words.iter_mut().take(width(parameter)).zip(parameter.index..) {
            *word = registers.get(&(parameter.space, at)).copied().unwrap_or(0);
        }
        decode(parameter.encoding, words)
    }

    fn trigger_of(&self, verb: Verb) -> Option<&Trigger> {
        self.triggers.iter().find(|trigger| trigger.verb == verb)
    }

    /// Keeps a value, in its registers unless they can only be written.
    fn store(&mut self, registers: &mut Registers, id: ParameterId, raw: i64) {
        let parameter = self.parameter(id);
        let Some(words) = encode(parameter.encoding, raw) else { return };
        let is_hidden = parameter.access == Access::Write;
        if is_hidden {
            self.hidden.insert(id, raw);
        }
        for (word, at) in words.into_iter().take(width(parameter)).zip(parameter.index..) {
            let place = registers.entry((parameter.space, at)).or_default();
            if !is_hidden {
                *place = word;
            }
        }
    }

    /// SI value of one raw unit, now.
    fn si_per_raw(&self, registers: &Registers, parameter: &Parameter) -> Option<f64> {
        let signed = parameter.encoding.is_signed();
        let scale =
            parameter.scale.compute(self.profile, signed, &|id| Some(self.value(registers, id)));
        Some(scale.ok()?.factor * parameter.unit.si_factor()).filter(|si| *si != 0.0)
    }

    fn si(&self, registers: &Registers, id: ParameterId) -> Option<f64> {
        let parameter = self.parameter(id);
        Some(
            parameter.encoding.number(self.value(registers, id))
                * self.si_per_raw(registers, parameter)?,
        )
    }

    /// Radians of the shaft for one metre, or radian, of the axis.
    fn shaft_per_axis(&self) -> f64 {
        if self.profile.axis == AxisKind::Linear { TAU / LEAD } else { 1.0 }
    }

    fn is_turning(&self) -> bool {
        self.shaft.velocity().abs() > REST || self.shaft.is_powered() && !self.shaft.has_arrived()
    }

    /// Parameters whose registers a request writes, with their new values. A parameter that can only be written is a
    /// word of one request, so the request has to begin there or with another one of that plan.
    pub(super) fn written_parameters(&self, start: u16, words: &[u16]) -> Vec<(ParameterId, i64)> {
        let covered = |id: ParameterId| {
            let parameter = self.parameter(id);
            let at = usize::from(parameter.index.checked_sub(start)?);
            let its = words.get(at..at + width(parameter))?;
            let mut padded = [0; REGISTERS_MAX];
            padded[..its.len()].copy_from_slice(its);
            let fits = parameter.space == Space::Holding as u8 && !its.is_empty();
            fits.then(|| (id, decode(parameter.encoding, padded)))
        };
        let is_request = |ids: &[(ParameterId, Written)]| {
            let widths = ids.iter().map(|(id, _)| width(self.parameter(*id))).sum::<usize>();
            let first = ids.first().map(|(id, _)| self.parameter(*id).index);
            first == Some(start) && widths == words.len()
        };
        let requests = || self.triggers.iter().map(|trigger| &trigger.request);
        let meant: Vec<ParameterId> = requests()
            .filter(|ids| is_request(ids))
            .flat_map(|ids| ids.iter().map(|(id, _)| *id))
            .collect();
        let is_meant = |id: ParameterId| {
            let parameter = self.parameter(id);
            let is_alone = parameter.index == start && width(parameter) == words.len();
            match parameter.access {
                Access::Read => false,
                Access::ReadWrite => true,
                Access::Write => meant.contains(&id) || meant.is_empty() && is_alone,
            }
        };
        self.ids().filter(|id| is_meant(*id)).filter_map(covered).collect()
    }

    /// Returns whether the motor's profile has a parameter in each register of a request, if `written` are those.
    pub(super) fn covers(&self, written: &[(ParameterId, i64)], address: u16) -> bool {
        written.iter().any(|(id, _)| {
            let parameter = self.parameter(*id);
            (parameter.index..).take(width(parameter)).any(|own| own == address)
        })
    }

    /// Returns whether all values are within their limits.
    pub(super) fn allows(&self, written: &[(ParameterId, i64)]) -> bool {
        written.iter().all(|(id, raw)| self.parameter(*id).allows(*raw))
    }

    /// Takes what a request wrote.
    pub(super) fn accept(&mut self, registers: &mut Registers, written: &[(ParameterId, i64)]) {
        written.iter().for_each(|(id, raw)| self.store(registers, *id, *raw));
        self.react(registers, written);
        self.obey(registers, written);
    }

    /// The coil at an address, if there is one that can be written.
    pub(super) fn coil(&self, address: u16) -> Option<ParameterId> {
        self.ids().find(|id| {
            let parameter = self.parameter(*id);
            let is_there = (parameter.space, parameter.index) == (Space::Coil as u8, address);
            is_there && parameter.access != Access::Read
        })
    }

    /// Returns whether a register, coil or input can be read.
    pub(super) fn is_readable(&self, space: Space, address: u16) -> bool {
        self.profile.parameters.iter().any(|parameter| {
            let is_there = parameter.space == space as u8 && parameter.access != Access::Write;
            is_there && (parameter.index..).take(width(parameter)).any(|own| own == address)
        })
    }

    /// Shows the states that plans wait for after a write.
    fn react(&mut self, registers: &mut Registers, written: &[(ParameterId, i64)]) {
        for reaction in self.reactions.clone() {
            let is_answer = reaction.after.is_some_and(|(id, value)| {
                written.iter().any(|(other, raw)| *other == id && value.allows(*raw))
            });
            if is_answer {
                self.show(registers, &reaction);
            }
        }
    }

    /// Carries out the verb whose trigger the request is.
    fn obey(&mut self, registers: &Registers, written: &[(ParameterId, i64)]) {
        let in_request = |(id, value): &(ParameterId, Written)| {
            written.iter().any(|(other, raw)| other == id && value.allows(*raw))
        };
        let holds = |(id, value): &(ParameterId, Written)| value.allows(self.value(registers, *id));
        let meant = (0..self.triggers.len())
            .filter(|at| {
                let trigger = &self.triggers[*at];
                trigger.request.iter().all(in_request) && trigger.before.iter().all(holds)
            })
            .max_by_key(|at| self.triggers[*at].exactness());
        let changed = self.active.filter(|at| {
            let arguments = [Argument::Velocity, Argument::Target];
            let ids = arguments.into_iter().filter_map(|which| self.triggers[*at].argument(which));
            let is_speed = self.triggers[*at].verb == Verb::Velocity;
            is_speed && ids.into_iter().any(|id| written.iter().any(|(other, _)| *other == id))
        });
        if let Some(at) = meant.or(changed) {
            self.carry_out(registers, at);
        }
    }

    fn carry_out(&mut self, registers: &Registers, at: usize) {
        let trigger = self.triggers[at].clone();
        let is_motion = trigger.verb.starts_motion();
        if is_motion {
            // A drive that is enabled by a command of its own does not turn before.
            if !self.shaft.is_powered() && !self.powers(&trigger) || self.fault != 0 {
                return;
            }
            if !self.shaft.is_powered() {
                self.shaft.power_on();
            }
            self.starts += 1;
        }
        let sign = if trigger.is_negative == Some(true) { -1.0 } else { 1.0 };
        let per_axis = self.shaft_per_axis();
        let argument = |which| Some(self.si(registers, trigger.argument(which)?)? * per_axis);
        let (velocity, target) = (argument(Argument::Velocity), argument(Argument::Target));
        match trigger.verb {
            Verb::Enable => self.shaft.power_on(),
            Verb::Disable => self.shaft.power_off(),
            Verb::Stop => self.shaft.hold(),
            Verb::QuickStop => self.shaft.halt(),
            Verb::Clear => self.fault = 0,
            Verb::Velocity => {
                self.set_speed(None);
                self.shaft.set_velocity(velocity.unwrap_or(SPEED) * sign);
            }
            Verb::MoveTo | Verb::MoveBy | Verb::MoveOn => {
                self.set_speed(velocity);
                let way = target.unwrap_or(0.0);
                let from = if trigger.verb == Verb::MoveTo { 0.0 } else { self.shaft.position() };
                self.shaft.move_to(from + way);
            }
            Verb::Home => self.shaft.move_to(0.0),
            _ => return,
        }
        self.active = is_motion.then_some(at);
    }

    /// Returns whether a plan enables the drive on its way.
    fn powers(&self, trigger: &Trigger) -> bool {
        let Some(enable) = self.trigger_of(Verb::Enable) else { return true };
        trigger.includes(&enable.request)
    }

    fn set_speed(&mut self, velocity: Option<f64>) {
        let top = velocity.map_or(self.shaft.bounds().velocity.max(SPEED), f64::abs);
        self.shaft.set_limits(Limits::trapezoid(top.max(REST), RAMP));
    }

    /// Brings the registers of the signals up to date.
    pub(super) fn show_signals(&mut self, registers: &mut Registers) {
        for source in self.profile.signals {
            let parameter = self.parameter(source.parameter);
            if source.is_flag() {
                self.show_flag(registers, source);
                continue;
            }
            let Some(si) = self.measured(source.signal) else { continue };
            let raw = match source.signal {
                Signal::Fault => {
                    Some(self.value(registers, source.parameter) & !source.mask | self.fault)
                }
                _ => self.raw_of(registers, parameter, si),
            };
            if let Some(raw) = raw {
                self.store(registers, source.parameter, raw);
            }
        }
    }

    fn raw_of(
        &mut self,
        registers: &mut Registers,
        parameter: &'static Parameter,
        si: f64,
    ) -> Option<i64> {
        if let Some((direction, test)) = parameter.scale.negative {
            let value = self.value(registers, direction);
            // A motor at rest keeps the direction that it had.
            let raw = match (si < 0.0, test.passes(value)) {
                (true, false) => passing(test, value),
                (false, true) if si > 0.0 => value ^ lowest_bit(test.mask),
                _ => value,
            };
            self.store(registers, direction, raw);
        }
        let si = if parameter.scale.negative.is_some() { si.abs() } else { si };
        let per_raw = self.si_per_raw(registers, parameter)?;
        let magnitude = if parameter.scale.negative.is_some() { per_raw.abs() } else { per_raw };
        parameter.encoding.raw(si / magnitude)
    }

    /// Measured value of a signal, in SI; `None` for one that the host sets.
    fn measured(&self, signal: Signal) -> Option<f64> {
        let shaft = &self.shaft;
        Some(match signal {
            Signal::Position => shaft.position() / self.shaft_per_axis(),
            Signal::Velocity => shaft.velocity() / self.shaft_per_axis(),
            Signal::Torque => shaft.motor().torque(),
            Signal::Current => shaft.motor().current(),
            Signal::Voltage => shaft.supply,
            Signal::Temperature => shaft.temperature(),
            Signal::Fault => self.fault as f64,
            _ => return None,
        })
    }

    fn show_flag(&mut self, registers: &mut Registers, source: &SignalSource) {
        let SignalSource { mask, equals, parameter: id, .. } = *source;
        let is_set = match source.signal {
            Signal::Enabled => self.shaft.is_powered(),
            Signal::Moving => self.is_turning(),
            Signal::Reached => self.shaft.is_powered() && !self.is_turning(),
            _ => false,
        };
        let raw = self.value(registers, id);
        if is_set == source.is_set(raw) {
            return;
        }
        let highest = 1_i64.checked_shl(63 - mask.leading_zeros()).unwrap_or(1);
        let raw = match (is_set, equals) {
            (true, Some(equals)) => raw & !mask | equals,
            (true, None) => raw | lowest_bit(mask),
            (false, None) => raw & !mask,
            // One bit is enough: the others may be those of another flag.
            (false, Some(equals)) => raw & !mask | equals ^ highest,
        };
        self.store(registers, id, raw);
    }
}

/// Registers, coils or inputs that a parameter takes.
fn width(parameter: &Parameter) -> usize {
    let is_bit = Space::of_number(parameter.space).is_some_and(Space::is_bits);
    if is_bit { 1 } else { usize::from(register_count(parameter.encoding)) }
}
