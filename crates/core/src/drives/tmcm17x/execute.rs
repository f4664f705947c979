//! What each request does.

use super::flags;
use super::memory::{check_readable, check_writable};
use super::module::Module;
use super::program::{ProgramState, is_direct, is_program_only};
use crate::proto::tmcl::device::{AsciiEcho, DeferredEvent, Firmware, Response};
use crate::proto::tmcl::{Opcode, Request, Status};
use crate::time::Instant;

/// Value of 137 and 255 without which nothing happens.
const CONFIRM_VALUE: i32 = 1234;
/// Value that unlocks the EEPROM.
const UNLOCK_VALUE: i32 = 4321;
/// So long a module is silent after its factory settings, ms (TMCL reference, 137).
const FACTORY_SILENCE_MS: u32 = 5000;
/// Firmware version that 136 tells: the manual's.
const VERSION: (i32, i32) = (1, 14);

impl Firmware for Module {
    fn address(&self) -> u8 {
        self.memory.global[66] as u8
    }

    fn secondary_address(&self) -> Option<u8> {
        Some(self.memory.global[87] as u8).filter(|address| *address != 0)
    }

    fn host_address(&self) -> u8 {
        self.memory.global[76] as u8
    }

    fn reply_pause_ms(&self) -> u8 {
        self.memory.global[75] as u8
    }

    fn baud(&self) -> u32 {
        const RATES: [u32; 8] = [9600, 14400, 19200, 28800, 38400, 57600, 76800, 115_200];
        RATES[(self.memory.global[65] & 7) as usize]
    }

    fn can_id(&self) -> u16 {
        self.memory.global[71] as u16
    }

    fn can_reply_id(&self) -> u16 {
        self.memory.global[70] as u16
    }

    fn can_bit_rate(&self) -> u32 {
        const RATES: [u32; 8] =
            [10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 1_000_000];
        RATES[(self.memory.global[69] - 1).clamp(0, 7) as usize]
    }

    fn ascii(&self) -> Option<AsciiEcho> {
        let echo = match self.memory.global[67] >> 4 & 3 {
            0 => AsciiEcho::Characters,
            1 => AsciiEcho::Line,
            _ => AsciiEcho::None,
        };
        self.ascii.then_some(echo)
    }

    fn set_ascii(&mut self, on: bool) {
        self.ascii = on;
    }

    fn execute(&mut self, now: Instant, request: &Request) -> Response {
        self.advance(now);
        if self.is_unresponsive(now) {
            return Response::Silent;
        }
        if let Some(response) = self.handle_download(request) {
            return response;
        }
        match request.opcode {
            Opcode::Version if request.kind == 0 => Response::Text(self.version_text()),
            Opcode::ReadMemory if self.has_programs() => self.read_memory(request),
            Opcode::SoftwareReset if request.value == CONFIRM_VALUE => {
                self.power_up(now);
                Response::Silent // [I] the reset comes before the reply
            }
            Opcode::Boot if is_boot(request) => {
                self.servo.disable();
                self.booting = true;
                Response::Silent
            }
            _ => match self.execute_request(now, request) {
                Ok(value) => {
                    self.starts += u64::from(starts_motion(request));
                    Response::ok(value)
                }
                Err(status) => Response::refused(status, request),
            },
        }
    }

    fn poll_deferred_event(&mut self, now: Instant) -> Option<DeferredEvent> {
        self.advance(now);
        if !self.event_armed || !self.flags.any(flags::POS_END) {
            return None;
        }
        self.event_armed = false;
        Some(DeferredEvent { opcode: Opcode::PositionReached, value: 1 })
    }
}

