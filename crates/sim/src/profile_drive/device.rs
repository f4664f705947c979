//! The registers, the motor, and the end of the wire.

use super::triggers::{self, Reaction, Trigger, Written, lowest_bit, passing};
use core::f64::consts::TAU;
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::plan::Argument;
use polepair_core::plant::{Limits, ServoShaft, TICK_NS, TICKS_MAX};
use polepair_core::profile::{
    Access, AxisKind, IdentityQuery, Parameter, ParameterId, Profile, Signal,
};
use polepair_core::proto::modbus::device::{Firmware, Framing, SerialEndpoint, SerialSettings};
use polepair_core::proto::modbus::encoding::{REGISTERS_MAX, decode, encode, register_count};
use polepair_core::proto::modbus::wire::{Exception, Function, Space, WireFormat};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};
use polepair_core::verb::Verb;
use polepair_drives::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_drives::{DeviceOptions, SimulatedDevice};
use std::collections::BTreeMap;

/// Rated current of the motor, A.
const RATED_CURRENT: f64 = 12.7;
/// Speed and ramp where the command states none, rad/s and rad/s².
const SPEED: f64 = 300.0 * TAU / 60.0;
const RAMP: f64 = 1000.0 * TAU / 60.0;
/// A linear axis goes so far at each turn, m.
const LEAD: f64 = 0.01;
/// Time between two wake-ups of a turning motor.
const WAKE_MS: u32 = 10;
/// Slower than this is standstill, rad/s.
const REST: f64 = 0.02;

/// A simulated drive of a user's profile, at its end of a Modbus line.
#[derive(Debug)]
pub struct ProfileDrive {
    endpoint: SerialEndpoint,
    bank: Bank,
}

impl ProfileDrive {
    /// Protocol of the profiles that can be simulated so.
    pub const PROTOCOL: &'static str = "modbus";

    /// The drive, just powered. Without an address it has address 1.
    ///
    /// # Errors
    /// An option, because it has none.
    pub fn new<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self, &'a str> {
        if let Some((option, _)) = options.extra.first() {
            return Err(option);
        }
        let format = match options.wires.first() {
            Some(&"modbus-ascii") => WireFormat::Ascii,
            Some(&"modbus-tcp") => WireFormat::Tcp,
            _ => WireFormat::Rtu,
        };
        let baud = if options.untimed { 0 } else { profile.line.map_or(9600, |line| line.baud) };
        let wire = SerialSettings { format, line: SerialLine::new_8n1(baud) };
        let address = options.address.and_then(|address| u8::try_from(address).ok()).unwrap_or(1);
        let bank = Bank::new(profile, address, wire);
        Ok(Self { endpoint: SerialEndpoint::new(Framing::Length), bank })
    }
}

/// Everything but the protocol.
#[derive(Debug)]
struct Bank {
    profile: &'static Profile,
    address: u8,
    wire: SerialSettings,
    words: BTreeMap<(u8, u16), u16>,
    /// The last value of each parameter, written or shown. Write-only words may share a register.
    values: Vec<i64>,
    triggers: Vec<Trigger>,
    reactions: Vec<Reaction>,
    /// The motion that runs: a changed argument changes it.
    active: Option<usize>,
    shaft: ServoShaft,
    now: Instant,
    ticked_at: Instant,
    fault: i64,
    starts: u64,
}

impl Bank {
    fn new(profile: &'static Profile, address: u8, wire: SerialSettings) -> Self {
        let (triggers, reactions) = triggers::read(profile);
        let mut bank = Self {
            profile,
            address,
            wire,
            words: BTreeMap::new(),
            values: Vec::new(),
            triggers,
            reactions,
            active: None,
            shaft: ServoShaft::new(RATED_CURRENT, u32::MAX),
            now: Instant::ZERO,
            ticked_at: Instant::ZERO,
            fault: 0,
            starts: 0,
        };
        bank.power_cycle();
        bank
    }

