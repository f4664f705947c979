//! One axis: parameters by name with units, and motion.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use std::time::Duration;
//! let link = polepair::connect_local("sim:tmcl?time=virtual")?;
//! let axis = link.axis(1)?;
//! println!("{}", axis.get("max current")?);
//! {
//!     let armed = axis.armed()?;
//!     armed.velocity("60 rpm")?;
//!     link.sleep(Duration::from_millis(500));
//!     armed.stop()?;
//! } // disabled and disarmed here, whatever happens in between
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod address;
mod argument;
pub mod coupling;
mod cyclic;
mod data;
mod device_details;
pub mod drive_log;
mod emergency;
mod failure;
mod instructions;
mod mode;
mod mounted;
mod pending_writes;
mod program;
mod raw_bytes;
mod raw_text;
mod reports;
mod request;
mod scales;
mod signal_value;
mod start_together;
mod stop;
mod streaming;
mod unmet_wait;
mod watchdog;
mod write_plan;

pub use cyclic::CyclicAxes;
pub use data::{DATA_MAX, ParameterValue};
pub use device_details::{DeviceDetail, summarize_details};
pub use instructions::ProgramStatus;
pub(crate) use instructions::is_refusal;
pub use pending_writes::PendingWrites;
pub use raw_text::RawRehearsal;
pub use reports::RunningReports;
pub use request::{PreparedCommand, RunningRequest};
pub use start_together::{check_together, start_together};
pub use stop::{
    STOP_RETRY_MAX, Standstill, StopNotice, StopOptions, StopPersistence, StopProgress, StopResult,
    StopSupervisor, WireAirtime, await_stops, stop_axes,
};
pub use watchdog::WatchdogState;
pub use write_plan::{NamedValue, PlannedWrite, WriteChange, WritePlan};

