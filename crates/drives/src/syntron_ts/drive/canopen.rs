//! CANopen mode (Fn_00 = 20): the registers as objects, and the motion of the drive profile (TS manual V2,
//! chapter 3).

use super::super::objects::{
    COMPUTED_TAGS, CommandedObjects, DICTIONARY, DN_TAGS, Objects, STORED_TAGS, computed,
    is_method, is_mode, seeks_home_switch, stored,
};
use super::super::shaft::{self, COUNTS_PER_TURN};
use super::*;
use polepair_core::plant::{ServoShaft, Setpoint};
use polepair_core::proto::canopen::device::motion::{
    self, MotionAxis, MotionEvent, MotionQuirks, modes,
};
use polepair_core::proto::canopen::device::{
    DomainObjects, Firmware, NodeClock, NodeIdentity, NodeStorage,
};
use polepair_core::proto::canopen::emcy::Emergency;
use polepair_core::proto::canopen::nmt::NmtState as Nmt;
use polepair_core::proto::canopen::od::Dictionary;
use polepair_core::proto::canopen::sdo::AbortCode;

/// Set-points that wait behind the one that runs (§3.6.2).
const QUEUED_POINTS: usize = 32;
/// Bit 9 stays 0 and an alarm shows 0088h (§3.3); enabling takes 6, 7 and F in turn `[I]`; the
/// recipe takes bit 4 back at once and homing goes on (§3.6.4).
const MOTION_QUIRKS: MotionQuirks = MotionQuirks {
    sets_remote_bit: false,
    fault_warns: true,
    enables_stepwise: true,
    homing_by_edge: true,
};

/// States that are reported by an emergency (chapter 4).
const FORWARD_LIMIT: u16 = 0x8681;
const REVERSE_LIMIT: u16 = 0x8682;
const ARRIVED: u16 = 0x8683;

/// State of CANopen mode beside the registers.
#[derive(Debug)]
pub(super) struct CanopenNode {
    axis: MotionAxis<QUEUED_POINTS>,
    objects: Objects,
    /// Alarm of the last report.
    reported_alarm: Alarm,
    arrival_pending: bool,
    /// Limit switches of the last report.
    reported_limits: [bool; 2],
}

impl CanopenNode {
    /// After power-on, with the shaft at `position`, rad.
    pub(super) fn new(position: f64) -> Self {
        let axis = MotionAxis::new(MOTION_QUIRKS, position);
        Self {
            axis,
            objects: Objects::default(),
            reported_alarm: Alarm::NONE,
            arrival_pending: false,
            reported_limits: [false; 2],
        }
    }

    pub(super) const fn seeks_hard_stop(&self) -> bool {
        self.axis.seeks_hard_stop()
    }
}

impl DriveCore {
    /// Calls a function with the state that a motion needs.
    fn with_axis<R>(
        &mut self,
        act: impl FnOnce(
            &mut MotionAxis<QUEUED_POINTS>,
            &mut motion::MotionContext<'_, CommandedObjects<'_>>,
        ) -> R,
    ) -> R {
        let position = self.shaft.motor().position();
        let method = self.canopen.objects.value(stored::HOMING_METHOD) as i8;
        let seeks = self.canopen.axis.is_homing() && seeks_home_switch(method);
        let is_end = |toward| seeks && self.lines.is_search_end(toward, position);
        let settings = CommandedObjects {
            objects: &self.canopen.objects,
            registers: &self.registers,
            homes_by_cia: self.options.homes_by_cia,
        };
        let mut scene = motion::MotionContext {
            home: self.is_input_closed(InputPurpose::Home, position),
            home_at: self.lines.home_at,
            positive: self.is_input_closed(InputPurpose::ForwardLimit, position) || is_end(1.0),
            negative: self.is_input_closed(InputPurpose::ReverseLimit, position) || is_end(-1.0),
            shaft: &mut self.shaft,
            settings: &settings,
        };
        act(&mut self.canopen.axis, &mut scene)
    }

