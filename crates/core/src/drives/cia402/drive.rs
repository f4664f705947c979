//! The drive: objects, motion, faults and time, whatever bus it is on.

use core::f64::consts::TAU;

use super::faults::Fault;
use super::files::Files;
use super::objects::{DICTIONARY, Objects, kept, read};
use super::shaft::{RATED_CURRENT, Shaft};
use crate::plant::{TICK_NS, Ticks};
use crate::proto::canopen::device::motion::{
    Axis, Event, Manner, Scene, Shaft as _, State as Power, is_method, modes,
};
use crate::proto::canopen::device::{Firmware, Group};
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::nmt::State;
use crate::proto::canopen::od::Dictionary;
use crate::proto::canopen::sdo::Abort;
use crate::proto::canopen::time::TimeOfDay;
use crate::time::Instant;
use crate::units::nearest;

/// The standard leaves nothing of this open.
const MANNER: Manner =
    Manner { remote: true, fault_warns: false, in_turn: false, homing_by_edge: false };
/// Set-points that wait behind the one that runs (CiA 402: one).
const POINTS: usize = 1;
/// Inputs of 60FDh: limit switches and home switch.
const INPUTS: usize = 3;

/// Switches that the shaft closes, and lines that something outside closes. In the order of 60FDh:
/// negative limit, positive limit, home.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Lines {
    /// Shaft position of each switch, rad; infinite where there is none.
    at: [f64; INPUTS],
    /// Shaft position from which on the home switch is open again, rad.
    home_until: f64,
    /// Lines that something outside closes.
    driven: [bool; INPUTS],
}

/// Positions that no shaft comes to.
const NOWHERE: [f64; INPUTS] = [f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY];

impl Lines {
    /// The home switch alone, at that shaft position (rad).
    const fn home(at: f64) -> Self {
        let [negative, positive, _] = NOWHERE;
        let at = [negative, positive, at];
        Self { at, home_until: f64::INFINITY, driven: [false; INPUTS] }
    }

    /// Moves the switch of a line to a shaft position (rad), or takes it away.
    pub fn place(&mut self, line: usize, at: Option<f64>) {
        self.at[line] = at.unwrap_or(NOWHERE[line]);
    }

    /// The home switch is open again from that shaft position (rad) on, or never.
    pub fn open_home(&mut self, from: Option<f64>) {
        self.home_until = from.unwrap_or(f64::INFINITY);
    }

    /// Something outside closes a line, or opens it.
    pub const fn drive(&mut self, line: usize, closed: bool) {
        self.driven[line] = closed;
    }

    #[inline]
    fn negative(&self, position: f64) -> bool {
        (position <= self.at[0]) | self.driven[0]
    }

    #[inline]
    fn positive(&self, position: f64) -> bool {
        (position >= self.at[1]) | self.driven[1]
    }

    #[inline]
    fn is_home(&self, position: f64) -> bool {
        ((position >= self.at[2]) & (position < self.home_until)) | self.driven[2]
    }

    /// Where the home switch's only edge is.
    #[inline]
    fn home_edge(&self) -> Option<f64> {
        (self.home_until == f64::INFINITY && self.at[2] != f64::INFINITY).then_some(self.at[2])
    }
}

/// A powered drive with its motor. It lies in memory in this order: what each cycle needs first.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Drive {
    ticks: Ticks,
    now: Instant,
    fault: Fault,
    told: Fault,
    /// Motions begun, and those that a repetition would have begun again.
    starts: u64,
    lines: Lines,
    objects: Objects,
    shaft: Shaft,
    axis: Axis<POINTS>,
    unrepeatable: u64,
    /// The time of day that was given, and when.
    clock: Option<(TimeOfDay, Instant)>,
    notice: Option<&'static str>,
    flash_writes: u64,
    node: u8,
    kept_node: u8,
    bit_rate: u32,
    kept_bit_rate: u32,
    serial: u32,
    files: Files,
    kept: Option<Objects>,
}

