//! A motor with its load: current, speed, position and energy.

use super::{TICK_S, clamp_abs, with_sign};

/// Parameters of a motor and its load, SI.
///
/// The model is a DC motor: a three-phase motor under field-oriented or block control behaves like one
/// in its torque-producing current.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MotorParameters {
    /// Inertia of rotor and load, kg·m².
    pub inertia: f64,
    /// Friction that grows with speed, N·m·s/rad.
    pub viscous: f64,
    /// Friction that opposes any motion, N·m.
    pub coulomb: f64,
    /// Torque that it takes to break away from rest, N·m; at least `coulomb`.
    pub stiction: f64,
    /// Torque constant, N·m/A. In SI it is the back-EMF constant too, V·s/rad, or energy would
    /// come from nothing.
    pub torque_constant: f64,
    /// Winding resistance, Ω.
    pub resistance: f64,
    /// Winding inductance, H. Below `resistance` × 60 µs it counts as that.
    pub inductance: f64,
    /// Current limit of the power stage, A.
    pub max_current: f64,
}

impl MotorParameters {
    /// A 150 W BLDC motor for 24 V: 3,800 rpm without load, 1.2 N·m at 20 A.
    pub const BLDC_24V: Self = Self {
        inertia: 8e-5,
        viscous: 2e-5,
        coulomb: 0.01,
        stiction: 0.013,
        torque_constant: 0.06,
        resistance: 0.3,
        inductance: 0.3e-3,
        max_current: 20.0,
    };

    /// A 400 W servo motor for 48 V: 4,500 rpm without load, 1.3 N·m rated at 12.7 A.
    pub const SERVO_48V: Self = Self {
        inertia: 6e-5,
        viscous: 4e-5,
        coulomb: 0.02,
        stiction: 0.025,
        torque_constant: 0.102,
        resistance: 0.12,
        inductance: 0.4e-3,
        max_current: 38.0,
    };

    /// Electrical time constant, s.
    #[must_use]
    pub fn electrical_s(&self) -> f64 {
        self.inductance / self.resistance
    }
}

/// State of the power stage.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Winding {
    /// Drivers off: no current, the shaft turns freely.
    Open,
    /// This voltage, V, limited to the bus voltage. The current limit has priority.
    Voltage(f64),
    /// This current, A, as far as the bus voltage can drive it.
    Current(f64),
}

/// Inputs of the motor during a step.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Inputs {
    /// State of the power stage.
    pub winding: Winding,
    /// Voltage that the power stage can give at most, V: the bus, times the PWM limit.
    pub bus: f64,
    /// Torque from outside, N·m; positive drives the shaft forward.
    pub load: f64,
}

/// Energy balance since the motor was made, J.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Energy {
    /// Taken from the bus; falls while the motor brakes into it.
    pub electrical: f64,
    /// Done by the load on the shaft.
    pub load: f64,
    /// Turned to heat in the winding. Only grows.
    pub copper: f64,
    /// Turned to heat by friction, or by a jam. Only grows.
    pub friction: f64,
}

/// A motor with its load.
///
/// Current and speed are advanced together by the implicit midpoint rule. It is stable at any
/// step, and its discrete energy balance is exact: what the bus and the load give equals what the
/// winding and the friction turn to heat and what mass and field store, to rounding.
#[derive(Clone, Debug)]
pub struct Motor {
    parameters: MotorParameters,
    position: f64,
    velocity: f64,
    current: f64,
    voltage: f64,
    jammed: bool,
    /// Hard stops, rad.
    ends: Option<(f64, f64)>,
    sub_steps: u32,
    sub_step: SubStep,
    energy: Energy,
    /// Heat in the winding before the last step, J.
    copper_before: f64,
}

/// A part of a step, and what follows from its length.
#[derive(Clone, Copy, Debug)]
struct SubStep {
    /// Length of the step, s.
    h: f64,
    /// Twice the inductance divided by the sub-step, Ω.
    l: f64,
    /// Twice the inertia by it, N·m·s/rad.
    j: f64,
    /// The step's coefficient with viscous friction.
    c: f64,
}

impl SubStep {
    fn new(h: f64, p: &MotorParameters) -> Self {
        let j = 2.0 * p.inertia / h;
        Self { h, l: 2.0 * p.inductance / h, j, c: j + p.viscous }
    }
}

impl Motor {
    /// A motor at rest at position 0.
    #[must_use]
    pub fn new(parameters: MotorParameters) -> Self {
        let mut p = parameters;
        // A shorter electrical time constant would need more sub-steps than a tick may take.
        p.inductance = p.inductance.max(p.resistance * 60e-6);
        // A motor that starts more easily than it turns would never come to rest.
        p.stiction = p.stiction.max(p.coulomb);
        debug_assert!(
            p.inertia > 0.0 && p.resistance > 0.0,
            "a motor needs inertia and resistance"
        );
        let parts = libm::ceil(TICK_S / (0.5 * p.electrical_s())).clamp(1.0, SUB_STEPS_MAX);
        Self {
            parameters: p,
            position: 0.0,
            velocity: 0.0,
            current: 0.0,
            voltage: 0.0,
            jammed: false,
            ends: None,
            sub_steps: parts as u32,
            sub_step: SubStep::new(TICK_S / parts, &p),
            energy: Energy::default(),
            copper_before: 0.0,
        }
    }

