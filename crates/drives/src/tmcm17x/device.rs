//! The simulated module with its serial and CAN ends, and its environment.

use super::flags;
use super::module::Module;
use super::profile;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, Stream};
use polepair_core::profile::Profile;
use polepair_core::proto::tmcl::module::{ModuleDevice, ModulePrograms, WireOptions};
use polepair_core::station::Station;
use polepair_core::time::Instant;

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
        let mut wires = WireOptions::new(options.untimed);
        WireOptions::set_address(&mut module, options.address);
        for (key, value) in options.extra {
            match (*key, *value) {
                ("power-on-hallerr", "0" | "1") => {
                    module.hallerr_at_power_on = *value == "1";
                    module.flags.set(flags::HALLERR, *value == "1");
                }
                ("power-on-hallerr", value) => return Err(value),
                (key, value) if !wires.read_option(&mut module, (key, value))? => return Err(key),
                _ => {}
            }
        }
        Ok(Device::new(module, wires))
    }
}

/// A simulated TMCM-170 or 171 with its motor.
pub type Device = ModuleDevice<Module>;

impl crate::SimulatedDevice for Device {
    fn serial_station(&mut self) -> Option<&mut dyn Station<Stream>> {
        Some(self)
    }

    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl SurroundingsControl for Device {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.module.advance(now);
        let module = &self.module;
        let channel = &module.channel;
        let motor = &channel.motor;
        GroundTruth {
            position: motor.position(),
            velocity: motor.velocity(),
            current: motor.current(),
            torque: motor.torque(),
            winding: channel.winding.temperature(),
            enabled: channel.servo.is_enabled(),
            fault: module.current_flags() & flags::TRIPS,
            flash_writes: module.state.memory.writes,
            unrepeatable: module.state.unrepeatable,
            starts: module.state.starts,
            bounds: channel.bounds(&module.settings()),
            setpoint: channel.servo.regulated_setpoint(),
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
            Act::Load(torque) => module.channel.load = torque,
            Act::Jam(jammed) => module.channel.motor.set_jammed(jammed),
            Act::Supply(volts) => module.set_supply(now, volts),
            Act::Ambient(celsius) => {
                (module.stage.ambient, module.channel.winding.ambient) = (celsius, celsius);
            }
            Act::Temperature(celsius) => {
                module.stage.set_temperature(celsius);
                module.channel.winding.set_temperature(celsius);
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
                module.channel.break_encoder(broken);
            }
            Act::HallBroken(broken) => around.hall_broken = broken,
            Act::Fault(code) if code != 0 && code & !flags::TRIPS == 0 => {
                module.flags.set(code, true);
                module.trip("fault injected: motor off");
            }
            Act::PowerCycle => module.power_up(now),
            _ => return false,
        }
        true
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.module.state.notice.take()
    }
}
