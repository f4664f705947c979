//! Motion modes: started by UPD, stopped, and complete.
//!
//! Source: the help pages on MCR and on the motion modes; the masks of the MODE instructions.

use super::addresses;
use super::drive::Drive;
use super::execute::ExecuteError;
use super::status::{der, isr, set_bits, srh, srl};
use super::units;
use polepair_core::plant::{Goal, Limits, Setpoint, TICK_S};

/// MCR: motion command register.
mod mcr {
    pub const NEW_MODE: u16 = 1 << 15;
    pub const KEEP_REFERENCE: u16 = 1 << 14;
    pub const ABSOLUTE: u16 = 1 << 13;
    pub const SOURCE: u16 = 3 << 6;
    pub const ANALOG: u16 = 1 << 6;
    pub const DIGITAL: u16 = 1 << 7;
}

/// ACR.11: relative positioning adds to the last target.
const ADDITIVE: u16 = 1 << 11;
/// ASR.3: with TUM0 the target speed starts at zero.
const START_AT_REST: u16 = 1 << 3;

/// The outermost loop that is closed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum ControlLoop {
    Position,
    Speed,
    Torque,
    Voltage,
}

/// Source of the reference.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum MotionMode {
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
    /// A value written to EREF, or the analogue input.
    External(ControlLoop),
    /// A ramp in TREF, to try the motor.
    Test(ControlLoop),
    /// A master's position, written to MREF.
    Gear,
    /// A table over that position.
    Cam,
    /// Segments of a contour.
    Contour(ControlLoop),
}

/// The state of the motion.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Motion {
    pub mode: MotionMode,
    /// True until it has reached its end.
    pub moving: bool,
    /// Target of the last positioning, counts.
    target_counts: i32,
    /// Reference of a test mode (TREF), internal units.
    test_reference: f64,
    /// Master's position when it was last looked at.
    master_position: i32,
    /// Ticks that the axis has been within the settle band.
    settled_ticks: u32,
}

impl Motion {
    /// At rest.
    pub const REST: Self = Self {
        mode: MotionMode::Hold,
        moving: false,
        target_counts: 0,
        test_reference: 0.0,
        master_position: 0,
        settled_ticks: 0,
    };
}

impl MotionMode {
    /// Selection by MCR: the closed loops in bits 10 to 8, the reference in bits 4 to 0.
    const fn of(word: u16) -> Option<Self> {
        let outer = match word >> 8 & 7 {
            7 => ControlLoop::Position,
            3 => ControlLoop::Speed,
            1 => ControlLoop::Torque,
            0 => ControlLoop::Voltage,
            _ => return None,
        };
        Some(match (word & 0x1F, outer) {
            (0, outer) => Self::External(outer),
            (1 | 7, ControlLoop::Position) => Self::Position,
            (1, ControlLoop::Speed) => Self::Speed,
            (2, ControlLoop::Position | ControlLoop::Speed)
            | (3, ControlLoop::Torque | ControlLoop::Voltage) => Self::Contour(outer),
            (5, ControlLoop::Position) => Self::Gear,
            (6, ControlLoop::Position) => Self::Cam,
            (8, ControlLoop::Torque | ControlLoop::Voltage) => Self::Test(outer),
            (9 | 10, ControlLoop::Position) => Self::Points,
            _ => return None,
        })
    }

    /// Returns whether the reference ends by itself.
    const fn ends(self) -> bool {
        matches!(
            self,
            Self::Position | Self::Speed | Self::Stopping | Self::Points | Self::Contour(_)
        )
    }
}

impl Drive {
    /// UPD: the programmed motion takes effect. While the axis is off, only the mode is stored \[I\].
    pub fn update(&mut self) -> Result<(), ExecuteError> {
        let word = self.memory.word(addresses::MCR);
        let mode = MotionMode::of(word).ok_or(ExecuteError::NotPossible)?;
        // The power stage needs a moment; a motion that began within it would start with a jump.
        if self.axis_on_ticks > 0 {
            return Err(ExecuteError::DerBits(der::UPDATE_DURING_AXISON));
        }
        let is_on = self.shaft.servo.is_enabled();
        if is_on {
            self.check_mode(mode, word)?;
        }
        self.update_master();
        // The bit is used up, so that a second UPD without MODE goes on in the same mode.
        self.memory.set(addresses::MCR, word & !mcr::NEW_MODE);
        self.mark_stale();
        if !is_on {
            return Ok(());
        }
        if word & mcr::NEW_MODE != 0 && word & mcr::KEEP_REFERENCE == 0 {
            self.start_from_motor();
        }
        // Before the motion begins: relative targets count from here.
        self.memory.set_long(addresses::POS0, self.shaft.count());
        self.begin_mode(mode, word);
        self.starts += 1;
        Ok(())
    }

