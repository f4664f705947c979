//! Stand-alone TMCL programs: memory and interpreter.
//!
//! The instruction set is the TMCL reference's; interrupts (EI, DI, VECT, RETI) and coordinates are
//! not part of it here. \[I\] One instruction takes a tick of 1 ms.

use crate::proto::tmcl::{Instruction, Opcode, Request, Status};

/// Instructions that fit into program memory. \[I\]
pub const PROGRAM_MAX: usize = 512;

/// Subroutine calls within each other at most (TMCL reference, CSUB).
pub const CALLS_MAX: usize = 8;

/// Program memory.
#[derive(Clone, Debug)]
pub struct ProgramMemory {
    memory: [Instruction; PROGRAM_MAX],
}

const STOP: Instruction = Instruction { opcode: 28, kind: 0, motor: 0, value: 0 };

impl ProgramMemory {
    /// Nothing but STOP.
    pub const EMPTY: Self = Self { memory: [STOP; PROGRAM_MAX] };

    /// The instruction at an address.
    #[must_use]
    pub fn instruction_at(&self, address: i32) -> Option<Instruction> {
        self.memory.get(usize::try_from(address).ok()?).copied()
    }

    /// Writes an instruction.
    ///
    /// # Errors
    /// [`Status::DownloadNotPossible`] beyond the memory.
    pub fn write(&mut self, address: i32, request: &Request) -> Result<(), Status> {
        let slot = usize::try_from(address).ok().and_then(|at| self.memory.get_mut(at));
        *slot.ok_or(Status::DownloadNotPossible)? = Instruction {
            opcode: request.opcode.number(),
            kind: request.kind,
            motor: request.motor,
            value: request.value,
        };
        Ok(())
    }
}

/// What a program is doing (global parameter 128).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub enum ProgramState {
    /// Stopped.
    Stop = 0,
    /// Running.
    Run = 1,
    /// Runs one instruction, then stops.
    Step = 2,
    /// Reset to its first instruction.
    Reset = 3,
}

/// What a WAIT waits for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WaitCondition {
    /// Only time.
    Ticks,
    /// The position of a motor.
    Position(u8),
    /// The stop switch of a motor.
    Switch(u8),
    /// The end of the reference search of a motor.
    ReferenceSearch(u8),
}

/// What an instruction wants of the module.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum InterpreterStep {
    /// Nothing.
    Nothing,
    /// To carry out a command; a read's value goes to the accumulator.
    Command(Request),
}

/// The interpreter's registers.
#[derive(Clone, Debug)]
pub struct Interpreter {
    /// What it is doing.
    pub state: ProgramState,
    /// Next instruction.
    pub counter: i32,
    accumulator: i32,
    x_register: i32,
    compared: i32,
    timed_out: bool,
    failed: bool,
    calls: [i32; CALLS_MAX],
    depth: usize,
    wait: Option<(WaitCondition, Option<u32>)>,
}

impl Interpreter {
    /// Stopped at the first instruction.
    pub const NEW: Self = Self {
        state: ProgramState::Stop,
        counter: 0,
        accumulator: 0,
        x_register: 0,
        compared: 0,
        timed_out: false,
        failed: false,
        calls: [0; CALLS_MAX],
        depth: 0,
        wait: None,
    };

    /// Runs from `address`, or from where it is.
    pub fn run(&mut self, address: Option<i32>) {
        if let Some(address) = address {
            *self = Self { counter: address, ..Self::NEW };
        }
        self.state = ProgramState::Run;
    }

    /// Whether it has anything to do.
    #[must_use]
    pub const fn is_active(&self) -> bool {
        matches!(self.state, ProgramState::Run | ProgramState::Step)
    }

    /// Takes the outcome of a command that it wanted.
    pub fn accept_outcome(&mut self, outcome: Result<i32, Status>, reads: bool) {
        match outcome {
            Ok(value) if reads => self.accumulator = value,
            Ok(_) => {}
            Err(_) => self.failed = true,
        }
    }

    /// One tick of 1 ms. `met` tells whether what is waited for is there.
    pub fn tick(
        &mut self,
        program: &ProgramMemory,
        met: impl Fn(WaitCondition) -> bool,
    ) -> InterpreterStep {
        if !self.is_active() || !self.is_wait_over(met) {
            return InterpreterStep::Nothing;
        }
        if self.state == ProgramState::Step {
            self.state = ProgramState::Stop;
        }
        let Some(instruction) = program.instruction_at(self.counter) else {
            self.state = ProgramState::Stop;
            return InterpreterStep::Nothing;
        };
        self.counter += 1;
        self.execute_instruction(&instruction)
    }

    fn is_wait_over(&mut self, met: impl Fn(WaitCondition) -> bool) -> bool {
        let Some((what, left)) = self.wait else { return true };
        if what != WaitCondition::Ticks && met(what) {
            self.wait = None;
        } else if left == Some(0) {
            self.timed_out = what != WaitCondition::Ticks;
            self.wait = None;
        } else {
            self.wait = Some((what, left.map(|ms| ms - 1)));
            return false;
        }
        true
    }

