//! Executes requests that do not concern a motor.

use super::super::device::{AsciiEcho, DeferredEvent, Firmware, Response};
use super::super::{Instruction, Opcode, Request, Status};
use super::memory::{check_readable, check_writable};
use super::program::{
    Interpreter, InterpreterStep, ProgramMemory, ProgramState, is_direct, is_direct_calculation,
    is_program_only,
};
use super::state::TmclModule;
use crate::time::Instant;

/// Value of 137 and 255 without which nothing happens.
const CONFIRM_VALUE: i32 = 1234;
/// Value that unlocks the EEPROM.
const UNLOCK_VALUE: i32 = 4321;
/// Silence of a module after its factory reset, ms (TMCL reference, 137).
const FACTORY_SILENCE_MS: u32 = 5000;

impl<M: TmclModule> Firmware for M {
    fn address(&self) -> u8 {
        self.state().memory.global[66] as u8
    }

    fn secondary_address(&self) -> Option<u8> {
        Some(self.state().memory.global[87] as u8).filter(|address| *address != 0)
    }

    fn host_address(&self) -> u8 {
        self.state().memory.global[76] as u8
    }

    fn reply_pause_ms(&self) -> u8 {
        self.state().memory.global[75] as u8
    }

    fn baud(&self) -> u32 {
        const RATES: [u32; 8] = [9600, 14400, 19200, 28800, 38400, 57600, 76800, 115_200];
        RATES[(self.state().memory.global[65] & 7) as usize]
    }

    fn can_id(&self) -> u16 {
        self.state().memory.global[71] as u16
    }

    fn can_reply_id(&self) -> u16 {
        self.state().memory.global[70] as u16
    }

    fn can_bit_rate(&self) -> u32 {
        const RATES: [u32; 8] =
            [10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 1_000_000];
        RATES[(self.state().memory.global[69] - 1).clamp(0, 7) as usize]
    }

    fn ascii(&self) -> Option<AsciiEcho> {
        let echo = match self.state().memory.global[67] >> 4 & 3 {
            0 => AsciiEcho::Characters,
            1 => AsciiEcho::Line,
            _ => AsciiEcho::None,
        };
        self.state().ascii.then_some(echo)
    }

    fn set_ascii(&mut self, on: bool) {
        self.state_mut().ascii = on;
    }

    fn execute(&mut self, now: Instant, request: &Request) -> Response {
        self.advance(now);
        if self.state().is_unresponsive(now) {
            return Response::Silent;
        }
        if let Some(response) = handle_download(self, request) {
            return response;
        }
        match request.opcode {
            Opcode::Version if request.kind == 0 => Response::Text(version_text(self)),
            Opcode::ReadMemory if self.has_programs() => read_memory(self, request),
            Opcode::SoftwareReset if request.value == CONFIRM_VALUE => {
                self.power_up(now);
                Response::Silent // [I] the reset comes before the reply
            }
            Opcode::Boot if is_boot(request) => {
                self.switch_off();
                self.state_mut().booting = true;
                Response::Silent
            }
            _ => match execute_request(self, now, request) {
                Ok(value) => {
                    let starts =
                        self.starts_motion(request) || request.opcode == Opcode::ProgramRun;
                    self.state_mut().starts += u64::from(starts);
                    Response::ok(value)
                }
                Err(status) => Response::refused(status, request),
            },
        }
    }

    fn poll_deferred_event(&mut self, now: Instant) -> Option<DeferredEvent> {
        self.advance(now);
        let value = self.state().armed_events & self.arrived_motors();
        if value == 0 {
            return None;
        }
        // Each request for an event is answered once (opcode 138).
        self.state_mut().armed_events &= !value;
        Some(DeferredEvent { opcode: Opcode::PositionReached, value })
    }
}

/// Executes a command and returns the reply's value.
///
/// # Errors
/// The status to answer.
pub(super) fn execute_request<M: TmclModule + ?Sized>(
    module: &mut M,
    now: Instant,
    request: &Request,
) -> Result<i32, Status> {
    match request.opcode {
        Opcode::Sgp | Opcode::Ggp | Opcode::Stgp | Opcode::Rsgp => {
            execute_global(module, now, request)
        }
        Opcode::Sio | Opcode::Gio => module.execute_ports(request),
        opcode if opcode.has_motor() => module.execute_axis(request),
        _ => execute_control(module, now, request),
    }
}

