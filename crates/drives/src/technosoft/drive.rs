//! The drive independent of its wires: memory, registers, motor, time.

use super::addresses;
use super::cam::Cam;
use super::change_reports::ChangeReports;
use super::clock::DriveClock;
use super::contour::Contour;
use super::events::EventMonitor;
use super::inputs::Surroundings;
use super::logger::DataLogger;
use super::master::GearMaster;
use super::memory::Memory;
use super::motion::{Motion, MotionMode};
use super::options::Options;
use super::outbox::Outbox;
use super::points::PathBuffer;
use super::program::ProgramExecution;
use super::protections::Protections;
use super::setup;
use super::shaft::Shaft;
use super::status::{Status, cer, mer, set_bits, srh, srl};
use super::sync::TimeSync;
use super::units;
use polepair_core::plant::TICK_S;
use polepair_core::proto::tml::rules::TmlWire;
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message};
use polepair_core::time::Instant;

/// Position triggers that there are.
pub(super) const TRIGGERS: usize = 4;

/// A Technosoft drive with its motor.
#[derive(Debug)]
pub(super) struct Drive {
    pub options: Options,
    pub memory: Memory,
    pub status: Status,
    pub clock: DriveClock,
    pub shaft: Shaft,
    pub motion: Motion,
    pub points: PathBuffer,
    pub contour: Contour,
    pub cam: Cam,
    pub protections: Protections,
    pub program: ProgramExecution,
    pub events: EventMonitor,
    pub surroundings: Surroundings,
    pub change_reports: ChangeReports,
    pub sync: TimeSync,
    pub logger: DataLogger,
    pub master: GearMaster,
    pub outbox: Outbox,
    pub limits_watched: bool,
    /// POSTRIGG1 to 4, those that were written.
    pub triggers: [Option<i32>; TRIGGERS],
    /// Ticks until AXISON is through.
    pub axis_on_ticks: u16,
    /// Axis ID and groups, as in AAR.
    pub axis: u8,
    pub groups: u8,
    pub baud: u32,
    pub bit_rate: u32,
    pub unrepeatable: u64,
    /// Number of commands that powered the motor or gave it a target: AXISON, UPD, a position written to
    /// TPOS.
    pub starts: u64,
    pub notice: Option<&'static str>,
    /// End of the present EEPROM write; the drive does not reply before.
    pub busy_until: Instant,
    /// True if the variables that programs and hosts read are as old as the last tick or instruction.
    published: bool,
}

impl Drive {
    /// A drive as from the factory, powered.
    pub fn new(options: Options) -> Self {
        let mut memory = Memory::new();
        setup::load_factory_setup(&mut memory, &options);
        if options.axis != 0 {
            memory.store_last_axis(options.axis);
            memory.writes = 0;
        }
        if !options.setup {
            memory.corrupt_table();
        }
        let mut new = Self {
            memory,
            status: Status::NEW,
            clock: DriveClock::new(&options, Instant::ZERO),
            shaft: Shaft::new(&options),
            motion: Motion::REST,
            points: PathBuffer::EMPTY,
            contour: Contour::EMPTY,
            cam: Cam::NONE,
            protections: Protections::NEW,
            program: ProgramExecution::IDLE,
            events: EventMonitor::NONE,
            surroundings: Surroundings::NEW,
            change_reports: ChangeReports::NONE,
            sync: TimeSync::SLAVE,
            logger: DataLogger::OFF,
            master: GearMaster::OFF,
            outbox: Outbox::EMPTY,
            limits_watched: false,
            triggers: [None; TRIGGERS],
            axis_on_ticks: 0,
            axis: 0,
            groups: 0,
            baud: 0,
            bit_rate: 0,
            unrepeatable: 0,
            starts: 0,
            notice: None,
            busy_until: Instant::ZERO,
            published: false,
            options,
        };
        new.power_up(Instant::ZERO);
        new
    }

