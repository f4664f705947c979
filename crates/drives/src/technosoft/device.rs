//! The simulated drive with its serial and CAN ends, and its environment.

use super::drive::Drive;
use super::options::Options;
use super::profile;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, CanLine, Frame, SerialLine, Stream};
use polepair_core::profile::Profile;
use polepair_core::proto::tml::relay::Relay;
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};

/// The family.
#[derive(Debug)]
pub enum Technosoft {}

impl Family for Technosoft {
    const NAME: &'static str = "technosoft";
    type Device = Device;

    fn profiles() -> &'static [&'static Profile] {
        static PRODUCTS: [&Profile; profile::PROFILES.len()] =
            [&profile::TECHNOSOFT_F514L, &profile::TECHNOSOFT_FA00G, &profile::TECHNOSOFT_F2XX];
        &PRODUCTS
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
    pub(super) wires: Relay,
}

impl Device {
    /// A drive after power-up.
    #[must_use]
    fn new(options: Options) -> Self {
        let drive = Drive::new(options);
        let wires = Relay::new(options.quirks, &drive);
        Self { drive, wires }
    }
}

impl crate::SimulatedDevice for Device {
    fn serial_station(&mut self) -> Option<&mut dyn Station<Stream>> {
        Some(self)
    }

    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Timed for Device {
    fn handle_timeout(&mut self, now: Instant) {
        self.drive.advance(now);
        self.wires.forward_messages(now, &mut self.drive);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.wires.poll_timeout(), self.drive.next_report_due())
    }
}

impl Station<Stream> for Device {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        if self.drive.is_unpowered() {
            return;
        }
        self.wires.handle_bytes(now, unit, &mut self.drive);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.drive.advance(now);
        self.wires.handle_serial_line(event, &mut self.drive);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.wires.poll_bytes(now, out, &mut self.drive)
    }

    fn line(&self) -> SerialLine {
        self.wires.serial_line()
    }
}

impl Station<Can> for Device {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        if self.drive.is_unpowered() {
            return;
        }
        self.wires.handle_frame(now, unit, &mut self.drive);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.drive.advance(now);
        self.wires.handle_can_line(event, &mut self.drive);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        *out = self.wires.poll_frame(now, &mut self.drive)?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        self.wires.can_line()
    }
}

impl SurroundingsControl for Device {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.drive.advance(now);
        let (drive, motor) = (&self.drive, &self.drive.shaft.motor);
        GroundTruth {
            position: motor.position(),
            velocity: motor.velocity(),
            current: motor.current(),
            torque: motor.torque(),
            winding: drive.shaft.winding.temperature(),
            enabled: drive.shaft.servo.is_enabled(),
            fault: drive.faults(),
            flash_writes: drive.memory.writes,
            unrepeatable: drive.unrepeatable,
            starts: drive.starts,
            bounds: drive.shaft.servo.bounds(),
            setpoint: drive.shaft.servo.regulated_setpoint(),
        }
    }

    /// Inputs: 1 = IN0 (home), 2 = IN1, 3 = LSP, 4 = LSN, 5 = ENABLE, 6 = STO (both on when high).
    /// Analog 5 is the reference input AD5, -10 to 10 V. Faults are bits of MER.
    fn act(&mut self, now: Instant, act: Act) -> bool {
        self.drive.advance(now);
        self.drive.act(now, act)
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.drive.notice.take()
    }
}