    /// STOP: a ramp to rest with CACC. A torque or voltage ends at once.
    pub fn stop(&mut self) -> Result<(), ExecuteError> {
        let rate = self.shaft.scale.acceleration_of_counts(self.memory.fixed(addresses::CACC));
        self.brake(rate);
        Ok(())
    }

    /// A ramp to rest with CDEC.
    pub fn quick_stop(&mut self) {
        let rate = self.shaft.scale.acceleration_of_counts(self.memory.fixed(addresses::CDEC));
        self.brake(rate);
    }

    /// TPOS was written: the reference is there, at rest. STA writes APOS to it.
    pub fn move_reference(&mut self) {
        let position = self.shaft.position_of_count(self.memory.long(addresses::TPOS));
        self.shaft.servo.follow(Setpoint { position, ..Setpoint::default() });
        self.shaft.servo.set_goal(Goal::Position(position));
        self.starts += u64::from(self.shaft.servo.is_enabled());
    }

    /// Returns whether a deceleration to rest is running.
    pub fn is_stopping(&self) -> bool {
        self.motion.mode == MotionMode::Stopping
    }

    /// Moves the reference on by a tick.
    #[inline]
    pub fn tick_motion(&mut self) {
        match self.motion.mode {
            MotionMode::Points => self.tick_points(),
            MotionMode::External(outer) => self.tick_external(outer),
            MotionMode::Test(outer) => self.tick_test(outer),
            MotionMode::Gear => self.tick_gear(),
            MotionMode::Cam => self.tick_cam(),
            MotionMode::Contour(outer) => self.tick_contour(outer),
            mode if self.motion.moving && self.shaft.servo.arrived() => self.finish_reference(mode),
            _ => {}
        }
    }

    /// The motion is complete.
    pub fn complete_motion(&mut self) {
        if !core::mem::take(&mut self.motion.moving) {
            return;
        }
        self.status.srl |= srl::MOTION_COMPLETE;
        self.status.srh |= srh::TARGET_REACHED;
        self.status.isr |= isr::MOTION_COMPLETE;
    }

    /// A motion has begun.
    pub fn note_motion_begun(&mut self) {
        self.motion.moving = true;
        set_bits(&mut self.status.srl, srl::MOTION_COMPLETE, false);
        set_bits(&mut self.status.srh, srh::TARGET_REACHED, false);
    }

    /// Another motion, or none, takes the place of a gear or cam.
    pub fn end_following(&mut self) {
        set_bits(&mut self.status.srh, srh::IN_GEAR | srh::IN_CAM, false);
    }

    /// A ramp to rest at `rate` rad/s², then the place is held.
    fn brake(&mut self, rate: f64) {
        let servo = &mut self.shaft.servo;
        if !servo.is_enabled() {
            return;
        }
        if matches!(servo.goal(), Goal::Current(_) | Goal::Voltage(_)) {
            // Torque and voltage keep no reference speed, so the ramp begins at the motor's own.
            servo.set_goal_from(&self.shaft.motor, Goal::Velocity(0.0));
        }
        let limits = *servo.limits();
        // A limit below the present speed would make the ramp begin with a jump.
        let speed = limits.velocity.max(servo.setpoint().velocity.abs());
        servo.set_goal(Goal::Velocity(0.0));
        servo.set_limits(Limits { velocity: speed, deceleration: rate, ..limits });
        debug_assert!(self.shaft.servo.is_enabled(), "only a powered motor brakes on a ramp");
        self.motion.mode = MotionMode::Stopping;
        self.end_following();
        self.note_motion_begun();
    }

    /// Checks whether the mode can start with the present settings.
    fn check_mode(&self, mode: MotionMode, word: u16) -> Result<(), ExecuteError> {
        let ramp = self.memory.fixed(addresses::CACC) > 0.0;
        let digital = word & mcr::SOURCE > mcr::ANALOG;
        match mode {
            MotionMode::Position if word & 0x1F == 7 && self.motion.moving => {
                Err(ExecuteError::DerBits(der::UPDATE_IGNORED))
            }
            MotionMode::Position if word & 0x1F == 7 && !ramp => {
                Err(ExecuteError::DerBits(der::INVALID_S_CURVE))
            }
            MotionMode::Position | MotionMode::Speed if !ramp => Err(ExecuteError::NotPossible),
            MotionMode::Cam if !self.has_cam() => Err(ExecuteError::NotPossible),
            MotionMode::External(_) if digital => Err(ExecuteError::NotPossible), // no second encoder
            _ => Ok(()),
        }
    }

