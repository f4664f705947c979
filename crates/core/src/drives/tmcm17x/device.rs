//! The simulated drive: a module behind its serial and its CAN end, and the bench around it.

use super::flags;
use super::module::Module;
use super::profile;
use crate::drives::bench::{Act, BenchControl, GroundTruth};
use crate::drives::{self, DeviceOptions, Family};
use crate::medium::{Can, CanLine, Frame, SerialLine, Stream};
use crate::profile::Profile;
use crate::proto::tmcl::device::{CanEndpoint, ChecksumErrorReply, Quirks, SerialEndpoint};
use crate::station::{LineEvent, Station, Timed};
use crate::time::{Instant, earliest};

/// The family.
#[derive(Debug)]
pub enum Tmcm17x {}

impl Family for Tmcm17x {
    const NAME: &'static str = "tmcm17x";
    type Device = Device;

    fn profiles() -> &'static [&'static Profile] {
        static ALL: [&Profile; 2] = [&profile::TMCM_171, &profile::TMCM_170];
        &ALL
    }

    fn create_device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Device, &'a str> {
        let mut module = Module::new(profile);
        let mut quirks = Quirks::default();
        if options.untimed {
            quirks.byte_timeout_ms = Some(UNTIMED_BYTE_TIMEOUT_MS);
        }
        if let Some(address) = options.address {
            module.memory.preset_global(66, i32::from(address as u8));
            module.memory.preset_global(71, i32::from(address as u16 & 0x7FF));
        }
        for (key, value) in options.extra {
            match (*key, *value) {
                ("dlc", "7") => quirks.eight_bytes = false,
                ("dlc", "8") => quirks.eight_bytes = true,
                ("bad-sum", "mine") => {
                    quirks.checksum_error_reply = ChecksumErrorReply::IfAddressed
                }
                ("bad-sum", "always") => quirks.checksum_error_reply = ChecksumErrorReply::Always,
                ("bad-sum", "ignore") => quirks.checksum_error_reply = ChecksumErrorReply::Never,
                ("settings", "before-reply") => quirks.settings_before_reply = true,
                ("settings", "after-reply") => quirks.settings_before_reply = false,
                ("host", host) => {
                    let host = host.parse::<u16>().ok().filter(|id| *id <= 0x7FF).ok_or(host)?;
                    if host <= 0xFF {
                        module.memory.preset_global(76, i32::from(host));
                    }
                    module.memory.preset_global(70, i32::from(host));
                }
                ("deaf-ms", ms) => quirks.ignore_after_foreign_ms = ms.parse().map_err(|_| ms)?,
                ("power-on-hallerr", "0" | "1") => {
                    module.hallerr_at_power_on = *value == "1";
                    module.flags.set(flags::HALLERR, *value == "1");
                }
                ("dlc" | "bad-sum" | "settings" | "power-on-hallerr", value) => return Err(value),
                (key, _) => return Err(key),
            }
        }
        Ok(Device::new(module, quirks))
    }
}

/// Where bytes may come in pieces at any time (pty, TCP), a datagram may take this long, ms.
const UNTIMED_BYTE_TIMEOUT_MS: u32 = 200;

/// A simulated TMCM-170 or 171 with its motor.
#[derive(Debug)]
pub struct Device {
    pub(super) module: Module,
    serial: SerialEndpoint,
    can: CanEndpoint,
}

impl Device {
    /// That module, just powered.
    #[must_use]
    fn new(module: Module, quirks: Quirks) -> Self {
        let (serial, can) =
            (SerialEndpoint::new(quirks, &module), CanEndpoint::new(quirks, &module));
        Self { module, serial, can }
    }
}

impl drives::SimulatedDevice for Device {
    fn serial_station(&mut self) -> Option<&mut dyn Station<Stream>> {
        Some(self)
    }

    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Timed for Device {
    fn handle_timeout(&mut self, now: Instant) {
        self.module.advance(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.serial.poll_timeout(), self.module.next_tick())
    }
}

impl Station<Stream> for Device {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.module.advance(now);
        if self.module.is_unresponsive(now) {
            return self.serial.handle_break();
        }
        self.module.last_requests.serial = Some(now);
        self.serial.handle_input(now, unit, &mut self.module);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.module.advance(now);
        if matches!(event, LineEvent::Break | LineEvent::Down) {
            self.serial.handle_break();
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.serial.poll_transmit(now, out, &mut self.module)
    }

    fn line(&self) -> SerialLine {
        self.serial.line()
    }
}

impl Station<Can> for Device {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.module.advance(now);
        if self.module.is_unresponsive(now) {
            return;
        }
        self.module.last_requests.can = Some(now);
        self.can.handle_input(now, unit, &mut self.module);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        let _ = event;
        self.module.advance(now);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        *out = self.can.poll_transmit(now, &mut self.module)?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        self.can.line()
    }
}

impl BenchControl for Device {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.module.advance(now);
        let (module, motor) = (&self.module, &self.module.motor);
        GroundTruth {
            position: motor.position(),
            velocity: motor.velocity(),
            current: motor.current(),
            torque: motor.torque(),
            winding: module.winding.temperature(),
            enabled: module.servo.is_enabled(),
            fault: module.current_flags() & flags::TRIPS,
            flash_writes: module.memory.writes,
            unrepeatable: module.unrepeatable,
            starts: module.starts,
            bounds: module.bounds(),
            setpoint: module.servo.regulated_setpoint(),
        }
    }

    /// Inputs: 1 to 4 = AIN0 to AIN3 as levels, 5 = /STOP, 6 = step, 7 = direction (high:
    /// backward).
    fn act(&mut self, now: Instant, act: Act) -> bool {
        self.module.advance(now);
        let module = &mut self.module;
        let is_171 = module.has_programs();
        let around = &mut module.surroundings;
        match act {
            Act::Load(torque) => around.load = torque,
            Act::Jam(jammed) => module.motor.set_jammed(jammed),
            Act::Supply(volts) => module.set_supply(now, volts),
            Act::Ambient(celsius) => {
                (module.stage.ambient, module.winding.ambient) = (celsius, celsius);
            }
            Act::Temperature(celsius) => {
                module.stage.set_temperature(celsius);
                module.winding.set_temperature(celsius);
            }
            Act::Input(n @ 1..=4, high) => {
                let full = if n == 2 { 10.0 } else { 5.0 };
                module.analog[usize::from(n) - 1] = if high { full } else { 0.0 };
            }
            Act::Input(5, high) => around.stop_high = high,
            Act::Input(6, high) if is_171 => module.step_input(high),
            Act::Input(7, high) if is_171 => around.backward = high,
            Act::Analog(n @ 0..=3, volts) => module.analog[usize::from(n)] = volts,
            Act::Switch { which: 0, at } => around.switch_at = Some(at).filter(|at| !at.is_nan()),
            Act::EncoderBroken(broken) => {
                around.encoder_broke_at = module.motor.position();
                module.encoder.set_broken(module.motor.position(), broken);
            }
            Act::HallBroken(broken) => around.hall_broken = broken,
            Act::Fault(code) => {
                module.flags.set(code & flags::TRIPS, true);
                if code & flags::TRIPS != 0 {
                    module.trip("fault injected: motor off");
                }
            }
            Act::PowerCycle => module.power_up(now),
            _ => return false,
        }
        true
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.module.notice.take()
    }
}