impl Drive {
    /// A drive as from the factory, with that node-ID.
    #[must_use]
    pub fn new(node: u8, serial: u32, bit_rate: u32) -> Self {
        Self {
            ticks: Ticks::new(Instant::ZERO),
            now: Instant::ZERO,
            shaft: Shaft::default(),
            axis: Axis::new(MANNER, 0.0),
            objects: Objects::factory(),
            // Half a turn behind, so that homing finds it.
            lines: Lines::home(-TAU / 2.0),
            fault: Fault::NONE,
            told: Fault::NONE,
            clock: None,
            notice: None,
            unrepeatable: 0,
            starts: 0,
            flash_writes: 0,
            node,
            kept_node: node,
            bit_rate,
            kept_bit_rate: bit_rate,
            serial,
            files: Files::default(),
            kept: None,
        }
    }

    /// The same with other values from the factory.
    #[must_use]
    pub fn with(mut self, objects: Objects) -> Self {
        self.objects = objects.clone();
        self.keep(objects);
        self
    }

    /// What every reset brings from now on, until its settings are stored or restored.
    pub fn keep(&mut self, objects: Objects) {
        self.kept = Some(objects);
    }

    /// Lets time pass up to `now`.
    #[inline]
    pub fn advance(&mut self, now: Instant) {
        let ticks = self.ticks.until(now);
        self.now = self.now.max(now);
        if ticks > 0 {
            self.pass(ticks);
        }
    }

    fn pass(&mut self, ticks: u64) {
        if self.shaft.resting() {
            self.shaft.rest(ticks);
            return self.watch();
        }
        for _ in 0..ticks {
            self.tick();
        }
    }