    /// TUM0: the reference starts where the motor is, as fast as it is.
    fn start_from_motor(&mut self) {
        let shaft = &mut self.shaft;
        shaft.servo.hold(&shaft.motor);
        if self.memory.word(addresses::ASR) & START_AT_REST != 0 {
            let position = shaft.motor.position();
            shaft.servo.follow(Setpoint { position, ..Setpoint::default() });
            self.memory.set(addresses::ASR, self.memory.word(addresses::ASR) & !START_AT_REST);
        }
    }

    fn begin_mode(&mut self, mode: MotionMode, word: u16) {
        self.motion.mode = mode;
        self.motion.settled_ticks = 0;
        self.end_following();
        match mode {
            MotionMode::Position => self.begin_position(word),
            MotionMode::Speed => self.begin_speed(),
            MotionMode::Points => self.begin_points(word & 0x1F == 10, word & mcr::ABSOLUTE != 0),
            MotionMode::Test(_) => self.motion.test_reference = 0.0,
            MotionMode::Cam => self.begin_cam(),
            MotionMode::Contour(outer) => self.begin_contour(outer),
            MotionMode::Gear => self.motion.master_position = self.memory.long(addresses::MREF),
            _ => {}
        }
        if mode.ends() {
            self.note_motion_begun();
        }
    }

    fn begin_position(&mut self, word: u16) {
        let by = self.memory.long(addresses::CPOS);
        let absolute = word & mcr::ABSOLUTE != 0;
        let additive = self.memory.word(addresses::ACR) & ADDITIVE != 0;
        self.motion.target_counts = match (absolute, additive) {
            (true, _) => by,
            // From the last target, whatever the motor has reached of it (ACR.11).
            (false, true) => self.motion.target_counts.wrapping_add(by),
            (false, false) => self.shaft.target().wrapping_add(by),
        };
        self.unrepeatable += u64::from(!absolute);
        let jerk_periods = if word & 0x1F == 7 { self.memory.long(addresses::TJERK) } else { 0 };
        let limits = self.profile_limits(f64::from(jerk_periods));
        let index = self.shaft.position_of_count(self.motion.target_counts);
        self.shaft.servo.set_goal(Goal::Position(index));
        self.shaft.servo.set_limits(limits);
    }

    fn begin_speed(&mut self) {
        let limits = self.profile_limits(0.0);
        let speed = self.shaft.scale.speed_of_counts(self.memory.fixed(addresses::CSPD));
        self.shaft.servo.set_goal(Goal::Velocity(speed));
        self.shaft.servo.set_limits(limits);
    }

    /// CSPD and CACC, with the acceleration rounded over `jerk_periods` slow loop periods.
    fn profile_limits(&self, jerk_periods: f64) -> Limits {
        let scale = &self.shaft.scale;
        let velocity = scale.speed_of_counts(self.memory.fixed(addresses::CSPD)).abs();
        let acceleration = scale.acceleration_of_counts(self.memory.fixed(addresses::CACC));
        let smoothing_s = jerk_periods.max(0.0) * scale.slow_s;
        Limits { smoothing_s, ..Limits::trapezoid(velocity, acceleration) }
    }

    fn finish_reference(&mut self, mode: MotionMode) {
        match mode {
            MotionMode::Stopping => {
                // The place that the ramp ended at, not the motor's: the loop takes away what is left between them.
                let index = self.shaft.servo.setpoint().position;
                self.shaft.servo.set_goal(Goal::Position(index));
                self.motion.mode = MotionMode::Hold;
            }
            // The reference is there; the motion is complete when the motor is, too.
            MotionMode::Position if !self.has_settled() => return,
            _ => {}
        }
        self.complete_motion();
    }

    /// UPGRADE.11: complete only when the axis has been within POSOKLIM for TONPOSOK periods. \[I\]
    fn has_settled(&mut self) -> bool {
        if self.memory.word(addresses::UPGRADE) & 1 << 11 == 0 {
            return true;
        }
        let near =
            self.shaft.position_error().abs() <= f64::from(self.memory.word(addresses::POSOKLIM));
        self.motion.settled_ticks = if near { self.motion.settled_ticks + 1 } else { 0 };
        let for_s = f64::from(self.motion.settled_ticks) * TICK_S;
        for_s >= f64::from(self.memory.word(addresses::TONPOSOK)) * self.shaft.scale.slow_s
    }