    /// One tick of CANopen mode, before the shaft's.
    pub(super) fn tick_canopen(&mut self) {
        let origin = self.canopen.axis.origin();
        let event = self.with_axis(|axis, scene| axis.tick(scene));
        if event == Some(MotionEvent::FollowingError) {
            self.raise_alarm(Alarm::PE);
        }
        self.canopen.arrival_pending |= event == Some(MotionEvent::Arrived)
            && self.canopen.axis.mode() == modes::PROFILE_POSITION;
        if origin != self.canopen.axis.origin() {
            self.motion.set_origin(self.canopen.axis.origin());
        }
    }

    /// An alarm was raised, in whatever mode.
    pub(super) fn fault_canopen(&mut self) {
        self.with_axis(|axis, scene| axis.handle_fault(scene));
    }

    /// Another mode, or power-on: nothing is commanded.
    pub(super) fn reset_canopen(&mut self) {
        let mut node = CanopenNode::new(self.motion.origin());
        (node.reported_alarm, node.reported_limits) =
            (self.canopen.reported_alarm, self.canopen.reported_limits);
        node.objects = core::mem::take(&mut self.canopen.objects);
        node.objects.set(stored::CONTROL, 0);
        self.canopen = node;
        if self.alarm.is_some() {
            self.fault_canopen();
        }
    }

    fn write_controlword(&mut self, word: u16) {
        if self.mode() != MODE_CANOPEN {
            return;
        }
        let before = self.canopen.axis.state();
        if !before.has_power() && !shaft::is_bus_ready(&self.shaft) && word & 0x0F == 0x0F {
            return self.raise_alarm(Alarm::DE);
        }
        if self.with_axis(|axis, scene| axis.handle_controlword(word, true, scene)) {
            self.unrepeatable += 1;
            self.starts += 1;
        }
        let after = self.canopen.axis.state();
        self.starts += u64::from(!before.has_power() && after.has_power());
        if before == motion::PowerState::Fault && after != before {
            self.clear_alarm();
        }
    }

    fn set_object(&mut self, tag: u16, value: i32) -> Result<(), AbortCode> {
        let allowed = match tag {
            stored::MODE => is_mode(value as i8),
            stored::HOMING_METHOD => is_method(value as i8),
            _ => true,
        };
        if !allowed {
            return Err(AbortCode::VALUE);
        }
        self.canopen.objects.set(tag, value);
        match tag {
            stored::CONTROL => self.write_controlword(value as u16),
            stored::TARGET_POSITION => {}
            _ => self.with_axis(|axis, scene| axis.handle_object_change(scene)),
        }
        let turns = matches!(tag, stored::TARGET_VELOCITY | stored::TARGET_TORQUE | stored::MODE);
        self.starts += u64::from(turns && self.canopen.axis.state().has_power());
        Ok(())
    }

    fn object_value(&self, tag: u16) -> i64 {
        let (node, shaft) = (&self.canopen, &self.shaft);
        let origin = self.motion.origin();
        match tag {
            computed::STATUS if self.mode() == MODE_CANOPEN => node.axis.status(true).into(),
            computed::STATUS if self.alarm.is_some() => 0x88,
            computed::STATUS => 0x50,
            computed::MODE => node.axis.mode().into(),
            computed::POSITION_DEMAND => {
                to_pulses(demanded_setpoint(shaft).position - origin, &node.objects)
            }
            computed::POSITION => to_pulses(shaft.position() - origin, &node.objects),
            computed::INCREMENTS => to_increments(shaft.position(), origin),
            computed::DEMAND_INCREMENTS => to_increments(demanded_setpoint(shaft).position, origin),
            computed::SENSOR_VELOCITY => nearest(shaft::rpm(shaft) * 10.0),
            computed::VELOCITY_DEMAND => nearest(demanded_setpoint(shaft).velocity / TAU * 600.0),
            computed::VELOCITY => nearest(shaft::rpm(shaft)),
            computed::FOLLOWING_ERROR => {
                to_pulses(demanded_setpoint(shaft).position - shaft.position(), &node.objects)
            }
            computed::ERROR_CODE => self.alarm.0.into(),
            computed::TIME => (self.now.0 / 1000) as i64 & 0xFFFF_FFFF,
            computed::TORQUE => nearest(shaft.torque() * 1000.0),
            _ => node.objects.value(tag).into(),
        }
    }

