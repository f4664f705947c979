//! Stand-alone TMCL programs: memory and interpreter.
//!
//! The instruction set is the TMCL reference's. \[I\] One instruction takes a tick of 1 ms.

use super::interrupts::Interrupts;
use super::memory::VARIABLES;
use crate::proto::tmcl::{Instruction, Opcode, Request, Status};

/// Instructions that fit into program memory: those of the maker's larger modules.
pub const PROGRAM_MAX: usize = 2048;

/// Values that PUSHA, PUSHX and PUSHV keep at most. \[I\]
pub const STACK_MAX: usize = 8;

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

/// State of a program (global parameter 128).
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

/// Condition of a WAIT.
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

/// Action of an instruction on the module.
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
    /// State.
    pub state: ProgramState,
    /// Next instruction.
    pub counter: i32,
    /// Registers of calculations.
    registers: Registers,
    timed_out: bool,
    calls: [i32; CALLS_MAX],
    depth: usize,
    stack: [i32; STACK_MAX],
    stacked: usize,
    wait: Wait,
    /// Interrupts: where they go, and whether they may.
    pub interrupts: Interrupts,
    /// The registers, the place and the wait that an interrupt has interrupted.
    interrupted: Option<(Registers, i32, Wait)>,
}

/// Condition of a wait, and its time limit, ms.
type Wait = Option<(WaitCondition, Option<u32>)>;

#[derive(Clone, Copy, Debug)]
struct Registers {
    accumulator: i32,
    x: i32,
    /// Values compared by COMP.
    compared: (i32, i32),
}

impl Interpreter {
    /// Stopped at the first instruction.
    pub const NEW: Self = Self {
        state: ProgramState::Stop,
        counter: 0,
        registers: Registers { accumulator: 0, x: 0, compared: (0, 0) },
        timed_out: false,
        calls: [0; CALLS_MAX],
        depth: 0,
        stack: [0; STACK_MAX],
        stacked: 0,
        wait: None,
        interrupts: Interrupts::NONE,
        interrupted: None,
    };

    /// Runs from `address`, or from where it is.
    pub fn run(&mut self, address: Option<i32>) {
        if let Some(address) = address {
            *self = Self { counter: address, ..Self::NEW };
        }
        self.state = ProgramState::Run;
    }

    /// Returns whether it has anything to execute.
    #[must_use]
    pub const fn is_active(&self) -> bool {
        matches!(self.state, ProgramState::Run | ProgramState::Step)
    }

    /// Takes the outcome of a command that it wanted.
    pub fn accept_outcome(&mut self, outcome: Result<i32, Status>, reads: bool) {
        match outcome {
            Ok(value) if reads => self.registers.accumulator = value,
            // \[I\] A program gets no notice of a refused command.
            Ok(_) | Err(_) => {}
        }
    }

    /// One tick of 1 ms: whether an instruction is executed in it. `met` returns whether a condition is
    /// met.
    pub fn is_ready(&mut self, met: impl Fn(WaitCondition) -> bool) -> bool {
        // Time passes for what an interrupt has interrupted.
        if let Some((_, _, Some((_, Some(left))))) = &mut self.interrupted {
            *left = left.saturating_sub(1);
        }
        let interrupts = self.interrupted.is_none() && self.interrupts.is_pending();
        self.is_active() && (interrupts || self.is_wait_over(met))
    }

    /// Executes the next instruction.
    pub fn execute_next(
        &mut self,
        program: &ProgramMemory,
        variables: &mut [i32; VARIABLES],
    ) -> InterpreterStep {
        if self.interrupted.is_none()
            && let Some(vector) = self.interrupts.take_pending()
        {
            // An interrupt leaves the wait of the main program under way; RETI returns to it.
            self.interrupted = Some((self.registers, self.counter, self.wait.take()));
            self.counter = vector;
        }
        if self.state == ProgramState::Step {
            self.state = ProgramState::Stop;
        }
        let Some(instruction) = program.instruction_at(self.counter) else {
            self.state = ProgramState::Stop;
            return InterpreterStep::Nothing;
        };
        // Counted up before the instruction, so that a jump replaces the address.
        self.counter += 1;
        self.execute_instruction(&instruction, variables)
    }