    /// RAM is lost, settings come from the set-up table if it is valid. The shaft stays as it is,
    /// unpowered.
    pub fn power_up(&mut self, now: Instant) {
        self.memory.clear_volatile();
        self.status = Status::NEW;
        if self.memory.is_table_valid() {
            self.memory.load_table();
        } else {
            self.status.mer = mer::INVALID_SETUP;
        }
        (self.axis, self.groups) = (self.initial_axis(), 1);
        (self.baud, self.bit_rate) = (self.options.baud, 500_000);
        self.clock = DriveClock::new(&self.options, now);
        self.busy_until = now;
        self.shaft.restart();
        (self.motion, self.points, self.protections) =
            (Motion::REST, PathBuffer::EMPTY, Protections::NEW);
        (self.contour, self.cam) = (Contour::EMPTY, Cam::NONE);
        (self.change_reports, self.sync, self.outbox) =
            (ChangeReports::NONE, TimeSync::SLAVE, Outbox::EMPTY);
        (self.events, self.logger, self.master) =
            (EventMonitor::NONE, DataLogger::OFF, GearMaster::OFF);
        (self.triggers, self.axis_on_ticks) = ([None; TRIGGERS], 0);
        self.memory.set(addresses::MASTERID, IdCode::host_at(self.axis).word());
        self.memory.set(addresses::CSR, self.hardware_status());
        self.read_masks();
        self.autorun();
        self.published = false;
    }

    /// The axis ID at power-up (TML communication manual, chapter 2): from a valid set-up table, otherwise
    /// the last one that came from a valid table; if that is "H/W", from the switches; otherwise 255.
    fn initial_axis(&mut self) -> u8 {
        let from_hardware = self.options.switches.unwrap_or(255);
        if !self.memory.is_table_valid() {
            return self.memory.last_axis().unwrap_or(from_hardware);
        }
        match self.memory.word(addresses::AAR_TABLE) as u8 {
            0 => from_hardware,
            axis => {
                self.memory.store_last_axis(axis);
                axis
            }
        }
    }

    /// CSR: bit 14 is set if the axis ID came from hardware, bit 0 if the port is RS-485.
    fn hardware_status(&self) -> u16 {
        let from_table = self.memory.word(addresses::AAR_TABLE) != 0;
        let rs485 = self.options.quirks.wire == Some(TmlWire::Rs485);
        u16::from(!from_table) << 14 | u16::from(rs485)
    }

    /// Runs the ticks up to `now`.
    pub fn advance(&mut self, now: Instant) {
        let count = self.clock.take_ticks(now);
        if count == 0 {
            return;
        }
        for n in 0..count {
            self.clock.unfinished = count - n - 1;
            if self.is_idle() {
                self.clock.unfinished = 0;
                self.published = false;
                return self.shaft.pass_time((count - n) as f64 * TICK_S);
            }
            self.tick();
        }
    }

    /// Returns whether nothing happens without an action from outside. Changes of inputs and supply are seen at a tick,
    /// so the bench requests one.
    fn is_idle(&self) -> bool {
        self.shaft.is_at_rest()
            && self.sync.ticks_left().is_none()
            && self.axis_on_ticks == 0
            && !self.protections.limits_stale
            && !self.program.is_active()
            && !self.events.is_pending()
            && !self.is_logging()
            && !self.master.is_active()
    }

    fn tick(&mut self) {
        self.published = false;
        let before = self.shaft.motor.position();
        self.check_inputs();
        self.tick_program();
        self.tick_axis_on();
        if self.shaft.servo.is_enabled() {
            self.tick_motion();
        }
        self.shaft.tick();
        self.check_protections();
        self.check_index(before);
        self.check_triggers();
        self.check_event();
        self.tick_sync();
        self.tick_logger();
        self.tick_master();
        self.report_changes();
    }

    /// Copies variables that are stored elsewhere into memory, before a read.
    pub fn publish(&mut self) {
        if core::mem::replace(&mut self.published, true) {
            return;
        }
        self.publish_motion();
        self.publish_status();
    }

    /// Marks the copies as possibly old.
    pub fn mark_stale(&mut self) {
        self.published = false;
    }

    /// Queues a message.
    pub fn send(&mut self, to: IdCode, instruction: Instruction) {
        if !self.outbox.push(Message { to, instruction }) {
            self.status.cer |= cer::CAN_OVERRUN;
        }
    }

    /// This drive's own address, as requests and answers name their sender.
    pub const fn own_id(&self) -> IdCode {
        IdCode::axis(self.axis)
    }