    fn tick_external(&mut self, outer: ControlLoop) {
        let analog = self.memory.word(addresses::MCR) & mcr::SOURCE == mcr::ANALOG;
        let share = self.surroundings.reference_v / 10.0;
        let shaft = &mut self.shaft;
        match outer {
            ControlLoop::Position => {
                let index = shaft.position_of_count(self.memory.long(addresses::EREF));
                // Without a ramp: EREF is followed as it is written, and its speed is fed forward.
                let velocity = (index - shaft.servo.setpoint().position) / TICK_S;
                shaft.servo.follow(Setpoint { position: index, velocity, acceleration: 0.0 });
            }
            ControlLoop::Speed => {
                let max = self.memory.fixed(addresses::CSPD);
                let counts = if analog { share * max } else { self.memory.fixed(addresses::EREF) };
                let speed = shaft.scale.speed_of_counts(counts);
                shaft.servo.set_limits(Limits::trapezoid(speed.abs(), 0.0));
                shaft.servo.set_goal(Goal::Velocity(speed));
            }
            ControlLoop::Torque => {
                let online = units::amperes_of_units(self.memory.int(addresses::EREFT));
                let amperes = if analog { share * units::PEAK_A } else { online };
                self.drive_current(amperes);
            }
            ControlLoop::Voltage => {
                let online = f64::from(self.memory.int(addresses::EREFT)) / 32_767.0;
                self.drive_voltage(if analog { share } else { online });
            }
        }
    }

    /// TREF ramps by RINCTST a slow loop period up to REFTST.
    fn tick_test(&mut self, outer: ControlLoop) {
        let goal = f64::from(self.memory.int(addresses::REFTST));
        let max =
            f64::from(self.memory.int(addresses::RINCTST)).abs() * TICK_S / self.shaft.scale.slow_s;
        self.motion.test_reference += (goal - self.motion.test_reference).clamp(-max, max);
        self.memory.set_fixed(addresses::TREF, self.motion.test_reference);
        match outer {
            ControlLoop::Voltage => self.drive_voltage(self.motion.test_reference / 32_767.0),
            _ => self.drive_current(units::amperes_of_units(self.motion.test_reference as i16)),
        }
    }

    /// Pulses on the second encoder's input move the master's position where a gear or cam follows them (EXTREF 2).
    /// False where nothing does.
    pub fn count_master_pulses(&mut self, count: i32) -> bool {
        let is_follower = matches!(self.motion.mode, MotionMode::Gear | MotionMode::Cam);
        let is_digital = self.memory.word(addresses::MCR) & mcr::SOURCE == mcr::DIGITAL;
        if is_follower && is_digital {
            let position = self.memory.long(addresses::MREF).wrapping_add(count);
            self.memory.set_long(addresses::MREF, position);
        }
        is_follower && is_digital
    }

    /// Counts for a count of the master. GEARSLAVE over GEARMASTER is the exact value of what GEAR rounds to 16 bits
    /// \[I\]; where they differ by more, GEAR counts.
    fn gear_ratio(&self) -> f64 {
        let rounded = self.memory.fixed(addresses::GEAR);
        let numerator = f64::from(self.memory.int(addresses::GEARSLAVE));
        let exact = numerator / f64::from(self.memory.word(addresses::GEARMASTER));
        if (exact - rounded).abs() < 1.0 / 65_536.0 { exact } else { rounded }
    }

    /// The master's steps times the ratio.
    fn tick_gear(&mut self) {
        let master = self.memory.long(addresses::MREF);
        let by = f64::from(master.wrapping_sub(self.motion.master_position)) * self.gear_ratio();
        // Only steps since the last tick count: a master that was moved before gives no jump.
        self.motion.master_position = master;
        let way = by / self.shaft.scale.per_rad;
        let position = self.shaft.servo.setpoint().position + way;
        let velocity = way / TICK_S;
        self.shaft.servo.follow(Setpoint { position, velocity, acceleration: 0.0 });
        self.status.srh |= srh::IN_GEAR;
    }

    /// A current, A, unless a limit switch forbids its direction.
    pub fn drive_current(&mut self, amperes: f64) {
        let amperes = if self.is_direction_blocked(amperes) { 0.0 } else { amperes };
        self.shaft.servo.set_goal(Goal::Current(amperes));
    }

    /// A share of the bus voltage.
    pub fn drive_voltage(&mut self, share: f64) {
        let share = if self.is_direction_blocked(share) { 0.0 } else { share };
        self.shaft.servo.set_goal(Goal::Voltage(share * self.shaft.supply));
    }
}
