//! Set-points: trapezoidal speed profiles, with S-curves, changeable at any time.

use super::TICK_S;

/// Limits of a set-point, SI.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Limits {
    /// Speed at most, rad/s.
    pub velocity: f64,
    /// Gain of speed at most, rad/s².
    pub acceleration: f64,
    /// Loss of speed at most, rad/s².
    pub deceleration: f64,
    /// Over how long the acceleration comes and goes, s: the jerk is the acceleration divided by
    /// this. 0 is a trapezoid.
    pub smoothing_s: f64,
}

impl Limits {
    /// A trapezoid, the same up and down.
    #[must_use]
    pub const fn trapezoid(velocity: f64, acceleration: f64) -> Self {
        Self { velocity, acceleration, deceleration: acceleration, smoothing_s: 0.0 }
    }
}

/// Acceleration that means "no ramp", rad/s².
pub const ACCELERATION_MAX: f64 = 1e7;

/// Position and velocity of the axis at the end of a tick.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Setpoint {
    /// rad.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
    /// rad/s², mean over the tick.
    pub acceleration: f64,
}

/// A set-point on its way. Goal and limits can be changed at any tick; it goes on from where it
/// is, as fast as it is.
#[derive(Clone, Debug)]
pub struct Trajectory {
    limits: Limits,
    goal: TrajectoryGoal,
    base: Setpoint,
    output: Setpoint,
    smoother: Smoother,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum TrajectoryGoal {
    Velocity(f64),
    Position(f64),
}

impl Trajectory {
    /// At rest at `position` (rad).
    #[must_use]
    pub fn new(limits: Limits, position: f64) -> Self {
        let mut new = Self {
            limits: Limits::trapezoid(0.0, 0.0),
            goal: TrajectoryGoal::Position(position),
            base: Setpoint { position, ..Setpoint::default() },
            output: Setpoint { position, ..Setpoint::default() },
            smoother: Smoother::new(),
        };
        new.set_limits(limits);
        new
    }

