//! CANopen mode (Fn_00 = 20): the same registers behind a bus, and the motion that the drive
//! profile's objects command (TS manual V2, chapter 3).

use super::super::objects::{
    Commands, DICTIONARY, DN, KEPT, Objects, READ, is_method, is_mode, kept, read,
};
use super::super::shaft::COUNTS_PER_TURN;
use super::*;
use crate::plant::{Limits, Setpoint};
use crate::proto::canopen::device::Firmware;
use crate::proto::canopen::device::motion::{self, Axis, Event, Manner, modes};
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::nmt::State as Nmt;
use crate::proto::canopen::od::Dictionary;
use crate::proto::canopen::sdo::Abort;

/// Set-points that wait behind the one that runs (§3.6.2).
const POINTS: usize = 32;
/// Bit 9 stays 0 and an alarm shows 0088h (§3.3); enabling takes 6, 7 and F in turn `[I]`; the
/// recipe takes bit 4 back at once and homing goes on (§3.6.4).
const MANNER: Manner =
    Manner { remote: false, fault_warns: true, in_turn: true, homing_by_edge: true };

/// States of which an emergency tells (chapter 4).
const FORWARD_LIMIT: u16 = 0x8681;
const REVERSE_LIMIT: u16 = 0x8682;
const ARRIVED: u16 = 0x8683;

/// What CANopen mode needs beside the registers.
#[derive(Debug)]
pub(super) struct Node {
    axis: Axis<POINTS>,
    objects: Objects,
    /// The alarm that was told last.
    told: Alarm,
    arrived: bool,
    /// Limit switches as they were told last.
    limits: [bool; 2],
}

impl Node {
    /// After power-on, with the shaft at `position`, rad.
    pub(super) fn new(position: f64) -> Self {
        let axis = Axis::new(MANNER, position);
        Self {
            axis,
            objects: Objects::default(),
            told: Alarm::NONE,
            arrived: false,
            limits: [false; 2],
        }
    }

    pub(super) const fn feels_for_stop(&self) -> bool {
        self.axis.feels_for_stop()
    }
}

impl Core {
    /// Lends the motion what it has to do with.
    fn with_axis<R>(
        &mut self,
        act: impl FnOnce(&mut Axis<POINTS>, &mut motion::Scene<'_, Shaft, Commands<'_>>) -> R,
    ) -> R {
        let position = self.shaft.motor().position();
        let closed = |purpose| self.lines.closed(purpose, position);
        let settings = Commands { objects: &self.node.objects, registers: &self.registers };
        let mut scene = motion::Scene {
            home: closed(Purpose::Home),
            home_at: self.lines.home_at,
            positive: closed(Purpose::ForwardLimit),
            negative: closed(Purpose::ReverseLimit),
            shaft: &mut self.shaft,
            settings: &settings,
        };
        act(&mut self.node.axis, &mut scene)
    }

    /// One tick of CANopen mode, before the shaft's.
    pub(super) fn follow_bus(&mut self) {
        let origin = self.node.axis.origin();
        let event = self.with_axis(|axis, scene| axis.tick(scene));
        if event == Some(Event::FollowingError) {
            self.raise(Alarm::PE);
        }
        self.node.arrived |=
            event == Some(Event::Arrived) && self.node.axis.mode() == modes::PROFILE_POSITION;
        if origin != self.node.axis.origin() {
            self.motion.set_origin(self.node.axis.origin());
        }
    }

    /// An alarm was raised, in whatever mode.
    pub(super) fn fault_on_bus(&mut self) {
        self.with_axis(|axis, scene| axis.fault(scene));
    }

    /// Another mode, or power-on: nothing is commanded.
    pub(super) fn leave_bus(&mut self) {
        let mut node = Node::new(self.motion.origin());
        (node.told, node.limits) = (self.node.told, self.node.limits);
        node.objects = core::mem::take(&mut self.node.objects);
        node.objects.set(kept::CONTROL, 0);
        self.node = node;
        if self.alarm.is_some() {
            self.fault_on_bus();
        }
    }

    fn control(&mut self, word: u16) {
        if self.mode() != MODE_CANOPEN {
            return;
        }
        let before = self.node.axis.state();
        if !before.has_power() && !self.shaft.bus_ready() && word & 0x0F == 0x0F {
            return self.raise(Alarm::DE);
        }
        if self.with_axis(|axis, scene| axis.control(word, true, scene)) {
            self.unrepeatable += 1;
            self.starts += 1;
        }
        let after = self.node.axis.state();
        self.starts += u64::from(!before.has_power() && after.has_power());
        if before == motion::State::Fault && after != before {
            self.clear_alarm();
        }
    }

    fn set_object(&mut self, tag: u16, value: i32) -> Result<(), Abort> {
        let allowed = match tag {
            kept::MODE => is_mode(value as i8),
            kept::HOMING_METHOD => is_method(value as i8),
            _ => true,
        };
        if !allowed {
            return Err(Abort::VALUE);
        }
        self.node.objects.set(tag, value);
        match tag {
            kept::CONTROL => self.control(value as u16),
            kept::TARGET_POSITION => {}
            _ => self.with_axis(|axis, scene| axis.changed(scene)),
        }
        let turns = matches!(tag, kept::TARGET_VELOCITY | kept::TARGET_TORQUE | kept::MODE);
        self.starts += u64::from(turns && self.node.axis.state().has_power());
        Ok(())
    }