    fn execute_instruction(&mut self, i: &Instruction) -> InterpreterStep {
        let value = i.value;
        match Opcode::from(i.opcode) {
            Opcode::Calc => self.accumulator = self.calculate(i.kind, self.accumulator, value),
            Opcode::Calcx if i.kind == 10 => {
                core::mem::swap(&mut self.accumulator, &mut self.x_register);
            }
            Opcode::Calcx if i.kind == 9 => self.x_register = self.accumulator,
            Opcode::Calcx => {
                self.accumulator = self.calculate(i.kind, self.accumulator, self.x_register)
            }
            Opcode::Comp => self.compared = value,
            Opcode::Jc if self.condition_holds(i.kind) => self.counter = value,
            Opcode::Jc => {}
            Opcode::Ja => self.counter = value,
            Opcode::Csub => self.call(value),
            Opcode::Rsub => self.return_from_call(),
            Opcode::Wait => self.wait_for(i.kind, i.motor, value),
            Opcode::Stop => self.state = ProgramState::Stop,
            Opcode::Cle => (self.failed, self.timed_out) = (false, false),
            Opcode::Djnz => {
                self.accumulator = self.accumulator.wrapping_sub(1);
                if self.accumulator != 0 {
                    self.counter = value;
                }
            }
            Opcode::Aap => return execute_command(Opcode::Sap, i, self.accumulator),
            Opcode::Agp => return execute_command(Opcode::Sgp, i, self.accumulator),
            Opcode::Mvpa => return execute_command(Opcode::Mvp, i, self.accumulator),
            Opcode::Rora => return execute_command(Opcode::Ror, i, self.accumulator),
            Opcode::Rola => return execute_command(Opcode::Rol, i, self.accumulator),
            opcode if is_direct(opcode) => return execute_command(opcode, i, value),
            _ => {
                self.failed = true;
                self.state = ProgramState::Stop; // \[I\] what it cannot do ends it
            }
        }
        InterpreterStep::Nothing
    }

    /// CALC and CALCX, types 0 to 9 (TMCL reference).
    fn calculate(&mut self, kind: u8, a: i32, b: i32) -> i32 {
        match kind {
            0 => a.wrapping_add(b),
            1 => a.wrapping_sub(b),
            2 => a.wrapping_mul(b),
            3 | 4 if b == 0 => {
                self.failed = true;
                a
            }
            3 => a.wrapping_div(b),
            4 => a.wrapping_rem(b),
            5 => a & b,
            6 => a | b,
            7 => a ^ b,
            8 => !a,
            9 => b,
            _ => {
                self.failed = true;
                a
            }
        }
    }

    /// Conditions of JC (TMCL reference): 0 to 7 compare, 8 is a wait timed out, 10 an
    /// error in a calculation or command. 9 (external alarm) and 12 have no source here.
    fn condition_holds(&self, kind: u8) -> bool {
        let (a, b) = (self.accumulator, self.compared);
        match kind {
            0 => a == 0,
            1 => a != 0,
            2 => a == b,
            3 => a != b,
            4 => a > b,
            5 => a >= b,
            6 => a < b,
            7 => a <= b,
            8 => self.timed_out,
            10 => self.failed,
            _ => false,
        }
    }

    fn call(&mut self, address: i32) {
        let Some(slot) = self.calls.get_mut(self.depth) else {
            self.failed = true;
            self.state = ProgramState::Stop;
            return;
        };
        *slot = self.counter;
        self.depth += 1;
        self.counter = address;
    }

    fn return_from_call(&mut self) {
        match self.depth.checked_sub(1) {
            Some(depth) => {
                self.depth = depth;
                self.counter = self.calls[depth];
            }
            None => self.state = ProgramState::Stop,
        }
    }

    /// WAIT: time in units of 10 ms; for what comes by itself 0 is without limit.
    fn wait_for(&mut self, kind: u8, motor: u8, value: i32) {
        self.timed_out = false;
        let ms = u32::try_from(value).unwrap_or(0).saturating_mul(10);
        let limit = (ms > 0).then_some(ms);
        self.wait = match kind {
            0 => Some((WaitCondition::Ticks, Some(ms.saturating_sub(1)))),
            1 => Some((WaitCondition::Position(motor), limit)),
            2 | 3 => Some((WaitCondition::Switch(motor), limit)),
            4 => Some((WaitCondition::ReferenceSearch(motor), limit)),
            _ => {
                self.failed = true;
                None
            }
        };
    }
}

fn execute_command(opcode: Opcode, i: &Instruction, value: i32) -> InterpreterStep {
    InterpreterStep::Command(Request { address: 0, opcode, kind: i.kind, motor: i.motor, value })
}

/// Commands that do in a program what they do from a host.
#[must_use]
pub const fn is_direct(opcode: Opcode) -> bool {
    matches!(
        opcode,
        Opcode::Ror
            | Opcode::Rol
            | Opcode::Mst
            | Opcode::Mvp
            | Opcode::Sap
            | Opcode::Gap
            | Opcode::Stap
            | Opcode::Rsap
            | Opcode::Sgp
            | Opcode::Ggp
            | Opcode::Stgp
            | Opcode::Rsgp
            | Opcode::Sio
            | Opcode::Gio
            | Opcode::Rfs
    )
}

/// Whether an opcode means something in programs only.
#[must_use]
pub const fn is_program_only(opcode: Opcode) -> bool {
    matches!(
        opcode,
        Opcode::Calc
            | Opcode::Comp
            | Opcode::Jc
            | Opcode::Ja
            | Opcode::Csub
            | Opcode::Rsub
            | Opcode::Wait
            | Opcode::Stop
            | Opcode::Calcx
            | Opcode::Aap
            | Opcode::Agp
            | Opcode::Cle
            | Opcode::Mvpa
            | Opcode::Djnz
            | Opcode::Rola
            | Opcode::Rora
    )
}
