//! The simulated drive with its CAN end, and its environment.

use super::drive::Drive;
use super::options::Options;
use super::profile;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::profile::Profile;
use polepair_core::proto::thruster::device::CanEndpoint;
use polepair_core::proto::thruster::fault;
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;

/// The family.
#[derive(Debug)]
pub enum ThrusterFamily {}

impl Family for ThrusterFamily {
    const NAME: &'static str = "thruster";
    type Device = Device;

    fn profiles() -> &'static [&'static Profile] {
        static ALL: [&Profile; 3] =
            [&profile::THRUSTER, &profile::THRUSTER_SERVO, &profile::THRUSTER_ACTUATOR];
        &ALL
    }

    fn create_device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Device, &'a str> {
        Ok(Device::new(Options::from_device_options(profile, options)?))
    }
}

/// A simulated drive with its motor.
#[derive(Debug)]
pub struct Device {
    pub(super) drive: Drive,
    can: CanEndpoint,
}

impl Device {
    /// A drive after power-up.
    #[must_use]
    fn new(options: Options) -> Self {
        let drive = Drive::new(options);
        let can = CanEndpoint::new(options.quirks, &drive);
        Self { drive, can }
    }

    /// Thrust of its propeller, N; forward is positive.
    #[must_use]
    pub fn thrust(&mut self, now: Instant) -> f64 {
        self.drive.advance(now);
        self.drive.shaft.water.thrust(self.drive.shaft.motor.velocity())
    }
}

impl crate::SimulatedDevice for Device {
    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Timed for Device {
    fn handle_timeout(&mut self, now: Instant) {
        self.drive.advance(now);
        if !self.drive.is_unpowered() {
            self.can.handle_timeout(now, &self.drive);
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.can.poll_timeout().filter(|_| !self.drive.is_unpowered())
    }
}

impl Station<Can> for Device {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.drive.advance(now);
        if !self.drive.is_unpowered() {
            self.can.handle_input(now, unit, &mut self.drive);
        }
    }

    fn handle_line(&mut self, now: Instant, _event: LineEvent) {
        self.drive.advance(now);
    }

    fn poll_transmit(&mut self, _now: Instant, out: &mut Frame) -> Option<usize> {
        *out = self.can.poll_transmit()?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        self.can.line()
    }
}

impl SurroundingsControl for Device {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.drive.advance(now);
        let Drive { shaft, faults, writes, unrepeatable, starts, .. } = &self.drive;
        GroundTruth {
            position: shaft.motor.position(),
            velocity: shaft.motor.velocity(),
            current: shaft.motor.current(),
            torque: shaft.motor.torque(),
            winding: shaft.winding.temperature(),
            enabled: shaft.servo.is_enabled(),
            fault: u32::from(faults & (fault::OUTPUT_OFF | fault::ENCODER)),
            flash_writes: *writes,
            unrepeatable: *unrepeatable,
            starts: *starts,
            bounds: shaft.servo.bounds(),
            setpoint: shaft.servo.regulated_setpoint().filter(|_| shaft.signal.is_none()),
        }
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        self.drive.advance(now);
        let shaft = &mut self.drive.shaft;
        match act {
            Act::Load(torque) => shaft.load = torque,
            Act::Jam(jammed) => shaft.motor.set_jammed(jammed),
            Act::Ambient(celsius) => {
                (shaft.stage.ambient, shaft.winding.ambient) = (celsius, celsius);
            }
            Act::Temperature(celsius) => {
                shaft.stage.set_temperature(celsius);
                shaft.winding.set_temperature(celsius);
            }
            Act::EepromDamaged(damaged) => {
                let bits = if damaged { fault::EE_DATA } else { 0 };
                return self.drive.inject_faults(bits.into());
            }
            Act::Supply(volts) => {
                if self.drive.set_supply(now, volts) {
                    self.can.restart(now, &self.drive);
                }
            }
            Act::EncoderBroken(broken) if self.drive.options.encoder => {
                shaft.encoder_broken_at = broken.then_some(shaft.motor.position());
                if broken {
                    self.drive.handle_encoder_loss();
                }
            }
            Act::Switch { which: which @ 1..=2, at } if self.drive.options.encoder => {
                let (low, high) = shaft.motor.ends().unwrap_or((f64::MIN, f64::MAX));
                let ends = if which == 1 {
                    (low, turned_or(f64::MAX, at))
                } else {
                    (turned_or(f64::MIN, at), high)
                };
                shaft.motor.set_ends(Some(ends));
            }
            Act::Fault(bits) => return self.drive.inject_faults(bits),
            Act::PowerCycle => {
                self.drive.power_up(now);
                self.can.restart(now, &self.drive);
            }
            _ => return false,
        }
        true
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.drive.notice.take()
    }
}

fn turned_or(none: f64, at: f64) -> f64 {
    if at.is_nan() { none } else { at }
}
