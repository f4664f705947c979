//! The drive: objects, motion, faults and time, independent of its bus.

use core::f64::consts::TAU;

use super::faults::FaultCode;
use super::interpolation::RecordBuffer;
use super::objects::{ALL_MODES, DICTIONARY, Objects, VELOCITY_MODE, computed, stored};
use super::protections::{self, RATED_CURRENT, STALL_TICKS};
use super::touch_probe::TouchProbes;
use super::transfer_objects::TransferObjects;
use polepair_core::plant::{ServoShaft, TICK_NS, Ticks};
use polepair_core::proto::canopen::device::motion::{
    MotionAxis, MotionContext, MotionEvent, MotionLimits, MotionQuirks, PowerState as Power,
    is_method, modes,
};
use polepair_core::proto::canopen::device::{
    DomainObjects, Firmware, NodeClock, NodeIdentity, NodeStorage, SettingsGroup,
};
use polepair_core::proto::canopen::emcy::Emergency;
use polepair_core::proto::canopen::nmt::NmtState;
use polepair_core::proto::canopen::od::Dictionary;
use polepair_core::proto::canopen::sdo::AbortCode;
use polepair_core::proto::canopen::time::TimeOfDay;
use polepair_core::time::Instant;
use polepair_core::units::nearest;

/// The standard leaves nothing of this open.
const MOTION_QUIRKS: MotionQuirks = MotionQuirks {
    sets_remote_bit: true,
    fault_warns: false,
    enables_stepwise: false,
    homing_by_edge: false,
};
/// Set-points that wait behind the one that runs (CiA 402: one).
const QUEUED_POINTS: usize = 1;
/// Inputs of 60FDh: limit switches and home switch.
const INPUTS: usize = 3;

/// Switches that the shaft closes, and lines that something outside closes. In the order of 60FDh:
/// negative limit, positive limit, home.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SwitchLines {
    /// Shaft position of each switch, rad; infinite where there is none.
    switch_positions: [f64; INPUTS],
    /// Shaft position from which on the home switch is open again, rad.
    home_until: f64,
    /// Lines that something outside closes.
    forced_closed: [bool; INPUTS],
}

/// Positions that no shaft comes to.
const NOWHERE: [f64; INPUTS] = [f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY];

impl SwitchLines {
    /// The home switch alone, at that shaft position (rad).
    const fn with_home(at: f64) -> Self {
        let [negative, positive, _] = NOWHERE;
        let switch_positions = [negative, positive, at];
        Self { switch_positions, home_until: f64::INFINITY, forced_closed: [false; INPUTS] }
    }

    /// Moves the switch of a line to a shaft position (rad), or takes it away.
    pub fn set_switch(&mut self, line: usize, at: Option<f64>) {
        self.switch_positions[line] = at.unwrap_or(NOWHERE[line]);
    }

    /// The home switch is open again from that shaft position (rad) on, or never.
    pub fn open_home(&mut self, from: Option<f64>) {
        self.home_until = from.unwrap_or(f64::INFINITY);
    }

    /// Something outside closes a line, or opens it.
    pub const fn force_line(&mut self, line: usize, closed: bool) {
        self.forced_closed[line] = closed;
    }

    #[inline]
    fn is_negative_closed(&self, position: f64) -> bool {
        (position <= self.switch_positions[0]) | self.forced_closed[0]
    }

    #[inline]
    fn is_positive_closed(&self, position: f64) -> bool {
        (position >= self.switch_positions[1]) | self.forced_closed[1]
    }

    #[inline]
    fn is_home_closed(&self, position: f64) -> bool {
        ((position >= self.switch_positions[2]) & (position < self.home_until))
            | self.forced_closed[2]
    }

    /// Position of the home switch's only edge.
    #[inline]
    fn home_edge(&self) -> Option<f64> {
        (self.home_until == f64::INFINITY && self.switch_positions[2] != f64::INFINITY)
            .then_some(self.switch_positions[2])
    }
}

