//! The drive itself, apart from its wires: memory, registers, motor, and what happens in time.

use super::at;
use super::clock::Clock;
use super::events::Events;
use super::guard::Guard;
use super::inputs::Around;
use super::memory::Memory;
use super::motion::{Mode, Motion};
use super::notices::Notices;
use super::options::Options;
use super::outbox::Outbox;
use super::points::Points;
use super::program::Program;
use super::setup;
use super::shaft::Shaft;
use super::status::{Status, cer, mer, put, srh, srl};
use super::sync::Sync;
use super::units;
use crate::plant::TICK_S;
use crate::proto::tml::rules::Wire;
use crate::proto::tml::wire::{IdCode, Instruction, Message};
use crate::time::Instant;

/// Position triggers that there are.
pub(super) const TRIGGERS: usize = 4;

/// A Technosoft drive with its motor.
#[derive(Debug)]
pub(super) struct Drive {
    pub options: Options,
    pub memory: Memory,
    pub status: Status,
    pub clock: Clock,
    pub shaft: Shaft,
    pub motion: Motion,
    pub points: Points,
    pub guard: Guard,
    pub program: Program,
    pub events: Events,
    pub around: Around,
    pub notices: Notices,
    pub sync: Sync,
    pub outbox: Outbox,
    pub limits_watched: bool,
    /// POSTRIGG1 to 4, those that were written.
    pub triggers: [Option<i32>; TRIGGERS],
    /// Ticks until AXISON is through.
    pub starting: u16,
    /// Axis ID and groups, as AAR tells them.
    pub axis: u8,
    pub groups: u8,
    pub baud: u32,
    pub bit_rate: u32,
    pub unrepeatable: u64,
    /// What powered the motor or gave it somewhere to go: AXISON, UPD, a position written to TPOS.
    pub starts: u64,
    pub notice: Option<&'static str>,
    /// Until when the EEPROM takes what was written: the drive answers nobody before.
    pub busy_until: Instant,
    /// What programs and hosts read is as old as the last tick or instruction.
    published: bool,
}

