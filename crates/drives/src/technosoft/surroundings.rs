//! External forces, loads and switches of a simulated drive.

use super::drive::Drive;
use super::inputs::line;
use super::status::{mer, set_bits};
use super::units;
use crate::surroundings::Act;
use polepair_core::time::Instant;

/// Below this supply the logic dies, V. \[I\]
const LOGIC_V: f64 = 7.0;

impl Drive {
    /// Returns whether the logic has no supply.
    pub fn is_unpowered(&self) -> bool {
        self.shaft.supply < LOGIC_V
    }

    /// Bits of MER that keep the motor off.
    pub fn faults(&self) -> u32 {
        u32::from(self.status.mer & mer::FAULTS)
    }

    /// Does something to the drive. False if it has no such thing.
    pub fn act(&mut self, now: Instant, act: Act) -> bool {
        match act {
            Act::Load(torque) => self.shaft.load = torque,
            Act::Jam(jammed) => self.shaft.motor.set_jammed(jammed),
            Act::Supply(volts) => self.set_supply(now, volts),
            Act::Ambient(celsius) => {
                (self.shaft.stage.ambient, self.shaft.winding.ambient) = (celsius, celsius);
            }
            Act::Temperature(celsius) => {
                self.shaft.stage.set_temperature(celsius);
                self.shaft.winding.set_temperature(celsius);
            }
            // The drive looks at its set-up table when it starts.
            Act::EepromDamaged(damaged) => {
                if self.memory.is_table_valid() == damaged {
                    self.memory.corrupt_table();
                }
            }
            Act::Sto(requested) => {
                set_bits(&mut self.surroundings.levels, line::STO, !requested);
            }
            Act::Input(n @ 1..=6, high) => {
                const LINES: [u16; 6] =
                    [line::HOME, 1 << 1, line::LSP, line::LSN, line::ENABLE, line::STO];
                set_bits(&mut self.surroundings.levels, LINES[usize::from(n) - 1], high);
            }
            Act::Analog(5, volts) => self.surroundings.reference_v = volts.clamp(-10.0, 10.0),
            Act::Switch { which: which @ 0..=2, at } => {
                self.surroundings.switches[usize::from(which)] = at;
            }
            Act::Pulses(count) => return self.count_master_pulses(count),
            Act::HallBroken(broken) => self.surroundings.hall_broken = broken,
            Act::Fault(bits) => {
                let known = mer::FAULTS & bits as u16;
                if known == 0 || u32::from(known) != bits {
                    return false;
                }
                self.trip(known, "fault injected: motor off");
            }
            Act::EncoderBroken(broken) => self.shaft.set_encoder_broken(broken),
            Act::PowerCycle => self.power_up(now),
            _ => return false,
        }
        self.protections.limits_stale = true; // a tick must look at it
        self.mark_stale();
        true
    }

    /// The supply's new value; the logic dies below a few volts and starts anew above.
    fn set_supply(&mut self, now: Instant, volts: f64) {
        let was_dead = self.is_unpowered();
        self.shaft.supply = volts.clamp(0.0, units::MEASURED_V);
        if self.is_unpowered() {
            self.axis_off();
        } else if was_dead {
            self.power_up(now);
        }
    }
}