    fn power_cycle(&mut self) {
        let within = |p: &Parameter| p.default.unwrap_or(0).clamp(p.min.min(p.max), p.max);
        self.values = self.profile.parameters.iter().map(within).collect();
        self.words.clear();
        (self.active, self.fault) = (None, 0);
        self.shaft = ServoShaft::new(RATED_CURRENT, u32::MAX);
        self.set_speed(None);
        if self.trigger_of(Verb::Enable).is_none() {
            self.shaft.power_on();
        }
        for id in self.ids() {
            let raw = self.value(id);
            self.store(id, raw);
        }
        let identity = self.profile.identity.and_then(|identity| match identity.query {
            IdentityQuery::Parameter(id) => Some((id, identity.equals)),
            IdentityQuery::Text(_) => None,
        });
        if let Some((id, raw)) = identity {
            self.store(id, raw);
        }
        for reaction in self.reactions.clone().iter().filter(|reaction| reaction.after.is_none()) {
            let raw = passing(reaction.test, self.value(reaction.shown_by));
            self.store(reaction.shown_by, raw);
        }
    }

    fn ids(&self) -> impl Iterator<Item = ParameterId> + use<> {
        (0..self.profile.parameters.len() as u16).map(ParameterId)
    }

    fn parameter(&self, id: ParameterId) -> &'static Parameter {
        &self.profile.parameters[usize::from(id.0)]
    }

    fn value(&self, id: ParameterId) -> i64 {
        self.values[usize::from(id.0)]
    }

    fn trigger_of(&self, verb: Verb) -> Option<&Trigger> {
        self.triggers.iter().find(|trigger| trigger.verb == verb)
    }

    /// Keeps a value, and shows it in its registers unless they can only be written.
    fn store(&mut self, id: ParameterId, raw: i64) {
        let parameter = self.parameter(id);
        self.values[usize::from(id.0)] = raw;
        let Some(words) = encode(parameter.encoding, raw) else { return };
        let is_hidden = parameter.access == Access::Write;
        for (word, at) in words.into_iter().take(width(parameter)).zip(parameter.index..) {
            let place = self.words.entry((parameter.space, at)).or_default();
            if !is_hidden {
                *place = word;
            }
        }
    }

    /// SI value of one raw unit, now.
    fn si_per_raw(&self, parameter: &Parameter) -> Option<f64> {
        let signed = parameter.encoding.is_signed();
        let scale = parameter.scale.compute(self.profile, signed, &|id| Some(self.value(id)));
        Some(scale.ok()?.factor * parameter.unit.si_factor()).filter(|si| *si != 0.0)
    }

    fn si(&self, id: ParameterId) -> Option<f64> {
        let parameter = self.parameter(id);
        Some(parameter.encoding.number(self.value(id)) * self.si_per_raw(parameter)?)
    }

    /// Radians of the shaft for one metre, or radian, of the axis.
    fn shaft_per_axis(&self) -> f64 {
        if self.profile.axis == AxisKind::Linear { TAU / LEAD } else { 1.0 }
    }

    fn advance(&mut self, now: Instant) {
        self.now = now.max(self.now);
        let ticks = (self.now.since(self.ticked_at).as_nanos() as u64 / TICK_NS).min(TICKS_MAX);
        self.ticked_at = self.ticked_at.plus_ns(ticks * TICK_NS);
        if self.shaft.is_resting() {
            self.shaft.pass_rest(ticks);
        } else {
            (0..ticks).for_each(|_| self.shaft.tick());
        }
    }

    fn is_turning(&self) -> bool {
        self.shaft.velocity().abs() > REST || self.shaft.is_powered() && !self.shaft.has_arrived()
    }

    /// Parameters whose registers a request writes, with their new values. A parameter that can only be written is a
    /// word of one request, so the request has to begin there or with another one of that plan.
    fn written_parameters(&self, start: u16, words: &[u16]) -> Vec<(ParameterId, i64)> {
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

    fn write(&mut self, start: u16, words: &[u16]) -> Result<(), Exception> {
        let written = self.written_parameters(start, words);
        let covers = |at: u16| {
            written.iter().any(|(id, _)| {
                let parameter = self.parameter(*id);
                (parameter.index..).take(width(parameter)).any(|own| own == at)
            })
        };
        if (start..).take(words.len()).any(|at| !covers(at)) {
            return Err(Exception::IllegalAddress);
        }
        if written.iter().any(|(id, raw)| !self.parameter(*id).allows(*raw)) {
            return Err(Exception::IllegalValue);
        }
        written.iter().for_each(|(id, raw)| self.store(*id, *raw));
        self.react(&written);
        self.obey(&written);
        Ok(())
    }

    /// Shows the states that plans wait for after a write.
    fn react(&mut self, written: &[(ParameterId, i64)]) {
        for reaction in self.reactions.clone() {
            let is_answer = reaction.after.is_some_and(|(id, value)| {
                written.iter().any(|(other, raw)| *other == id && value.allows(*raw))
            });
            if is_answer {
                let raw = passing(reaction.test, self.value(reaction.shown_by));
                self.store(reaction.shown_by, raw);
            }
        }
    }

    /// Carries out the verb whose trigger the request is.
    fn obey(&mut self, written: &[(ParameterId, i64)]) {
        let in_request = |(id, value): &(ParameterId, Written)| {
            written.iter().any(|(other, raw)| other == id && value.allows(*raw))
        };
        let holds = |(id, value): &(ParameterId, Written)| value.allows(self.value(*id));
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
            self.carry_out(at);
        }
    }

    fn carry_out(&mut self, at: usize) {
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
        let argument = |which| Some(self.si(trigger.argument(which)?)? * per_axis);
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
        enable.request.iter().all(|write| trigger.writes().any(|own| own == write))
    }

    fn set_speed(&mut self, velocity: Option<f64>) {
        let top = velocity.map_or(self.shaft.bounds().velocity.max(SPEED), f64::abs);
        self.shaft.set_limits(Limits::trapezoid(top.max(REST), RAMP));
    }

    /// Brings the registers of the signals up to date.
    fn show_signals(&mut self) {
        for source in self.profile.signals {
            let parameter = self.parameter(source.parameter);
            if source.is_flag() {
                self.show_flag(source.signal, source.parameter, source.mask, source.equals);
                continue;
            }
            let Some(si) = self.measured(source.signal) else { continue };
            let raw = match source.signal {
                Signal::Fault => Some(self.value(source.parameter) & !source.mask | self.fault),
                _ => self.raw_of(parameter, si),
            };
            if let Some(raw) = raw {
                self.store(source.parameter, raw);
            }
        }
    }

    fn raw_of(&mut self, parameter: &'static Parameter, si: f64) -> Option<i64> {
        if let Some((direction, test)) = parameter.scale.negative {
            let value = self.value(direction);
            // A motor at rest keeps the direction that it had.
            let raw = match (si < 0.0, test.passes(value)) {
                (true, false) => passing(test, value),
                (false, true) if si > 0.0 => value ^ lowest_bit(test.mask),
                _ => value,
            };
            self.store(direction, raw);
        }
        let si = if parameter.scale.negative.is_some() { si.abs() } else { si };
        let per_raw = self.si_per_raw(parameter)?;
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

    fn show_flag(&mut self, signal: Signal, id: ParameterId, mask: i64, equals: Option<i64>) {
        let is_set = match signal {
            Signal::Enabled => self.shaft.is_powered(),
            Signal::Moving => self.is_turning(),
            Signal::Reached => self.shaft.is_powered() && !self.is_turning(),
            _ => false,
        };
        let raw = self.value(id);
        let matches = equals.map_or(raw & mask != 0, |equals| raw & mask == equals);
        if is_set == matches {
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
        self.store(id, raw);
    }
}

/// Registers, coils or inputs that a parameter takes.
fn width(parameter: &Parameter) -> usize {
    let is_bit = Space::of_number(parameter.space).is_some_and(Space::is_bits);
    if is_bit { 1 } else { usize::from(register_count(parameter.encoding)) }
}

impl Firmware for Bank {
    fn address(&self) -> u8 {
        self.address
    }

    fn serial_settings(&self) -> SerialSettings {
        self.wire
    }

    fn supports(&self, function: Function) -> bool {
        matches!(function.code(), 1..=6 | 15 | 16)
    }

    fn read_bits(
        &mut self,
        now: Instant,
        space: Space,
        start: u16,
        count: u16,
        out: &mut [u8],
    ) -> Result<(), Exception> {
        self.advance(now);
        self.show_signals();
        for n in 0..count {
            let at = start.checked_add(n).ok_or(Exception::IllegalAddress)?;
            let word = self.words.get(&(space as u8, at)).ok_or(Exception::IllegalAddress)?;
            out[usize::from(n / 8)] |= u8::from(*word != 0) << (n % 8);
        }
        Ok(())
    }

    fn read_words(
        &mut self,
        now: Instant,
        space: Space,
        start: u16,
        out: &mut [u16],
    ) -> Result<(), Exception> {
        self.advance(now);
        self.show_signals();
        let readable = |at: u16| {
            self.ids().map(|id| self.parameter(id)).any(|p| {
                let is_there = p.space == space as u8 && p.access != Access::Write;
                is_there && (p.index..).take(width(p)).any(|own| own == at)
            })
        };
        for (word, at) in out.iter_mut().zip(start..=u16::MAX) {
            let found = self.words.get(&(space as u8, at)).filter(|_| readable(at));
            *word = *found.ok_or(Exception::IllegalAddress)?;
        }
        Ok(())
    }

    fn write_bit(&mut self, now: Instant, address: u16, on: bool) -> Result<(), Exception> {
        self.advance(now);
        let is_coil = |id: &ParameterId| {
            let parameter = self.parameter(*id);
            (parameter.space, parameter.index) == (Space::Coil as u8, address)
        };
        let id = self.ids().find(is_coil).ok_or(Exception::IllegalAddress)?;
        if self.parameter(id).access == Access::Read {
            return Err(Exception::IllegalAddress);
        }
        let written = [(id, i64::from(on))];
        self.store(id, written[0].1);
        self.react(&written);
        self.obey(&written);
        Ok(())
    }

    fn write_words(
        &mut self,
        now: Instant,
        _function: Function,
        start: u16,
        words: &[u16],
    ) -> Result<(), Exception> {
        self.advance(now);
        self.write(start, words)
    }
}

impl Timed for ProfileDrive {
    fn handle_timeout(&mut self, now: Instant) {
        self.bank.advance(now);
        self.endpoint.handle_timeout(now, &mut self.bank);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let turning = !self.bank.shaft.is_resting();
        earliest(self.endpoint.poll_timeout(), turning.then(|| self.bank.now.plus_ms(WAKE_MS)))
    }
}

impl SimulatedDevice for ProfileDrive {
    fn serial_station(&mut self) -> Option<&mut dyn Station<Stream>> {
        Some(self)
    }
}

impl Station<Stream> for ProfileDrive {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.bank.advance(now);
        self.endpoint.handle_input(now, unit, &mut self.bank);
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        self.endpoint.handle_line(event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.endpoint.poll_transmit(now, out)
    }

    fn line(&self) -> SerialLine {
        self.bank.wire.line
    }
}

impl SurroundingsControl for ProfileDrive {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.bank.advance(now);
        let shaft = &self.bank.shaft;
        GroundTruth {
            position: shaft.motor().position(),
            velocity: shaft.motor().velocity(),
            current: shaft.motor().current(),
            torque: shaft.motor().torque(),
            winding: shaft.winding(),
            enabled: shaft.is_powered(),
            fault: self.bank.fault as u32,
            starts: self.bank.starts,
            bounds: shaft.bounds(),
            setpoint: shaft.active_setpoint(),
            ..GroundTruth::default()
        }
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        self.bank.advance(now);
        let shaft = &mut self.bank.shaft;
        match act {
            Act::Load(torque) => shaft.load = torque,
            Act::Jam(jammed) => shaft.jam(jammed),
            Act::Supply(volts) => shaft.supply = volts,
            Act::Ambient(celsius) => shaft.set_ambient(celsius),
            Act::Temperature(celsius) => shaft.set_temperature(celsius),
            Act::EncoderBroken(broken) => shaft.break_encoder(broken),
            Act::Fault(code) => {
                shaft.power_off();
                self.bank.fault = code.into();
            }
            Act::PowerCycle => {
                self.bank.power_cycle();
                self.endpoint.clear();
            }
            _ => return false,
        }
        true
    }
}
