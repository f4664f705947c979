//! One motor of a module: its ramp, driver, switches, and the motor itself.

use super::search::{Search, SearchStep, SwitchKind};
use super::units;
use crate::surroundings::ServoBounds;
use core::f64::consts::TAU;
use polepair_core::plant::{
    Limits, Setpoint, Stepper, StepperInputs, StepperParameters, TICK_S, ThermalModel, Trajectory,
};

/// Settings of a motor, by number.
pub type Settings = [i32; 256];

/// The numbers of the parameters that the motor lives by.
pub mod number {
    /// Speed of positioning at most.
    pub const MAX_SPEED: usize = 4;
    /// Acceleration at most.
    pub const MAX_ACCELERATION: usize = 5;
    /// Current while it turns, 255 is all.
    pub const RUN_CURRENT: usize = 6;
    /// Current at standstill.
    pub const STANDBY_CURRENT: usize = 7;
    /// The right stop switch does not stop.
    pub const RIGHT_STOP_DISABLE: usize = 12;
    /// The left stop switch does not stop.
    pub const LEFT_STOP_DISABLE: usize = 13;
    /// A stop switch stops by the ramp.
    pub const SOFT_STOP: usize = 149;
    /// Divides accelerations, as an exponent of two.
    pub const RAMP_DIVISOR: usize = 153;
    /// Divides speeds.
    pub const PULSE_DIVISOR: usize = 154;
    /// stallGuard2 threshold, -64 to 63: greater is less sensitive.
    pub const STALL_THRESHOLD: usize = 174;
    /// Speed from which on a stall stops the motor; 0 is never.
    pub const STALL_SPEED: usize = 181;
    /// Speed of the reference search.
    pub const SEARCH_SPEED: usize = 194;
    /// Speed at which a switch is left.
    pub const SWITCH_SPEED: usize = 195;
    /// Distance between the stop switches, as the last search found it.
    pub const SWITCH_DISTANCE: usize = 196;
    /// Position at which the last search ended, in counts before it.
    pub const LAST_REFERENCE: usize = 197;
    /// Time without motion after which the driver is switched off, 10 ms; 0 is never.
    pub const FREEWHEELING: usize = 204;
    /// Time without motion after which the standby current holds, 10 ms.
    pub const POWER_DOWN_DELAY: usize = 214;
}

/// Set in parameter 207: stopped by stallGuard2.
pub const STALL_ERROR: i32 = 1;
/// Speeds of the TMC428 and TMC429.
pub const DIVIDED_SPEED_MAX: i32 = 2047;
/// Ticks in which a motor is computed after a change.
// A second: longer than any oscillation of the rotor in its field lasts.
const SETTLING_TICKS: u32 = 1000;
/// Part of the load that a tick's reading moves.
// stallGuard2 measures once in a full step, so its reading lags behind the load.
const LOAD_FILTER: f64 = 0.2;
/// stallGuard2 reading of an unloaded motor, and its increase by a step of the threshold.
const STALL_UNLOADED: f64 = 500.0;
const STALL_STEP: f64 = 10.0;
/// Greatest stallGuard2 reading.
const STALL_MAX: f64 = 1023.0;

/// Mode of the ramp.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RampMode {
    /// To a position.
    Position,
    /// At a speed.
    Velocity,
}

/// Surroundings of a motor on the bench.
#[derive(Clone, Copy, Debug)]
pub struct ChannelSurroundings {
    /// Torque from outside, N·m.
    pub load: f64,
    /// From where on each switch is closed, rad: left, right, home. The left one is closed from there on
    /// backward.
    pub switches: [Option<f64>; 3],
}