/// A powered drive with its motor. It lies in memory in this order: what each cycle needs first.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Drive {
    ticks: Ticks,
    now: Instant,
    fault: FaultCode,
    reported_fault: FaultCode,
    /// Motions begun, and those that a repetition would have begun again.
    starts: u64,
    lines: SwitchLines,
    objects: Objects,
    shaft: ServoShaft,
    axis: MotionAxis<QUEUED_POINTS>,
    unrepeatable: u64,
    /// The time of day that was given, and when.
    clock: Option<(TimeOfDay, Instant)>,
    notice: Option<&'static str>,
    flash_writes: u64,
    node: u8,
    stored_node: u8,
    bit_rate: u32,
    stored_bit_rate: u32,
    serial: u32,
    files: TransferObjects,
    stored_objects: Option<Objects>,
    /// Bits of 6502h: the modes that it has.
    modes: u32,
    probes: TouchProbes,
    records: RecordBuffer,
}

impl Drive {
    /// A drive as from the factory, with that node-ID.
    #[must_use]
    pub fn new(node: u8, serial: u32, bit_rate: u32) -> Self {
        Self {
            ticks: Ticks::new(Instant::ZERO),
            now: Instant::ZERO,
            shaft: ServoShaft::new(RATED_CURRENT, STALL_TICKS),
            axis: MotionAxis::new(MOTION_QUIRKS, 0.0),
            objects: Objects::factory(),
            // Half a turn behind, so that homing finds it.
            lines: SwitchLines::with_home(-TAU / 2.0),
            fault: FaultCode::NONE,
            reported_fault: FaultCode::NONE,
            clock: None,
            notice: None,
            unrepeatable: 0,
            starts: 0,
            flash_writes: 0,
            node,
            stored_node: node,
            bit_rate,
            stored_bit_rate: bit_rate,
            serial,
            files: TransferObjects::default(),
            stored_objects: None,
            modes: ALL_MODES,
            probes: TouchProbes::default(),
            records: RecordBuffer::default(),
        }
    }

    /// An inverter: a drive with the velocity mode alone.
    #[must_use]
    pub const fn with_velocity_mode_only(mut self) -> Self {
        self.modes = VELOCITY_MODE;
        self
    }

    /// A drive with these modes alone (bits of 6502h).
    #[must_use]
    pub const fn with_modes(mut self, modes: u32) -> Self {
        self.modes = modes & ALL_MODES;
        self
    }

    /// [`new`](Self::new) with other factory values.
    #[must_use]
    pub fn with_objects(mut self, objects: Objects) -> Self {
        self.objects = objects.clone();
        self.apply_torque_limits();
        self.set_reset_objects(objects);
        self
    }

    /// Sets the values that a reset restores, until settings are stored or restored.
    pub fn set_reset_objects(&mut self, objects: Objects) {
        self.stored_objects = Some(objects);
    }

    /// Lets time pass up to `now`.
    #[inline]
    pub fn advance(&mut self, now: Instant) {
        let ticks = self.ticks.advance_to(now);
        self.now = self.now.max(now);
        if ticks > 0 {
            self.run_ticks(ticks);
        }
    }

    fn run_ticks(&mut self, ticks: u64) {
        if self.shaft.is_resting() {
            // Nothing moves and nothing pushes: hours of simulated rest are one step, not millions.
            self.shaft.pass_rest(ticks);
            return self.check_protections();
        }
        for _ in 0..ticks {
            self.tick();
        }
    }

    /// Time of the next call to [`advance`](Self::advance), without a request.
    #[must_use]
    pub fn next_due(&self) -> Option<Instant> {
        // A resting drive asks for no wake-up, so that a bench of a thousand idle drives costs nothing.
        (!self.shaft.is_resting()).then(|| self.ticks.at().plus_ns(TICK_NS))
    }

    /// The motor, and what acts on it.
    #[must_use]
    pub const fn shaft(&self) -> &ServoShaft {
        &self.shaft
    }

    /// The motor, for what acts on it from outside.
    pub const fn shaft_mut(&mut self) -> &mut ServoShaft {
        &mut self.shaft
    }

    /// The switches, for what acts on them from outside.
    pub const fn lines_mut(&mut self) -> &mut SwitchLines {
        &mut self.lines
    }

