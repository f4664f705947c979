//! Motion modes: what UPD starts, how it stops, when it is complete.
//!
//! Source: the help pages on MCR and on the motion modes; the masks of the MODE instructions.

use super::at;
use super::drive::Drive;
use super::execute::Refused;
use super::status::{der, isr, put, srh, srl};
use super::units;
use crate::plant::{Goal, Limits, Setpoint, TICK_S};

/// MCR: motion command register.
mod mcr {
    pub const NEW_MODE: u16 = 1 << 15;
    pub const KEEP_REFERENCE: u16 = 1 << 14;
    pub const ABSOLUTE: u16 = 1 << 13;
    pub const SOURCE: u16 = 3 << 6;
    pub const ANALOG: u16 = 1 << 6;
}

/// ACR.11: relative positioning adds to the last target.
const ADDITIVE: u16 = 1 << 11;
/// ASR.3: with TUM0 the target speed starts at zero.
const START_AT_REST: u16 = 1 << 3;

/// The outermost loop that is closed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Loop {
    Position,
    Speed,
    Torque,
    Voltage,
}

/// Where the reference comes from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Mode {
    /// The axis stays where it is.
    Hold,
    /// A trapezoid or S-curve to a position.
    Position,
    /// A ramp to a speed.
    Speed,
    /// A ramp to rest.
    Stopping,
    /// PVT or PT points.
    Points,
    /// What somebody writes to EREF, or the analogue input.
    External(Loop),
    /// A ramp in TREF, to try the motor.
    Test(Loop),
    /// A master's position, which somebody writes to MREF.
    Gear,
}

/// The state of the motion.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Motion {
    pub mode: Mode,
    /// It has not come to its end.
    pub moving: bool,
    /// Target of the last positioning, counts.
    target: i32,
    /// Reference of a test mode (TREF), internal units.
    test: f64,
    /// Master's position when it was last looked at.
    master: i32,
    /// Ticks that the axis has been within the settle band.
    settled: u32,
}

impl Motion {
    /// At rest.
    pub const REST: Self =
        Self { mode: Mode::Hold, moving: false, target: 0, test: 0.0, master: 0, settled: 0 };
}

impl Mode {
    /// What MCR selects: the closed loops in bits 10 to 8, the reference in bits 4 to 0. Contouring
    /// (PC, SC, TC, VC) and camming are not simulated: their tables are not published.
    const fn of(word: u16) -> Option<Self> {
        let outer = match word >> 8 & 7 {
            7 => Loop::Position,
            3 => Loop::Speed,
            1 => Loop::Torque,
            0 => Loop::Voltage,
            _ => return None,
        };
        Some(match (word & 0x1F, outer) {
            (0, outer) => Self::External(outer),
            (1 | 7, Loop::Position) => Self::Position,
            (1, Loop::Speed) => Self::Speed,
            (5, Loop::Position) => Self::Gear,
            (8, Loop::Torque | Loop::Voltage) => Self::Test(outer),
            (9 | 10, Loop::Position) => Self::Points,
            _ => return None,
        })
    }

    /// Whether the reference ends by itself.
    const fn ends(self) -> bool {
        matches!(self, Self::Position | Self::Speed | Self::Stopping | Self::Points)
    }
}

impl Drive {
    /// UPD: what was programmed takes effect. While the axis is off, only the mode is noted \[I\].
    pub fn update(&mut self) -> Result<(), Refused> {
        let word = self.memory.word(at::MCR);
        let mode = Mode::of(word).ok_or(Refused::NotNow)?;
        if self.starting > 0 {
            return Err(Refused::Detail(der::UPDATE_DURING_AXISON));
        }
        let is_on = self.status.srl & srl::AXIS_ON != 0;
        if is_on {
            self.admit(mode, word)?;
        }
        self.memory.put(at::MCR, word & !mcr::NEW_MODE);
        self.stale();
        if !is_on {
            return Ok(());
        }
        if word & mcr::NEW_MODE != 0 && word & mcr::KEEP_REFERENCE == 0 {
            self.start_from_motor();
        }
        self.memory.put_long(at::POS0, self.shaft.count());
        self.begin(mode, word);
        self.starts += 1;
        Ok(())
    }

    /// STOP: a ramp to rest with CACC. A torque or voltage ends at once.
    pub fn stop(&mut self) -> Result<(), Refused> {
        let rate = self.shaft.scale.acceleration(self.memory.fixed(at::CACC));
        self.brake(rate);
        Ok(())
    }

    /// A ramp to rest with CDEC.
    pub fn quick_stop(&mut self) {
        let rate = self.shaft.scale.acceleration(self.memory.fixed(at::CDEC));
        self.brake(rate);
    }