    /// When it next wants [`advance`](Self::advance) though nobody asks it anything.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        (!self.shaft.resting()).then(|| self.ticks.at().plus_ns(TICK_NS))
    }

    /// The motor, and what acts on it.
    #[must_use]
    pub const fn shaft(&self) -> &Shaft {
        &self.shaft
    }

    /// The motor, for what acts on it from outside.
    pub const fn shaft_mut(&mut self) -> &mut Shaft {
        &mut self.shaft
    }

    /// The switches, for what acts on them from outside.
    pub const fn lines_mut(&mut self) -> &mut Lines {
        &mut self.lines
    }

    /// The fault, if there is one.
    #[must_use]
    pub const fn fault(&self) -> Fault {
        self.fault
    }

    /// Motions begun that a repetition of their order would have begun again, and all.
    #[must_use]
    pub const fn counts(&self) -> (u64, u64) {
        (self.unrepeatable, self.starts)
    }

    /// Times that its flash was written.
    #[must_use]
    pub const fn flash_writes(&self) -> u64 {
        self.flash_writes
    }

    /// What happened since the last call.
    pub const fn take_notice(&mut self) -> Option<&'static str> {
        self.notice.take()
    }

    /// Something is wrong: power goes off as 605Eh says.
    pub fn raise(&mut self, fault: Fault) {
        if self.fault != Fault::NONE {
            return;
        }
        self.fault = fault;
        self.notice = Some(fault.name());
        self.act(Axis::fault);
    }

    /// Power off and on.
    pub fn power_cycle(&mut self) {
        (self.node, self.bit_rate) = (self.kept_node, self.kept_bit_rate);
        self.clock = None;
        self.start_anew();
    }

    fn start_anew(&mut self) {
        self.shaft.release();
        self.shaft.forget();
        self.objects = self.kept.clone().unwrap_or_else(Objects::factory);
        self.axis = Axis::new(MANNER, self.shaft.position());
        (self.fault, self.told) = (Fault::NONE, Fault::NONE);
    }

    #[inline]
    fn act<R>(
        &mut self,
        act: impl FnOnce(&mut Axis<POINTS>, &mut Scene<'_, Shaft, Objects>) -> R,
    ) -> R {
        let position = self.shaft.motor().position();
        let mut scene = Scene {
            negative: self.lines.negative(position),
            positive: self.lines.positive(position),
            home: self.lines.is_home(position),
            home_at: self.lines.home_edge(),
            shaft: &mut self.shaft,
            settings: &self.objects,
        };
        act(&mut self.axis, &mut scene)
    }

    fn tick(&mut self) {
        let event = match self.axis.follows() {
            true => self.act(Axis::follow),
            false => self.act(Axis::tick),
        };
        if event == Some(Event::FollowingError) {
            self.raise(Fault::FOLLOWING);
        }
        self.shaft.tick();
        self.watch();
    }

    #[inline]
    fn watch(&mut self) {
        if let Some(fault) = self.shaft.trouble(|| self.axis.feels_for_stop()) {
            self.raise(fault);
        }
    }

    fn control(&mut self, word: u16) {
        let starved = self.fault == Fault::UNDERVOLTAGE && !self.shaft.has_voltage();
        let clear = !starved && self.shaft.lasting().is_none();
        let before = self.axis.state();
        if self.act(|axis, scene| axis.control(word, clear, scene)) {
            self.unrepeatable += 1;
            self.starts += 1;
        }
        let after = self.axis.state();
        if !before.has_power() && after.has_power() {
            self.starts += 1;
        }
        if before == Power::Fault && after != Power::Fault {
            self.fault = Fault::NONE;
            self.shaft.forget();
        }
    }

    fn set_other(&mut self, tag: u16, value: u64) -> Result<(), Abort> {
        if !is_allowed(tag, value.cast_signed()) {
            return Err(Abort::VALUE);
        }
        self.objects.set(tag, value as i32);
        match tag {
            kept::CONTROL => self.control(value as u16),
            // Only a new edge of the controlword takes it over.
            kept::TARGET_POSITION if self.axis.mode() == modes::PROFILE_POSITION => {}
            _ => self.act(Axis::changed),
        }
        let turns = matches!(tag, kept::TARGET_VELOCITY | kept::TARGET_TORQUE | kept::MODE);
        if turns && self.axis.state().has_power() {
            self.starts += 1;
        }
        Ok(())
    }

    /// Positions in user units, from where 0 is.
    #[inline]
    fn coordinate(&self, position: f64) -> i32 {
        self.objects.position(position - self.axis.origin())
    }

    fn increments(&self, position: f64) -> i32 {
        let turns = (position - self.axis.origin()) / TAU;
        nearest(turns * self.objects.turn()) as i32
    }

    fn reading(&self, tag: u16) -> i64 {
        let shaft = &self.shaft;
        match tag {
            read::STATUS => self.axis.status(shaft.has_voltage()).into(),
            read::POSITION => self.coordinate(shaft.position()).into(),
            read::VELOCITY | read::SENSOR_VELOCITY => {
                self.objects.velocity(shaft.velocity()).into()
            }
            read::TORQUE | read::CURRENT => nearest(shaft.torque() * 1000.0),
            read::ERROR_CODE => self.fault.0.into(),
            read::MODE => self.axis.mode().into(),
            read::POSITION_DEMAND => self.coordinate(shaft.setpoint().position).into(),
            read::INCREMENTS => self.increments(shaft.position()).into(),
            read::VELOCITY_DEMAND => self.objects.velocity(shaft.setpoint().velocity).into(),
            read::TORQUE_DEMAND => nearest(self.axis.torque_demand() * 1000.0),
            read::RATED_CURRENT => nearest(RATED_CURRENT * 1000.0),
            read::RATED_TORQUE => nearest(shaft.rated_torque() * 1000.0),
            read::VOLTAGE => nearest(shaft.supply * 1000.0),
            read::FOLLOWING_ERROR => {
                self.objects.position(shaft.setpoint().position - shaft.position()).into()
            }
            read::DEMAND_INCREMENTS => self.increments(shaft.setpoint().position).into(),
            read::INPUTS => self.inputs(),
            read::TEMPERATURE => nearest(shaft.temperature()),
            read::CLOCK => self.clock(),
            read::STREAMED => self.files.streamed().into(),
            read::STREAM_CHECK => self.files.check().into(),
            _ => 0,
        }
    }

    fn inputs(&self) -> i64 {
        let (lines, position) = (&self.lines, self.shaft.motor().position());
        let bit = |n: u8, closed: bool| i64::from(closed) << n;
        bit(0, lines.negative(position))
            | bit(1, lines.positive(position))
            | bit(2, lines.is_home(position))
    }

    fn clock(&self) -> i64 {
        let Some((given, at)) = self.clock else { return 0 };
        let ms = given.unix_ms() + self.now.since(at).as_millis() as u64;
        let [a, b, c, d, e, f] = TimeOfDay::from_unix_ms(ms).unwrap_or_default().bytes();
        i64::from_le_bytes([a, b, c, d, e, f, 0, 0])
    }
}