use crate::amount::{Amount, Value, misfit_error};
use crate::error::Error;
use crate::identification::Identification;
use crate::mounting::ResolvedMounting;
use crate::simulate::Simulation;
use crate::url::AxisNumber;
use failure::RequestKind;
use polepair_core::axis::{AxisStatus, Command, Reading, RehearsalAction, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::{Frame, MediumKind};
use polepair_core::plan::{Argument, Step};
use polepair_core::profile::{Parameter, ParameterId, Profile, Scale, Signal};
use polepair_core::station::AxisIndex;
use polepair_core::units::Unit;
use polepair_link::Connection;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;

/// Hint for an axis that is armed already.
pub(crate) const ALREADY_ARMED_HINT: &str =
    "move it in the block that armed it: the end of a second block would stop it";

/// One axis of a link that this program opened. Clones are the same axis; any thread may use it.
#[derive(Clone, Debug)]
pub struct LocalAxis {
    pub(crate) connection: Connection,
    pub(crate) index: AxisIndex,
    pub(crate) number: u32,
    pub(crate) name: String,
    pub(crate) protocol: &'static str,
    pub(crate) medium: MediumKind,
    /// The number that the host has among the drives of its wire, where it has one.
    pub(crate) host: Option<u32>,
    /// The axis that the host is wired to, where that may be a relay to others.
    pub(crate) relay: Option<u32>,
    /// Period of the host's heartbeat on this wire, if it sends one.
    pub(crate) heartbeat: Option<Duration>,
    pub(crate) profile: &'static Profile,
    pub(crate) identified: Identification,
    pub(crate) simulation: Option<Simulation>,
    /// Mounting in a machine, from a rack file.
    pub(crate) mounted: Option<Arc<ResolvedMounting>>,
}

/// A step of a rehearsal: what a command would send. Nothing was sent.
#[derive(Clone, PartialEq, Debug)]
pub struct Rehearsal {
    /// Action of the step, and its parameter.
    pub step: RehearsalAction,
    /// The bytes on the wire.
    pub bytes: Vec<u8>,
    /// The frame that carries them, on CAN.
    pub frame: Option<Frame>,
}

impl LocalAxis {
    /// The number of the axis: the drive's address on the wire, or a group, as in [`AxisNumber`].
    #[must_use]
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Name in a rack file; empty for none.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// `axis 1`, or `axis 1 (x)` where it has a name; `axes g3` for a group.
    #[must_use]
    pub fn label(&self) -> String {
        let number = AxisNumber(self.number);
        match self.name.as_str() {
            "" if number.is_group() => format!("axes {number}"),
            "" => format!("axis {number}"),
            name => format!("axis {number} ({name})"),
        }
    }

    /// Profile of the product.
    #[must_use]
    pub fn profile(&self) -> &'static Profile {
        self.profile
    }

    /// The protocol's word.
    #[must_use]
    pub fn protocol(&self) -> &'static str {
        self.protocol
    }

    /// Medium of its wire.
    #[must_use]
    pub fn medium(&self) -> MediumKind {
        self.medium
    }

    /// Source of its profile.
    #[must_use]
    pub fn identified(&self) -> &Identification {
        &self.identified
    }

    /// The connection that it shares with the other axes of its wire.
    #[must_use]
    pub fn connection(&self) -> &Connection {
        &self.connection
    }

    /// Last known state, without a request: every value carries its age.
    #[must_use]
    pub fn state(&self) -> AxisStatus {
        let state = self.connection.with_axes(|axes, _| axes.state(self.index).copied());
        self.with_derived_moving(self.to_machine_scale(state.unwrap_or(AxisStatus::UNKNOWN)))
    }

    /// Every parameter that the profile has.
    #[must_use]
    pub fn params(&self) -> &'static [Parameter] {
        self.profile.parameters
    }

    /// Reads a parameter by name, in its unit.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn get(&self, name: &str) -> Result<Value, Error> {
        let id = self.find(name)?;
        let raw = self.read(id)?;
        self.value(id, raw)
    }

    /// Reads a parameter by name, raw.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn get_raw(&self, name: &str) -> Result<i64, Error> {
        self.read(self.find(name)?)
    }

    /// Writes a parameter by name: `set("max current", 1.2)` in its own unit, `set("max current",
    /// "1200 mA")`, or one of its words. Checked against its limits before a byte is sent; permanent
    /// memory is left alone.
    ///
    /// # Errors
    /// [`Error`] by blame; `E216` outside the limits, `E219` for what moves an unarmed axis.
    pub fn set(&self, name: &str, amount: impl Into<Amount>) -> Result<(), Error> {
        let id = self.find(name)?;
        let amount = self.amount_for_name(name, id, amount.into())?;
        self.write(id, self.raw_within_limits(id, &amount)?, false)
    }

    /// Writes a parameter by name, and has the drive keep it over power-off.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn set_and_store(&self, name: &str, amount: impl Into<Amount>) -> Result<(), Error> {
        let id = self.find(name)?;
        let amount = self.amount_for_name(name, id, amount.into())?;
        self.write(id, self.raw_within_limits(id, &amount)?, true)
    }

    /// Writes a parameter by name, raw.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn set_raw(&self, name: &str, raw: i64) -> Result<(), Error> {
        self.write(self.find(name)?, raw, false)
    }

    /// Reads a parameter, raw.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn read(&self, id: ParameterId) -> Result<i64, Error> {
        self.start_read(id)?.finish()
    }

    /// Reads a raw parameter of each drive of the axis. For a group, returns one value for each drive that
    /// replied, with its address, in the order of the addresses.
    ///
    /// # Errors
    /// [`Error`] by source. Different values within a group are not an error.
    pub fn read_each(&self, id: ParameterId) -> Result<Vec<(u32, i64)>, Error> {
        let mut running = self.start_read(id)?;
        let ticket = running.pending.ticket();
        let ended = running.finish();
        // Taken after the request ended: drives of a group may still answer until then.
        let parts = self.connection.with_axes(|axes, _| {
            let parts = std::iter::from_fn(|| axes.poll_group_answer(ticket));
            parts.map(|part| (part.address, part.raw)).collect::<Vec<_>>()
        });
        match ended {
            // A single axis replies once and leaves no list of members.
            Ok(raw) if parts.is_empty() => Ok(vec![(self.number, raw)]),
            Err(error @ Error::Interrupted { .. }) => Err(error),
            Err(error) if parts.is_empty() => Err(error),
            // One silent member does not hide the values of the others; the caller sees who is missing.
            Ok(_) | Err(_) => Ok(parts),
        }
    }

    /// Writes a parameter, raw; `keep` also has the drive keep it over power-off.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn write(&self, id: ParameterId, raw: i64, keep: bool) -> Result<(), Error> {
        self.start_write(id, raw, keep)?.finish().map(drop)
    }

    /// The raw value that an amount means for a parameter.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217`; or what reading the parameters brings that the scale depends on.
    pub fn raw_of(&self, id: ParameterId, amount: &Amount) -> Result<i64, Error> {
        let parameter = self.required_parameter(id)?;
        self.read_unread_factors(parameter)?;
        let unit = self.unit(id);
        amount.resolve(parameter, unit)?.into_raw(
            parameter,
            unit,
            |si| {
                let si = si * self.factor(id);
                self.connection.with_axes(|axes, _| axes.to_raw(self.index, id, si))
            },
            || {
                let zero = self.connection.with_axes(|axes, _| axes.to_raw(self.index, id, 0.0));
                if zero.is_some() {
                    return misfit_error(parameter, amount);
                }
                let what = format!("`{}`: the scale of this value is not known", parameter.name);
                Error::usage("E217", what, "write it raw")
            },
        )
    }

    /// A raw value of a parameter, in its unit.
    ///
    /// # Errors
    /// What reading the parameters brings that the scale depends on.
    pub fn value(&self, id: ParameterId, raw: i64) -> Result<Value, Error> {
        let parameter = self.required_parameter(id)?;
        let convert = || self.connection.with_axes(|axes, _| axes.to_si(self.index, id, raw));
        // First with what is known: a read costs a request, and scales seldom change.
        let mut si = convert();
        if si.is_none() {
            self.read_factors(parameter)?;
            si = convert();
        }
        // The step between two raw values, so that a value is shown with no more digits than it has.
        let neighbour = raw.wrapping_add(1);
        let next = self.connection.with_axes(|axes, _| axes.to_si(self.index, id, neighbour));
        let (unit, factor) = (self.unit(id), self.factor(id));
        let shown = |si: f64| si / factor / unit.si_factor();
        let step = si.zip(next).map_or(0.0, |(si, next)| (shown(next) - shown(si)).abs());
        let word = parameter.values.iter().find(|(value, _)| *value == raw);
        Ok(Value {
            raw,
            value: si.map_or(f64::NAN, shown),
            step,
            unit,
            word: word.map(|(_, word)| *word),
            bits: parameter.bits,
            encoding: parameter.encoding,
            is_raw: parameter.scale == Scale::ONE && unit == Unit::None && factor == 1.0,
        })
    }

    /// A value in SI in a parameter's unit, with the step between its raw values. It need not be one of them: the
    /// raw value is the nearest.
    ///
    /// # Errors
    /// As [`value`](Self::value); [`Error::Usage`] `E217` if the scale is not known.
    pub fn value_of_si(&self, id: ParameterId, si: f64) -> Result<Value, Error> {
        let unit = self.unit(id);
        let raw = self.raw_of(id, &Amount::Number(si / unit.si_factor()))?;
        Ok(Value { value: si / unit.si_factor(), word: None, ..self.value(id, raw)? })
    }

    /// Waits on the link's own clock: in virtual time it is over at once.
    pub fn sleep(&self, span: Duration) {
        crate::simulate::sleep_on_clock(self.simulation.as_ref(), span);
    }

    /// Lets motion commands through, or no longer. [`armed`](Self::armed) does it for a while.
    pub fn arm(&self, armed: bool) {
        // A restart that is received already was before this, and disarms nothing.
        self.connection.catch_up();
        self.connection.with_axes(|axes, _| axes.set_armed(self.index, armed));
    }

    /// Arms the axis for a caller that stops it at the end, so that no other caller's end stops it
    /// meanwhile.
    ///
    /// # Errors
    /// [`Error::Unsupported`] `E220` if it is already armed.
    pub fn arm_exclusively(&self) -> Result<(), Error> {
        self.connection.catch_up();
        let armed = self.connection.with_axes(|axes, _| {
            // Read and set under one lock: two callers cannot both find it unarmed.
            let before = axes.state(self.index).is_some_and(|state| state.armed);
            axes.set_armed(self.index, true);
            before
        });
        if armed {
            Err(Error::Unsupported {
                what: format!("{}: it is already armed", self.label()),
                why: Unsupported::Busy,
                hint: ALREADY_ARMED_HINT.to_owned(),
            })
        } else {
            Ok(())
        }
    }

    /// Powers the motor. It holds its actual position. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn enable(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Enable)).map(drop)
    }

    /// Takes power off the motor.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn disable(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Disable)).map(drop)
    }

    /// Clears faults.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn clear(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Clear)).map(drop)
    }

    /// Turns at a speed: rad/s (m/s), or text with a unit. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn velocity(&self, speed: impl Into<Amount>) -> Result<(), Error> {
        let velocity = self.argument(Verb::Velocity, Argument::Velocity, &speed.into())?;
        let command = Command { velocity: Some(velocity), ..Command::new(Verb::Velocity) };
        self.run(command).map(drop)
    }

    /// Turns with a torque: N·m (or the drive's substitute: A, a share), or text with a unit. The axis must
    /// be armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn torque(&self, torque: impl Into<Amount>) -> Result<(), Error> {
        let torque = self.argument(Verb::Torque, Argument::Torque, &torque.into())?;
        self.run(Command { torque: Some(torque), ..Command::new(Verb::Torque) }).map(drop)
    }

    /// Starts a move to a position: rad (m), or text with a unit. Returns when the drive has acknowledged
    /// the start; [`wait`](Self::wait) waits for the arrival. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn move_to(&self, target: impl Into<Amount>) -> Result<(), Error> {
        let target = self.argument(Verb::MoveTo, Argument::Target, &target.into())?;
        self.run(Command { target: Some(target), ..Command::new(Verb::MoveTo) }).map(drop)
    }

    /// Sets out for a position so far from here. As [`move_to`](Self::move_to); it is never sent
    /// twice.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn move_by(&self, distance: impl Into<Amount>) -> Result<(), Error> {
        let target = self.argument(Verb::MoveBy, Argument::Target, &distance.into())?;
        self.run(Command { target: Some(target), ..Command::new(Verb::MoveBy) }).map(drop)
    }

    /// Sets out for a position so far from the last target, whether that was reached or not. As
    /// [`move_by`](Self::move_by).
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn move_on(&self, distance: impl Into<Amount>) -> Result<(), Error> {
        let target = self.argument(Verb::MoveOn, Argument::Target, &distance.into())?;
        self.run(Command { target: Some(target), ..Command::new(Verb::MoveOn) }).map(drop)
    }

    /// Sets out for a position along an S-curve, whose acceleration takes `jerk_time` (s, or text
    /// with a unit) to build up. As [`move_to`](Self::move_to).
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn curve_to(
        &self,
        target: impl Into<Amount>,
        jerk_time: impl Into<Amount>,
    ) -> Result<(), Error> {
        self.run_curve(Verb::CurveTo, &target.into(), &jerk_time.into())
    }

    /// Sets out for a position so far from here, along an S-curve. As [`curve_to`](Self::curve_to);
    /// it is never sent twice.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn curve_by(
        &self,
        distance: impl Into<Amount>,
        jerk_time: impl Into<Amount>,
    ) -> Result<(), Error> {
        self.run_curve(Verb::CurveBy, &distance.into(), &jerk_time.into())
    }

    fn run_curve(&self, verb: Verb, target: &Amount, jerk_time: &Amount) -> Result<(), Error> {
        let target = Some(self.argument(verb, Argument::Target, target)?);
        let jerk_time = Some(self.argument(verb, Argument::JerkTime, jerk_time)?);
        self.run(Command { target, jerk_time, ..Command::new(verb) }).map(drop)
    }

    /// Finds the reference position, and waits for it. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn home(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Home)).map(drop)
    }

    /// Waits until the last move has ended, at most for this time; false when it goes on. True means that its
    /// position was measured within the window of the target.
    ///
    /// # Errors
    /// [`Error::Failed`] `E106` when it ended elsewhere, `E102` when another master ended it or the motor lost
    /// its power, `E801` for a fault, `E901` when the drive reports no position. Others by source.
    pub fn wait_reached(&self, within: Duration) -> Result<bool, Error> {
        let mut running = self.start(Command::new(Verb::Reached).limited(within))?;
        match running.wait(within) {
            Ok(ended) => Ok(ended.is_some()),
            Err(Error::Failed { outcome, .. })
                if outcome.failure() == Some(Failure::NotReached) =>
            {
                Ok(false)
            }
            Err(error) => Err(error),
        }
    }

    /// Waits until the last move has arrived.
    ///
    /// # Errors
    /// [`Error::Failed`] `E101` when it has not arrived in time; others by blame.
    pub fn wait(&self, within: Duration) -> Result<(), Error> {
        if self.wait_reached(within)? {
            return Ok(());
        }
        let outcome = Outcome::NotDone(Failure::NotReached);
        let what = format!("waiting {} for the move", format_span(within));
        Err(self.outcome_error(&what, RequestKind::Verb(Verb::Reached), outcome))
    }

    /// Makes a verb ready to be started: where a file mounts the axis, its arguments are turned into
    /// the drive's and held against the limits, for which its position may be read. Nothing moves
    /// yet, so that of several axes none starts when one is refused.
    ///
    /// # Errors
    /// [`Error::Usage`] `E223` for what a file's limits do not let through; what reading the position
    /// brings.
    pub fn prepare(&self, command: Command) -> Result<PreparedCommand, Error> {
        self.check_s_time(&command)?;
        // Limits before scales: a command that a file forbids costs no request.
        let mounted = self.apply_mounting(command)?;
        self.check_scales(&command)?;
        Ok(PreparedCommand { axis: self.clone(), command: mounted })
    }

    /// Starts a verb and does not wait for its end.
    ///
    /// # Errors
    /// As [`prepare`](Self::prepare); [`Error::Unsupported`]: nothing was sent.
    pub fn start(&self, command: Command) -> Result<RunningRequest, Error> {
        self.prepare(command)?.start()
    }

    /// Runs a verb to its end. The value is the last one read.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn run(&self, command: Command) -> Result<i64, Error> {
        self.start(command)?.finish()
    }

    /// Runs a verb to its end, at most for this time. The value is the last one read.
    ///
    /// # Errors
    /// [`Error::Failed`] `E101` when it has not ended in time: it goes on until a stop or a newer
    /// command ends it. Others by blame.
    pub fn run_within(&self, command: Command, within: Duration) -> Result<i64, Error> {
        match self.start(command.limited(within))?.wait(within)? {
            Some(value) => Ok(value),
            None => {
                let what = format!("{} within {}", command.verb.name(), format_span(within));
                Err(self.outcome_error(
                    &what,
                    RequestKind::Query,
                    Outcome::NotDone(Failure::NotReached),
                ))
            }
        }
    }

    /// Rehearses a command, and returns its requests step by step. Nothing of it is sent; if a scale depends on
    /// parameters of the drive that were not read yet, those are read.
    ///
    /// # Errors
    /// [`Error::Unsupported`] as the command itself would give.
    pub fn rehearse(&self, command: Command) -> Result<Vec<Rehearsal>, Error> {
        // The bytes depend on the drive's own units; without them the rehearsal would show other bytes than
        // the command sends.
        self.check_s_time(&command)?;
        self.read_factors_of(command.verb)?;
        let command = self.apply_mounting(command)?;
        let rehearsed = self.collect_rehearsal(command);
        rehearsed.map_err(|why| self.unsupported_error(command.verb.name(), why))
    }

    fn collect_rehearsal(&self, command: Command) -> Result<Vec<Rehearsal>, Unsupported> {
        let mut steps = Vec::new();
        self.connection.with_axes(|axes, _| {
            axes.rehearse(self.index, command, &mut |r| {
                let (bytes, frame) = (r.bytes.to_vec(), r.frame.copied());
                steps.push(Rehearsal { step: r.action, bytes, frame });
            })
        })?;
        Ok(steps)
    }

    /// Reads what the scales of a verb's arguments depend on, where it is not known yet.
    fn read_factors_of(&self, verb: Verb) -> Result<(), Error> {
        let steps = self.profile.plan(verb).map_or(&[][..], |plan| plan.steps);
        let scaled = steps.iter().flat_map(Step::operands).filter_map(|(operand, like)| {
            operand.argument()?;
            like
        });
        let mut parameters = scaled.filter_map(|id| self.parameter(id));
        parameters.try_for_each(|p| self.read_unread_factors(p))
    }

    /// Reads signals now, in SI, each parameter once.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` for a signal that the profile has no source for; others by blame.
    pub fn signals(&self, signals: &[Signal]) -> Result<Vec<Reading>, Error> {
        let mut read: Vec<ParameterId> = Vec::new();
        for signal in signals {
            let source = self.profile.signal(*signal).ok_or_else(|| {
                let what = format!("{} does not report its {}", self.profile.name, signal.name());
                let known: Vec<&str> =
                    self.profile.signals.iter().map(|s| s.signal.name()).collect();
                Error::usage("E213", what, format!("it tells {}", known.join(", ")))
            })?;
            if !read.contains(&source.parameter) {
                if let Some(parameter) = self.parameter(source.parameter) {
                    self.read_unread_factors(parameter)?;
                }
                // "Not implemented" is an answer: a value of zero would be a claim.
                if self.read_optional(source.parameter)?.is_none() {
                    let what = format!("{} has no object for its {}", self.label(), signal.name());
                    return Err(Error::usage("E213", what, "the maker did not implement it"));
                }
                read.push(source.parameter);
            }
        }
        // The speed shows whether it moves, too.
        if let Some(source) = self.profile.signal(Signal::Velocity)
            && signals.contains(&Signal::Moving)
            && !read.contains(&source.parameter)
        {
            self.read_optional(source.parameter)?;
        }
        let state = self.state();
        Ok(signals.iter().map(|signal| state.reading(*signal)).collect())
    }

    /// Reads signals again and again, every `period` on the link's clock, until `show` breaks.
    /// Readings that take longer than the period are not caught up with.
    ///
    /// # Errors
    /// As [`signals`](Self::signals).
    pub fn watch(
        &self,
        signals: &[Signal],
        period: Duration,
        mut show: impl FnMut(&[Reading]) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        loop {
            debug_assert!(!signals.is_empty(), "a watch without signals would spin");
            let began = self.connection.now();
            if show(&self.signals(signals)?).is_break() {
                return Ok(());
            }
            // On the link's clock, which in virtual time is not the computer's.
            let spent = self.connection.now().since(began);
            crate::simulate::sleep_on_clock(self.simulation.as_ref(), period.saturating_sub(spent));
        }
    }
}

/// A span for people: with no more digits than milliseconds.
fn format_span(span: Duration) -> String {
    format!("{} s", (span.as_secs_f64() * 1e3).round() / 1e3)
}