    /// TPOS was written: the reference is there, at rest. STA writes APOS to it.
    pub fn move_reference(&mut self) {
        let position = self.shaft.place(self.memory.long(at::TPOS));
        self.shaft.servo.follow(Setpoint { position, ..Setpoint::default() });
        self.shaft.servo.go(Goal::Position(position));
        self.starts += u64::from(self.shaft.servo.is_enabled());
    }

    /// Whether a ramp to rest is under way.
    pub fn is_stopping(&self) -> bool {
        self.motion.mode == Mode::Stopping
    }

    /// Moves the reference on by a tick.
    #[inline]
    pub fn tick_motion(&mut self) {
        match self.motion.mode {
            Mode::Points => self.tick_points(),
            Mode::External(outer) => self.tick_external(outer),
            Mode::Test(outer) => self.tick_test(outer),
            Mode::Gear => self.tick_gear(),
            mode if self.motion.moving && self.shaft.servo.arrived() => self.arrive(mode),
            _ => {}
        }
    }

    /// The motion is complete.
    pub fn complete(&mut self) {
        if !core::mem::take(&mut self.motion.moving) {
            return;
        }
        self.status.srl |= srl::MOTION_COMPLETE;
        self.status.srh |= srh::TARGET_REACHED;
        self.status.isr |= isr::MOTION_COMPLETE;
    }

    /// A motion has begun.
    pub fn set_off(&mut self) {
        self.motion.moving = true;
        put(&mut self.status.srl, srl::MOTION_COMPLETE, false);
        put(&mut self.status.srh, srh::TARGET_REACHED, false);
    }

    /// A ramp to rest at `rate` rad/s², then the place is held.
    fn brake(&mut self, rate: f64) {
        let servo = &mut self.shaft.servo;
        if !servo.is_enabled() {
            return;
        }
        if matches!(servo.goal(), Goal::Current(_) | Goal::Voltage(_)) {
            servo.go_from(&self.shaft.motor, Goal::Velocity(0.0));
        }
        let limits = *servo.limits();
        let speed = limits.velocity.max(servo.setpoint().velocity.abs());
        servo.go(Goal::Velocity(0.0));
        servo.set_limits(Limits { velocity: speed, deceleration: rate, ..limits });
        self.motion.mode = Mode::Stopping;
        self.set_off();
    }

    /// Whether the mode can begin with what is set.
    fn admit(&self, mode: Mode, word: u16) -> Result<(), Refused> {
        let ramp = self.memory.fixed(at::CACC) > 0.0;
        let digital = word & mcr::SOURCE > mcr::ANALOG;
        match mode {
            Mode::Position if word & 0x1F == 7 && self.motion.moving => {
                Err(Refused::Detail(der::UPDATE_IGNORED))
            }
            Mode::Position if word & 0x1F == 7 && !ramp => {
                Err(Refused::Detail(der::INVALID_S_CURVE))
            }
            Mode::Position | Mode::Speed if !ramp => Err(Refused::NotNow),
            Mode::External(_) if digital => Err(Refused::NotNow), // no second encoder
            _ => Ok(()),
        }
    }

    /// TUM0: the reference starts where the motor is, as fast as it is.
    fn start_from_motor(&mut self) {
        let shaft = &mut self.shaft;
        shaft.servo.hold(&shaft.motor);
        if self.memory.word(at::ASR) & START_AT_REST != 0 {
            let position = shaft.motor.position();
            shaft.servo.follow(Setpoint { position, ..Setpoint::default() });
            self.memory.put(at::ASR, self.memory.word(at::ASR) & !START_AT_REST);
        }
    }

    fn begin(&mut self, mode: Mode, word: u16) {
        self.motion.mode = mode;
        self.motion.settled = 0;
        match mode {
            Mode::Position => self.begin_position(word),
            Mode::Speed => self.begin_speed(),
            Mode::Points => self.begin_points(word & 0x1F == 10, word & mcr::ABSOLUTE != 0),
            Mode::Test(_) => self.motion.test = 0.0,
            Mode::Gear => self.motion.master = self.memory.long(at::MREF),
            _ => {}
        }
        if mode.ends() {
            self.set_off();
        }
    }

    fn begin_position(&mut self, word: u16) {
        let by = self.memory.long(at::CPOS);
        let absolute = word & mcr::ABSOLUTE != 0;
        let additive = self.memory.word(at::ACR) & ADDITIVE != 0;
        self.motion.target = match (absolute, additive) {
            (true, _) => by,
            (false, true) => self.motion.target.wrapping_add(by),
            (false, false) => self.shaft.target().wrapping_add(by),
        };
        self.unrepeatable += u64::from(!absolute);
        let jerk_periods = if word & 0x1F == 7 { self.memory.long(at::TJERK) } else { 0 };
        let limits = self.limits(f64::from(jerk_periods));
        let place = self.shaft.place(self.motion.target);
        self.shaft.servo.go(Goal::Position(place));
        self.shaft.servo.set_limits(limits);
    }