impl Drive {
    /// A drive as from the factory, powered.
    pub fn new(options: Options) -> Self {
        let mut memory = Memory::new();
        setup::deliver(&mut memory, &options);
        if options.axis != 0 {
            memory.keep_last_axis(options.axis);
            memory.writes = 0;
        }
        if !options.setup {
            memory.spoil_table();
        }
        let mut new = Self {
            memory,
            status: Status::NEW,
            clock: Clock::new(&options, Instant::ZERO),
            shaft: Shaft::new(&options),
            motion: Motion::REST,
            points: Points::EMPTY,
            guard: Guard::NEW,
            program: Program::IDLE,
            events: Events::NONE,
            around: Around::NEW,
            notices: Notices::NONE,
            sync: Sync::SLAVE,
            outbox: Outbox::EMPTY,
            limits_watched: false,
            triggers: [None; TRIGGERS],
            starting: 0,
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
        self.memory.forget();
        self.status = Status::NEW;
        if self.memory.table_is_valid() {
            self.memory.load_table();
        } else {
            self.status.mer = mer::INVALID_SETUP;
        }
        (self.axis, self.groups) = (self.first_axis(), 1);
        (self.baud, self.bit_rate) = (self.options.baud, 500_000);
        self.clock = Clock::new(&self.options, now);
        self.busy_until = now;
        self.shaft.restart();
        (self.motion, self.points, self.guard) = (Motion::REST, Points::EMPTY, Guard::NEW);
        (self.notices, self.sync, self.outbox) = (Notices::NONE, Sync::SLAVE, Outbox::EMPTY);
        self.events = Events::NONE;
        (self.triggers, self.starting) = ([None; TRIGGERS], 0);
        self.memory.put(at::MASTERID, IdCode::host_at(self.axis).word());
        self.memory.put(at::CSR, self.hardware());
        self.read_masks();
        self.autorun();
        self.published = false;
    }

    /// The axis ID at power-up (TML communication manual, chapter 2): from a valid set-up table,
    /// else the last that came from a valid one; where that says "H/W", the switches; else 255.
    fn first_axis(&mut self) -> u8 {
        let from_hardware = self.options.switches.unwrap_or(255);
        if !self.memory.table_is_valid() {
            return self.memory.last_axis().unwrap_or(from_hardware);
        }
        match self.memory.word(at::AAR_TABLE) as u8 {
            0 => from_hardware,
            axis => {
                self.memory.keep_last_axis(axis);
                axis
            }
        }
    }

    /// CSR: bit 14 tells that the axis ID came from hardware, bit 0 that the port is RS-485.
    fn hardware(&self) -> u16 {
        let from_table = self.memory.word(at::AAR_TABLE) != 0;
        let rs485 = self.options.quirks.wire == Some(Wire::Rs485);
        u16::from(!from_table) << 14 | u16::from(rs485)
    }

    /// Runs the ticks up to `now`.
    pub fn advance(&mut self, now: Instant) {
        let count = self.clock.until(now);
        if count == 0 {
            return;
        }
        for n in 0..count {
            if self.is_idle() {
                self.published = false;
                return self.shaft.rest((count - n) as f64 * TICK_S);
            }
            self.tick();
        }
    }

    /// Whether nothing will happen until somebody does something. What the inputs and the supply
    /// did is seen at a tick, so the bench asks for one.
    fn is_idle(&self) -> bool {
        self.shaft.is_still()
            && self.sync.ticks_left().is_none()
            && self.starting == 0
            && !self.guard.old
            && !self.program.is_active()
            && !self.events.is_watched()
    }

    fn tick(&mut self) {
        self.published = false;
        let before = self.shaft.motor.position();
        self.watch_inputs();
        self.tick_program();
        self.tick_start();
        if self.shaft.servo.is_enabled() {
            self.tick_motion();
        }
        self.shaft.tick();
        self.watch();
        self.watch_index(before);
        self.watch_triggers();
        self.watch_event();
        self.tick_sync();
        self.tell();
    }

    /// Brings the variables that live elsewhere into memory, before somebody reads.
    pub fn publish(&mut self) {
        if core::mem::replace(&mut self.published, true) {
            return;
        }
        self.publish_motion();
        self.publish_status();
    }

    /// What was published may be old.
    pub fn stale(&mut self) {
        self.published = false;
    }

    /// Queues a message.
    pub fn send(&mut self, to: IdCode, instruction: Instruction) {
        if !self.outbox.push(Message { to, instruction }) {
            self.status.cer |= cer::CAN_OVERRUN;
        }
    }

    /// This drive's own address, as requests and answers name their sender.
    pub const fn own(&self) -> IdCode {
        IdCode::axis(self.axis)
    }

    fn publish_motion(&mut self) {
        let (shaft, memory) = (&self.shaft, &mut self.memory);
        let (actual, target) = (shaft.count(), shaft.target());
        let error = target.wrapping_sub(actual);
        let speed = shaft.scale.counts_speed(shaft.velocity());
        let setpoint = shaft.servo.setpoint();
        memory.put_long(at::APOS, actual);
        memory.put_long(at::APOS_MT, actual);
        memory.put_long(at::RPOS, actual.wrapping_sub(memory.long(at::POS0)));
        memory.put_fixed(at::ASPD, speed);
        memory.put_fixed(at::ASPD_LD, speed);
        memory.put(at::POSERR, clamped(error).cast_unsigned());
        memory.put_long(at::POSERRL, error);
        memory.put(at::SPDREF, whole(shaft.scale.counts_speed(setpoint.velocity)));
        memory.put_long(at::TPOS, target);
        memory.put_fixed(at::TSPD, shaft.scale.counts_speed(setpoint.velocity));
        memory.put_fixed(at::TACC, shaft.scale.counts_acceleration(setpoint.acceleration));
        let current = units::current(shaft.motor.current()).cast_unsigned();
        memory.put(at::IQ, current);
        memory.put(at::IQREF, current);
        memory.put(at::AD4, units::voltage(shaft.supply));
        memory.put_long(at::I2TINT_M, self.guard.i2t_units());
        memory.put(at::AD7, libm::round(shaft.stage.temperature()) as u16);
    }

    fn publish_status(&mut self) {
        let (now, status, levels) = (self.clock.now(), self.status, self.levels());
        let points = self.points_status();
        let memory = &mut self.memory;
        memory.put(at::SRL, status.srl);
        memory.put(at::SRH, status.srh);
        memory.put(at::MER, status.mer);
        memory.put(at::DER, status.der);
        memory.put(at::DER2, status.der2);
        memory.put(at::CER, status.cer);
        memory.put(at::ISR, status.isr);
        memory.put(at::MSR, status.msr());
        memory.put(at::INSTATUS, levels);
        memory.put(at::PVTSTS, points);
        memory.put(at::AAR, u16::from(self.groups) << 8 | u16::from(self.axis));
        memory.put_long(at::ATIME, self.clock.absolute(now).cast_signed());
        memory.put_long(at::RTIME, self.clock.relative(now).cast_signed());
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
            self.power();
        } else if self.starting == 0 {
            self.starting = self.options.axison_ms;
        }
        true
    }

    /// AXISON takes its time: the field is looked for, and the axis is not on yet.
    fn tick_start(&mut self) {
        if self.starting > 0 {
            self.starting -= 1;
            if self.starting == 0 {
                self.power();
            }
        }
    }

    fn power(&mut self) {
        if !self.shaft.servo.is_enabled() {
            self.shaft.servo.enable(&self.shaft.motor);
            self.motion.mode = Mode::Stopping;
            self.motion.moving = self.shaft.motor.velocity() != 0.0;
            if !self.motion.moving {
                self.motion.mode = Mode::Hold;
            }
        }
        self.status.srl |= srl::AXIS_ON;
        self.starts += 1;
    }

    /// AXISOFF: the motor coasts.
    pub fn axis_off(&mut self) {
        self.shaft.servo.disable();
        self.starting = 0;
        self.motion.mode = Mode::Hold;
        put(&mut self.status.srl, srl::AXIS_ON, false);
        put(&mut self.status.srh, srh::IN_GEAR, false);
        self.complete();
        self.status.srh &= !srh::TARGET_REACHED;
    }
}

fn clamped(value: i32) -> i16 {
    value.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

fn whole(value: f64) -> u16 {
    clamped(libm::round(value) as i32).cast_unsigned()
}
