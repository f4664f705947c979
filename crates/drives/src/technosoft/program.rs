//! TML programs: jumps, calls, waits, interrupts.
//!
//! Source: the help pages on program execution (on-line instructions precede the next program instruction;
//! sequential instructions wait, immediate ones do not), and on DER for errors of calls.

use super::addresses;
use super::drive::Drive;
use super::execute::ExecuteError;
use super::status::{cer, der, isr, mer, set_bits, srh, srl};
use polepair_core::proto::tml::instruction;
use polepair_core::proto::tml::online::MemorySpace as Space;
use polepair_core::proto::tml::wire::{DATA_WORDS_MAX, Instruction};

/// Calls that fit into each other. \[I\]
const STACK_MAX: usize = 12;
/// Instructions that run in a tick. \[I\]
const INSTRUCTIONS_MAX: usize = 20;
/// Messages that are kept while a WAIT! that came as a message holds.
const HELD_MAX: usize = 16;
/// Ticks that a drive waits for the answer of another. \[I\]
const ANSWER_TICKS: u64 = 100;
/// Address of a program that runs at power-up.
const AUTORUN: u16 = 0x4000;
const BEGIN_OPCODE: u16 = 0x649C;

/// Condition that execution waits for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum ProgramWait {
    /// The watched event, with a limit in ticks.
    Event(Option<u64>),
    /// Another drive's value, for this variable.
    Answer { address: u16, long: bool, ticks: u64 },
}

/// The state of execution.
#[derive(Clone, Debug)]
pub(super) struct ProgramExecution {
    /// The next instruction; `None` while no program runs.
    next_address: Option<u16>,
    /// Return addresses of calls; `None` returns to no program.
    stack: [Option<u16>; STACK_MAX],
    depth: usize,
    /// Depth at which the cancelable call was made.
    cancelable: Option<usize>,
    interrupts: bool,
    /// BREAK halted it; CONTINUE goes on.
    halted: bool,
    pub wait: Option<ProgramWait>,
    held_messages: [Instruction; HELD_MAX],
    held_messages_len: usize,
}

impl ProgramExecution {
    /// No program runs.
    pub const IDLE: Self = Self {
        next_address: None,
        stack: [None; STACK_MAX],
        depth: 0,
        cancelable: None,
        interrupts: false,
        halted: false,
        wait: None,
        held_messages: [Instruction::of(0, []); HELD_MAX],
        held_messages_len: 0,
    };

    /// Returns whether an instruction is being executed or waited for.
    pub const fn is_active(&self) -> bool {
        self.next_address.is_some() || self.wait.is_some() || self.held_messages_len > 0
    }

    /// BREAK and CONTINUE. \[I\] Messages are carried out all the same.
    pub const fn halt(&mut self, on: bool) {
        self.halted = on;
    }

    /// Returns whether a message must wait behind a WAIT! that came as a message.
    pub const fn must_hold(&self, opcode: u16) -> bool {
        let waiting =
            self.next_address.is_none() && (self.wait.is_some() || self.held_messages_len > 0);
        waiting && !is_immediate(opcode)
    }
}

/// Returns whether an instruction never waits: stops and resets, and the points of a path. \[I\]
const fn is_immediate(opcode: u16) -> bool {
    matches!(opcode, 0x0001 | 0x0002 | 0x0104 | 0x0144 | 0x0184 | 0x01C4 | 0x0402)
        || matches!(opcode, 0x1000 | 0x1401 | 0x1C02 | 0x1C04)
        || matches!(opcode & 0xFC00, 0x1800 | 0xC800 | 0xA800 | 0xAC00 | 0xB400 | 0xD400)
}

type ExecuteResult = Result<(), ExecuteError>;

impl Drive {
    /// The program in the EEPROM runs by itself if it begins with BEGIN. \[I\]
    pub fn autorun(&mut self) {
        // Whatever ran before the power-up is gone; only the EEPROM decides what runs now.
        self.program = ProgramExecution::IDLE;
        if self.memory.read(Space::Program, AUTORUN) == BEGIN_OPCODE {
            self.program.next_address = Some(AUTORUN);
            self.status.srh |= srh::AUTORUN;
        }
    }

    /// Keeps a message for when the wait is over.
    pub fn hold_message(&mut self, instruction: &Instruction) {
        match self.program.held_messages.get_mut(self.program.held_messages_len) {
            Some(slot) => {
                debug_assert!(self.program.held_messages_len < HELD_MAX);
                *slot = *instruction;
                self.program.held_messages_len += 1;
            }
            None => {
                // The message is lost, as on a drive whose receive buffer is full; the host can see it in CER and MER.
                self.status.cer |= cer::SERIAL_RECEIVE;
                self.status.mer |= mer::COMMUNICATION;
            }
        }
    }