    /// The fault, if there is one.
    #[must_use]
    pub const fn fault(&self) -> FaultCode {
        self.fault
    }

    /// Motions begun that a repetition of their order would have begun again, and all.
    #[must_use]
    pub const fn motion_counts(&self) -> (u64, u64) {
        (self.unrepeatable, self.starts)
    }

    /// Times that its flash was written.
    #[must_use]
    pub const fn flash_writes(&self) -> u64 {
        self.flash_writes
    }

    /// Takes the event since the last call.
    pub const fn take_notice(&mut self) -> Option<&'static str> {
        self.notice.take()
    }

    /// Raises a fault: removes power as 605Eh states.
    pub fn raise_fault(&mut self, fault: FaultCode) {
        if self.fault != FaultCode::NONE {
            return;
        }
        debug_assert!(fault != FaultCode::NONE);
        self.fault = fault;
        self.notice = Some(fault.name());
        // The first fault stays the reported one: what it causes afterwards (a following error behind an
        // undervoltage) would hide the cause from the technician.
        self.with_axis(MotionAxis::handle_fault);
    }

    /// Power off and on.
    pub fn power_cycle(&mut self) {
        // An id that LSS set without storing it lasts until here (CiA 305, switch and store are two services).
        (self.node, self.bit_rate) = (self.stored_node, self.stored_bit_rate);
        // No battery: the time of day has to be sent again.
        self.clock = None;
        self.restart();
    }

    fn restart(&mut self) {
        self.shaft.power_off();
        self.shaft.reset_protections();
        self.objects = self.stored_objects.clone().unwrap_or_else(Objects::factory);
        self.axis = MotionAxis::new(MOTION_QUIRKS, self.shaft.position());
        (self.fault, self.reported_fault) = (FaultCode::NONE, FaultCode::NONE);
        self.probes.set_function(0);
        self.records.clear();
        self.apply_torque_limits();
    }

    fn apply_torque_limits(&mut self) {
        let (backward, forward) = self.objects.torque_limits();
        self.shaft.limit_torque(backward, forward);
    }

    /// Something outside closes the input of a touch probe, or opens it.
    pub fn set_probe_input(&mut self, probe: usize, closed: bool) {
        let position = self.coordinate(self.shaft.position());
        self.probes.handle_input(probe, closed, position);
    }

    /// Takes a record of the interpolated position mode.
    fn take_record(&mut self, record: i32) -> Result<(), AbortCode> {
        if self.objects.value(stored::BUFFER_CLEAR) == 0 {
            return Err(AbortCode::STATE);
        }
        let size = self.objects.value(stored::BUFFER_SIZE) as usize;
        if size == 1 {
            self.objects.set(stored::ACTIVE_RECORD, record);
        } else if !self.records.push(record, size) {
            return Err(AbortCode::RESOURCE);
        }
        self.objects.set(stored::RECORD, record);
        self.starts += u64::from(self.axis.state().has_power());
        Ok(())
    }

    #[cold]
    fn handle_index_pulse(&mut self) {
        if let Some(position) = self.shaft.index_pulse() {
            self.probes.handle_index(self.coordinate(position));
        }
    }

    #[inline]
    fn with_axis<R>(
        &mut self,
        act: impl FnOnce(&mut MotionAxis<QUEUED_POINTS>, &mut MotionContext<'_, Objects>) -> R,
    ) -> R {
        // The switches see the real shaft, not the encoder: a broken encoder does not move a switch.
        let position = self.shaft.motor().position();
        let mut scene = MotionContext {
            negative: self.lines.is_negative_closed(position),
            positive: self.lines.is_positive_closed(position),
            home: self.lines.is_home_closed(position),
            home_at: self.lines.home_edge(),
            shaft: &mut self.shaft,
            settings: &self.objects,
        };
        act(&mut self.axis, &mut scene)
    }

    fn tick(&mut self) {
        if self.axis.needs_record()
            && let Some(record) = self.records.pop()
        {
            self.objects.set(stored::ACTIVE_RECORD, record);
        }
        // Following a streamed setpoint is the common case of a busy bus and needs no mode switch per tick.
        let event = if self.axis.is_following() {
            self.with_axis(MotionAxis::tick_following)
        } else {
            self.with_axis(MotionAxis::tick)
        };
        if event == Some(MotionEvent::FollowingError) {
            self.raise_fault(FaultCode::FOLLOWING);
        }
        // After the axis, so that the setpoint of this millisecond acts in this millisecond.
        self.shaft.tick();
        if self.probes.waits_for_index() {
            self.handle_index_pulse();
        }
        self.check_protections();
    }

    #[inline]
    fn check_protections(&mut self) {
        let fault = protections::check(&mut self.shaft, || self.axis.seeks_hard_stop());
        if let Some(fault) = fault {
            self.raise_fault(fault);
        }
    }

    fn write_controlword(&mut self, word: u16) {
        // A fault whose cause is still there cannot be acknowledged; the state machine stays in FAULT.
        let starved =
            self.fault == FaultCode::UNDERVOLTAGE && !protections::has_voltage(&self.shaft);
        let clear = !starved && protections::lasting_fault(&self.shaft).is_none();
        let before = self.axis.state();
        if self.with_axis(|axis, scene| axis.handle_controlword(word, clear, scene)) {
            // A new set-point bit with a relative target: a repeated telegram would move the axis twice.
            self.unrepeatable += 1;
            self.starts += 1;
        }
        let after = self.axis.state();
        // Power alone counts as a start: a vertical axis or a cyclic target moves at once.
        if !before.has_power() && after.has_power() {
            self.starts += 1;
        }
        if before == Power::Fault && after != Power::Fault {
            // The motor model keeps its heat: acknowledging a fault cools nothing.
            self.fault = FaultCode::NONE;
            self.shaft.reset_protections();
        }
    }

    fn set_slow_path(&mut self, tag: u16, value: u64) -> Result<(), AbortCode> {
        // Refused before it is stored, so that a read-back never shows a mode which the drive does not have.
        if !self.is_allowed(tag, value.cast_signed()) {
            return Err(AbortCode::VALUE);
        }
        if tag == stored::RECORD {
            return self.take_record(value as i32);
        }
        self.objects.set(tag, value as i32);
        match tag {
            stored::MAX_TORQUE | stored::FORWARD_TORQUE | stored::BACKWARD_TORQUE => {
                self.apply_torque_limits();
            }
            stored::TOUCH_PROBE => self.probes.set_function(value as u16),
            stored::BUFFER_CLEAR if value == 0 => self.records.clear(),
            // A smaller buffer cannot hold what waits.
            stored::BUFFER_SIZE => self.records.clear(),
            stored::CONTROL => self.write_controlword(value as u16),
            // Only a new edge of the controlword takes it over.
            stored::TARGET_POSITION if self.axis.mode() == modes::PROFILE_POSITION => {}
            _ => self.with_axis(MotionAxis::handle_object_change),
        }
        // These act without an edge of the controlword (CiA 402-2, profile velocity and torque mode).
        let turns = matches!(
            tag,
            stored::TARGET_VELOCITY | stored::TARGET_TORQUE | stored::VL_TARGET | stored::MODE
        );
        if turns && self.axis.state().has_power() {
            self.starts += 1;
        }
        Ok(())
    }

    /// Returns false for values that are refused although they lie within the entry's limits.
    const fn is_allowed(&self, tag: u16, value: i64) -> bool {
        match tag {
            // The bit of mode 1 is bit 0 (CiA 402-2, 6502h).
            stored::MODE => match value as i8 {
                0 => true,
                mode @ 1..=10 => self.modes >> (mode - 1) & 1 != 0,
                _ => false,
            },
            stored::HOMING_METHOD => is_method(value as i8),
            _ => true,
        }
    }

    /// Positions in user units, from where 0 is.
    #[inline]
    fn coordinate(&self, position: f64) -> i32 {
        self.objects.to_user_position(position - self.axis.origin())
    }

    fn increments(&self, position: f64) -> i32 {
        let turns = (position - self.axis.origin()) / TAU;
        nearest(turns * self.objects.increments_per_turn()) as i32
    }

    fn reading(&self, tag: u16) -> i64 {
        let shaft = &self.shaft;
        match tag {
            computed::STATUS => self.axis.status(protections::has_voltage(shaft)).into(),
            computed::POSITION => self.coordinate(shaft.position()).into(),
            computed::VELOCITY | computed::SENSOR_VELOCITY => {
                self.objects.to_user_velocity(shaft.velocity()).into()
            }
            computed::TORQUE | computed::CURRENT => nearest(shaft.torque() * 1000.0),
            computed::ERROR_CODE => self.fault.0.into(),
            computed::MODE => self.axis.mode().into(),
            computed::POSITION_DEMAND => self.coordinate(shaft.setpoint().position).into(),
            computed::INCREMENTS => self.increments(shaft.position()).into(),
            computed::VELOCITY_DEMAND => {
                self.objects.to_user_velocity(shaft.setpoint().velocity).into()
            }
            computed::TORQUE_DEMAND => nearest(self.axis.torque_demand() * 1000.0),
            computed::RATED_CURRENT => nearest(RATED_CURRENT * 1000.0),
            computed::RATED_TORQUE => nearest(shaft.rated_torque() * 1000.0),
            computed::VOLTAGE => nearest(shaft.supply * 1000.0),
            computed::FOLLOWING_ERROR => {
                self.objects.to_user_position(shaft.setpoint().position - shaft.position()).into()
            }
            computed::DEMAND_INCREMENTS => self.increments(shaft.setpoint().position).into(),
            computed::INPUTS => self.input_bits(),
            computed::TEMPERATURE => nearest(shaft.temperature()),
            computed::CLOCK => self.clock_value(),
            computed::STREAMED => self.files.streamed().into(),
            computed::STREAM_CHECK => self.files.stream_crc().into(),
            computed::MODES => self.modes.into(),
            computed::VL_DEMAND => {
                nearest(shaft.setpoint().velocity / self.objects.velocity_mode_unit())
            }
            computed::VL_VELOCITY => nearest(shaft.velocity() / self.objects.velocity_mode_unit()),
            computed::BUFFER_POSITION => self.records.len() as i64,
            computed::TOUCH_PROBE_STATUS => self.probes.status().into(),
            _ => {
                let probe = usize::from(tag.saturating_sub(computed::TOUCH_PROBE_POSITIONS));
                self.probes.positions().get(probe).copied().unwrap_or_default().into()
            }
        }
    }

    fn input_bits(&self) -> i64 {
        let (lines, position) = (&self.lines, self.shaft.motor().position());
        input_bit(0, lines.is_negative_closed(position))
            | input_bit(1, lines.is_positive_closed(position))
            | input_bit(2, lines.is_home_closed(position))
            | input_bit(16, self.probes.is_closed(0))
            | input_bit(17, self.probes.is_closed(1))
    }

    fn clock_value(&self) -> i64 {
        // Zero is "not set" for a TIME_OF_DAY: no drive has a date before 1984 (CiA 301, TIME_OF_DAY).
        let Some((given, at)) = self.clock else { return 0 };
        let ms = given.unix_ms() + self.now.since(at).as_millis() as u64;
        let [a, b, c, d, e, f] = TimeOfDay::from_unix_ms(ms).unwrap_or_default().bytes();
        i64::from_le_bytes([a, b, c, d, e, f, 0, 0])
    }
}