fn execute_global<M: TmclModule + ?Sized>(
    module: &mut M,
    now: Instant,
    request: &Request,
) -> Result<i32, Status> {
    let (kind, value) = (request.kind, request.value);
    let has_programs = module.has_programs();
    let memory = &mut module.state_mut().memory;
    match (request.motor, request.opcode) {
        (0, Opcode::Sgp) => set_global(module, now, kind, value),
        (0, Opcode::Ggp) => read_global(module, now, kind),
        (0, opcode) => {
            check_readable(memory.global_parameter(kind))?;
            if opcode == Opcode::Rsgp {
                memory.global[usize::from(kind)] = memory.stored_global(kind);
            } else if memory.is_locked() {
                return Err(Status::EepromLocked);
            }
            Ok(value) // what 64 to 128 hold is in the EEPROM already
        }
        (2, Opcode::Sgp) => {
            memory.variables[usize::from(kind)] = value;
            Ok(value)
        }
        (2, Opcode::Ggp) => Ok(memory.variables[usize::from(kind)]),
        (2, Opcode::Stgp) => memory.store_variable(kind).map(|()| value),
        (2, _) => {
            memory.restore_variable(kind);
            Ok(memory.variables[usize::from(kind)])
        }
        (3, Opcode::Sgp) if has_programs => {
            memory.interrupt_settings[usize::from(kind)] = value;
            Ok(value)
        }
        (3, Opcode::Ggp) if has_programs => Ok(memory.interrupt_settings[usize::from(kind)]),
        _ => Err(Status::InvalidValue), // no such bank
    }
}

fn set_global<M: TmclModule + ?Sized>(
    module: &mut M,
    now: Instant,
    kind: u8,
    value: i32,
) -> Result<i32, Status> {
    let state = module.state_mut();
    let memory = &mut state.memory;
    check_writable(memory.global_parameter(kind), value)?;
    match (kind, value) {
        (73, CONFIRM_VALUE) => memory.lock(true),
        (73, UNLOCK_VALUE) => memory.lock(false),
        (73, _) => return Err(Status::InvalidValue),
        (132, _) => {
            let ms = u64::try_from(value).map_err(|_| Status::InvalidValue)?;
            // The timer counts on from the written value.
            state.timer_zero = Instant(now.0.saturating_sub(ms * 1_000_000));
        }
        (81, _) => {
            let before = memory.global[81];
            memory.store_global(kind, value)?;
            if before & 1 == 1 && value & 1 == 0 {
                // Taking the protection away erases the program: it cannot be read out afterwards (global parameter
                // 81).
                memory.program = ProgramMemory::EMPTY;
            }
        }
        _ => memory.store_global(kind, value)?,
    }
    Ok(value)
}

fn read_global<M: TmclModule + ?Sized>(module: &M, now: Instant, kind: u8) -> Result<i32, Status> {
    let state = module.state();
    check_readable(state.memory.global_parameter(kind))?;
    Ok(match kind {
        73 => state.memory.is_locked().into(),
        128 => state.program.state as i32,
        129 => state.download.is_some().into(),
        130 => state.program.counter,
        132 => (now.since(state.timer_zero).as_millis() & 0x7FFF_FFFF) as i32,
        _ => state.memory.global[usize::from(kind)],
    })
}

fn execute_control<M: TmclModule + ?Sized>(
    module: &mut M,
    now: Instant,
    request: &Request,
) -> Result<i32, Status> {
    let value = request.value;
    match request.opcode {
        Opcode::Version if request.kind == 1 => {
            let (number, major, minor) = module.version();
            Ok(i32::from(number) << 16 | i32::from(major) << 8 | i32::from(minor))
        }
        Opcode::Version => Err(Status::WrongType),
        Opcode::FactoryDefault => restore_factory(module, now, value),
        Opcode::PositionReached => {
            module.state_mut().armed_events = value;
            Ok(value)
        }
        Opcode::EnterAscii => Ok(value),
        Opcode::SoftwareReset | Opcode::Boot => Err(Status::InvalidValue),
        opcode if module.has_programs() => match opcode {
            opcode if is_direct_calculation(opcode) => execute_calculation(module, now, request),
            opcode if is_program_only(opcode) => Err(Status::NotAvailable),
            _ => execute_program(module, request),
        },
        _ => Err(Status::InvalidCommand),
    }
}

/// An instruction of programs that a host sends by itself.
fn execute_calculation<M: TmclModule + ?Sized>(
    module: &mut M,
    now: Instant,
    request: &Request,
) -> Result<i32, Status> {
    let Request { kind, motor, value, .. } = *request;
    let instruction = Instruction { opcode: request.opcode.number(), kind, motor, value };
    // Taken out, because its command is executed by the module that holds it.
    let mut program = core::mem::replace(&mut module.state_mut().program, Interpreter::NEW);
    let step = program.execute_direct(&instruction, &mut module.state_mut().memory.variables);
    module.state_mut().program = program;
    let InterpreterStep::Command(command) = step else { return Ok(value) };
    let outcome = execute_request(module, now, &command);
    module.state_mut().program.accept_outcome(outcome, command.opcode.only_reads());
    outcome
}