    /// Parameters of the motor.
    #[must_use]
    pub const fn parameters(&self) -> &MotorParameters {
        &self.parameters
    }

    /// Shaft position since it was made, rad, never wrapped.
    #[must_use]
    pub const fn position(&self) -> f64 {
        self.position
    }

    /// Shaft speed, rad/s.
    #[must_use]
    pub const fn velocity(&self) -> f64 {
        self.velocity
    }

    /// Torque-producing current, A.
    #[must_use]
    pub const fn current(&self) -> f64 {
        self.current
    }

    /// Mean voltage at the winding in the last part of the last step, V.
    #[must_use]
    pub const fn voltage(&self) -> f64 {
        self.voltage
    }

    /// Air-gap torque, N·m.
    #[must_use]
    pub fn torque(&self) -> f64 {
        self.parameters.torque_constant * self.current
    }

    /// Mean heat in the winding during the last step, W.
    #[must_use]
    pub fn copper_w(&self) -> f64 {
        (self.energy.copper - self.copper_before) / TICK_S
    }

    /// Energy balance of the motor.
    #[must_use]
    pub const fn energy(&self) -> Energy {
        self.energy
    }

    /// Energy in moving mass and magnetic field, J.
    #[must_use]
    pub fn stored_energy(&self) -> f64 {
        let p = &self.parameters;
        let kinetic = p.inertia * self.velocity * self.velocity;
        0.5 * (kinetic + p.inductance * self.current * self.current)
    }

    /// Error of the energy balance, J: zero but for rounding.
    #[must_use]
    pub fn energy_error(&self) -> f64 {
        let e = &self.energy;
        e.electrical + e.load - e.copper - e.friction - self.stored_energy()
    }

    /// Holds the shaft still, or lets it go. What moved is turned to heat.
    pub fn set_jammed(&mut self, jammed: bool) {
        self.jammed = jammed;
    }

    /// Sets hard stops, rad; `None` without. A collision turns the kinetic energy to heat.
    pub const fn set_ends(&mut self, ends: Option<(f64, f64)>) {
        self.ends = ends;
    }

    /// The hard stops, rad.
    #[must_use]
    pub const fn ends(&self) -> Option<(f64, f64)> {
        self.ends
    }

    fn stop_at_ends(&mut self) {
        let Some((low, high)) = self.ends else { return };
        let outward = self.position > high && self.velocity > 0.0
            || self.position < low && self.velocity < 0.0;
        if outward {
            // A stop takes the kinetic energy as friction does, so that the balance stays closed.
            self.energy.friction += 0.5 * self.parameters.inertia * self.velocity * self.velocity;
            self.velocity = 0.0;
            self.position = self.position.clamp(low, high);
        }
    }

    /// Advances by one tick of [`TICK_S`].
    #[inline]
    pub fn step(&mut self, inputs: Inputs) {
        self.copper_before = self.energy.copper;
        let winding = self.sanitized(inputs.winding);
        // Written so that a bus that is not a number counts as none.
        let bus = if inputs.bus > 0.0 { inputs.bus } else { 0.0 };
        let inputs = Inputs { winding, bus, ..inputs };
        for _ in 0..self.sub_steps {
            self.run_sub_step(&inputs);
            self.stop_at_ends();
        }
    }

    /// The winding's command with limits and nonsense taken out.
    #[inline]
    fn sanitized(&self, winding: Winding) -> Winding {
        let max = self.parameters.max_current;
        match winding {
            Winding::Current(i) if i.is_finite() => Winding::Current(clamp_abs(i, max)),
            Winding::Voltage(v) if v.is_finite() => Winding::Voltage(v),
            _ => Winding::Open,
        }
    }

    #[inline]
    fn run_sub_step(&mut self, inputs: &Inputs) {
        // In each sub-step: the energy that is left in the winding must not be counted twice.
        if inputs.winding == Winding::Open {
            self.release();
        }
        if self.jammed {
            self.halt();
        }
        if self.velocity == 0.0 {
            return self.leave_rest(self.sub_step, inputs);
        }
        let execution = self.velocity;
        let friction = with_sign(self.parameters.coulomb, execution);
        let solved = self.solve(&self.sub_step, inputs, inputs.load - friction);
        // The mean of a sub-step is solved for; its end lies as far beyond it as its beginning before.
        let next = 2.0 * solved.speed - execution;
        if next * execution >= 0.0 {
            return self.apply(self.sub_step.h, inputs, friction, solved);
        }
        // Friction changes its sign at rest: the sub-step is cut there, or the rotor would be driven backwards
        // by its own friction.
        self.come_to_rest(execution / (execution - next), inputs, friction);
    }