    /// Changes how it may move, from now on. A change of `smoothing_s` takes effect when the
    /// set-point is next at rest.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = Limits {
            velocity: limits.velocity.abs(),
            acceleration: limited_acceleration(limits.acceleration),
            deceleration: limited_acceleration(limits.deceleration),
            smoothing_s: limits.smoothing_s.max(0.0),
        };
    }

    /// The limits.
    #[must_use]
    pub const fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Forgets where it was going: it is at `position` (rad), as fast as `velocity` (rad/s), and
    /// goes on at that speed.
    pub fn restart_at(&mut self, position: f64, velocity: f64) {
        self.base = Setpoint { position, velocity, acceleration: 0.0 };
        self.output = self.base;
        // An empty window would begin at rest and make a moving set-point leap.
        self.smoother = Smoother::filled(self.limits.smoothing_s, velocity * TICK_S);
        self.goal = if velocity == 0.0 {
            TrajectoryGoal::Position(position)
        } else {
            TrajectoryGoal::Velocity(velocity)
        };
    }

    /// Heads for a speed, rad/s, cut to the limit.
    pub fn set_velocity_goal(&mut self, velocity: f64) {
        self.goal = TrajectoryGoal::Velocity(velocity);
    }

    /// Heads for a position, rad, to come to rest exactly there.
    pub fn set_position_goal(&mut self, position: f64) {
        self.goal = TrajectoryGoal::Position(position);
    }

    /// Brakes to rest.
    pub fn stop(&mut self) {
        self.goal = TrajectoryGoal::Velocity(0.0);
    }

    /// The present set-point.
    #[must_use]
    pub const fn setpoint(&self) -> Setpoint {
        self.output
    }

    /// True at rest at the target, or at the target speed.
    #[must_use]
    pub fn arrived(&self) -> bool {
        let there = match self.goal {
            TrajectoryGoal::Velocity(v) => self.base.velocity == self.clamp_velocity(v),
            TrajectoryGoal::Position(p) => self.base.position == p && self.base.velocity == 0.0,
        };
        there && self.smoother.is_steady()
    }

    /// The greatest speed, rad/s, that an S-curve has not left behind: it comes to that before it
    /// brakes. 0 without one.
    #[must_use]
    pub fn smoothed_velocity(&self) -> f64 {
        self.smoother.peak() / TICK_S
    }

    /// Advances by one tick and returns the new set-point.
    pub fn step(&mut self) -> Setpoint {
        let before = self.base;
        let changed = self.smoother.smoothing_s != self.limits.smoothing_s;
        // At rest only: another window in motion would lose the distance that the old one holds.
        if changed && before.velocity == 0.0 && self.smoother.is_steady() {
            self.smoother = Smoother::filled(self.limits.smoothing_s, 0.0);
        }
        self.base = match self.goal {
            TrajectoryGoal::Velocity(v) => self.toward_velocity(v),
            TrajectoryGoal::Position(p) => self.toward_position(p),
        };
        if self.smoother.window == 0 {
            self.output = self.base;
        } else {
            self.smooth(self.base.position - before.position);
        }
        self.output
    }

    fn clamp_velocity(&self, velocity: f64) -> f64 {
        velocity.clamp(-self.limits.velocity, self.limits.velocity)
    }

    fn toward_velocity(&self, goal: f64) -> Setpoint {
        let from = self.base.velocity;
        let goal = self.clamp_velocity(goal);
        let velocity = if from * goal < 0.0 {
            self.ramp_toward(from, 0.0) // through rest, which is a tick of its own
        } else {
            self.ramp_toward(from, goal)
        };
        self.advance_at(velocity)
    }

    /// `from`, changed toward `goal` by as much as a tick allows.
    fn ramp_toward(&self, from: f64, goal: f64) -> f64 {
        let slower = goal.abs() < from.abs();
        let rate = if slower { self.limits.deceleration } else { self.limits.acceleration };
        let change = rate * TICK_S;
        from + (goal - from).clamp(-change, change)
    }

    fn advance_at(&self, velocity: f64) -> Setpoint {
        let from = self.base;
        Setpoint {
            position: from.position + 0.5 * (from.velocity + velocity) * TICK_S,
            velocity,
            acceleration: (velocity - from.velocity) / TICK_S,
        }
    }

    /// One tick of the fastest way to rest at `goal` within the limits.
    fn toward_position(&self, goal: f64) -> Setpoint {
        let left = goal - self.base.position;
        if left == 0.0 && self.base.velocity == 0.0 {
            return Setpoint { position: goal, velocity: 0.0, acceleration: 0.0 };
        }
        let way =
            if left == 0.0 { -super::with_sign(1.0, self.base.velocity) } else { left.signum() };
        let (left, speed) = (left.abs(), self.base.velocity * way);
        let Limits { velocity: top, acceleration, deceleration, .. } = self.limits;
        // It moves away from the target: it turns round through rest.
        if speed < 0.0 {
            return self.advance_at(self.ramp_toward(self.base.velocity, 0.0));
        }
        // The distance after this tick must still suffice to brake: v²/2d ≤ left - (speed+v)T/2.
        let capacity = left - 0.5 * speed * TICK_S;
        if capacity <= 0.0 || (capacity <= POSITION_TOLERANCE && speed <= deceleration * TICK_S) {
            return self.last_tick(goal, way, speed);
        }
        debug_assert!(deceleration > 0.0, "limited_acceleration leaves no zero");
        let half = 0.5 * TICK_S;
        // No speed is allowed: it brakes and stays short of the target.
        if top == 0.0 {
            return self.advance_at(way * self.ramp_toward(speed, 0.0));
        }
        let brake = deceleration * (libm::sqrt(half * half + 2.0 * capacity / deceleration) - half);
        let fastest = (speed + acceleration * TICK_S).min(top.max(speed - deceleration * TICK_S));
        let slowest = speed - deceleration * TICK_S;
        let next = brake.min(fastest).max(slowest).max(0.0);
        let left_over = capacity - 0.5 * next * TICK_S;
        if next == 0.0 || (left_over <= POSITION_TOLERANCE && next <= deceleration * TICK_S) {
            return self.last_tick(goal, way, speed);
        }
        self.advance_at(way * next)
    }

    /// The tick that ends at the goal, if it can be braked within one; else one of braking.
    fn last_tick(&self, goal: f64, way: f64, speed: f64) -> Setpoint {
        let change = self.limits.deceleration * TICK_S;
        // Too fast to end in this tick, by more than rounding: it brakes and comes back.
        if speed > change * 1.000_001 {
            return self.advance_at(way * (speed - change));
        }
        let acceleration = -self.base.velocity / TICK_S;
        Setpoint { position: goal, velocity: 0.0, acceleration }
    }

    fn smooth(&mut self, moved: f64) {
        let velocity = self.smoother.step(moved) / TICK_S;
        let acceleration = (velocity - self.output.velocity) / TICK_S;
        let position = self.output.position + velocity * TICK_S;
        self.output = Setpoint { position, velocity, acceleration };
        // At the very end the exact position replaces the sum of smoothed steps, which is off by rounding.
        let resting = self.base.velocity == 0.0 && moved == 0.0;
        if resting && self.smoother.is_steady() {
            self.output = self.base;
        }
    }
}