fn input_bit(n: u8, closed: bool) -> i64 {
    i64::from(closed) << n
}

impl NodeIdentity for Drive {
    fn node_id(&self) -> u8 {
        self.node
    }

    fn bit_rate(&self) -> u32 {
        self.bit_rate
    }

    fn serial(&self) -> u32 {
        self.serial
    }

    fn set_node_id(&mut self, node: u8) {
        debug_assert!(
            (1..=127).contains(&node) || node == 255,
            "255 is the unconfigured node of CiA 305"
        );
        self.node = node;
    }

    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        self.bit_rate = bit_rate;
        true
    }

    fn store_link(&mut self) -> bool {
        self.flash_writes += 1;
        (self.stored_node, self.stored_bit_rate) = (self.node, self.bit_rate);
        true
    }
}

impl DomainObjects for Drive {
    fn length(&mut self, tag: u16) -> u32 {
        match tag {
            computed::SCRATCH => self.files.scratch_len(),
            _ => self.objects.value(stored::STREAM_LENGTH).cast_unsigned(),
        }
    }

    fn read(&mut self, tag: u16, offset: u32, out: &mut [u8]) {
        self.files.read(tag, offset, out);
    }

    fn begin_write(&mut self, tag: u16, size: Option<u32>) -> Result<(), AbortCode> {
        self.files.begin_write(tag, size)
    }

