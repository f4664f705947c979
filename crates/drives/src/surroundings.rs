//! The environment of a simulated drive: external forces, loads, switches, and the real state.

pub use polepair_core::plant::{ServoBounds, Setpoint};
use polepair_core::time::Instant;

/// The real state of a simulated motor, whatever the drive reports.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct GroundTruth {
    /// Shaft position since power-on, rad, never wrapped.
    pub position: f64,
    /// Shaft speed, rad/s.
    pub velocity: f64,
    /// Motor current, A.
    pub current: f64,
    /// Air-gap torque, N·m.
    pub torque: f64,
    /// Winding temperature, °C.
    pub winding: f64,
    /// The power stage is on.
    pub enabled: bool,
    /// The drive's fault code or bits, zero for none.
    pub fault: u32,
    /// Writes to flash or EEPROM since it was made.
    pub flash_writes: u64,
    /// Requests executed that a repetition would have doubled (relative moves, path starts).
    pub unrepeatable: u64,
    /// Requests executed that powered the motor or gave it somewhere to go; stops are none.
    pub starts: u64,
    /// Present limits of the drive.
    pub bounds: ServoBounds,
    /// Set-point of the control loops, if they regulate speed or position.
    pub setpoint: Option<Setpoint>,
}

/// Something done to a simulated drive from outside the wire.
#[derive(Clone, Copy, PartialEq, Debug)]
#[non_exhaustive]
pub enum Act {
    /// Constant torque on the shaft, N·m; positive drives it forward.
    Load(f64),
    /// Holds the shaft still, or lets it go.
    Jam(bool),
    /// Supply voltage, V.
    Supply(f64),
    /// Air temperature, °C.
    Ambient(f64),
    /// Makes motor and power stage so warm at once, °C.
    Temperature(f64),
    /// The settings in permanent memory are damaged, or right again.
    EepromDamaged(bool),
    /// Safe torque off is requested, or no longer.
    Sto(bool),
    /// A digital input, counted from 1.
    Input(u8, bool),
    /// An analog input, counted from 0, V.
    Analog(u8, f64),
    /// Pulses on the pulse input; negative ones by the other level of the direction.
    Pulses(i32),
    /// A reference switch at a shaft position: closed from there on in positive direction.
    Switch {
        /// Switch: 0 home, 1 positive limit, 2 negative limit.
        which: u8,
        /// Position, rad; NaN removes it.
        at: f64,
    },
    /// The encoder stops counting, or counts again.
    EncoderBroken(bool),
    /// The hall sensors give an impossible pattern, or work again.
    HallBroken(bool),
    /// Raises a fault by its code.
    Fault(u32),
    /// Switches the supply off and on: RAM is lost, stored values are kept.
    PowerCycle,
    /// A key of the front panel goes down or up, counted from 0 as the manual lists them.
    Key(u8, bool),
}

/// The bench side of a simulated drive.
pub trait SurroundingsControl {
    /// The real state at `now`.
    fn ground_truth(&mut self, now: Instant) -> GroundTruth;
    /// Does something to it. Returns whether this drive has such a thing.
    fn act(&mut self, now: Instant, act: Act) -> bool;
    /// The real state of one motor; `None` if there is no motor of that number.
    fn motor_truth(&mut self, now: Instant, motor: u8) -> Option<GroundTruth> {
        (motor == 0).then(|| self.ground_truth(now))
    }
    /// Acts on one motor. Actions on the drive itself accept any motor number.
    fn act_on_motor(&mut self, now: Instant, motor: u8, act: Act) -> bool {
        motor == 0 && self.act(now, act)
    }
    /// Text on the front panel, if there is one.
    fn panel_text(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let _ = (now, out);
        None
    }
    /// Something unusual the drive did since the last call, for a scene log: a trip, a store.
    fn take_notice(&mut self) -> Option<&'static str> {
        None
    }
}