/// What is refused though it lies within the entry's limits.
const fn is_allowed(tag: u16, value: i64) -> bool {
    match tag {
        kept::MODE => matches!(
            value as i8,
            0 | modes::PROFILE_POSITION
                | modes::PROFILE_VELOCITY
                | modes::PROFILE_TORQUE
                | modes::HOMING
                | modes::CYCLIC_POSITION
                | modes::CYCLIC_VELOCITY
                | modes::CYCLIC_TORQUE
        ),
        kept::HOMING_METHOD => is_method(value as i8),
        _ => true,
    }
}

impl Firmware for Drive {
    fn dictionary(&self) -> &'static Dictionary {
        &DICTIONARY
    }

    fn node_id(&self) -> u8 {
        self.node
    }

    fn bit_rate(&self) -> u32 {
        self.bit_rate
    }

    fn serial(&self) -> u32 {
        self.serial
    }

    #[inline]
    fn get(&mut self, tag: u16) -> u64 {
        if tag < read::FIRST {
            return i64::from(self.objects.value(tag)).cast_unsigned();
        }
        self.reading(tag).cast_unsigned()
    }

    /// What comes each cycle goes ahead of the rest.
    #[inline]
    fn set(&mut self, _now: Instant, tag: u16, value: u64) -> Result<(), Abort> {
        match tag {
            kept::CONTROL if value as u16 == self.axis.control_word() => {}
            kept::TARGET_POSITION if self.axis.mode() == modes::CYCLIC_POSITION => {
                self.objects.set(tag, value as i32);
                self.starts += u64::from(self.axis.state().has_power());
            }
            _ => return self.set_other(tag, value),
        }
        Ok(())
    }

    fn length(&mut self, tag: u16) -> u32 {
        match tag {
            read::SCRATCH => self.files.length(),
            _ => self.objects.value(kept::STREAM_LENGTH).cast_unsigned(),
        }
    }

    fn read(&mut self, tag: u16, offset: u32, out: &mut [u8]) {
        self.files.read(tag, offset, out);
    }

    fn begin(&mut self, tag: u16, size: Option<u32>) -> Result<(), Abort> {
        self.files.begin(tag, size)
    }

    fn write(&mut self, tag: u16, offset: u32, data: &[u8]) -> Result<(), Abort> {
        self.files.write(tag, offset, data)
    }

    #[inline]
    fn synced(&mut self, _now: Instant) {
        self.act(Axis::sync);
    }

    fn entered(&mut self, now: Instant, state: State) {
        if state == State::Stopped {
            self.lost(now);
        }
    }

    fn reset(&mut self, _now: Instant) {
        self.start_anew();
    }

    /// As 6007h says.
    fn lost(&mut self, _now: Instant) {
        match self.objects.value(kept::ABORT_OPTION) {
            1 => self.raise(Fault::LINK),
            2 => self.act(Axis::disable),
            3 => self.act(Axis::quick_stop),
            _ => {}
        }
    }

    fn error_register(&self) -> u8 {
        self.fault.register()
    }

    #[inline]
    fn poll_emergency(&mut self) -> Option<Emergency> {
        if self.told == self.fault {
            return None;
        }
        self.told = self.fault;
        Some(Emergency { code: self.fault.0, ..Emergency::default() })
    }

    fn store(&mut self, group: Group) {
        self.flash_writes += 1;
        if group != Group::Communication {
            self.kept = Some(self.objects.settings());
        }
    }

    fn restore(&mut self, _group: Group) {
        self.flash_writes += 1;
        self.kept = None;
    }

    fn set_node_id(&mut self, node: u8) {
        self.node = node;
    }

    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        self.bit_rate = bit_rate;
        true
    }

    fn store_link(&mut self) -> bool {
        self.flash_writes += 1;
        (self.kept_node, self.kept_bit_rate) = (self.node, self.bit_rate);
        true
    }

    fn clock(&mut self, now: Instant, time: TimeOfDay) {
        self.clock = Some((time, now));
    }

    fn time_of_day(&mut self, now: Instant) -> Option<TimeOfDay> {
        let (given, at) = self.clock?;
        TimeOfDay::from_unix_ms(given.unix_ms() + now.since(at).as_millis() as u64)
    }
}