    /// Executes an instruction that a host sends by itself, with the registers of the program. Those that lead through
    /// a program cannot be sent so ([`is_direct_calculation`]).
    pub fn execute_direct(
        &mut self,
        instruction: &Instruction,
        variables: &mut [i32; VARIABLES],
    ) -> InterpreterStep {
        debug_assert!(is_direct_calculation(Opcode::from(instruction.opcode)), "no jump");
        self.execute_instruction(instruction, variables)
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

    fn execute_instruction(
        &mut self,
        i: &Instruction,
        variables: &mut [i32; VARIABLES],
    ) -> InterpreterStep {
        let value = i.value;
        let Registers { accumulator, x, .. } = self.registers;
        let axis = x as u8;
        match Opcode::from(i.opcode) {
            Opcode::Calc => self.registers.accumulator = self.calculate(i.kind, accumulator, value),
            Opcode::Calcx if i.kind == 10 => {
                core::mem::swap(&mut self.registers.accumulator, &mut self.registers.x);
            }
            Opcode::Calcx if i.kind == 9 => self.registers.x = accumulator,
            Opcode::Calcx => self.registers.accumulator = self.calculate(i.kind, accumulator, x),
            Opcode::Calcvv
            | Opcode::Calcva
            | Opcode::Calcav
            | Opcode::Calcvx
            | Opcode::Calcxv
            | Opcode::Calcv => self.calculate_variables(i, variables),
            Opcode::Comp => self.registers.compared = (accumulator, value),
            Opcode::Jc if self.condition_holds(i.kind) => self.counter = value,
            Opcode::Jc => {}
            Opcode::Ja => self.counter = value,
            Opcode::Call if self.condition_holds(i.kind) => self.call(value),
            Opcode::Call => {}
            Opcode::Csub => self.call(value),
            Opcode::Rsub => self.return_from_call(),
            Opcode::Rst => self.run(Some(value)),
            Opcode::Wait => self.wait_for(i.kind, i.motor, value),
            Opcode::Stop => self.state = ProgramState::Stop,
            Opcode::Cle => self.timed_out = false,
            Opcode::Djnz => {
                let variable = &mut variables[usize::from(i.kind)];
                *variable = variable.wrapping_sub(1);
                if *variable != 0 {
                    self.counter = value;
                }
            }
            Opcode::Siv => variables[usize::from(axis)] = value,
            Opcode::Giv => self.registers.accumulator = variables[usize::from(axis)],
            Opcode::Aiv => variables[usize::from(axis)] = accumulator,
            Opcode::Pusha => self.push(accumulator),
            Opcode::Pushx => self.push(x),
            Opcode::Pushv => self.push(variables[usize::from(i.kind)]),
            Opcode::Popa => self.registers.accumulator = self.pop(),
            Opcode::Popx => self.registers.x = self.pop(),
            Opcode::Popv => variables[usize::from(i.kind)] = self.pop(),
            Opcode::Ei => self.interrupts.enable(i.kind, true),
            Opcode::Di => self.interrupts.enable(i.kind, false),
            Opcode::Vect => self.interrupts.set_vector(i.kind, value),
            Opcode::Reti => match self.interrupted.take() {
                Some((registers, counter, wait)) => {
                    (self.registers, self.counter, self.wait) = (registers, counter, wait);
                }
                None => self.state = ProgramState::Stop,
            },
            Opcode::Aap => return execute_command(Opcode::Sap, i, accumulator),
            Opcode::Agp => return execute_command(Opcode::Sgp, i, accumulator),
            Opcode::Aco => return execute_command(Opcode::Sco, i, accumulator),
            Opcode::Mvpa => return execute_command(Opcode::Mvp, i, accumulator),
            Opcode::Rora => return execute_command(Opcode::Ror, i, accumulator),
            Opcode::Rola => return execute_command(Opcode::Rol, i, accumulator),
            opcode => {
                let of_axis = Instruction { motor: axis, ..*i };
                match opcode {
                    Opcode::Sapx => return execute_command(Opcode::Sap, &of_axis, value),
                    Opcode::Gapx => return execute_command(Opcode::Gap, &of_axis, value),
                    Opcode::Aapx => return execute_command(Opcode::Sap, &of_axis, accumulator),
                    Opcode::Mvpxa => return execute_command(Opcode::Mvp, &of_axis, accumulator),
                    Opcode::Rorxa => return execute_command(Opcode::Ror, &of_axis, accumulator),
                    Opcode::Rolxa => return execute_command(Opcode::Rol, &of_axis, accumulator),
                    Opcode::Mstx => return execute_command(Opcode::Mst, &of_axis, value),
                    opcode if is_direct(opcode) => return execute_command(opcode, i, value),
                    _ => self.state = ProgramState::Stop, // \[I\] what it cannot do ends it
                }
            }
        }
        InterpreterStep::Nothing
    }

    /// CALCVV to CALCV: a variable, the accumulator or the X register with a variable or a value. Type 11
    /// compares.
    fn calculate_variables(&mut self, i: &Instruction, variables: &mut [i32; VARIABLES]) {
        let (at, other) = (usize::from(i.motor), i.value as u8);
        let Registers { accumulator, x, .. } = self.registers;
        let (left, right) = match Opcode::from(i.opcode) {
            Opcode::Calcvv => (variables[at], variables[usize::from(other)]),
            Opcode::Calcva => (variables[at], accumulator),
            Opcode::Calcav => (accumulator, variables[at]),
            Opcode::Calcvx => (variables[at], x),
            Opcode::Calcxv => (x, variables[at]),
            _ => (variables[at], i.value),
        };
        if i.kind == 11 {
            self.registers.compared = (left, right);
            return;
        }
        let result = if i.kind == 10 { right } else { self.calculate(i.kind, left, right) };
        match Opcode::from(i.opcode) {
            Opcode::Calcav => self.registers.accumulator = result,
            Opcode::Calcxv => self.registers.x = result,
            _ => variables[at] = result,
        }
        if i.kind == 10 {
            match Opcode::from(i.opcode) {
                Opcode::Calcvv => variables[usize::from(other)] = left,
                Opcode::Calcva => self.registers.accumulator = left,
                Opcode::Calcvx => self.registers.x = left,
                Opcode::Calcav | Opcode::Calcxv => variables[at] = left,
                _ => {}
            }
        }
    }

    /// CALC and CALCX, types 0 to 9 (TMCL reference).
    fn calculate(&mut self, kind: u8, a: i32, b: i32) -> i32 {
        match kind {
            0 => a.wrapping_add(b),
            1 => a.wrapping_sub(b),
            2 => a.wrapping_mul(b),
            3 | 4 if b == 0 => a,
            3 => a.wrapping_div(b),
            4 => a.wrapping_rem(b),
            5 => a & b,
            6 => a | b,
            7 => a ^ b,
            8 => !a,
            9 => b,
            _ => a,
        }
    }

    /// Conditions of JC (TMCL reference): 0 to 7 compare, 8 is a wait timed out. 9 to 12 (external alarm,
    /// deviation, position error, shutdown) have no source here.
    fn condition_holds(&self, kind: u8) -> bool {
        let (a, (left, right)) = (self.registers.accumulator, self.registers.compared);
        match kind {
            0 => a == 0,
            1 => a != 0,
            2 => left == right,
            3 => left != right,
            4 => left > right,
            5 => left >= right,
            6 => left < right,
            7 => left <= right,
            8 => self.timed_out,
            _ => false,
        }
    }

    fn push(&mut self, value: i32) {
        if let Some(slot) = self.stack.get_mut(self.stacked) {
            *slot = value;
            self.stacked += 1;
        }
    }

    fn pop(&mut self) -> i32 {
        match self.stacked.checked_sub(1) {
            Some(top) => {
                self.stacked = top;
                self.stack[top]
            }
            None => 0,
        }
    }

    fn call(&mut self, address: i32) {
        let Some(slot) = self.calls.get_mut(self.depth) else {
            self.state = ProgramState::Stop;
            return;
        };
        debug_assert!(self.depth < CALLS_MAX);
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

    /// WAIT: time in units of 10 ms; for events, 0 is without limit.
    fn wait_for(&mut self, kind: u8, motor: u8, value: i32) {
        self.timed_out = false;
        let ms = value.max(0).cast_unsigned().saturating_mul(10);
        let limit = (ms > 0).then_some(ms);
        self.wait = match kind {
            0 => Some((WaitCondition::Ticks, Some(ms.saturating_sub(1)))),
            1 => Some((WaitCondition::Position(motor), limit)),
            2 | 3 => Some((WaitCondition::Switch(motor), limit)),
            4 => Some((WaitCondition::ReferenceSearch(motor), limit)),
            _ => None,
        };
    }
}

fn execute_command(opcode: Opcode, i: &Instruction, value: i32) -> InterpreterStep {
    InterpreterStep::Command(Request { address: 0, opcode, kind: i.kind, motor: i.motor, value })
}

/// Commands with the same effect in a program as from a host.
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
            | Opcode::Sco
            | Opcode::Gco
            | Opcode::Cco
    )
}