fn restore_factory<M: TmclModule + ?Sized>(
    module: &mut M,
    now: Instant,
    value: i32,
) -> Result<i32, Status> {
    if value != CONFIRM_VALUE {
        return Err(Status::InvalidValue);
    }
    if module.state().memory.is_locked() {
        return Err(Status::EepromLocked);
    }
    module.state_mut().memory.write_factory_settings();
    module.power_up(now);
    // Writing the whole EEPROM takes the module seconds, in which it answers nothing.
    module.state_mut().silent_until = now.plus_ms(FACTORY_SILENCE_MS);
    Ok(value)
}

fn execute_program<M: TmclModule + ?Sized>(
    module: &mut M,
    request: &Request,
) -> Result<i32, Status> {
    let value = request.value;
    let state = module.state_mut();
    match (request.opcode, request.kind) {
        (Opcode::ProgramStop, _) => state.program.state = ProgramState::Stop,
        (Opcode::ProgramRun, 0) => state.program.run(None),
        (Opcode::ProgramRun, 1) if has_instruction(value, &state.memory.program) => {
            state.program.run(Some(value))
        }
        (Opcode::ProgramRun, 1) => return Err(Status::InvalidValue),
        (Opcode::ProgramRun, _) => return Err(Status::WrongType),
        (Opcode::ProgramStep, _) => state.program.state = ProgramState::Step,
        (Opcode::ProgramReset, _) => {
            // A reset forgets the stack and the registers as well as the address.
            state.program = Interpreter::NEW;
            state.program.state = ProgramState::Reset;
        }
        (Opcode::DownloadStart, _) if !has_instruction(value, &state.memory.program) => {
            return Err(Status::InvalidValue);
        }
        (Opcode::DownloadStart, _) => {
            if state.memory.global[81] & 2 != 0 || state.program.is_active() {
                return Err(Status::DownloadNotPossible);
            }
            state.download = Some(value);
        }
        (Opcode::DownloadEnd, _) => {}
        (Opcode::ProgramStatus, _) => return Ok(state.program.state as i32),
        _ => return Err(Status::InvalidCommand),
    }
    Ok(value)
}

fn has_instruction(value: i32, state_memory_program: &ProgramMemory) -> bool {
    state_memory_program.instruction_at(value).is_some()
}

/// Between 132 and 133 commands go into program memory.
fn handle_download(module: &mut impl TmclModule, request: &Request) -> Option<Response> {
    let state = module.state_mut();
    let at = state.download?;
    if request.opcode == Opcode::DownloadEnd {
        state.download = None;
        return Some(Response::ok(request.value));
    }
    let known = is_direct(request.opcode) || is_program_only(request.opcode);
    if !known {
        return Some(Response::refused(Status::InvalidCommand, request));
    }
    Some(match state.memory.program.write(at, request) {
        Ok(()) => {
            debug_assert!(at >= 0);
            state.download = Some(at + 1);
            state.memory.writes += 1;
            Response::Reply { status: Status::Loaded, value: request.value }
        }
        Err(status) => Response::refused(status, request),
    })
}

fn read_memory(module: &impl TmclModule, request: &Request) -> Response {
    let memory = &module.state().memory;
    if memory.global[81] & 1 != 0 {
        return Response::refused(Status::NotAvailable, request);
    }
    match memory.program.instruction_at(request.value) {
        Some(instruction) => Response::Instruction(instruction),
        None => Response::refused(Status::InvalidValue, request),
    }
}

/// Eight characters: `170V1.14`, and of a module of four digits `6110V148` (136 type 0).
fn version_text(module: &impl TmclModule) -> [u8; 8] {
    let (number, major, minor) = module.version();
    let minor = [decimal_digit(minor.into(), 10), decimal_digit(minor.into(), 1)];
    let major = decimal_digit(major.into(), 1);
    let [a, b, c, d] = [1000, 100, 10, 1].map(|place| decimal_digit(number, place));
    if number < 1000 {
        [b, c, d, b'V', major, b'.', minor[0], minor[1]]
    } else {
        [a, b, c, d, b'V', major, minor[0], minor[1]]
    }
}

fn decimal_digit(value: u16, place: u16) -> u8 {
    b'0' + (value / place % 10) as u8
}

/// 242 with its magic (TMCL reference): type 81h, motor 92h, value A3B4C5D6h.
fn is_boot(request: &Request) -> bool {
    let magic = u32::from_be_bytes([0xA3, 0xB4, 0xC5, 0xD6]);
    (request.kind, request.motor, request.value as u32) == (0x81, 0x92, magic)
}