    /// Handles a part in which the motor comes to rest: runs to the standstill, then from rest for the
    /// remaining time.
    fn come_to_rest(&mut self, share: f64, inputs: &Inputs, friction: f64) {
        let h = self.sub_step.h;
        let part = SubStep::new(h * share, &self.parameters);
        let solved = self.solve(&part, inputs, inputs.load - friction);
        self.apply(h * share, inputs, friction, solved);
        self.halt();
        let rest = SubStep::new(h * (1.0 - share), &self.parameters);
        self.leave_rest(rest, inputs);
    }

    /// From standstill: it stays there unless the torque breaks it loose.
    fn leave_rest(&mut self, part: SubStep, inputs: &Inputs) {
        // The current of a rotor that is held decides whether it breaks loose.
        let held = self.solve_held(&part, inputs);
        let torque = self.parameters.torque_constant * held.current + inputs.load;
        if self.jammed || torque.abs() <= self.parameters.stiction {
            return self.apply(part.h, inputs, 0.0, held);
        }
        let friction = with_sign(self.parameters.coulomb, torque);
        let solved = self.solve(&part, inputs, inputs.load - friction);
        // Its own inertia or back-EMF would turn it against the torque: it stays.
        if solved.speed * torque <= 0.0 {
            return self.apply(part.h, inputs, 0.0, held);
        }
        self.apply(part.h, inputs, friction, solved);
    }

    /// Means of current, speed and voltage over a part with `torque` acting from outside.
    #[inline]
    fn solve(&self, part: &SubStep, inputs: &Inputs, torque: f64) -> Means {
        let p = &self.parameters;
        let &SubStep { l, j, c, .. } = part;
        let k = p.torque_constant;
        let q = torque + j * self.velocity;
        let with_current = |current: f64| {
            let speed = (q + k * current) / c;
            let voltage = p.resistance * current + l * (current - self.current) + k * speed;
            Means { current, speed, voltage }
        };
        self.limited(inputs, with_current, |voltage| {
            let a = l + p.resistance;
            let e = voltage + l * self.current;
            let determinant = a * c + k * k;
            let current = (e * c - k * q) / determinant;
            Means { current, speed: (a * q + k * e) / determinant, voltage }
        })
    }

    /// Solves a part with the shaft at rest.
    #[inline]
    fn solve_held(&self, part: &SubStep, inputs: &Inputs) -> Means {
        let p = &self.parameters;
        let l = part.l;
        let with_current = |current: f64| {
            let voltage = p.resistance * current + l * (current - self.current);
            Means { current, speed: 0.0, voltage }
        };
        self.limited(inputs, with_current, |voltage| {
            let current = (voltage + l * self.current) / (l + p.resistance);
            Means { current, speed: 0.0, voltage }
        })
    }

    /// Applies the winding's command within bus voltage and current limit.
    #[inline]
    fn limited(
        &self,
        inputs: &Inputs,
        with_current: impl Fn(f64) -> Means,
        with_voltage: impl Fn(f64) -> Means,
    ) -> Means {
        let to_end = |end: f64| with_current(0.5 * (self.current + end));
        let solved = match inputs.winding {
            Winding::Open => return with_current(0.0),
            Winding::Current(i) => to_end(i),
            Winding::Voltage(v) => {
                let solved = with_voltage(clamp_abs(v, inputs.bus));
                let end = 2.0 * solved.current - self.current;
                let max = self.parameters.max_current;
                // The power stage limits current first; only within its limit does the voltage hold.
                if end.abs() <= max {
                    return solved;
                }
                to_end(clamp_abs(end, max))
            }
        };
        if solved.voltage.abs() <= inputs.bus {
            return solved;
        }
        // The stage cannot give more than its supply: the current is then what this voltage drives.
        with_voltage(clamp_abs(solved.voltage, inputs.bus))
    }

    #[inline]
    fn apply(&mut self, h: f64, inputs: &Inputs, friction: f64, means: Means) {
        let p = &self.parameters;
        let Means { current, speed, voltage } = means;
        self.energy.electrical += voltage * current * h;
        self.energy.copper += p.resistance * current * current * h;
        self.energy.load += inputs.load * speed * h;
        self.energy.friction += (friction + p.viscous * speed) * speed * h;
        if speed != 0.0 {
            self.position += speed * h;
            self.velocity = 2.0 * speed - self.velocity;
        }
        self.current = 2.0 * current - self.current;
        self.voltage = voltage;
    }

    /// Drivers off: the field's energy goes back into the bus.
    fn release(&mut self) {
        let p = &self.parameters;
        self.energy.electrical -= 0.5 * p.inductance * self.current * self.current;
        self.current = 0.0;
    }

    /// Brings the shaft to rest at once; what moved is turned to heat.
    fn halt(&mut self) {
        let p = &self.parameters;
        self.energy.friction += 0.5 * p.inertia * self.velocity * self.velocity;
        self.velocity = 0.0;
    }
}

/// Parts that a tick is cut into at most.
const SUB_STEPS_MAX: f64 = 8.0;

/// Means over a part of a step.
#[derive(Clone, Copy)]
struct Means {
    current: f64,
    speed: f64,
    voltage: f64,
}
