//! The environment of the drive, independent of its bus.

use super::drive::Drive;
use super::faults::FaultCode;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_core::time::Instant;

impl SurroundingsControl for Drive {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.advance(now);
        let (motor, (unrepeatable, starts)) = (self.shaft().motor(), self.motion_counts());
        GroundTruth {
            position: motor.position(),
            velocity: motor.velocity(),
            current: motor.current(),
            torque: motor.torque(),
            winding: self.shaft().winding(),
            enabled: self.shaft().is_powered(),
            fault: self.fault().0.into(),
            flash_writes: self.flash_writes(),
            unrepeatable,
            starts,
            bounds: self.shaft().bounds(),
            setpoint: self.shaft().active_setpoint(),
        }
    }

    /// Inputs: 1 negative limit, 2 positive limit, 3 home, 4 and 5 touch probes.
    /// Switch 3 is where the home switch opens
    /// again, going forward.
    fn act(&mut self, now: Instant, act: Act) -> bool {
        self.advance(now);
        match act {
            Act::Load(torque) => self.shaft_mut().load = torque,
            Act::Jam(jammed) => self.shaft_mut().jam(jammed),
            Act::Supply(volts) => self.shaft_mut().supply = volts,
            Act::Ambient(celsius) => self.shaft_mut().set_ambient(celsius),
            Act::Temperature(celsius) => self.shaft_mut().set_temperature(celsius),
            Act::EepromDamaged(damaged) => {
                if damaged {
                    self.raise_fault(FaultCode::DATA_STORAGE);
                }
            }
            Act::Input(number @ 1..=3, on) => {
                self.lines_mut().force_line(usize::from(number) - 1, on);
            }
            Act::Input(number @ 4..=5, on) => self.set_probe_input(usize::from(number) - 4, on),
            Act::Switch { which: which @ 0..=2, at } => {
                let line = [2, 1, 0][usize::from(which)];
                self.lines_mut().set_switch(line, (!at.is_nan()).then_some(at));
            }
            Act::Switch { which: 3, at } => {
                self.lines_mut().open_home((!at.is_nan()).then_some(at));
            }
            Act::EncoderBroken(broken) => self.shaft_mut().break_encoder(broken),
            Act::HallBroken(broken) => self.shaft_mut().hall_broken = broken,
            Act::Fault(code) => match u16::try_from(code) {
                Ok(code) => self.raise_fault(FaultCode(code)),
                Err(_) => return false,
            },
            Act::PowerCycle => self.power_cycle(),
            _ => return false,
        }
        true
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.take_notice()
    }
}