fn limited_acceleration(a: f64) -> f64 {
    if a > 0.0 { a.min(ACCELERATION_MAX) } else { ACCELERATION_MAX }
}

/// Nearer than this counts as there, rad: far below a count of any encoder.
const POSITION_TOLERANCE: f64 = 1e-9;

/// Slots of the moving average.
const SLOTS: usize = 32;

/// A moving average over the movement of each tick. A window of more ticks than slots gathers
/// several in a slot and lets each slot in and out evenly, so that no way is ever lost or gained.
#[derive(Clone, Debug)]
struct Smoother {
    smoothing_s: f64,
    window: u32,
    per_slot: u32,
    slots: [f64; SLOTS],
    at: usize,
    filled: u32,
    filling: f64,
    entering: f64,
    leaving: f64,
    sum: f64,
    last: f64,
    steady_ticks: u32,
}

impl Smoother {
    const fn new() -> Self {
        Self {
            smoothing_s: 0.0,
            window: 0,
            per_slot: 1,
            slots: [0.0; SLOTS],
            at: 0,
            filled: 0,
            filling: 0.0,
            entering: 0.0,
            leaving: 0.0,
            sum: 0.0,
            last: 0.0,
            steady_ticks: u32::MAX,
        }
    }

    /// A window that has seen nothing but `moved` for ever.
    fn filled(smoothing_s: f64, moved: f64) -> Self {
        let ticks = libm::round(smoothing_s / TICK_S) as u32;
        if ticks < 2 {
            return Self { smoothing_s, ..Self::new() };
        }
        // Memory is fixed: a longer window has coarser slots instead of more of them.
        let per_slot = ticks.div_ceil(SLOTS as u32);
        let window = ticks.div_ceil(per_slot) * per_slot;
        Self {
            smoothing_s,
            window,
            per_slot,
            slots: [moved * f64::from(per_slot); SLOTS],
            entering: moved * f64::from(per_slot),
            leaving: moved * f64::from(per_slot),
            sum: moved * f64::from(window),
            last: moved,
            ..Self::new()
        }
    }

    /// True when all that the window holds is the same.
    const fn is_steady(&self) -> bool {
        self.window == 0 || self.steady_ticks >= self.window + 2 * self.per_slot
    }

    /// The most that was moved in a tick, of all that the window holds.
    fn peak(&self) -> f64 {
        if self.window == 0 {
            return 0.0;
        }
        let slots = self.slots.iter().take((self.window / self.per_slot) as usize);
        let (of_slots, filled) = (f64::from(self.per_slot), f64::from(self.filled.max(1)));
        let within = slots.chain([&self.entering, &self.leaving]).map(|moved| moved / of_slots);
        within
            .chain([self.filling / filled, self.last])
            .fold(0.0, |max, moved| max.max(moved.abs()))
    }

    fn step(&mut self, moved: f64) -> f64 {
        let alike = (moved - self.last).abs() <= 1e-9 * self.last.abs();
        self.steady_ticks = if alike { self.steady_ticks.saturating_add(1) } else { 0 };
        self.last = moved;
        self.filling += moved;
        self.filled += 1;
        if self.filled == self.per_slot {
            self.entering = core::mem::take(&mut self.filling);
            self.leaving = core::mem::replace(&mut self.slots[self.at], self.entering);
            self.filled = 0;
            self.at = (self.at + 1) % (self.window / self.per_slot) as usize;
        }
        debug_assert!(self.window > 0, "an empty window is not stepped");
        // Each slot enters and leaves evenly, so that the mean has no steps at its borders.
        self.sum += (self.entering - self.leaving) / f64::from(self.per_slot);
        self.sum / f64::from(self.window)
    }
}
