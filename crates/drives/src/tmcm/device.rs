//! The family: its products, and the environment of a simulated module.

use super::channel::Channel;
use super::module::{DRIVER_FAULTS, Module};
use super::profile;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, Stream};
use polepair_core::profile::Profile;
use polepair_core::proto::tmcl::module::{ModuleDevice, TmclModule as _, WireOptions};
use polepair_core::station::Station;
use polepair_core::time::Instant;

/// The family.
#[derive(Debug)]
pub enum Tmcm {}

impl Family for Tmcm {
    const NAME: &'static str = "tmcm";
    type Device = Device;

    fn profiles() -> &'static [&'static Profile] {
        static ALL: [&Profile; 2] = [&profile::TMCM_1140, &profile::TMCM_6110];
        &ALL
    }

    /// Beside the options of the wires: `ends`, where the stop switches of all motors are, in degrees
    /// (`ends=-3600..3600`), or `none`; `steps`, the full steps of a turn of the motors, or `steps.2` of one.
    fn create_device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Device, &'a str> {
        let mut module = Module::new(profile);
        let mut wires = WireOptions::new(options.untimed);
        WireOptions::set_address(&mut module, options.address);
        for (key, value) in options.extra {
            match (*key, *value) {
                ("ends", value) => set_ends(&mut module, value)?,
                ("steps", value) => module.set_full_steps(None, read_steps(value)?),
                (key, value) if key.starts_with("steps.") => {
                    let motor = key["steps.".len()..].parse().map_err(|_| key)?;
                    module.set_full_steps(Some(motor), read_steps(value)?);
                }
                (key, value) if !wires.read_option(&mut module, (key, value))? => return Err(key),
                _ => {}
            }
        }
        Ok(Device::new(module, wires))
    }
}

/// Full steps of a turn.
fn read_steps(value: &str) -> Result<u32, &str> {
    value.parse().ok().filter(|steps| (4..=10_000).contains(steps)).ok_or(value)
}

fn set_ends<'a>(module: &mut Module, value: &'a str) -> Result<(), &'a str> {
    let ends = match value {
        "none" => [None, None],
        _ => {
            let (left, right) = value.split_once("..").ok_or(value)?;
            let ends =
                parse_degrees(left).zip(parse_degrees(right)).filter(|(left, right)| left < right);
            let (left, right) = ends.ok_or(value)?;
            [Some(left.to_radians()), Some(right.to_radians())]
        }
    };
    for channel in &mut module.channels {
        channel.around.switches[..2].copy_from_slice(&ends);
    }
    Ok(())
}

fn parse_degrees(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|angle| angle.is_finite())
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
            current: channel.current(),
            torque: channel.motor.torque(),
            winding: channel.winding.temperature(),
            enabled: channel.is_powered(),
            fault: (module.driver_flags(at) & DRIVER_FAULTS).unsigned_abs(),
            flash_writes: module.state.memory.writes,
            unrepeatable: module.state.unrepeatable,
            starts: module.state.starts,
            bounds: channel.bounds(module.settings(at)),
            setpoint: Some(channel.setpoint()),
        })
    }

    /// Switches: 0 home, 1 right, 2 left. Inputs: 1 to 8 are the digital inputs 0 to 7 of the module.
    fn act_on_motor(&mut self, now: Instant, motor: u8, act: Act) -> bool {
        self.module.advance(now);
        let module = &mut self.module;
        let Some(channel) = module.channels[..module.motors].get_mut(usize::from(motor)) else {
            return false;
        };
        match act {
            Act::Load(torque) => channel.around.load = torque,
            Act::Jam(jammed) => channel.motor.set_jammed(jammed),
            Act::Switch { which: which @ 0..=2, at } => {
                let place = [2, 1, 0][usize::from(which)];
                channel.around.switches[place] = Some(at).filter(|at| !at.is_nan());
            }
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
            Act::Fault(code) if code & !DRIVER_FAULTS.unsigned_abs() == 0 => {
                module.raised_faults |= code as i32;
                module.state.notice = Some("fault injected: motors off");
            }
            Act::PowerCycle => module.power_up(now),
            _ => return false,
        }
        // A change may move a motor that was at standstill.
        module.channels.iter_mut().for_each(Channel::wake);
        true
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.module.state.notice.take()
    }
}
