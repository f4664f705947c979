//! Programs in the memory of a drive: loaded, verified, read, run.

use super::LocalAxis;
use super::failure::RequestKind;
use crate::error::Error;
use crate::program::{AssemblyContext, Program};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::program::{MemoryBlock, TransferKind};
use polepair_core::program::{
    MemoryKind, MemoryRules, ProgramCommand, ProgramLanguage, TransferProgress,
};
use polepair_core::proto;
use polepair_core::time::Instant;
use std::time::Duration;

/// Interval of progress reports of a transfer.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(50);

const PERMANENT_MEMORY_REASON: &str = "a part of it is in permanent memory, which wears: this is \
 written only on request";

impl LocalAxis {
    /// The language of its drive's programs.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where it has none.
    pub fn language(&self) -> Result<&'static dyn ProgramLanguage, Error> {
        let dissector = proto::find_dissector(self.protocol);
        let language = dissector.and_then(|dissector| dissector.program_language());
        language.ok_or_else(|| self.unsupported_error("programs", Unsupported::NoPlan))
    }

    /// Context for assembling a program's text, from address `origin` on.
    ///
    /// # Errors
    /// As [`language`](Self::language).
    pub fn assembly_context(&self, origin: u16) -> Result<AssemblyContext<'static>, Error> {
        Ok(AssemblyContext { language: self.language()?, profile: Some(self.profile), origin })
    }

    /// Writes a program into the drive's memory, chunk by chunk, each proven before the next, and has the drive's sum
    /// of each piece agree. `permanent` allows writes to memory that wears. The axis must have no power, and its
    /// program must not run. While permanent memory is written, the start address holds an instruction that ends at
    /// once; the true one is written last.
    ///
    /// ```
    /// use polepair::Program;
    /// let link = polepair::connect_local("sim:technosoft-f514l?time=virtual")?;
    /// let axis = &link.axes()[0];
    /// let text = "main: VAR_I1 = 77; END";
    /// let program = Program::assemble("a.tml", text, &axis.assembly_context(0x8270)?)?;
    /// axis.download(&program, false, |_| ())?;
    /// axis.verify(&program)?;
    /// axis.arm(true);
    /// axis.jump_to(program.label("main").unwrap())?;
    /// link.sleep(std::time::Duration::from_millis(10));
    /// assert_eq!(axis.get_raw("VAR_I1")?, 77);
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error`] by blame; `E103` names the addresses where the drive's sum differs. After any error
    /// but [`Error::Unsupported`] the program in the drive may be incomplete.
    pub fn download(
        &self,
        program: &Program,
        permanent: bool,
        show: impl FnMut(TransferProgress),
    ) -> Result<TransferProgress, Error> {
        const WHAT: &str = "loading a program";
        let rules = self.memory_rules(WHAT)?;
        if !permanent
            && program
                .pieces()
                .iter()
                .any(|p| rules.memory_at(p.start, p.words.len()) == Some(MemoryKind::Permanent))
        {
            return Err(
                self.unsupported_error(WHAT, Unsupported::Forbidden(PERMANENT_MEMORY_REASON))
            );
        }
        self.run_transfer(WHAT, TransferKind::Write, program.pieces(), show)
    }

    /// Compares the drive's sums over a program's pieces with the program. Changes nothing. Sums cannot detect
    /// exchanged words.
    ///
    /// # Errors
    /// [`Error`] by blame; `E103` names the addresses where they differ.
    pub fn verify(&self, program: &Program) -> Result<(), Error> {
        let pieces = program.pieces();
        self.run_transfer("verifying a program", TransferKind::Verify, pieces, |_| ()).map(drop)
    }

    /// Reads `count` words of the drive's memory for programs.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn upload(
        &self,
        start: u16,
        count: usize,
        show: impl FnMut(TransferProgress),
    ) -> Result<Program, Error> {
        const WHAT: &str = "reading memory";
        let words = vec![0; count];
        self.run_transfer(WHAT, TransferKind::Read, &[MemoryBlock { start, words }], show)?;
        let read = self.connection.with_axes(|axes, _| {
            let pieces = axes.last_transfer(self.index)?.blocks();
            pieces.first().map(|piece| piece.words.clone())
        });
        let read = read.ok_or_else(|| {
            let outcome = Outcome::NotDone(Failure::Misbehaved);
            self.outcome_error(WHAT, RequestKind::Query, outcome)
        })?;
        Ok(Program::from_words(start, read))
    }

    /// Has the drive go on at an address, whatever runs there now. The axis must be armed: a program
    /// may power and move its motor.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn jump_to(&self, address: u16) -> Result<(), Error> {
        self.run_order("starting a program", ProgramCommand::Goto(address)).map(drop)
    }

    /// Has the drive call a routine that [`abort`](Self::abort) can end; it returns at its `RET`.
    /// The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn call(&self, address: u16) -> Result<(), Error> {
        self.run_order("calling a routine", ProgramCommand::Call(address)).map(drop)
    }

    /// Returns whether a routine that was [called](Self::call) runs.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn is_routine_running(&self) -> Result<bool, Error> {
        let (_, mask) = self.memory_rules("programs")?.call_flag;
        let status = self.run_order("reading the routine", ProgramCommand::QueryCall)?;
        Ok(status & i64::from(mask) != 0)
    }

    /// Ends the routine that was called, then whatever program runs, then the motion. Overtakes
    /// everything else. The motor keeps its power.
    ///
    /// # Errors
    /// [`Error`] by blame: the first; the stop, which ends the program, is sent in any case.
    pub fn abort(&self) -> Result<(), Error> {
        let called = self.run_order("ending the routine", ProgramCommand::Abort);
        // ABORT ends the routine and leaves the motor in its motion.
        called.map(drop).and(self.stop())
    }

    /// Stops a further motor of the drive by its number, counted from 0: this axis is the first. The stop
    /// is sent, and standstill is not awaited.
    ///
    /// # Errors
    /// [`Error`] by source: refused by a drive without this motor, unsupported if an address is one motor.
    pub fn stop_motor(&self, number: u8) -> Result<(), Error> {
        self.run_order(&format!("stopping motor {number}"), ProgramCommand::StopMotor(number))
            .map(drop)
    }

    /// Rules of the memory for its programs.
    pub(crate) fn memory_rules(&self, what: &str) -> Result<&'static MemoryRules, Error> {
        let rules = self.connection.with_axes(|axes, _| axes.memory_rules(self.index));
        rules.ok_or_else(|| self.unsupported_error(what, Unsupported::NoPlan))
    }

    pub(super) fn run_order(&self, what: &str, command: ProgramCommand) -> Result<i64, Error> {
        let submitted = self.connection.submit_in_turn(Instant::FAR_FUTURE, |axes, now, ticket| {
            axes.send_program_command(now, ticket, self.index, command)
        });
        self.running(what, RequestKind::Command, submitted)?.finish()
    }

    pub(super) fn run_transfer(
        &self,
        what: &str,
        kind: TransferKind,
        pieces: &[MemoryBlock],
        mut show: impl FnMut(TransferProgress),
    ) -> Result<TransferProgress, Error> {
        let submitted = self
            .connection
            .submit(|axes, now, ticket| axes.start_transfer(now, ticket, self.index, kind, pieces));
        let request_kind = if kind.writes() { RequestKind::Command } else { RequestKind::Query };
        let mut running = self.running(what, request_kind, submitted)?;
        loop {
            let ended = running.wait(PROGRESS_INTERVAL)?;
            let progress = self.transfer_progress();
            show(progress);
            if ended.is_some() {
                return Ok(progress);
            }
            let TransferProgress { done, total, .. } = progress;
            debug_assert!(done <= total);
            // The error of a broken transfer names how far it came.
            running.what = format!("{what}, at {done} of {total} words");
        }
    }

    fn transfer_progress(&self) -> TransferProgress {
        self.connection.with_axes(|axes, _| {
            axes.last_transfer(self.index).map(|transfer| transfer.progress()).unwrap_or_default()
        })
    }
}