    fn begin_speed(&mut self) {
        let limits = self.limits(0.0);
        let speed = self.shaft.scale.speed(self.memory.fixed(at::CSPD));
        self.shaft.servo.go(Goal::Velocity(speed));
        self.shaft.servo.set_limits(limits);
    }

    /// CSPD and CACC, with the acceleration rounded over so many slow loop periods.
    fn limits(&self, jerk_periods: f64) -> Limits {
        let scale = &self.shaft.scale;
        let velocity = scale.speed(self.memory.fixed(at::CSPD)).abs();
        let acceleration = scale.acceleration(self.memory.fixed(at::CACC));
        let smoothing_s = jerk_periods.max(0.0) * scale.slow_s;
        Limits { smoothing_s, ..Limits::trapezoid(velocity, acceleration) }
    }

    fn arrive(&mut self, mode: Mode) {
        match mode {
            Mode::Stopping => {
                let place = self.shaft.servo.setpoint().position;
                self.shaft.servo.go(Goal::Position(place));
                self.motion.mode = Mode::Hold;
            }
            Mode::Position if !self.has_settled() => return,
            _ => {}
        }
        self.complete();
    }

    /// UPGRADE.11: complete only when the axis has been within POSOKLIM for TONPOSOK periods. \[I\]
    fn has_settled(&mut self) -> bool {
        if self.memory.word(at::UPGRADE) & 1 << 11 == 0 {
            return true;
        }
        let near = self.shaft.error().abs() <= f64::from(self.memory.word(at::POSOKLIM));
        self.motion.settled = if near { self.motion.settled + 1 } else { 0 };
        let for_s = f64::from(self.motion.settled) * TICK_S;
        for_s >= f64::from(self.memory.word(at::TONPOSOK)) * self.shaft.scale.slow_s
    }

    fn tick_external(&mut self, outer: Loop) {
        let analog = self.memory.word(at::MCR) & mcr::SOURCE == mcr::ANALOG;
        let share = self.around.reference_v / 10.0;
        let shaft = &mut self.shaft;
        match outer {
            Loop::Position => {
                let place = shaft.place(self.memory.long(at::EREF));
                let velocity = (place - shaft.servo.setpoint().position) / TICK_S;
                shaft.servo.follow(Setpoint { position: place, velocity, acceleration: 0.0 });
            }
            Loop::Speed => {
                let most = self.memory.fixed(at::CSPD);
                let counts = if analog { share * most } else { self.memory.fixed(at::EREF) };
                let speed = shaft.scale.speed(counts);
                shaft.servo.set_limits(Limits::trapezoid(speed.abs(), 0.0));
                shaft.servo.go(Goal::Velocity(speed));
            }
            Loop::Torque => {
                let online = units::ampere(self.memory.int(at::EREFT));
                let amperes = if analog { share * units::PEAK_A } else { online };
                self.drive_current(amperes);
            }
            Loop::Voltage => {
                let online = f64::from(self.memory.int(at::EREFT)) / 32_767.0;
                self.drive_voltage(if analog { share } else { online });
            }
        }
    }

    /// TREF ramps by RINCTST a slow loop period up to REFTST.
    fn tick_test(&mut self, outer: Loop) {
        let goal = f64::from(self.memory.int(at::REFTST));
        let most = f64::from(self.memory.int(at::RINCTST)).abs() * TICK_S / self.shaft.scale.slow_s;
        self.motion.test += (goal - self.motion.test).clamp(-most, most);
        self.memory.put_fixed(at::TREF, self.motion.test);
        match outer {
            Loop::Voltage => self.drive_voltage(self.motion.test / 32_767.0),
            _ => self.drive_current(units::ampere(self.motion.test as i16)),
        }
    }

    /// The master's steps times GEAR.
    fn tick_gear(&mut self) {
        let master = self.memory.long(at::MREF);
        let by = f64::from(master.wrapping_sub(self.motion.master)) * self.memory.fixed(at::GEAR);
        self.motion.master = master;
        let way = by / self.shaft.scale.per_rad;
        let position = self.shaft.servo.setpoint().position + way;
        let velocity = way / TICK_S;
        self.shaft.servo.follow(Setpoint { position, velocity, acceleration: 0.0 });
        self.status.srh |= srh::IN_GEAR;
    }

    /// A current, A, unless a limit switch forbids its direction.
    fn drive_current(&mut self, amperes: f64) {
        let amperes = if self.is_barred(amperes) { 0.0 } else { amperes };
        self.shaft.servo.go(Goal::Current(amperes));
    }

    /// A share of the bus voltage.
    fn drive_voltage(&mut self, share: f64) {
        let share = if self.is_barred(share) { 0.0 } else { share };
        self.shaft.servo.go(Goal::Voltage(share * self.shaft.supply));
    }
}