impl Module {
    /// Carries out a command and tells the reply's value.
    ///
    /// # Errors
    /// The status to answer.
    pub(super) fn execute_request(
        &mut self,
        now: Instant,
        request: &Request,
    ) -> Result<i32, Status> {
        match request.opcode {
            Opcode::Ror
            | Opcode::Rol
            | Opcode::Mst
            | Opcode::Mvp
            | Opcode::Sap
            | Opcode::Gap
            | Opcode::Stap
            | Opcode::Rsap => self.execute_axis(request),
            Opcode::Sgp | Opcode::Ggp | Opcode::Stgp | Opcode::Rsgp => {
                self.execute_global(now, request)
            }
            Opcode::Sio | Opcode::Gio => self.execute_ports(request),
            _ => self.execute_module(now, request),
        }
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
            Opcode::Stap => self.memory.store_axis(kind)?,
            _ => return self.restore_axis(kind),
        }
        Ok(value)
    }

    /// MVP: 0 ABS, 1 REL. COORD (2) is for several axes. \[I\] REL counts from where the motor is,
    /// and answers where it will be.
    fn execute_move(&mut self, kind: u8, value: i32) -> Result<i32, Status> {
        let target = match kind {
            0 => value,
            1 => self.counter().checked_add(value).ok_or(Status::InvalidValue)?,
            _ => return Err(Status::WrongType),
        };
        self.move_to(target)?;
        self.unrepeatable += u64::from(kind == 1);
        Ok(target)
    }

    fn execute_global(&mut self, now: Instant, request: &Request) -> Result<i32, Status> {
        let (kind, value) = (request.kind, request.value);
        match (request.motor, request.opcode) {
            (0, Opcode::Sgp) => self.set_global(now, kind, value),
            (0, Opcode::Ggp) => self.read_global(now, kind),
            (0, opcode) => {
                check_readable(self.memory.global_parameter(kind))?;
                if opcode == Opcode::Rsgp {
                    self.memory.global[usize::from(kind)] = self.memory.stored_global(kind);
                } else if self.memory.is_locked() {
                    return Err(Status::EepromLocked);
                }
                Ok(value) // what 64 to 128 hold is in the EEPROM already
            }
            (2, Opcode::Sgp) => {
                self.memory.variables[usize::from(kind)] = value;
                Ok(value)
            }
            (2, Opcode::Ggp) => Ok(self.memory.variables[usize::from(kind)]),
            (2, Opcode::Stgp) => self.memory.store_variable(kind).map(|()| value),
            (2, _) => {
                self.memory.restore_variable(kind);
                Ok(self.memory.variables[usize::from(kind)])
            }
            _ => Err(Status::InvalidValue), // no such bank
        }
    }

    fn set_global(&mut self, now: Instant, kind: u8, value: i32) -> Result<i32, Status> {
        check_writable(self.memory.global_parameter(kind), value)?;
        match (kind, value) {
            (73, CONFIRM_VALUE) => self.memory.lock(true),
            (73, UNLOCK_VALUE) => self.memory.lock(false),
            (73, _) => return Err(Status::InvalidValue),
            (132, _) => {
                let ms = u64::try_from(value).map_err(|_| Status::InvalidValue)?;
                self.timer_zero = Instant(now.0.saturating_sub(ms * 1_000_000));
            }
            (81, _) => {
                let before = self.memory.global[81];
                self.memory.store_global(kind, value)?;
                if before & 1 == 1 && value & 1 == 0 {
                    self.memory.program = super::program::ProgramMemory::EMPTY;
                }
            }
            _ => self.memory.store_global(kind, value)?,
        }
        Ok(value)
    }

    fn read_global(&self, now: Instant, kind: u8) -> Result<i32, Status> {
        check_readable(self.memory.global_parameter(kind))?;
        Ok(match kind {
            73 => self.memory.is_locked().into(),
            128 => self.program_state() as i32,
            129 => self.download.is_some().into(),
            130 => self.program.counter,
            132 => (now.since(self.timer_zero).as_millis() & 0x7FFF_FFFF) as i32,
            _ => self.memory.global[usize::from(kind)],
        })
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

    fn execute_module(&mut self, now: Instant, request: &Request) -> Result<i32, Status> {
        let value = request.value;
        match request.opcode {
            Opcode::Version if request.kind == 1 => {
                Ok(self.type_number() << 16 | VERSION.0 << 8 | VERSION.1)
            }
            Opcode::Version => Err(Status::WrongType),
            Opcode::FactoryDefault => self.restore_factory(now, value),
            Opcode::PositionReached => {
                self.event_armed = value & 1 != 0;
                Ok(value)
            }
            Opcode::EnterAscii => Ok(value),
            Opcode::SoftwareReset | Opcode::Boot => Err(Status::InvalidValue),
            opcode if self.has_programs() => match opcode {
                opcode if is_program_only(opcode) => Err(Status::NotAvailable),
                _ => self.execute_program(request),
            },
            _ => Err(Status::InvalidCommand),
        }
    }

    fn restore_factory(&mut self, now: Instant, value: i32) -> Result<i32, Status> {
        if value != CONFIRM_VALUE {
            return Err(Status::InvalidValue);
        }
        if self.memory.is_locked() {
            return Err(Status::EepromLocked);
        }
        self.memory.write_factory_settings();
        self.power_up(now);
        self.silent_until = now.plus_ms(FACTORY_SILENCE_MS);
        Ok(value)
    }

    fn execute_program(&mut self, request: &Request) -> Result<i32, Status> {
        let value = request.value;
        match (request.opcode, request.kind) {
            (Opcode::ProgramStop, _) => self.program.state = ProgramState::Stop,
            (Opcode::ProgramRun, 0) => self.program.run(None),
            (Opcode::ProgramRun, 1) => {
                self.memory.program.instruction_at(value).ok_or(Status::InvalidValue)?;
                self.program.run(Some(value));
            }
            (Opcode::ProgramRun, _) => return Err(Status::WrongType),
            (Opcode::ProgramStep, _) => self.program.state = ProgramState::Step,
            (Opcode::ProgramReset, _) => {
                self.program = super::program::Interpreter::NEW;
                self.program.state = ProgramState::Reset;
            }
            (Opcode::DownloadStart, _) => {
                self.memory.program.instruction_at(value).ok_or(Status::InvalidValue)?;
                if self.memory.global[81] & 2 != 0 || self.program.is_active() {
                    return Err(Status::DownloadNotPossible);
                }
                self.download = Some(value);
            }
            (Opcode::DownloadEnd, _) => {}
            (Opcode::ProgramStatus, _) => return Ok(self.program_state() as i32),
            _ => return Err(Status::InvalidCommand),
        }
        Ok(value)
    }

    /// Between 132 and 133 commands go into program memory.
    fn handle_download(&mut self, request: &Request) -> Option<Response> {
        let at = self.download?;
        if request.opcode == Opcode::DownloadEnd {
            self.download = None;
            return Some(Response::ok(request.value));
        }
        let known = is_direct(request.opcode) || is_program_only(request.opcode);
        if !known {
            return Some(Response::refused(Status::InvalidCommand, request));
        }
        Some(match self.memory.program.write(at, request) {
            Ok(()) => {
                self.download = Some(at + 1);
                self.memory.writes += 1;
                Response::Reply { status: Status::Loaded, value: request.value }
            }
            Err(status) => Response::refused(status, request),
        })
    }

    fn read_memory(&self, request: &Request) -> Response {
        if self.memory.global[81] & 1 != 0 {
            return Response::refused(Status::NotAvailable, request);
        }
        match self.memory.program.instruction_at(request.value) {
            Some(instruction) => Response::Instruction(instruction),
            None => Response::refused(Status::InvalidValue, request),
        }
    }

    fn type_number(&self) -> i32 {
        if self.has_programs() { 171 } else { 170 }
    }

    fn version_text(&self) -> [u8; 8] {
        if self.has_programs() { *b"171V1.14" } else { *b"170V1.14" }
    }
}

/// Whether a request, once executed, has powered the motor or given it somewhere to go.
const fn starts_motion(request: &Request) -> bool {
    match (request.opcode, request.kind) {
        (Opcode::Ror | Opcode::Rol, _) | (Opcode::Sap, 2 | 155 | 255) => request.value != 0,
        (Opcode::Mvp | Opcode::ProgramRun, _) | (Opcode::Sap, 0) => true,
        _ => false,
    }
}

/// 242 with its magic (TMCL reference): type 81h, motor 92h, value A3B4C5D6h.
fn is_boot(request: &Request) -> bool {
    let magic = u32::from_be_bytes([0xA3, 0xB4, 0xC5, 0xD6]);
    (request.kind, request.motor, request.value as u32) == (0x81, 0x92, magic)
}
