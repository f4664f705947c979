//! The drive on a CAN bus, and the bench around it.

use super::drive::Drive;
use super::faults::Fault;
use super::objects::PDOS;
use crate::drives;
use crate::drives::bench::{Act, Bench, Truth};
use crate::medium::{Can, CanLine, Frame};
use crate::proto::canopen::device::{CanEnd, Options};
use crate::station::{LineEvent, Station, Timed};
use crate::time::{Instant, earliest};

/// A simulated CiA 402 drive.
#[derive(Clone, Debug)]
pub struct Device {
    end: CanEnd<PDOS>,
    drive: Drive,
}

impl Device {
    /// That drive, just powered.
    #[must_use]
    pub fn new(mut drive: Drive) -> Self {
        Self { end: CanEnd::new(Options::STRICT, &mut drive), drive }
    }

    /// The drive behind the bus.
    #[must_use]
    pub const fn drive(&self) -> &Drive {
        &self.drive
    }
}

impl Timed for Device {
    fn handle_timeout(&mut self, now: Instant) {
        self.drive.advance(now);
        self.end.handle_timeout(now, &mut self.drive);
    }

    #[inline]
    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.end.poll_timeout(), self.drive.due())
    }
}

impl drives::Device for Device {
    fn can(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Station<Can> for Device {
    #[inline]
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.drive.advance(now);
        self.end.handle_input(now, unit, &mut self.drive);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.drive.advance(now);
        self.end.handle_line(now, event, &mut self.drive);
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        *out = self.end.poll_transmit(now, &mut self.drive)?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        self.end.line()
    }
}

impl Bench for Device {
    fn truth(&mut self, now: Instant) -> Truth {
        let drive = &mut self.drive;
        drive.advance(now);
        let (motor, (unrepeatable, starts)) = (drive.shaft().motor(), drive.counts());
        Truth {
            position: motor.position(),
            velocity: motor.velocity(),
            current: motor.current(),
            torque: motor.torque(),
            winding: drive.shaft().winding(),
            enabled: drive.shaft().powered(),
            fault: drive.fault().0.into(),
            flash_writes: drive.flash_writes(),
            unrepeatable,
            starts,
            bounds: drive.shaft().bounds(),
            setpoint: drive.shaft().regulated(),
        }
    }

    /// Inputs: 1 negative limit, 2 positive limit, 3 home. Switch 3 is where the home switch opens
    /// again, going forward.
    fn act(&mut self, now: Instant, act: Act) -> bool {
        let drive = &mut self.drive;
        drive.advance(now);
        match act {
            Act::Load(torque) => drive.shaft_mut().load = torque,
            Act::Jam(jammed) => drive.shaft_mut().jam(jammed),
            Act::Supply(volts) => drive.shaft_mut().supply = volts,
            Act::Ambient(celsius) => drive.shaft_mut().set_ambient(celsius),
            Act::Input(number @ 1..=3, on) => {
                drive.lines_mut().driven[usize::from(number) - 1] = on;
            }
            Act::Switch { which: which @ 0..=2, at } => {
                let line = [2, 1, 0][usize::from(which)];
                drive.lines_mut().at[line] = (!at.is_nan()).then_some(at);
            }
            Act::Switch { which: 3, at } => {
                drive.lines_mut().home_until = (!at.is_nan()).then_some(at);
            }
            Act::EncoderBroken(broken) => drive.shaft_mut().break_encoder(broken),
            Act::HallBroken(broken) => drive.shaft_mut().hall_broken = broken,
            Act::Fault(code) => match u16::try_from(code) {
                Ok(code) => drive.raise(Fault(code)),
                Err(_) => return false,
            },
            Act::PowerCycle => {
                drive.power_cycle();
                self.end.power_cycle(now, drive);
            }
            _ => return false,
        }
        true
    }

    fn notice(&mut self) -> Option<&'static str> {
        self.drive.take_notice()
    }
}