    fn publish_motion(&mut self) {
        let (shaft, memory) = (&self.shaft, &mut self.memory);
        let (actual, target) = (shaft.count(), shaft.target());
        let error = target.wrapping_sub(actual);
        let speed = shaft.scale.counts_of_speed(shaft.velocity());
        let setpoint = shaft.servo.setpoint();
        memory.set_long(addresses::APOS, actual);
        memory.set_long(addresses::APOS_MT, actual);
        memory.set_long(addresses::RPOS, actual.wrapping_sub(memory.long(addresses::POS0)));
        memory.set_fixed(addresses::ASPD, speed);
        memory.set_fixed(addresses::ASPD_LD, speed);
        memory.set(addresses::POSERR, to_i16(error).cast_unsigned());
        memory.set_long(addresses::POSERRL, error);
        memory.set(addresses::SPDREF, to_u16(shaft.scale.counts_of_speed(setpoint.velocity)));
        memory.set_long(addresses::TPOS, target);
        memory.set_fixed(addresses::TSPD, shaft.scale.counts_of_speed(setpoint.velocity));
        memory
            .set_fixed(addresses::TACC, shaft.scale.counts_of_acceleration(setpoint.acceleration));
        let current = units::units_of_amperes(shaft.motor.current()).cast_unsigned();
        memory.set(addresses::IQ, current);
        memory.set(addresses::IQREF, current);
        memory.set(addresses::AD4, units::units_of_volts(shaft.supply));
        memory.set_long(addresses::I2TINT_M, self.protections.i2t_units());
        memory.set(addresses::AD7, libm::round(shaft.stage.temperature()) as u16);
    }

    fn publish_status(&mut self) {
        let (now, status, levels) = (self.clock.now(), self.status, self.input_levels());
        let (points, segment_due) = (self.points_status(), self.is_segment_due());
        let memory = &mut self.memory;
        memory.set(addresses::SRL, status.srl);
        memory.set(addresses::SRH, status.srh);
        memory.set(addresses::MER, status.mer);
        memory.set(addresses::DER, status.der);
        memory.set(addresses::DER2, status.der2);
        memory.set(addresses::CER, status.cer);
        memory.set(addresses::ISR, status.isr);
        memory.set(addresses::MSR, status.msr(segment_due));
        memory.set(addresses::INSTATUS, levels);
        memory.set(addresses::PVTSTS, points);
        memory.set(addresses::AAR, u16::from(self.groups) << 8 | u16::from(self.axis));
        memory.set_long(addresses::ATIME, self.clock.absolute_time(now).cast_signed());
        memory.set_long(addresses::RTIME, self.clock.relative_time(now).cast_signed());
    }

    /// AXISON: the axis holds the position that it has. Not before ENDINIT, in fault or while
    /// disabled \[I\].
    pub fn axis_on(&mut self) -> bool {
        let ready = self.status.srh & srh::ENDINIT != 0;
        let barred = self.status.srh & srh::FAULT != 0 || self.status.mer & mer::DISABLED != 0;
        if !ready || barred {
            return false;
        }
        if self.options.axison_ms == 0 || self.shaft.servo.is_enabled() {
            self.power_on();
        } else if self.axis_on_ticks == 0 {
            self.axis_on_ticks = self.options.axison_ms;
        }
        true
    }

    /// AXISON takes its time: the field is looked for, and the axis is not on yet.
    fn tick_axis_on(&mut self) {
        if self.axis_on_ticks > 0 {
            self.axis_on_ticks -= 1;
            if self.axis_on_ticks == 0 {
                self.power_on();
            }
        }
    }

    fn power_on(&mut self) {
        if !self.shaft.servo.is_enabled() {
            self.shaft.servo.enable(&self.shaft.motor);
            self.motion.mode = MotionMode::Stopping;
            self.motion.moving = self.shaft.motor.velocity() != 0.0;
            if !self.motion.moving {
                self.motion.mode = MotionMode::Hold;
            }
        }
        self.status.srl |= srl::AXIS_ON;
        self.starts += 1;
    }

    /// DISPWM: the power stage lets the motor coast, the axis stays on. \[I\]
    pub fn disable_stage(&mut self) {
        self.shaft.servo.disable();
        self.motion.mode = MotionMode::Hold;
        self.complete_motion();
    }

    /// ENPWM: the power stage holds the motor again, if the axis is on and has no fault. \[I\]
    pub fn enable_stage(&mut self) -> bool {
        let on = self.status.srl & srl::AXIS_ON != 0 && self.axis_on_ticks == 0;
        if on {
            self.power_on();
        }
        on
    }

    /// AXISOFF: the motor coasts.
    pub fn axis_off(&mut self) {
        self.shaft.servo.disable();
        self.axis_on_ticks = 0;
        self.motion.mode = MotionMode::Hold;
        set_bits(&mut self.status.srl, srl::AXIS_ON, false);
        self.end_following();
        self.complete_motion();
        self.status.srh &= !srh::TARGET_REACHED;
    }
}

fn to_i16(value: i32) -> i16 {
    value.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

fn to_u16(value: f64) -> u16 {
    to_i16(libm::round(value) as i32).cast_unsigned()
}