    /// Runs the program for a tick.
    #[inline]
    pub fn tick_program(&mut self) {
        if self.program.halted {
            return;
        }
        if self.program.interrupts {
            // Between two instructions, as the help page on interrupts describes it.
            self.serve_interrupt();
        }
        if !self.program.is_active() || !self.wait_is_over() {
            return;
        }
        self.run_held_messages();
        for _ in 0..INSTRUCTIONS_MAX {
            let (Some(at), None) = (self.program.next_address, self.program.wait) else { return };
            self.execute_at(at);
        }
    }

    /// END: no program runs, nothing is called, nothing waits.
    pub fn end_program(&mut self) {
        self.program =
            // END stops the program; EINT stays as it was set.
            ProgramExecution { interrupts: self.program.interrupts, ..ProgramExecution::IDLE };
        set_bits(&mut self.status.srl, srl::CALL_ACTIVE, false);
        set_bits(&mut self.status.srh, srh::AUTORUN, false);
    }

    /// 74xx and 76xx: GOTO and CALL, also when a variable tests against zero.
    pub fn jump(&mut self, i: &Instruction) -> ExecuteResult {
        let is_call = i.opcode & 1 != 0;
        let label = match i.opcode & 0xFE {
            0 if i.opcode & 0x200 != 0 => self.memory.word(i.word(0)),
            0 => i.word(0),
            condition => {
                let value = match i.opcode & 0x100 {
                    0 => self.memory.int(i.word(0)).into(),
                    _ => self.memory.long(i.word(0)),
                };
                if !condition_holds(condition, value) {
                    return Ok(());
                }
                i.word(1)
            }
        };
        if is_call { self.call_at(label) } else { self.jump_to(label) }
    }

    /// CALLS: a call that ABORT can cancel, one at a time.
    pub fn call_cancelable(&mut self, label: u16) -> ExecuteResult {
        if self.program.cancelable.is_some() {
            self.status.srl |= srl::CALL_WARNING;
            return Err(ExecuteError::DerBits(der::CALL_IGNORED));
        }
        // Noted before the call, because ABORT returns to this depth, however deep the called function went.
        let depth = self.program.depth;
        self.call_at(label)?;
        self.program.cancelable = Some(depth);
        set_bits(&mut self.status.srl, srl::CALL_WARNING, false);
        set_bits(&mut self.status.srl, srl::CALL_ACTIVE, true);
        Ok(())
    }

    /// FUNCTION n, counted from 1: a cancelable call of the n-th address in the function table; 0
    /// ends the table.
    pub fn call_function(&mut self, number: u16) -> ExecuteResult {
        let table = self.memory.word(addresses::FUNCTION_TABLE);
        if number == 0
            || table == 0
            || (0..number).any(|n| is_missing_label(self.table_entry(n, table)))
        {
            return Err(ExecuteError::DerBits(der::NO_FUNCTION));
        }
        self.call_cancelable(self.table_entry(number - 1, table))
    }

    fn table_entry(&self, n: u16, table: u16) -> u16 {
        self.memory.read(Space::Program, table.wrapping_add(n))
    }

    /// ABORT: back to where the cancelable call was made, waiting for nothing.
    pub fn abort(&mut self) {
        self.program.wait = None;
        if let Some(depth) = self.program.cancelable.take() {
            self.program.depth = depth;
            self.program.next_address = self.program.stack[depth];
            set_bits(&mut self.status.srl, srl::CALL_ACTIVE, false);
        }
    }

    /// RET and RETI.
    pub fn return_from(&mut self, from_interrupt: bool) -> ExecuteResult {
        if self.program.depth == 0 {
            return Err(ExecuteError::DerBits(der::STACK_UNDERFLOW));
        }
        debug_assert!(self.program.depth <= STACK_MAX);
        self.program.depth -= 1;
        self.program.next_address = self.program.stack[self.program.depth];
        if self.program.cancelable == Some(self.program.depth) {
            self.program.cancelable = None;
            set_bits(&mut self.status.srl, srl::CALL_ACTIVE, false);
        }
        // RETI allows interrupts again; a plain RET leaves them as they are.
        self.program.interrupts |= from_interrupt;
        Ok(())
    }

    /// EINT and DINT.
    pub const fn allow_interrupts(&mut self, on: bool) {
        self.program.interrupts = on;
    }

    /// Waits for another drive's value.
    pub const fn wait_for_answer(&mut self, address: u16, long: bool) {
        self.program.wait = Some(ProgramWait::Answer { address, long, ticks: ANSWER_TICKS });
    }

