//! Executes the requests of the motor and the ports.

use super::module::Module;
use crate::bldc::ControlMode;
use polepair_core::plant::TICK_NS;
use polepair_core::proto::tmcl::module::program::WaitCondition;
use polepair_core::proto::tmcl::module::{ModulePrograms, ModuleState, TmclModule};
use polepair_core::proto::tmcl::{Opcode, Request, Status};
use polepair_core::time::Instant;

/// Firmware version in the reply to 136, that of the manual.
const VERSION: (u8, u8) = (1, 14);

impl ModulePrograms for Module {
    /// Stand-alone programs exist from the TMCM-171's firmware 1.06 on (hardware manual).
    fn has_programs(&self) -> bool {
        self.state.profile.name.ends_with("171")
    }

    fn is_met(&self, what: WaitCondition) -> bool {
        match what {
            WaitCondition::Position(_) => self.channel.arrived,
            WaitCondition::Switch(_) => self.switch_active(),
            WaitCondition::Ticks | WaitCondition::ReferenceSearch(_) => false,
        }
    }

    fn arrived_motors(&self) -> i32 {
        self.channel.arrived.into()
    }
}

impl TmclModule for Module {
    fn state(&self) -> &ModuleState {
        &self.state
    }

    fn state_mut(&mut self) -> &mut ModuleState {
        &mut self.state
    }

    fn advance(&mut self, now: Instant) {
        self.advance(now);
    }

    fn power_up(&mut self, now: Instant) {
        self.power_up(now);
    }

    fn switch_off(&mut self) {
        self.channel.servo.disable();
    }

    fn execute_axis(&mut self, request: &Request) -> Result<i32, Status> {
        let (kind, value) = (request.kind, request.value);
        if request.motor != 0 {
            return Err(Status::InvalidValue); // [I] "always set to zero" (§2.1)
        }
        match request.opcode {
            Opcode::Ror => self.rotate(value)?,
            Opcode::Rol => self.rotate(value.checked_neg().ok_or(Status::InvalidValue)?)?,
            Opcode::Mst => self.halt(),
            Opcode::Mvp => return self.execute_move(kind, value),
            Opcode::Sap => self.set_axis(kind, value)?,
            Opcode::Gap => return self.read_axis(kind),
            Opcode::Stap => self.state.memory.store_axis(0, kind)?,
            Opcode::Rsap => return self.restore_axis(kind),
            _ => return Err(Status::InvalidCommand),
        }
        Ok(value)
    }

    /// Ports \[I\]: bank 0 digital 0 to 3 = AIN0 to AIN3 at half range, 4 = /STOP; bank 1 analog
    /// 0 to 3 in 1023rds of the range; bank 2 outputs 0 and 1.
    fn execute_ports(&mut self, request: &Request) -> Result<i32, Status> {
        let (port, value) = (request.kind, request.value);
        let analog = usize::from(port.min(3));
        let range = if port == 1 { 10.0 } else { 5.0 };
        match (request.opcode, request.motor, port) {
            (Opcode::Sio, 2, 0 | 1) => {
                if !(0..=1).contains(&value) {
                    return Err(Status::InvalidValue);
                }
                self.outputs = self.outputs & !(1 << port) | (value as u8) << port;
                Ok(value)
            }
            (Opcode::Gio, 0, 0..=3) => Ok((self.analog[analog] > range / 2.0).into()),
            (Opcode::Gio, 0, 4) => Ok(self.surroundings.stop_high.into()),
            (Opcode::Gio, 1, 0..=3) => {
                let share = (self.analog[analog] / range).clamp(0.0, 1.0);
                Ok(libm::round(share * 1023.0) as i32)
            }
            (Opcode::Gio, 2, 0 | 1) => Ok((self.outputs >> port & 1).into()),
            (Opcode::Gio, 0..=2, _) | (Opcode::Sio, 2, _) => Err(Status::WrongType),
            _ => Err(Status::InvalidValue),
        }
    }

    fn starts_motion(&self, request: &Request) -> bool {
        match (request.opcode, request.kind) {
            (Opcode::Ror | Opcode::Rol, _) | (Opcode::Sap, 2 | 155 | 255) => request.value != 0,
            (Opcode::Mvp, _) | (Opcode::Sap, 0) => true,
            _ => false,
        }
    }

    fn version(&self) -> (u16, u8, u8) {
        (if self.has_programs() { 171 } else { 170 }, VERSION.0, VERSION.1)
    }

    fn next_due(&self) -> Option<Instant> {
        let waits = self.state.armed_events & 1 != 0
            && self.channel.mode == ControlMode::Position
            && self.channel.servo.is_enabled();
        waits.then(|| self.ticked_to().plus_ns(TICK_NS))
    }
}

impl Module {
    /// MVP: 0 ABS, 1 REL. COORD (2) is for several axes. \[I\] REL counts from where the motor is,
    /// and answers where it will be.
    fn execute_move(&mut self, kind: u8, value: i32) -> Result<i32, Status> {
        let target = match kind {
            0 => value,
            1 => self.channel.counter().checked_add(value).ok_or(Status::InvalidValue)?,
            _ => return Err(Status::WrongType),
        };
        self.move_to(target)?;
        self.state.unrepeatable += u64::from(kind == 1);
        Ok(target)
    }
}
