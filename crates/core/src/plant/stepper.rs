//! A two-phase stepper motor: the driver turns its field, and the rotor follows within its torque. With too
//! much load it falls behind by whole periods of the field: lost steps.

use super::TICK_S;

/// Parameters of a stepper motor and its load, SI.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StepperParameters {
    /// Full steps of a turn.
    pub full_steps: u32,
    /// Holding torque at the rated current, N·m.
    pub torque: f64,
    /// Current for that torque, A RMS.
    pub rated_current: f64,
    /// Inertia of rotor and load, kg·m².
    pub inertia: f64,
    /// Friction that opposes any motion, N·m.
    pub friction: f64,
    /// Damping of the rotor's oscillation about its field, N·m·s/rad.
    pub damping: f64,
    /// Speed at which the torque has fallen to 0.7 of its value with a supply of 24 V, rad/s.
    pub corner: f64,
}

impl StepperParameters {
    /// A motor of 42 mm for 1.1 A: 0.35 N·m, 200 full steps a turn.
    pub const NEMA_17: Self = Self {
        full_steps: 200,
        torque: 0.35,
        rated_current: 1.1,
        inertia: 2.5e-5,
        friction: 0.008,
        damping: 8e-3,
        corner: 60.0,
    };
}

/// Inputs of the motor during a tick.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StepperInputs {
    /// Position of the field at the end of the tick, rad of the shaft.
    pub field: f64,
    /// Current, A RMS; 0 leaves the shaft free.
    pub current: f64,
    /// Supply, V.
    pub bus: f64,
    /// Torque from outside, N·m; positive drives the shaft forward.
    pub load: f64,
}

/// Parts of a tick that are computed one by one: the rotor swings at some 100 Hz.
const PARTS: u32 = 8;
/// Below this speed friction holds the rotor, rad/s.
const SLOW: f64 = 0.02;

/// The motor. At rest at 0, its field there.
#[derive(Clone, Debug)]
pub struct Stepper {
    parameters: StepperParameters,
    position: f64,
    velocity: f64,
    field: f64,
    torque: f64,
    torque_max: f64,
    jammed: bool,
}

impl Stepper {
    /// A motor at rest.
    #[must_use]
    pub const fn new(parameters: StepperParameters) -> Self {
        Self {
            parameters,
            position: 0.0,
            velocity: 0.0,
            field: 0.0,
            torque: 0.0,
            torque_max: 0.0,
            jammed: false,
        }
    }

    /// Parameters of the motor.
    #[must_use]
    pub const fn parameters(&self) -> &StepperParameters {
        &self.parameters
    }

    /// Position of the shaft, rad.
    #[must_use]
    pub const fn position(&self) -> f64 {
        self.position
    }

    /// Speed of the shaft, rad/s.
    #[must_use]
    pub const fn velocity(&self) -> f64 {
        self.velocity
    }

    /// Torque of the field on the rotor, N·m.
    #[must_use]
    pub const fn torque(&self) -> f64 {
        self.torque
    }

    /// Holds the shaft still, or lets it go.
    pub const fn set_jammed(&mut self, jammed: bool) {
        self.jammed = jammed;
    }

    /// Share of the torque in use: 1 is the maximum.
    #[must_use]
    pub fn load_share(&self) -> f64 {
        if self.torque_max > 0.0 { (self.torque / self.torque_max).abs() } else { 0.0 }
    }

    /// Lag of the rotor behind its field, rad: after lost steps more than half a period.
    #[must_use]
    pub fn lag(&self) -> f64 {
        self.field - self.position
    }

    /// Returns whether the rotor is at rest while the field and the load stay the same.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.velocity == 0.0
    }

    /// Advances by one tick.
    pub fn step(&mut self, inputs: StepperInputs) {
        let p = self.parameters;
        // The field moves evenly within a tick: a leap would throw the rotor into the next step.
        let field_step = (inputs.field - self.field) / f64::from(PARTS);
        let field_speed = (inputs.field - self.field) / TICK_S;
        let dt = TICK_S / f64::from(PARTS);
        // Four full steps are one electrical period.
        let periods = f64::from(p.full_steps) / 4.0;
        // The torque falls where back-EMF uses up the supply, so the corner moves with it.
        let corner = p.corner * inputs.bus.max(0.0) / 24.0;
        let share = inputs.current / p.rated_current;
        for _ in 0..PARTS {
            self.field += field_step;
            let fast = self.velocity / corner.max(1e-6);
            self.torque_max = p.torque * share / libm::sqrt(1.0 + fast * fast);
            self.torque = self.torque_max * libm::sin(periods * (self.field - self.position));
            // A winding without current damps nothing.
            let damping = p.damping * share.min(1.0) * (field_speed - self.velocity);
            let driving = self.torque + damping + inputs.load;
            if self.jammed || self.velocity.abs() < SLOW && driving.abs() <= p.friction {
                self.velocity = 0.0;
                continue;
            }
            // At rest friction opposes what drives the rotor, in motion its speed.
            let direction = if self.velocity == 0.0 { driving } else { self.velocity };
            let net = driving - libm::copysign(p.friction, direction);
            let before = self.velocity;
            self.velocity += net / p.inertia * dt;
            // Friction stops the rotor and does not turn it back.
            if before * self.velocity < 0.0 && driving.abs() <= p.friction {
                self.velocity = 0.0;
            }
            self.position += self.velocity * dt;
        }
        // Exactly: the sum of the parts is off by rounding, which would add up over hours.
        self.field = inputs.field;
    }
}