/// Returns whether an instruction of programs is executed in direct mode too: it changes registers, interrupts and
/// variables, and leads nowhere. \[I\] Public clients send COMP, CALC, AAP, EI and VECT to real modules.
#[must_use]
pub const fn is_direct_calculation(opcode: Opcode) -> bool {
    is_program_only(opcode)
        && !matches!(
            opcode,
            Opcode::Jc
                | Opcode::Ja
                | Opcode::Csub
                | Opcode::Rsub
                | Opcode::Wait
                | Opcode::Stop
                | Opcode::Reti
                | Opcode::Rst
                | Opcode::Call
                | Opcode::Djnz
        )
}

/// Returns whether an opcode is valid in programs only.
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
            | Opcode::Ei
            | Opcode::Di
            | Opcode::Vect
            | Opcode::Reti
            | Opcode::Rst
            | Opcode::Call
            | Opcode::Aco
            | Opcode::Calcvv
            | Opcode::Calcva
            | Opcode::Calcav
            | Opcode::Calcvx
            | Opcode::Calcxv
            | Opcode::Calcv
            | Opcode::Sapx
            | Opcode::Gapx
            | Opcode::Aapx
            | Opcode::Mvpxa
            | Opcode::Rolxa
            | Opcode::Rorxa
            | Opcode::Mstx
            | Opcode::Siv
            | Opcode::Giv
            | Opcode::Aiv
            | Opcode::Pusha
            | Opcode::Pushx
            | Opcode::Pushv
            | Opcode::Popa
            | Opcode::Popx
            | Opcode::Popv
    )
}
