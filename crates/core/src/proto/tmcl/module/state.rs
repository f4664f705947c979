//! The state of a module without its motors, and the extensions of a product.

use super::memory::Memory;
use super::program::{Interpreter, InterpreterStep, WaitCondition};
use crate::profile::Profile;
use crate::proto::tmcl::{Request, Status};
use crate::time::Instant;

/// The state of a module apart from its motors.
#[derive(Clone, Debug)]
pub struct ModuleState {
    /// The product.
    pub profile: &'static Profile,
    /// Settings and EEPROM.
    pub memory: Memory,
    /// The stand-alone program.
    pub program: Interpreter,
    /// Address of the next instruction of a download.
    pub download: Option<i32>,
    /// The serial interface is in ASCII mode.
    pub ascii: bool,
    /// True while it is in its bootloader.
    pub booting: bool,
    /// True while its logic has no supply.
    pub is_unpowered: bool,
    /// End of a silence without replies.
    pub silent_until: Instant,
    /// Time at which the tick timer (global parameter 132) was zero.
    pub timer_zero: Instant,
    /// Requests executed that a repetition would have doubled.
    pub unrepeatable: u64,
    /// Requests executed that started a motion.
    pub starts: u64,
    /// Time of the last request of each wire.
    pub last_requests: LastRequests,
    /// Motors whose arrival 138 reports, a bit each.
    pub armed_events: i32,
    /// Something unusual that it did.
    pub notice: Option<&'static str>,
}

/// Time of the last request of each wire.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastRequests {
    /// The serial line.
    pub serial: Option<Instant>,
    /// The CAN bus.
    pub can: Option<Instant>,
}

impl ModuleState {
    /// Factory state, not powered yet.
    #[must_use]
    pub fn new(profile: &'static Profile) -> Self {
        let mut memory = Memory::new(profile);
        memory.writes = 0;
        Self {
            profile,
            memory,
            program: Interpreter::NEW,
            download: None,
            ascii: false,
            booting: false,
            is_unpowered: false,
            silent_until: Instant::ZERO,
            timer_zero: Instant::ZERO,
            unrepeatable: 0,
            starts: 0,
            last_requests: LastRequests::default(),
            armed_events: 0,
            notice: None,
        }
    }

    /// Powers the module up: RAM is lost, settings come from the EEPROM. The program starts if the settings enable it.
    pub fn power_up(&mut self, now: Instant, has_programs: bool) {
        self.memory.load();
        self.program = Interpreter::NEW;
        self.download = None;
        self.booting = false;
        self.is_unpowered = false;
        self.armed_events = 0;
        self.ascii = self.memory.global[67] & 1 != 0;
        self.timer_zero = now;
        self.last_requests = LastRequests::default();
        if self.memory.global[77] == 1 && has_programs {
            self.program.run(None);
        }
    }

    /// Returns whether it ignores requests.
    #[must_use]
    pub fn is_unresponsive(&self, now: Instant) -> bool {
        self.is_unpowered || self.booting || now < self.silent_until
    }

    /// A wire that spoke once and is silent for longer than its heartbeat allows (global parameters 68 and
    /// 82). \[I\]
    pub fn check_heartbeats(&mut self, now: Instant) -> Option<&'static str> {
        if is_late(self.memory.global[68], self.last_requests.serial, now) {
            // Once for each silence: the next request begins a new watch.
            self.last_requests.serial = None;
            return Some("no serial request: motor stopped");
        }
        if is_late(self.memory.global[82], self.last_requests.can, now) {
            self.last_requests.can = None;
            return Some("no CAN request: motor stopped");
        }
        None
    }
}

fn is_late(limit: i32, received_at: Option<Instant>, now: Instant) -> bool {
    let limit = limit.max(0).cast_unsigned();
    limit > 0 && received_at.is_some_and(|at| now > at.plus_ms(limit))
}

/// Stand-alone programs of a module, and their waits.
pub trait ModulePrograms {
    /// Returns whether it runs stand-alone programs.
    fn has_programs(&self) -> bool;

    /// Returns whether the condition of a program is met.
    fn is_met(&self, what: WaitCondition) -> bool;

    /// Causes of interrupts that are there, a bit for each number.
    fn interrupt_levels(&self) -> u64 {
        0
    }

    /// Motors that have arrived at their targets, a bit each.
    fn arrived_motors(&self) -> i32;
}

/// A product: its motors, ports and identity.
pub trait TmclModule: ModulePrograms {
    /// The state apart from the motors.
    fn state(&self) -> &ModuleState;

    /// Mutable access to the state.
    fn state_mut(&mut self) -> &mut ModuleState;

    /// Runs what happens in time up to `now`.
    fn advance(&mut self, now: Instant);

    /// Power comes: RAM is lost.
    fn power_up(&mut self, now: Instant);

    /// Switches all motors off.
    fn switch_off(&mut self);

    /// Carries out a command for a motor.
    ///
    /// # Errors
    /// The status to answer.
    fn execute_axis(&mut self, request: &Request) -> Result<i32, Status>;

    /// Carries out SIO or GIO.
    ///
    /// # Errors
    /// The status to answer.
    fn execute_ports(&mut self, request: &Request) -> Result<i32, Status>;

    /// Returns whether a request has powered a motor or given it a target.
    fn starts_motion(&self, request: &Request) -> bool;

    /// Module number and firmware version, as in the reply to 136 type 1.
    fn version(&self) -> (u16, u8, u8);

    /// Time of the next change that a host waits for.
    fn next_due(&self) -> Option<Instant>;

    /// One tick of the stand-alone program.
    fn run_program(&mut self, now: Instant) {
        if !self.state().program.is_active() {
            return;
        }
        let levels = self.interrupt_levels();
        // Taken out, because its command runs on the module that holds it.
        let mut program = core::mem::replace(&mut self.state_mut().program, Interpreter::NEW);
        let ready = program.is_ready(|what| self.is_met(what));
        let memory = &mut self.state_mut().memory;
        program.interrupts.tick(levels, &memory.interrupt_settings);
        let step = if ready {
            program.execute_next(&memory.program, &mut memory.variables)
        } else {
            InterpreterStep::Nothing
        };
        self.state_mut().program = program;
        if let InterpreterStep::Command(request) = step {
            let outcome = super::execute::execute_request(self, now, &request);
            self.state_mut().program.accept_outcome(outcome, request.opcode.only_reads());
        }
    }
}