/// One motor.
#[derive(Clone, Debug)]
pub struct Channel {
    ramp: Trajectory,
    /// Mode of the ramp.
    pub mode: RampMode,
    /// Target of the last move, microsteps.
    pub target: i32,
    /// Last target speed, in the module's unit.
    pub target_speed: i32,
    /// Electrical angle of the field at position 0, rad.
    zero: f64,
    /// rad of a microstep.
    microstep: f64,
    /// True if speeds have divisors (TMC428, TMC429).
    pub has_divisors: bool,
    /// The motor.
    pub motor: Stepper,
    /// Thermal model of the winding.
    pub winding: ThermalModel,
    /// Current at full scale, A RMS.
    pub full_current: f64,
    current: f64,
    search: Option<Search>,
    /// Parameter 207.
    pub errors: i32,
    load_share: f64,
    standing_ticks: u32,
    unsettled_ticks: u32,
    /// The bench's side.
    pub around: ChannelSurroundings,
}

impl Channel {
    /// A motor at rest, its position 0.
    #[must_use]
    pub fn new(has_divisors: bool, full_current: f64) -> Self {
        let ends = 20.0 * TAU;
        Self {
            ramp: Trajectory::new(Limits::trapezoid(0.0, 1.0), 0.0),
            mode: RampMode::Position,
            target: 0,
            target_speed: 0,
            zero: 0.0,
            microstep: TAU / (f64::from(StepperParameters::NEMA_17.full_steps) * 256.0),
            has_divisors,
            motor: Stepper::new(StepperParameters::NEMA_17),
            winding: ThermalModel::new(6.0, 60.0, 25.0),
            full_current,
            current: 0.0,
            search: None,
            errors: 0,
            load_share: 0.0,
            standing_ticks: 0,
            unsettled_ticks: SETTLING_TICKS,
            around: ChannelSurroundings {
                load: 0.0,
                switches: [Some(-ends), Some(ends), Some(5.0 * TAU)],
            },
        }
    }

    /// Sets the full steps of the motor per turn. Its position stays the same.
    pub fn set_full_steps(&mut self, full_steps: u32, settings: &Settings) {
        self.motor = Stepper::new(StepperParameters { full_steps, ..*self.motor.parameters() });
        // The field of another motor has another period, so the counter starts anew with it.
        self.power_up(settings);
    }

    /// Power-up: counters are 0, the field is at the rotor.
    pub fn power_up(&mut self, settings: &Settings) {
        let at = self.motor.position() + self.period_lag();
        self.ramp.restart_at(at, 0.0);
        // The rotor stays where it is; only what counts as zero changes.
        self.zero = at;
        (self.mode, self.target, self.target_speed) = (RampMode::Position, 0, 0);
        (self.search, self.errors, self.standing_ticks) = (None, 0, 0);
        self.apply_resolution(settings);
    }

    /// The field powers up at the rotor's position: its nearest period.
    fn period_lag(&self) -> f64 {
        let period = TAU / (f64::from(self.motor.parameters().full_steps) / 4.0);
        let lag = self.motor.lag();
        // A stepper that was turned by hand snaps to the nearest period, and not back to where it was switched
        // off.
        lag - libm::round(lag / period) * period
    }

    /// Position as the module counts it: of the field, not of the rotor.
    #[must_use]
    pub fn counter(&self) -> i32 {
        libm::round((self.ramp.setpoint().position - self.zero) / self.microstep) as i32
    }

    /// Makes the counter read `count`; the motor stays.
    pub fn set_counter(&mut self, count: i32) {
        // A search ends at a place that it found in the old count.
        self.cancel_search();
        self.zero = self.ramp.setpoint().position - f64::from(count) * self.microstep;
        if self.mode == RampMode::Position {
            self.target = count;
            self.ramp.set_position_goal(self.ramp.setpoint().position);
        }
    }

    /// Microstep resolution was written: the counter keeps its number.
    pub fn apply_resolution(&mut self, settings: &Settings) {
        // Taken before the step changes, because the counter depends on it.
        let count = f64::from(self.counter());
        let exponent = settings[usize::from(units::MICROSTEPS.0)].clamp(0, 8).unsigned_abs();
        let steps = f64::from(self.motor.parameters().full_steps);
        self.microstep = TAU / (steps * units::power_of_two(exponent));
        self.zero = self.ramp.setpoint().position - count * self.microstep;
    }