    fn write(&mut self, tag: u16, offset: u32, data: &[u8]) -> Result<(), AbortCode> {
        self.files.write(tag, offset, data)
    }
}

impl NodeStorage for Drive {
    fn store(&mut self, group: SettingsGroup) {
        self.flash_writes += 1;
        if group != SettingsGroup::Communication {
            // Settings only: targets and the controlword must not act again after the next power-up.
            self.stored_objects = Some(self.objects.settings());
        }
    }

    fn restore(&mut self, _group: SettingsGroup) {
        self.flash_writes += 1;
        self.stored_objects = None;
    }
}

impl NodeClock for Drive {
    fn set_time_of_day(&mut self, now: Instant, time: TimeOfDay) {
        self.clock = Some((time, now));
    }

    fn time_of_day(&mut self, now: Instant) -> Option<TimeOfDay> {
        let (given, at) = self.clock?;
        TimeOfDay::from_unix_ms(given.unix_ms() + now.since(at).as_millis() as u64)
    }
}

impl Firmware for Drive {
    fn dictionary(&self) -> &'static Dictionary {
        &DICTIONARY
    }

    #[inline]
    fn get(&mut self, tag: u16) -> u64 {
        if tag < computed::FIRST {
            return i64::from(self.objects.value(tag)).cast_unsigned();
        }
        self.reading(tag).cast_unsigned()
    }

    /// Writes a cyclic value ahead of the others.
    #[inline]
    fn set(&mut self, _now: Instant, tag: u16, value: u64) -> Result<(), AbortCode> {
        match tag {
            // A process data object repeats the same word each cycle; without an edge there is nothing to do.
            stored::CONTROL if value as u16 == self.axis.control_word() => {}
            // The path of every SYNC of every axis, kept out of the long match below.
            stored::TARGET_POSITION if self.axis.mode() == modes::CYCLIC_POSITION => {
                self.objects.set(tag, value as i32);
                self.starts += u64::from(self.axis.state().has_power());
            }
            _ => return self.set_slow_path(tag, value),
        }
        Ok(())
    }

    #[inline]
    fn handle_sync(&mut self, _now: Instant) {
        // Records that wait are taken by the drive's own clock of 60C2h.
        if self.axis.mode() == modes::INTERPOLATED_POSITION
            && self.objects.value(stored::BUFFER_SIZE) > 1
        {
            return;
        }
        self.with_axis(MotionAxis::handle_sync);
    }

    fn handle_nmt_state(&mut self, now: Instant, state: NmtState) {
        // In STOPPED no process data arrives any more: to the axis that is a lost link (CiA 402, 6007h).
        if state == NmtState::Stopped {
            self.handle_link_loss(now);
        }
    }

    fn reset(&mut self, _now: Instant) {
        self.restart();
    }

    /// Reacts to the loss of the link as 6007h states.
    fn handle_link_loss(&mut self, _now: Instant) {
        match self.objects.value(stored::ABORT_OPTION) {
            1 => self.raise_fault(FaultCode::LINK),
            2 => self.with_axis(MotionAxis::disable),
            3 => self.with_axis(MotionAxis::quick_stop),
            _ => {}
        }
    }

    fn error_register(&self) -> u8 {
        self.fault.error_register()
    }

    #[inline]
    fn poll_emergency(&mut self) -> Option<Emergency> {
        // One emergency object for each change, also for the change to "no error" (CiA 301, emergency object).
        if self.reported_fault == self.fault {
            return None;
        }
        self.reported_fault = self.fault;
        Some(Emergency { code: self.fault.0, ..Emergency::default() })
    }
}
