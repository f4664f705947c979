//! Programs of drives that store instructions: written one by one, read back, run, single-stepped.

use super::LocalAxis;
use crate::error::Error;
use crate::instruction_program::InstructionProgram;
use polepair_core::convert::saturating;
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::profile::{Profile, Signal};
use polepair_core::program::{
    InstructionBytes, InstructionLanguage, InstructionRole, ProgramCommand, TransferProgress,
};
use polepair_core::proto;

/// Attempts to resume a download after a lost reply.
const RESUMED_MAX: usize = 8;
/// Empty places in a row that end a program.
const EMPTY_RUN: usize = 8;
/// Noise of the measured speed of a brushless motor at standstill, in rpm.
const NOISE_RPM: i64 = 5;

/// State of a module's program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ProgramStatus {
    /// True if it runs.
    pub running: bool,
    /// The address of the next instruction.
    pub counter: u16,
}

impl LocalAxis {
    /// The language of its drive's programs, where they are instructions.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where it has none.
    pub fn instruction_language(&self) -> Result<&'static dyn InstructionLanguage, Error> {
        let dissector = proto::find_dissector(self.protocol);
        let language = dissector.and_then(|dissector| dissector.instruction_language());
        language
            .ok_or_else(|| self.unsupported_error("programs of instructions", Unsupported::NoPlan))
    }

    /// Stores a program in the module's memory, which keeps it without power, and reads it back. Each instruction's
    /// reply must confirm its storage. No program may run and no motor of the module may turn. The axis must be armed:
    /// a module that is not in download mode would execute the instructions.
    ///
    /// ```
    /// use polepair::InstructionProgram;
    /// let link = polepair::connect_local("sim:tmcm-1140?time=virtual")?;
    /// let axis = link.axis(1)?;
    /// let text = "CALC LOAD, 7\nAGP 3, 2\nSTOP";
    /// let language = axis.instruction_language()?;
    /// let program = InstructionProgram::assemble(language, "a.tmc", text, None)?;
    /// let armed = axis.armed()?;
    /// armed.download_instructions(&program, |_| ())?;
    /// armed.run_instructions(Some(0))?;
    /// link.sleep(std::time::Duration::from_millis(20));
    /// assert_eq!(armed.get_raw("GP 3.2")?, 7);
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error`] by blame; `E103` names the first address where the module has another instruction. After
    /// an error behind the first instruction the program in the module is incomplete.
    pub fn download_instructions(
        &self,
        program: &InstructionProgram,
        mut show: impl FnMut(TransferProgress),
    ) -> Result<TransferProgress, Error> {
        // Download mode ends a running program, whose outputs then stay as they are.
        self.check_idle()?;
        let total = program.instructions().len();
        let (mut stored, mut repeated) = (0, 0);
        let language = self.instruction_language()?;
        let mut resumed = 0;
        while stored < total {
            let ended = self.store_from(language, program, stored, &mut |done| {
                show(TransferProgress { done, total, repeated });
            });
            // Whatever happened, the module must not go on storing.
            let closed = self.run_order("ending the download", ProgramCommand::EndStore);
            match ended {
                Ok(()) => {
                    closed?;
                    break;
                }
                Err(error) if !is_lost(&error) || resumed == RESUMED_MAX => return Err(error),
                Err(_) => {
                    closed?;
                    resumed += 1;
                    // The instruction without a reply is read back, not sent again: in download mode the address counts
                    // up by itself.
                    let same = self.count_same(program, stored)?;
                    repeated += usize::from(same == stored);
                    stored = same;
                }
            }
        }
        self.verify_instructions(program)?;
        let progress = TransferProgress { done: total, total, repeated };
        show(progress);
        Ok(progress)
    }

    fn store_from(
        &self,
        language: &dyn InstructionLanguage,
        program: &InstructionProgram,
        from: usize,
        show: &mut dyn FnMut(usize),
    ) -> Result<(), Error> {
        // The module answers a stored instruction with status 101, which is no "done" (TMCL firmware manual,
        // status codes).
        let stored = Failure::Refused { code: language.stored_code() };
        self.run_order("beginning a download", ProgramCommand::BeginStore(from as u16))?;
        for (at, instruction) in program.instructions().iter().enumerate().skip(from) {
            let what = format!("storing instruction {at}");
            match self.run_order(&what, ProgramCommand::Store(*instruction)) {
                Err(error) if failure(&error) == Some(stored) => show(at + 1),
                Err(error) => return Err(error),
                Ok(_) => {
                    let what = format!(
                        "{}: the module executed instruction {at} instead of storing it",
                        self.label()
                    );
                    let hint = "stop its motors; another host may have ended its download mode";
                    return Err(differs(what, at, hint, true));
                }
            }
        }
        Ok(())
    }

    /// Number of instructions the module has as the program has them.
    fn count_same(&self, program: &InstructionProgram, from: usize) -> Result<usize, Error> {
        for (at, wanted) in program.instructions().iter().enumerate().skip(from) {
            if self.read_instruction(at as u16)? != *wanted {
                return Ok(at);
            }
        }
        Ok(program.instructions().len())
    }

    /// Reads the module's program memory and compares it with a program.
    ///
    /// # Errors
    /// [`Error`] by blame; `E103` names the first address where they differ.
    pub fn verify_instructions(&self, program: &InstructionProgram) -> Result<(), Error> {
        let at = self.count_same(program, 0)?;
        let Some(wanted) = program.instructions().get(at) else { return Ok(()) };
        let found = self.instruction_at(at as u16)?;
        let wanted =
            InstructionProgram::from_instructions(self.instruction_language()?, vec![*wanted]);
        let what = format!(
            "{}: at address {at} the module has `{}`, the program `{}`",
            self.label(),
            first_instruction_text(&found),
            first_instruction_text(&wanted)
        );
        Err(differs(what, at, "load the program again", false))
    }

    /// Reads a program from the module's memory: `count` instructions, or up to the first eight empty places.
    ///
    /// # Errors
    /// [`Error`] by blame: refused by a module whose program is protected (global parameter 81).
    pub fn upload_instructions(
        &self,
        count: Option<usize>,
        mut show: impl FnMut(TransferProgress),
    ) -> Result<InstructionProgram, Error> {
        let language = self.instruction_language()?;
        let is_empty = |instruction: &InstructionBytes| language.role(*instruction).empty;
        let total = count.unwrap_or(language.capacity());
        let mut read: Vec<InstructionBytes> = Vec::new();
        while read.len() < total {
            let next = self.read_instruction(read.len() as u16);
            match next {
                Ok(instruction) => read.push(instruction),
                Err(error) if count.is_none() && !read.is_empty() && is_refusal(&error) => break,
                Err(error) => return Err(error),
            }
            show(TransferProgress { done: read.len(), total: count.unwrap_or(0), repeated: 0 });
            // Some makers' memories end in a refusal, others are full of empty instructions.
            let tail = &read[read.len().saturating_sub(EMPTY_RUN)..];
            if count.is_none() && tail.len() == EMPTY_RUN && tail.iter().all(&is_empty) {
                break;
            }
        }
        if count.is_none() {
            let used = read.iter().rposition(|it| !is_empty(it)).map_or(0, |last| last + 1);
            // A program that could run into what is behind it ends there.
            let role = |at: usize| read.get(at).map(|instruction| language.role(*instruction));
            let ends = used.checked_sub(1).and_then(role).is_none_or(|last| last.ends);
            let stops = role(used).is_some_and(|next: InstructionRole| next.ends);
            read.truncate(used + usize::from(stops && !ends));
        }
        Ok(InstructionProgram::from_instructions(language, read))
    }

    /// State of the module's program, and its address.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn program_status(&self) -> Result<ProgramStatus, Error> {
        let raw = self.run_order("reading the program", ProgramCommand::QueryProgram)?;
        // Asked after the state: a program that ends in between has a counter, but none that moves.
        let counter =
            self.run_order("reading the program counter", ProgramCommand::QueryCounter)?;
        let running = self.instruction_language()?.is_running(raw);
        Ok(ProgramStatus { running, counter: saturating(counter) })
    }

    /// Runs the module's program, from an address or from where it is. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn run_instructions(&self, from: Option<u16>) -> Result<(), Error> {
        let command = from.map_or(ProgramCommand::Resume, ProgramCommand::Goto);
        self.run_order("starting the program", command).map(drop)
    }

    /// Executes one instruction of the module's program, and returns its new position. The axis must be
    /// armed, because the instruction may move a motor.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn step_instruction(&self) -> Result<ProgramStatus, Error> {
        self.run_order("a step of the program", ProgramCommand::Step)?;
        self.program_status()
    }

    /// Sets the module's program to its first instruction. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn reset_program(&self) -> Result<(), Error> {
        self.run_order("resetting the program", ProgramCommand::Reset).map(drop)
    }

    /// The instruction at an address of the module's program memory, as a program of its own.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn instruction_at(&self, at: u16) -> Result<InstructionProgram, Error> {
        let instruction = self.read_instruction(at)?;
        Ok(InstructionProgram::from_instructions(self.instruction_language()?, vec![instruction]))
    }

    fn read_instruction(&self, at: u16) -> Result<InstructionBytes, Error> {
        let what = format!("reading instruction {at}");
        let packed = self.run_order(&what, ProgramCommand::ReadInstruction(at))?;
        debug_assert!(packed >> 56 == 0, "an instruction has seven bytes");
        let [_, bytes @ ..] = packed.to_be_bytes();
        Ok(bytes)
    }

    /// The speed of a motor behind the drive's address, by its number there, in the drive's own unit.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn motor_speed(&self, motor: u8) -> Result<i64, Error> {
        self.run_order(
            &format!("reading the speed of motor {motor}"),
            ProgramCommand::QuerySpeed(motor),
        )
    }

    /// No program runs, and no motor of the module turns.
    fn check_idle(&self) -> Result<(), Error> {
        if self.program_status()?.running {
            let why = Unsupported::Forbidden(
                "a program runs in the module: `polepair program stop URL` ends it",
            );
            return Err(self.unsupported_error("loading a program", why));
        }
        // A stepper counts its own steps; a brushless motor measures, and its reading flickers at rest.
        let noise = if is_stepper(self.profile) { 0 } else { NOISE_RPM };
        for motor in 0..self.profile.motors.max(1) {
            if self.motor_speed(motor)?.abs() > noise {
                let why = Unsupported::Forbidden(
                    "a motor of the module turns: `polepair stop URL` ends that",
                );
                return Err(self.unsupported_error("loading a program", why));
            }
        }
        Ok(())
    }
}

pub(crate) fn is_refusal(error: &Error) -> bool {
    // The memory ends where the module refuses to read.
    matches!(failure(error), Some(Failure::Refused { .. }))
}

fn first_instruction_text(program: &InstructionProgram) -> String {
    program.instruction_text(0).unwrap_or_default()
}

/// Returns whether the profile has a motor whose speed is that of its steps.
fn is_stepper(profile: &Profile) -> bool {
    let velocity =
        profile.signal(Signal::Velocity).and_then(|source| profile.parameter(source.parameter));
    velocity
        .is_some_and(|velocity| velocity.scale.rule.is_some_and(|rule| rule.full_steps.is_some()))
}

fn differs(what: String, at: usize, hint: &'static str, may_turn: bool) -> Error {
    let at = saturating(at);
    Error::Failed {
        what,
        execution: String::new(),
        outcome: Outcome::NotDone(Failure::Differs { start: at, end: at }),
        received: Box::default(),
        may_turn,
        hint: hint.into(),
    }
}

fn failure(error: &Error) -> Option<Failure> {
    match error {
        Error::Failed { outcome, .. } => outcome.failure(),
        _ => None,
    }
}

/// Returns whether the module may have done it and its reply was lost.
fn is_lost(error: &Error) -> bool {
    // A lost reply leaves two cases, stored or not; only reading it back decides.
    matches!(error, Error::Failed { outcome: Outcome::Unknown(_), .. })
        || matches!(failure(error), Some(Failure::Silent | Failure::Misbehaved))
}