    /// Turns at a speed in the module's unit.
    pub fn rotate(&mut self, speed: i32, settings: &Settings) {
        self.search = None;
        (self.mode, self.target_speed) = (RampMode::Velocity, speed);
        self.apply_limits(settings);
        self.ramp.set_velocity_goal(self.speed_of(speed, settings));
        self.standing_ticks = 0;
    }

    /// Goes to a position.
    pub fn move_to(&mut self, target: i32, settings: &Settings) {
        self.search = None;
        (self.mode, self.target) = (RampMode::Position, target);
        self.apply_limits(settings);
        self.ramp.set_position_goal(self.zero + f64::from(target) * self.microstep);
        self.standing_ticks = 0;
    }

    /// Brakes to rest.
    pub fn stop(&mut self, settings: &Settings) {
        self.rotate(0, settings);
    }

    /// Starts the reference search of a mode; `false` where there is none of that number.
    pub fn start_search(&mut self, mode: i32, settings: &Settings) -> bool {
        self.search = Search::new(mode);
        let Some(search) = self.search else { return false };
        (self.mode, self.target_speed) = (RampMode::Velocity, 0);
        self.apply_limits(settings);
        self.standing_ticks = 0;
        self.begin_search_step(search, settings);
        true
    }

    /// Ends the search, if there is one.
    pub fn cancel_search(&mut self) {
        if self.search.take().is_some() {
            self.ramp.stop();
        }
    }

    /// Reply to RFS STATUS: 0 when no search is running.
    #[must_use]
    pub fn search_status(&self) -> i32 {
        self.search.map_or(0, |search| search.at as i32 + 1)
    }

    /// Returns whether the last move has reached its target.
    #[must_use]
    pub fn has_arrived(&self) -> bool {
        self.mode == RampMode::Position
            && self.search.is_none()
            && self.counter() == self.target
            && self.ramp.setpoint().velocity == 0.0
    }

    /// Speed of the field, in the module's unit.
    #[must_use]
    pub fn actual_speed(&self, settings: &Settings) -> i32 {
        debug_assert!(self.speed_unit(settings) > 0.0, "a unit of the ramp generator is a speed");
        // A module that was just started has begun its ramp: a reading of 0 would be that of a motor at its target.
        match self.starting_direction() {
            0 => libm::round(self.ramp.setpoint().velocity / self.speed_unit(settings)) as i32,
            direction => direction,
        }
    }

    /// 1 or -1 between the request that starts the motor and the first tick of its ramp, otherwise 0.
    fn starting_direction(&self) -> i32 {
        let setpoint = self.ramp.setpoint();
        if setpoint.velocity != 0.0 || self.ramp.arrived() || self.search.is_some() {
            return 0;
        }
        let ahead = match self.mode {
            RampMode::Velocity => f64::from(self.target_speed),
            RampMode::Position => {
                self.zero + f64::from(self.target) * self.microstep - setpoint.position
            }
        };
        if ahead > 0.0 { 1 } else { -1 }
    }

    /// Acceleration of the field, in the module's unit.
    #[must_use]
    pub fn actual_acceleration(&self, settings: &Settings) -> i32 {
        match self.starting_direction() {
            0 => {
                let acceleration = self.ramp.setpoint().acceleration;
                libm::round(acceleration / self.acceleration_unit(settings)) as i32
            }
            direction => direction * settings[number::MAX_ACCELERATION].max(1),
        }
    }