    /// The emergency of a limit switch that has closed, in CANopen mode.
    fn next_limit_emergency(&mut self) -> Option<u16> {
        if self.mode() != MODE_CANOPEN {
            return None;
        }
        let position = self.shaft.motor().position();
        let ends = [
            (InputPurpose::ForwardLimit, FORWARD_LIMIT),
            (InputPurpose::ReverseLimit, REVERSE_LIMIT),
        ];
        ends.into_iter().enumerate().find_map(|(n, (purpose, code))| {
            let is = self.lines.is_closed(purpose, position);
            let was = core::mem::replace(&mut self.canopen.reported_limits[n], is);
            (is && !was).then_some(code)
        })
    }
}

fn to_pulses(rad: f64, node_objects: &Objects) -> i64 {
    i64::from(node_objects.pulses(rad))
}

fn to_increments(position: f64, origin: f64) -> i64 {
    nearest((position - origin) / TAU * COUNTS_PER_TURN)
}

fn demanded_setpoint(shaft: &ServoShaft) -> Setpoint {
    shaft.setpoint()
}

impl NodeIdentity for Drive {
    fn node_id(&self) -> u8 {
        self.core.registers.value(fn_registers::NODE) as u8
    }

    fn bit_rate(&self) -> u32 {
        u32::from(self.core.registers.value(fn_registers::BIT_RATE)) * 1000
    }

    fn serial(&self) -> u32 {
        self.core.options.address.into()
    }

    fn set_node_id(&mut self, node: u8) {
        self.core.registers.set(fn_registers::NODE, node.into());
    }

    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        let kbit = (bit_rate / 1000) as u16;
        let fits = self.core.check_value(fn_registers::BIT_RATE, kbit).is_ok();
        if fits {
            self.core.registers.set(fn_registers::BIT_RATE, kbit);
        }
        fits
    }

    fn store_link(&mut self) -> bool {
        for number in [fn_registers::NODE, fn_registers::BIT_RATE] {
            self.core.registers.store(number, self.core.registers.value(number));
        }
        true
    }
}

impl DomainObjects for Drive {}

impl NodeStorage for Drive {}

impl NodeClock for Drive {}

impl Firmware for Drive {
    fn dictionary(&self) -> &'static Dictionary {
        &DICTIONARY
    }

    #[inline]
    fn get(&mut self, tag: u16) -> u64 {
        let core = &self.core;
        match tag {
            0..DN_TAGS => core.registers.value(tag).into(),
            DN_TAGS..STORED_TAGS => core.dn_reading(tag - DN_TAGS).into(),
            _ => core.object_value(tag).cast_unsigned(),
        }
    }

    fn set(&mut self, _now: Instant, tag: u16, value: u64) -> Result<(), AbortCode> {
        self.core.disturbed = true;
        match tag {
            0..DN_TAGS => self.write(tag, &[value as u16]).map_err(|refusal| match refusal {
                RegisterError::Address => AbortCode::NO_OBJECT,
                RegisterError::Value => AbortCode::VALUE,
                RegisterError::Failure => AbortCode::LOCAL,
            }),
            STORED_TAGS..COMPUTED_TAGS => self.core.set_object(tag, value as i32),
            _ => Err(AbortCode::READ_ONLY),
        }
    }

    /// The manual lets no state of the network raise an alarm.
    fn handle_nmt_state(&mut self, _now: Instant, _state: Nmt) {}

    fn reset(&mut self, _now: Instant) {
        self.power_cycle();
    }

    /// `[I]` ERR_Lo where the motor is powered through the bus.
    fn handle_link_loss(&mut self, _now: Instant) {
        if self.core.canopen.axis.state().has_power() {
            self.raise_alarm(Alarm::LO);
        }
    }

    fn error_register(&self) -> u8 {
        if self.core.alarm.is_some() { 0x81 } else { 0 }
    }

    #[inline]
    fn poll_emergency(&mut self) -> Option<Emergency> {
        let core = &mut self.core;
        if core.canopen.reported_alarm != core.alarm {
            core.canopen.reported_alarm = core.alarm;
            return line_emergency(core.alarm.0);
        }
        if core::mem::take(&mut core.canopen.arrival_pending) {
            return line_emergency(ARRIVED);
        }
        core.next_limit_emergency().and_then(line_emergency)
    }
}

fn line_emergency(code: u16) -> Option<Emergency> {
    Some(Emergency { code, ..Emergency::default() })
}
