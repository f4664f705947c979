//! The family, and the environment of a simulated module.

use super::module::{Module, flags};
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, Stream};
use polepair_core::profile::Profile;
use polepair_core::proto::tmcl::module::{ModuleDevice, TmclModule as _, WireOptions};
use polepair_core::station::Station;
use polepair_core::time::Instant;

/// The family. Its profiles are those of the maker's library, which the host has.
#[derive(Debug)]
pub enum BrushlessFamily {}

impl Family for BrushlessFamily {
    const NAME: &'static str = "trinamic-brushless";
    type Device = Device;

    fn profiles() -> &'static [&'static Profile] {
        &[]
    }

    fn create_device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Device, &'a str> {
        let mut module = Module::new(profile);
        let mut wires = WireOptions::new(options.untimed);
        WireOptions::set_address(&mut module, options.address);
        for (key, value) in options.extra {
            if !wires.read_option(&mut module, (key, value))? {
                return Err(key);
            }
        }
        Ok(Device::new(module, wires))
    }
}

/// A simulated module with its motors.
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
        self.motor_truth(now, 0).unwrap_or_default()
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        self.act_on_motor(now, 0, act)
    }

    fn motor_truth(&mut self, now: Instant, motor: u8) -> Option<GroundTruth> {
        self.module.advance(now);
        let (module, at) = (&self.module, usize::from(motor));
        let channel = module.channels[..module.motors].get(at)?;
        Some(GroundTruth {
            position: channel.motor.position(),
            velocity: channel.motor.velocity(),
            current: channel.motor.current(),
            torque: channel.motor.torque(),
            winding: channel.winding.temperature(),
            enabled: channel.servo.is_enabled(),
            fault: module.faults() & flags::TRIPS,
            flash_writes: module.state.memory.writes,
            unrepeatable: module.state.unrepeatable,
            starts: module.state.starts,
            bounds: channel.bounds(&module.settings(at)),
            setpoint: channel.servo.regulated_setpoint(),
        })
    }

    /// Inputs: 1 to 8 are the digital inputs 0 to 7 of the module.
    fn act_on_motor(&mut self, now: Instant, motor: u8, act: Act) -> bool {
        self.module.advance(now);
        let module = &mut self.module;
        let Some(channel) = module.channels[..module.motors].get_mut(usize::from(motor)) else {
            return false;
        };
        match act {
            Act::Load(torque) => channel.load = torque,
            Act::Jam(jammed) => channel.motor.set_jammed(jammed),
            Act::EncoderBroken(broken) => channel.break_encoder(broken),
            Act::HallBroken(broken) => module.hall_broken = broken,
            Act::Supply(volts) => module.set_supply(now, volts),
            Act::Ambient(celsius) => {
                module.stage.ambient = celsius;
                module.channels.iter_mut().for_each(|it| it.winding.ambient = celsius);
            }
            Act::Temperature(celsius) => {
                module.stage.set_temperature(celsius);
                module.channels.iter_mut().for_each(|it| it.winding.set_temperature(celsius));
            }
            Act::Input(n @ 1..=8, high) => module.inputs[usize::from(n) - 1] = high,
            Act::Analog(n @ 0..=3, volts) => module.analog[usize::from(n)] = volts,
            Act::Fault(code) if code & !flags::TRIPS == 0 => {
                module.raised |= code;
                module.trip("fault injected: motors off");
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