    /// Reading of stallGuard2 (parameter 206): less is more load, 0 a stall.
    #[must_use]
    pub fn load_value(&self, settings: &Settings) -> i32 {
        let threshold = f64::from(settings[number::STALL_THRESHOLD]) * STALL_STEP;
        let reading =
            STALL_UNLOADED * (1.0 - self.load_share) + threshold * (1.0 - self.load_share);
        reading.clamp(0.0, STALL_MAX) as i32
    }

    /// Current now, A RMS.
    #[must_use]
    pub const fn current(&self) -> f64 {
        self.current
    }

    /// Returns whether the driver holds the motor.
    #[must_use]
    pub fn is_powered(&self) -> bool {
        self.current > 0.0
    }

    /// The set-point of the ramp.
    #[must_use]
    pub const fn setpoint(&self) -> Setpoint {
        self.ramp.setpoint()
    }

    /// The limits by the settings, not by the ramp.
    #[must_use]
    pub fn bounds(&self, settings: &Settings) -> ServoBounds {
        let speed = match self.mode {
            _ if self.search.is_some() => {
                settings[number::SEARCH_SPEED].max(settings[number::SWITCH_SPEED])
            }
            RampMode::Position => settings[number::MAX_SPEED],
            RampMode::Velocity => self.target_speed,
        };
        ServoBounds {
            velocity: self.speed_of(speed, settings).abs(),
            acceleration: self.acceleration_of(settings),
            // A stepper has no current loop that its motion could overrun.
            current: f64::INFINITY,
        }
    }

    /// Returns whether a switch is closed.
    #[must_use]
    pub fn is_closed(&self, switch: SwitchKind) -> bool {
        let at = self.motor.position();
        match switch {
            SwitchKind::Left => self.around.switches[0].is_some_and(|place| at <= place),
            SwitchKind::Right => self.around.switches[1].is_some_and(|place| at >= place),
            SwitchKind::Home => self.around.switches[2].is_some_and(|place| at >= place),
        }
    }

    /// Returns whether nothing but temperatures changes without an action.
    #[must_use]
    pub fn is_idle(&self, settings: &Settings) -> bool {
        // Until both delays are over, the current of a motor at rest still changes.
        let standby = Self::ticks_of(settings[number::POWER_DOWN_DELAY]);
        let freewheel = Self::ticks_of(settings[number::FREEWHEELING]);
        self.search.is_none()
            && self.unsettled_ticks == 0
            && self.ramp.setpoint().velocity == 0.0
            && self.ramp.arrived()
            && self.motor.is_at_rest()
            && self.standing_ticks > standby.max(freewheel)
    }

    /// Something from outside changed: the motor is looked at until it has settled.
    pub const fn wake(&mut self) {
        self.unsettled_ticks = SETTLING_TICKS;
    }

