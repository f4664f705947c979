//! Requests of a host, and whether they may be repeated.

use super::address::Space;
use super::explain::TmclDissector;
use super::explain::parameter_of;
use super::opcode::{Opcode, SEARCH_STATUS};
use super::wire::Request;
use crate::explain::AddressNotation as _;
use crate::explain::Effect;
use crate::profile::{Parameter, ParameterAddress, Profile};
use crate::station::RequestClass;

/// A request with what may be done when no answer comes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HostRequest {
    /// The request.
    pub request: Request,
    /// True if it may be sent again.
    pub class: RequestClass,
    /// The CAN identifier that it is sent to; its low byte is the address, as replies have it. \[I\]
    pub can_id: u16,
    /// Permission to become part of a program.
    pub storing: Storing,
}

/// Permission to send a request to a module in download mode, which stores what it receives.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Storing {
    /// No: a reading or a write of its own accord does not belong to the program.
    Never,
    /// Yes, and it is executed at other times: what a user sends as it is.
    Allowed,
    /// Sent in download mode only: at other times the module would execute it.
    Required,
}

impl HostRequest {
    /// A request with the class that its opcode has by itself.
    #[must_use]
    pub const fn of(request: Request) -> Self {
        let class = match request.opcode {
            Opcode::Mst => RequestClass::Stop,
            Opcode::Ror | Opcode::Rol if request.value == 0 => RequestClass::Stop,
            // To order an event twice is to order it once.
            Opcode::PositionReached => RequestClass::Idempotent,
            Opcode::Rfs if request.kind == SEARCH_STATUS => RequestClass::Idempotent,
            Opcode::Sap | Opcode::Sgp | Opcode::Sio | Opcode::Sco => RequestClass::ReadBack,
            opcode if opcode.only_reads() => RequestClass::Idempotent,
            _ => RequestClass::NoRetry,
        };
        Self { request, class, can_id: request.address as u16, storing: Storing::Allowed }
    }

    /// Sends the request to another CAN identifier.
    #[must_use]
    pub const fn to_can_id(self, can_id: u16) -> Self {
        Self { can_id, ..self }
    }
}

impl crate::station::Request for HostRequest {
    /// Effect of the request. A parameter is a setting, a set-point or a switch of the motor, by its profile; for an
    /// unknown one the address decides.
    fn effect(&self, profile: &'static Profile) -> Effect {
        let Request { opcode, kind, motor, .. } = self.request;
        let space = match opcode {
            Opcode::Sap => Space::Axis,
            Opcode::Sgp => Space::Global(motor),
            _ => return Effect::from_class(self.class),
        };
        match parameter_of(&self.request, Some(profile)) {
            Some(parameter) => Effect::from_write(Some(parameter)),
            None => Effect::from_write(Some(&undescribed_address(kind, &space))),
        }
    }

    fn class(&self) -> RequestClass {
        self.class
    }
}

fn undescribed_address(kind: u8, space: &Space) -> Parameter {
    TmclDissector.describe_address(&ParameterAddress::new(kind.into(), space.number()))
}