    fn object(&self, tag: u16) -> i64 {
        let (node, shaft) = (&self.node, &self.shaft);
        let origin = self.motion.origin();
        let demand = || shaft.setpoint();
        let increments = |position: f64| nearest((position - origin) / TAU * COUNTS_PER_TURN);
        let pulses = |rad: f64| i64::from(node.objects.pulses(rad));
        match tag {
            read::STATUS if self.mode() == MODE_CANOPEN => node.axis.status(true).into(),
            read::STATUS if self.alarm.is_some() => 0x88,
            read::STATUS => 0x50,
            read::MODE => node.axis.mode().into(),
            read::POSITION_DEMAND => pulses(demand().position - origin),
            read::POSITION => pulses(shaft.position() - origin),
            read::INCREMENTS => increments(shaft.position()),
            read::DEMAND_INCREMENTS => increments(demand().position),
            read::SENSOR_VELOCITY => nearest(shaft.rpm() * 10.0),
            read::VELOCITY_DEMAND => nearest(demand().velocity / TAU * 600.0),
            read::VELOCITY => nearest(shaft.rpm()),
            read::FOLLOWING_ERROR => pulses(demand().position - shaft.position()),
            read::ERROR_CODE => self.alarm.0.into(),
            read::TORQUE => nearest(shaft.load_share() * 1000.0),
            _ => node.objects.value(tag).into(),
        }
    }

    /// Limit switches are told as they close, in CANopen mode.
    fn limit_notice(&mut self) -> Option<u16> {
        if self.mode() != MODE_CANOPEN {
            return None;
        }
        let position = self.shaft.motor().position();
        let ends = [(Purpose::ForwardLimit, FORWARD_LIMIT), (Purpose::ReverseLimit, REVERSE_LIMIT)];
        ends.into_iter().enumerate().find_map(|(n, (purpose, code))| {
            let is = self.lines.closed(purpose, position);
            let was = core::mem::replace(&mut self.node.limits[n], is);
            (is && !was).then_some(code)
        })
    }
}

impl Firmware for Drive {
    fn dictionary(&self) -> &'static Dictionary {
        &DICTIONARY
    }

    fn node_id(&self) -> u8 {
        self.core.registers.value(fns::NODE) as u8
    }

    fn bit_rate(&self) -> u32 {
        u32::from(self.core.registers.value(fns::BIT_RATE)) * 1000
    }

    fn serial(&self) -> u32 {
        self.core.options.address.into()
    }

    #[inline]
    fn get(&mut self, tag: u16) -> u64 {
        let core = &self.core;
        match tag {
            0..DN => core.registers.value(tag).into(),
            DN..KEPT => core.reading(tag - DN).into(),
            _ => core.object(tag).cast_unsigned(),
        }
    }

    fn set(&mut self, _now: Instant, tag: u16, value: u64) -> Result<(), Abort> {
        self.core.stirred = true;
        match tag {
            0..DN => self.write(tag, &[value as u16]).map_err(|refusal| match refusal {
                Refusal::Address => Abort::NO_OBJECT,
                Refusal::Value => Abort::VALUE,
                Refusal::Failure => Abort::LOCAL,
            }),
            KEPT..READ => self.core.set_object(tag, value as i32),
            _ => Err(Abort::READ_ONLY),
        }
    }

    fn entered(&mut self, now: Instant, state: Nmt) {
        if state == Nmt::Stopped {
            self.lost(now);
        }
    }

    fn reset(&mut self, _now: Instant) {
        self.power_cycle();
    }

    /// `[I]` ERR_Lo where the motor is powered through the bus.
    fn lost(&mut self, _now: Instant) {
        if self.core.node.axis.state().has_power() {
            self.raise(Alarm::LO);
        }
    }

    fn error_register(&self) -> u8 {
        if self.core.alarm.is_some() { 0x81 } else { 0 }
    }

    #[inline]
    fn poll_emergency(&mut self) -> Option<Emergency> {
        let core = &mut self.core;
        let tell = |code| Some(Emergency { code, ..Emergency::default() });
        if core.node.told != core.alarm {
            core.node.told = core.alarm;
            return tell(core.alarm.0);
        }
        if core::mem::take(&mut core.node.arrived) {
            return tell(ARRIVED);
        }
        core.limit_notice().and_then(tell)
    }

    fn set_node_id(&mut self, node: u8) {
        self.core.registers.set(fns::NODE, node.into());
    }

    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        let kbit = (bit_rate / 1000) as u16;
        let fits = self.core.check_value(fns::BIT_RATE, kbit).is_ok();
        if fits {
            self.core.registers.set(fns::BIT_RATE, kbit);
        }
        fits
    }

    fn store_link(&mut self) -> bool {
        for number in [fns::NODE, fns::BIT_RATE] {
            self.core.registers.keep(number, self.core.registers.value(number));
        }
        true
    }
}

impl motion::Shaft for Shaft {
    fn power(&mut self) {
        Self::power(self);
    }

    fn release(&mut self) {
        Self::release(self);
    }

    fn manner(&mut self, limits: Limits) {
        Self::manner(self, limits);
    }

    fn turn(&mut self, rad_per_s: f64) {
        Self::turn(self, rad_per_s);
    }

    fn go(&mut self, position: f64) {
        Self::go(self, position);
    }

    fn push(&mut self, share: f64) {
        Self::push(self, share);
    }

    /// The drive has no mode in which the host makes the way.
    fn follow(&mut self, setpoint: Setpoint) {
        Self::go(self, setpoint.position);
    }

    fn hold(&mut self) {
        Self::halt(self);
    }

    fn settle(&mut self) {
        Self::settle(self);
    }

    fn setpoint(&self) -> Setpoint {
        Self::setpoint(self)
    }

    fn arrived(&self) -> bool {
        Self::arrived(self)
    }

    fn position(&self) -> f64 {
        Self::position(self)
    }

    fn before(&self) -> f64 {
        Self::before(self)
    }

    fn velocity(&self) -> f64 {
        self.rpm() / 60.0 * TAU
    }

    fn torque_reached(&self) -> bool {
        Self::torque_reached(self)
    }
}