    /// One tick; returns an unusual event.
    pub fn tick(&mut self, settings: &mut Settings, supply: f64) -> Option<&'static str> {
        self.unsettled_ticks = self.unsettled_ticks.saturating_sub(1);
        self.run_search(settings);
        self.check_stop_switches(settings);
        let setpoint = self.ramp.step();
        let stands = setpoint.velocity == 0.0 && self.ramp.arrived();
        self.standing_ticks = if stands { self.standing_ticks.saturating_add(1) } else { 0 };
        self.current = self.driver_current(settings, supply);
        let lost_before = self.lost_periods();
        self.motor.step(StepperInputs {
            field: setpoint.position,
            current: self.current,
            bus: supply,
            load: self.around.load,
        });
        // Two phases of 1.6 Ω each.
        self.winding.step(2.0 * 1.6 * self.current * self.current, TICK_S);
        // A motor without current slips in its field all the time; only under current does it lose steps.
        let lost = self.lost_periods() != lost_before && self.is_powered();
        let share = if lost { 1.0 } else { self.motor.load_share() };
        self.load_share += LOAD_FILTER * (share - self.load_share);
        if lost {
            self.load_share = 1.0;
        }
        self.check_stall(settings).or(lost.then_some("steps lost"))
    }

    fn lost_periods(&self) -> i64 {
        let period = TAU / (f64::from(self.motor.parameters().full_steps) / 4.0);
        libm::round(self.motor.lag() / period) as i64
    }

    fn check_stall(&mut self, settings: &Settings) -> Option<&'static str> {
        let limit = settings[number::STALL_SPEED];
        let turns = self.actual_speed(settings).abs() >= limit && limit > 0;
        if !turns || self.load_value(settings) > 0 {
            return None;
        }
        self.errors |= STALL_ERROR;
        self.search = None;
        (self.mode, self.target_speed) = (RampMode::Velocity, 0);
        self.ramp.restart_at(self.ramp.setpoint().position, 0.0);
        Some("stalled: motor stopped")
    }

    /// \[I\] A stop switch stops only a motor that turns towards it.
    fn check_stop_switches(&mut self, settings: &Settings) {
        let velocity = self.ramp.setpoint().velocity;
        let stops = velocity > 0.0
            && is_switch_watched(number::RIGHT_STOP_DISABLE, settings)
            && self.is_closed(SwitchKind::Right)
            || velocity < 0.0
                && is_switch_watched(number::LEFT_STOP_DISABLE, settings)
                && self.is_closed(SwitchKind::Left);
        // A search runs into the switches on purpose.
        if !stops || self.search.is_some() {
            return;
        }
        self.target_speed = 0;
        match settings[number::SOFT_STOP] {
            0 => self.ramp.restart_at(self.ramp.setpoint().position, 0.0),
            _ => self.ramp.stop(),
        }
    }

    fn run_search(&mut self, settings: &mut Settings) {
        let Some(mut search) = self.search else { return };
        if search.is_braking {
            if self.ramp.setpoint().velocity == 0.0 && self.ramp.arrived() {
                search.advance();
                self.begin_search_step(search, settings);
            }
            return;
        }
        match search.step() {
            SearchStep::Find { switch, forward, turns_round } => {
                let end = if forward { SwitchKind::Right } else { SwitchKind::Left };
                if self.search_sees(&search, switch) {
                    self.brake_search(&mut search);
                } else if turns_round && !search.turned && self.is_closed(end) {
                    search.turned = true;
                    let speed = self.speed_of(settings[number::SEARCH_SPEED], settings);
                    self.ramp.set_velocity_goal(if forward { -speed } else { speed });
                }
            }
            SearchStep::Leave { switch, .. } => {
                if !self.search_sees(&search, switch) {
                    search.edge = self.ramp.setpoint().position;
                    if switch == SwitchKind::Right {
                        search.right_edge = Some(search.edge);
                    }
                    self.brake_search(&mut search);
                }
            }
            SearchStep::Finish => {
                if self.ramp.arrived() {
                    return self.finish_search(&search, settings);
                }
            }
        }
        self.search = Some(search);
    }

    fn finish_search(&mut self, search: &Search, settings: &mut Settings) {
        // Before the zero moves: it is the distance between the old zero and the new one.
        settings[number::LAST_REFERENCE] = self.counter();
        if let Some(right) = search.right_edge {
            settings[number::SWITCH_DISTANCE] =
                libm::round((right - search.edge).abs() / self.microstep) as i32;
        }
        self.search = None;
        (self.mode, self.target) = (RampMode::Position, 0);
        self.zero = search.edge;
        self.ramp.restart_at(search.edge, 0.0);
    }

    fn search_sees(&self, search: &Search, switch: SwitchKind) -> bool {
        let inverts = search.inverts_home && switch == SwitchKind::Home;
        self.is_closed(switch) != inverts
    }

    fn brake_search(&mut self, search: &mut Search) {
        search.is_braking = true;
        self.ramp.stop();
    }

    fn begin_search_step(&mut self, mut search: Search, settings: &Settings) {
        match search.step() {
            SearchStep::Find { switch, .. } if self.search_sees(&search, switch) => {
                // It is there already.
                search.is_braking = true;
            }
            SearchStep::Find { forward, .. } => {
                let speed = self.speed_of(settings[number::SEARCH_SPEED], settings);
                self.ramp.set_velocity_goal(signed_speed(speed, forward));
            }
            SearchStep::Leave { forward, .. } => {
                let speed = self.speed_of(settings[number::SWITCH_SPEED], settings);
                self.ramp.set_velocity_goal(signed_speed(speed, forward));
            }
            SearchStep::Finish => self.ramp.set_position_goal(search.edge),
        }
        self.search = Some(search);
    }

    fn driver_current(&self, settings: &Settings, supply: f64) -> f64 {
        if supply < super::module::UNDERVOLTAGE_V {
            return 0.0;
        }
        let freewheel = settings[number::FREEWHEELING];
        if freewheel > 0 && self.standing_ticks > Self::ticks_of(freewheel) {
            return 0.0;
        }
        let stands = self.standing_ticks > Self::ticks_of(settings[number::POWER_DOWN_DELAY]);
        debug_assert!(supply >= super::module::UNDERVOLTAGE_V);
        let which = if stands { number::STANDBY_CURRENT } else { number::RUN_CURRENT };
        self.full_current * f64::from(settings[which].clamp(0, 255)) / 255.0
    }

    /// Ticks of a time in 10 ms.
    fn ticks_of(setting: i32) -> u32 {
        setting.max(0).cast_unsigned().saturating_mul(10)
    }

    fn apply_limits(&mut self, settings: &Settings) {
        let speed = match self.mode {
            RampMode::Position => self.speed_of(settings[number::MAX_SPEED], settings),
            RampMode::Velocity => f64::INFINITY,
        };
        self.ramp.set_limits(Limits::trapezoid(speed, self.acceleration_of(settings)));
    }

    /// Settings that the ramp looks at were written: they hold from now on.
    pub fn apply_settings(&mut self, settings: &Settings) {
        self.apply_limits(settings);
        match (self.search, self.mode) {
            (Some(search), _) if !search.is_braking => self.begin_search_step(search, settings),
            (Some(_), _) => {}
            (None, RampMode::Velocity) => {
                self.ramp.set_velocity_goal(self.speed_of(self.target_speed, settings));
            }
            (None, RampMode::Position) => {
                let target = self.zero + f64::from(self.target) * self.microstep;
                self.ramp.set_position_goal(target);
            }
        }
    }

    fn acceleration_of(&self, settings: &Settings) -> f64 {
        let acceleration = f64::from(settings[number::MAX_ACCELERATION]);
        // None is no ramp to the plant, and none at all to the module.
        (acceleration * self.acceleration_unit(settings)).max(1e-6)
    }

    /// rad/s of a speed in the module's unit.
    fn speed_of(&self, speed: i32, settings: &Settings) -> f64 {
        f64::from(speed) * self.speed_unit(settings)
    }

    fn speed_unit(&self, settings: &Settings) -> f64 {
        let divisor = settings[number::PULSE_DIVISOR].clamp(0, 13).unsigned_abs();
        units::velocity_unit(self.has_divisors.then_some(divisor)) * self.microstep
    }

    fn acceleration_unit(&self, settings: &Settings) -> f64 {
        let both = (
            divisor_exponent(number::PULSE_DIVISOR, settings),
            divisor_exponent(number::RAMP_DIVISOR, settings),
        );
        units::acceleration_unit(self.has_divisors.then_some(both)) * self.microstep
    }
}

fn divisor_exponent(at: usize, settings: &[i32; 256]) -> u32 {
    settings[at].clamp(0, 13).unsigned_abs()
}

fn signed_speed(speed: f64, forward: bool) -> f64 {
    if forward { speed } else { -speed }
}

fn is_switch_watched(disable: usize, settings: &[i32; 256]) -> bool {
    settings[disable] == 0
}