    /// Takes another drive's value.
    pub fn accept_answer(&mut self, value: u32) {
        let Some(ProgramWait::Answer { address, long, .. }) = self.program.wait else { return };
        self.program.wait = None;
        debug_assert!(self.program.wait.is_none(), "one answer ends the wait");
        let done = if long {
            self.set_long_variable(address, value.cast_signed())
        } else {
            self.set_variable(address, value as u16)
        };
        if done.is_err() {
            self.status.mer |= mer::COMMAND;
        }
    }

    fn jump_to(&mut self, label: u16) -> ExecuteResult {
        if !(0x4000..0xC000).contains(&label) {
            return Err(ExecuteError::NoMemory);
        }
        self.program.next_address = Some(label);
        Ok(())
    }

    fn call_at(&mut self, label: u16) -> ExecuteResult {
        if self.program.depth == STACK_MAX {
            return Err(ExecuteError::DerBits(der::STACK_OVERFLOW));
        }
        // From a message there is no program to return to, and the call ends with its RET.
        let back = self.program.next_address;
        self.jump_to(label)?;
        self.program.stack[self.program.depth] = back;
        self.program.depth += 1;
        Ok(())
    }

    /// Executes one instruction of the program. \[I\] An invalid one ends it. `SEG` waits for free space.
    fn execute_at(&mut self, at: u16) {
        let opcode = self.program_word(0, at);
        if matches!(opcode & 0xFC00, 0x7800 | 0x7C00) && self.contour.is_full() {
            return;
        }
        let mut words = [0; DATA_WORDS_MAX + 2];
        let Some(count) =
            instruction::data_word_count(opcode).filter(|count| *count <= words.len())
        else {
            self.status.mer |= mer::COMMAND;
            return self.end_program();
        };
        for (n, slot) in words[..count].iter_mut().enumerate() {
            *slot = self.program_word(n + 1, at);
        }
        // Before the instruction runs: a jump in it replaces the address.
        self.program.next_address = Some(at.wrapping_add(1 + count as u16));
        if opcode & 0xFFF8 == 0x9400 {
            return self.send_instruction(&words[..count]);
        }
        if let Some(instruction) = Instruction::new(opcode, &words[..count]) {
            self.execute(&instruction);
        }
    }

    fn program_word(&self, n: usize, at: u16) -> u16 {
        self.memory.read(Space::Program, at.wrapping_add(n as u16))
    }

    fn wait_is_over(&mut self) -> bool {
        let ticks = match &mut self.program.wait {
            None => return true,
            Some(ProgramWait::Event(_)) if !self.events.is_pending() => {
                self.program.wait = None;
                return true;
            }
            Some(ProgramWait::Event(None)) => return false,
            Some(ProgramWait::Event(Some(ticks)) | ProgramWait::Answer { ticks, .. }) => ticks,
        };
        *ticks = ticks.saturating_sub(1);
        let over = *ticks == 0;
        if over {
            if matches!(self.program.wait, Some(ProgramWait::Answer { .. })) {
                self.status.cer |= cer::CAN_TIMEOUT;
            }
            self.program.wait = None;
        }
        over
    }

    /// Messages that were held back, until one of them waits again.
    fn run_held_messages(&mut self) {
        let mut consumed = 0;
        while consumed < self.program.held_messages_len && self.program.wait.is_none() {
            let instruction = self.program.held_messages[consumed];
            consumed += 1;
            self.execute(&instruction);
        }
        debug_assert!(consumed <= self.program.held_messages_len);
        let left = self.program.held_messages_len.saturating_sub(consumed);
        self.program.held_messages.copy_within(consumed..consumed + left, 0);
        self.program.held_messages_len = left;
    }

    /// The lowest interrupt that is flagged and allowed, if INTTABLE has a routine for it.
    fn serve_interrupt(&mut self) {
        let flagged = self.status.isr & self.memory.word(addresses::ICR);
        let table = self.memory.word(addresses::INTTABLE);
        let number = flagged.trailing_zeros();
        if number >= isr::COUNT || table == 0 {
            return;
        }
        let routine = self.memory.read(Space::Program, table.wrapping_add(number as u16));
        // Cleared before the routine is called, so that an event during it is noticed again.
        self.status.isr &= !(1 << number);
        if routine != 0xFFFF && self.call_at(routine).is_ok() {
            // Until RETI: a routine is not interrupted by itself.
            self.program.interrupts = false;
            self.program.wait = None;
        }
    }
}

fn is_missing_label(label: u16) -> bool {
    label == 0 || label == 0xFFFF
}

/// Tests against zero: 90 LT, 88 LEQ, C0 EQ, A0 NEQ, 84 GT, 82 GEQ.
const fn condition_holds(condition: u16, value: i32) -> bool {
    match condition {
        0x90 => value < 0,
        0x88 => value <= 0,
        0xC0 => value == 0,
        0xA0 => value != 0,
        0x84 => value > 0,
        _ => value >= 0,
    }
}
