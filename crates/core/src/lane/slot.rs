//! One axis of a lane: its driver, its known state, and the scales between raw values and SI.

use alloc::boxed::Box;
use alloc::vec::Vec;

use super::event_queue::EventQueue;
use super::path::PathStream;
use super::watch::MotionWatch;
use crate::axis::{
    AxisStatus, Command, DriveReport, Driver, Emergency, GroupAnswer, Reading, Refusal, UnmetWait,
    Verb,
};
use crate::error::{Failure, Unsupported};
use crate::plan::{Operand, Step};
use crate::profile::{Access, NoScale, Parameter, ParameterId, Profile, Signal, SignalSource};
use crate::program::MemoryTransfer;
use crate::program::ProgramCommand;
use crate::proto::drive_address;
use crate::station::Counters;
use crate::stream::cyclic::SetpointKind;
use crate::time::Instant;
use crate::units::Unit;

/// A driver behind a pointer, so that one lane serves several families.
pub type BoxedDriver<R, A> = Box<dyn Driver<Request = R, Answer = A> + Send>;

/// Makes the driver of a product at an address.
pub type DriverFactory<R, A> = fn(&'static Profile, u32) -> BoxedDriver<R, A>;

/// A parameter that some scale depends on, and its last value.
#[derive(Clone, Copy, Debug)]
struct ScaleFactor {
    parameter: ParameterId,
    raw: Option<i64>,
    /// A value that was read and is not believed until it is read again: one that it cannot have, or one that may
    /// belong to another request.
    unconfirmed: Option<i64>,
    /// Number of reads: a drive that refuses it is not asked for ever.
    attempts: u8,
    /// True if it is the direction of a value: one reading counts for one value.
    is_direction: bool,
    /// A direction that was read before the last value, and holds for it alone.
    is_spent: bool,
}

/// Parameters that are added to those of an axis' profile at most.
const ADDED_PARAMETERS_MAX: usize = 4096;
/// Greatest number of reads of a factor whose replies are implausible.
// Two equal readings decide; the third is for one that was damaged.
const ATTEMPTS_MAX: u8 = 3;

impl ScaleFactor {
    const fn new(parameter: ParameterId) -> Self {
        let (raw, unconfirmed, attempts) = (None, None, 0);
        Self { parameter, raw, unconfirmed, attempts, is_direction: false, is_spent: false }
    }

    /// Returns whether it is to be asked: once, and again after a value that is not believed yet.
    const fn is_due(&self) -> bool {
        let max = if self.unconfirmed.is_some() { ATTEMPTS_MAX } else { 1 };
        (self.raw.is_none() || self.is_spent) && self.attempts < max
    }

    /// Stores a reading, and returns whether it is plausible. A value that it cannot have may belong to another
    /// request, where replies do not repeat their request; it is accepted when the drive repeats it. With
    /// `is_anonymous` that holds for each new value: one wrong scale would make all later values wrong.
    fn accept_reading(&mut self, raw: i64, possible: bool, is_anonymous: bool) -> bool {
        // A wrong microstep resolution would shift every position by up to 256 times, so a reply that does not
        // name its question counts when it came twice (TMCL-6).
        self.is_spent = false;
        let is_known = !is_anonymous || self.raw == Some(raw);
        if possible && is_known || self.unconfirmed == Some(raw) {
            (self.raw, self.unconfirmed) = (Some(raw), None);
            return true;
        }
        let is_contradicted = self.unconfirmed.is_some();
        if is_anonymous && self.raw.take().is_some() {
            self.attempts = 0;
        }
        self.unconfirmed = Some(raw);
        possible && !is_contradicted
    }
}

/// State of a parameter's scale.
#[derive(Clone, Copy, Debug)]
enum ScaleState {
    /// SI value of one raw unit.
    Known(f64),
    /// The parameters that it depends on have not been read.
    Unread,
    /// There is none: the value is shown raw.
    None(NoScale),
}

pub struct AxisSlot<R, A> {
    pub driver: BoxedDriver<R, A>,
    pub profile: &'static Profile,
    pub state: AxisStatus,
    /// The kind of set-point that it was last prepared for.
    pub setpoint_kind: Option<SetpointKind>,
    /// The path that is streamed to it.
    pub path: Option<Box<PathStream>>,
    /// The running memory transfer, or the last one.
    pub transfer: Option<Box<MemoryTransfer>>,
    /// Counters when its last request was submitted, and the counts during the last request that timed out.
    pub counters_at_request: Counters,
    pub silence_counters: Counters,
    /// True if the drive sent an implausible value, which may belong to another request.
    pub implausible_reply: bool,
    /// The test of the last wait step that timed out.
    pub unmet_wait: Option<UnmetWait>,
    /// The last motion, and its measurements.
    pub motion: MotionWatch,
    factors: Vec<ScaleFactor>,
    /// Cached properties of parameters, by [`ParameterId`].
    entries: Vec<ParameterEntry<R>>,
}

/// Properties of a parameter that are needed often, computed once.
#[derive(Clone, Debug)]
struct ParameterEntry<R> {
    parameter: &'static Parameter,
    /// The request that reads it.
    read_request: Result<R, Unsupported>,
    scale: ScaleState,
    /// Positions, among the factors, of those that its scale depends on.
    inputs: Box<[usize]>,
    /// Index among the factors.
    factor_index: Option<usize>,
    /// Signals that the parameter carries.
    signal_sources: Box<[SignalSource]>,
    /// Not every drive of the profile has it.
    optional: bool,
    /// True if this drive answered that it does not have the parameter.
    missing: bool,
}

impl<R, A> core::fmt::Debug for AxisSlot<R, A> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Slot").field("profile", &self.profile.name).finish_non_exhaustive()
    }
}

impl<R: crate::station::Request, A: Copy + 'static> AxisSlot<R, A> {
    pub fn new(driver: BoxedDriver<R, A>) -> Self {
        let profile = driver.profile();
        let mut factors: Vec<ScaleFactor> = Vec::new();
        for scale in profile.parameters.iter().map(|p| p.scale) {
            for parameter in scale.inputs(profile) {
                if !factors.iter().any(|f| f.parameter == parameter) {
                    factors.push(ScaleFactor::new(parameter));
                }
            }
        }
        let directions = profile.parameters.iter().filter_map(|p| p.scale.negative);
        for (direction, _) in directions {
            let factor = factors.iter_mut().find(|factor| factor.parameter == direction);
            factor.into_iter().for_each(|factor| factor.is_direction = true);
        }
        let motion = MotionWatch::new(driver.is_group());
        let mut slot = Self {
            motion,
            driver,
            profile,
            state: AxisStatus::UNKNOWN,
            setpoint_kind: None,
            path: None,
            transfer: None,
            counters_at_request: Counters::default(),
            silence_counters: Counters::default(),
            implausible_reply: false,
            unmet_wait: None,
            factors,
            entries: Vec::with_capacity(profile.parameters.len()),
        };
        for (id, parameter) in (0..=u16::MAX).map(ParameterId).zip(profile.parameters) {
            slot.add_entry(id, parameter);
        }
        slot.update_scales();
        slot
    }

    fn add_entry(&mut self, id: ParameterId, parameter: &'static Parameter) {
        let signals = self.profile.signals.iter();
        let inputs = parameter.scale.inputs(self.profile);
        self.entries.push(ParameterEntry {
            parameter,
            read_request: match parameter.access {
                Access::Write => Err(Unsupported::WriteOnly(id)),
                _ => self.driver.read_request(parameter),
            },
            scale: constant_si(parameter).map_or(ScaleState::Unread, ScaleState::Known),
            inputs: inputs
                .filter_map(|input| self.factors.iter().position(|f| f.parameter == input))
                .collect(),
            factor_index: self.factors.iter().position(|f| f.parameter == id),
            signal_sources: signals.filter(|signal| signal.parameter == id).copied().collect(),
            optional: self.profile.optional.contains(&id),
            missing: false,
        });
    }

    /// Adds a parameter that the profile does not have. It has an id of its own, and the same one if it
    /// is added again. `None` when there are too many.
    pub fn add_parameter(&mut self, parameter: &'static Parameter) -> Option<ParameterId> {
        let known = self.entries.iter().position(|entry| core::ptr::eq(entry.parameter, parameter));
        // The same definition keeps its number, so that programs that name it again do not fill the table.
        let at = known.unwrap_or(self.entries.len());
        let id = u16::try_from(at).ok().map(ParameterId)?;
        if known.is_none() {
            if at >= self.profile.parameters.len() + ADDED_PARAMETERS_MAX {
                return None;
            }
            self.add_entry(id, parameter);
        }
        Some(id)
    }

    /// The parameter of that id, in the profile or added to it.
    #[inline]
    pub fn parameter(&self, id: ParameterId) -> Option<&'static Parameter> {
        self.entry(id).map(|entry| entry.parameter)
    }

    /// The request that reads a parameter, if it exists and may be read.
    #[inline]
    pub fn read_request(&self, id: ParameterId) -> Result<&R, Unsupported> {
        let entry = self.entry(id).ok_or(Unsupported::NoSuchParameter)?;
        entry.read_request.as_ref().map_err(|unsupported| *unsupported)
    }

    /// [`read_request`](Self::read_request) for a scale that needs no other parameter: the usual case, looked up once.
    #[inline]
    pub fn plain_read_request(&self, id: ParameterId) -> Option<&R> {
        let entry = self.entry(id)?;
        match entry.scale {
            ScaleState::Unread => None,
            _ if entry.parameter.scale.negative.is_some() => None,
            _ => entry.read_request.as_ref().ok(),
        }
    }

    #[inline]
    fn entry(&self, id: ParameterId) -> Option<&ParameterEntry<R>> {
        self.entries.get(usize::from(id.0))
    }

    /// The parameter, if it may be written with that value.
    pub fn check_writable(
        &self,
        id: ParameterId,
        raw: i64,
    ) -> Result<&'static Parameter, Unsupported> {
        let parameter = self.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
        if parameter.access == Access::Read {
            return Err(Unsupported::ReadOnly(id));
        }
        if !parameter.allows_raw(raw) {
            check_range(parameter, id, raw)?;
        }
        Ok(parameter)
    }

    /// Returns the raw value of a parameter in a reply, and stores it in the state and the scales.
    ///
    /// # Errors
    /// The driver's failure for this reply.
    #[inline]
    pub fn handle_answer(
        &mut self,
        now: Instant,
        id: ParameterId,
        answer: &A,
    ) -> Result<i64, Failure> {
        let entry = self.entries.get(usize::from(id.0));
        let raw = self.driver.decode_answer(entry.map(|entry| entry.parameter), answer)?;
        self.record_value(now, id, raw);
        Ok(raw)
    }

    /// Takes a raw reading of a parameter into the state and the scales.
    #[inline]
    pub fn record_value(&mut self, now: Instant, id: ParameterId, raw: i64) {
        debug_assert!(
            usize::from(id.0) < self.entries.len(),
            "a value belongs to a known parameter"
        );
        let Some(entry) = self.entries.get(usize::from(id.0)) else { return };
        if let Some(factor) = entry.factor_index.and_then(|at| self.factors.get_mut(at)) {
            let possible = entry.parameter.allows(raw);
            let before = factor.raw;
            let is_anonymous = self.driver.has_anonymous_replies();
            self.implausible_reply |= !factor.accept_reading(raw, possible, is_anonymous);
            if factor.raw != before {
                self.update_scales();
            }
        }
        let Some(entry) = self.entries.get(usize::from(id.0)) else { return };
        let direction = entry.parameter.scale.negative;
        let direction =
            direction.and_then(|(of, _)| self.factors.iter_mut().find(|f| f.parameter == of));
        if let Some(direction) = direction {
            // A value whose direction was not read before it would be shown with that of an earlier one.
            if core::mem::replace(&mut direction.is_spent, true) {
                return;
            }
            direction.attempts = 0;
        }
        if entry.signal_sources.is_empty() {
            return;
        }
        let si = self.si_per_raw(id).unwrap_or(f64::NAN);
        for source in &entry.signal_sources {
            let masked = raw & source.mask;
            let (raw, value) = if source.is_flag() {
                (i64::from(source.is_set(raw)), f64::from(source.is_set(raw)))
            } else {
                (masked, entry.parameter.encoding.number(masked) * si)
            };
            self.state.set_reading(source.signal, Reading { value, raw, at: Some(now) });
            if source.signal == Signal::Mode {
                self.motion.note_mode(raw);
            }
        }
    }

    /// Processes a message that the drive sent by itself.
    fn handle_report(&mut self, now: Instant, report: DriveReport) {
        match report {
            DriveReport::Parameter(id, raw) => self.record_value(now, id, raw),
            DriveReport::Presence(presence) if presence.invalidates_state() => {
                self.forget_learned()
            }
            DriveReport::Presence(_) | DriveReport::Address(..) => {}
            DriveReport::Signal(signal, raw) => {
                self.state.set_reading(signal, Reading { value: raw as f64, raw, at: Some(now) });
            }
            // Code 0 is the end of all errors.
            DriveReport::Emergency(0) => {}
            DriveReport::Emergency(code) => {
                self.state.emergency = Some(Emergency { code, at: now });
            }
        }
    }

    /// Returns whether the drive reported that it does not have this parameter.
    #[inline]
    pub fn lacks_parameter(&self, id: ParameterId) -> bool {
        self.entry(id).is_some_and(|entry| entry.missing)
    }

    /// Processes a refusal. A refusal that shows that an optional parameter is missing is remembered.
    #[cold]
    pub fn handle_refusal(&mut self, id: ParameterId, code: u32) {
        // "Not now" is not "never": only a refusal for a missing object takes a reading out (STOP-21).
        if self.driver.refusal(code) == Refusal::Missing {
            self.handle_missing(id);
        }
    }

    /// The drive does not have this parameter. That is remembered of an optional one.
    #[cold]
    pub fn handle_missing(&mut self, id: ParameterId) {
        if self.entry(id).is_some_and(|entry| entry.optional) {
            self.mark_lacking(id);
        }
    }

    /// Records that the drive's object at this address has another type, so that it has no such value.
    #[cold]
    pub fn mark_lacking(&mut self, id: ParameterId) {
        let Some(entry) = self.entries.get_mut(usize::from(id.0)) else { return };
        entry.missing = true;
        if entry.missing && entry.factor_index.is_some() {
            self.update_scales();
        }
    }

    /// Computes the scales that depend on other parameters.
    #[cold]
    fn update_scales(&mut self) {
        for at in 0..self.entries.len() {
            if !self.entries[at].parameter.scale.is_constant() {
                self.entries[at].scale = self.scale_from_factors(&self.entries[at]);
            }
        }
    }

    fn scale_from_factors(&self, entry: &ParameterEntry<R>) -> ScaleState {
        let parameter = entry.parameter;
        let factors = || entry.inputs.iter().map(|at| &self.factors[*at]);
        // A missing factor of the scale itself is known to be missing; one of a rule may have a default.
        let direct = [parameter.scale.times, parameter.scale.over];
        let lacks = |id| self.lacks_parameter(id);
        let unread = factors().any(|f| f.raw.is_none() && !lacks(f.parameter));
        if unread && !direct.into_iter().flatten().any(lacks) {
            return ScaleState::Unread;
        }
        match parameter.scale.compute(self.profile, parameter.encoding.is_signed(), &|id| {
            factors().find(|f| f.parameter == id)?.raw
        }) {
            Ok(scale) => ScaleState::Known(scale.factor * parameter.unit.si_factor()),
            Err(why) => ScaleState::None(why),
        }
    }

    /// Returns whether a setting that scales a parameter reads zero. This may be known only after an SI value was
    /// computed with the profile's unit, so no SI value is written then.
    fn is_zero_scaled(&self, id: ParameterId) -> bool {
        let Some(entry) = self.entry(id) else { return false };
        let direct = [entry.parameter.scale.times, entry.parameter.scale.over];
        direct
            .into_iter()
            .flatten()
            .any(|input| self.factors.iter().any(|f| f.parameter == input && f.raw == Some(0)))
    }

    /// The value of a parameter that others are scaled by.
    pub fn scale_input(&self, id: ParameterId) -> Option<i64> {
        self.factors.iter().find(|f| f.parameter == id)?.raw
    }

    /// Returns the reason why a parameter's value has no unit, if it has none.
    pub fn scale_error(&self, id: ParameterId) -> Option<NoScale> {
        match self.entry(id)?.scale {
            ScaleState::None(why) => Some(why),
            _ => None,
        }
    }

    /// Returns whether a step is skipped because the drive lacks its parameter: a write without effect, or a read that
    /// decides nothing. A step that carries the caller's argument, or checks whether the drive is ready, is never
    /// skipped.
    pub fn skips_step(&self, step: &Step) -> bool {
        match *step {
            Step::Write(id, Operand::Constant(_))
            | Step::Ensure(id, _)
            | Step::WriteBits { id, .. }
            | Step::Read(id)
            | Step::Skip { read: id, .. }
            | Step::SkipIfMissing { read: id, .. }
            | Step::NoFault { read: id, .. }
            | Step::Until { read: id, .. } => self.lacks_parameter(id),
            Step::Homed { read: id, .. } => self.lacks_parameter(id),
            Step::Copy { from, to } => self.lacks_parameter(from) || self.lacks_parameter(to),
            _ => false,
        }
    }

    /// The signals that come from a parameter.
    pub fn signal_sources(&self, id: ParameterId) -> &[SignalSource] {
        self.entry(id).map_or(&[], |entry| &entry.signal_sources)
    }

    /// The parameter that a step of this command writes. A plan names those of the path that moves overwrite; a caller
    /// may choose another path.
    pub fn chosen_path_parameter(&self, id: ParameterId, command: &Command) -> ParameterId {
        let of_path = |id: ParameterId| path_number(self.parameter(id)?.name);
        let Some((chosen, own)) = command.path.zip(of_path(id)) else { return id };
        // Parameters of paths are numbered in the order of the paths.
        let offset = chosen as i64 - i64::from(own);
        let other = u16::try_from(i64::from(id.0) + offset).map(ParameterId);
        match other {
            Ok(other) if of_path(other).is_some_and(|n| f64::from(n) == chosen) => other,
            _ => id,
        }
    }

    /// Discards the values that a restart may have changed.
    pub fn forget_learned(&mut self) {
        for factor in &mut self.factors {
            let is_direction = factor.is_direction;
            *factor = ScaleFactor { is_direction, ..ScaleFactor::new(factor.parameter) };
        }
        for entry in &mut self.entries {
            entry.missing = false;
        }
        self.update_scales();
        self.motion.end_start();
        // The person who armed it did so for the drive that was there then.
        self.state.armed = false;
        self.setpoint_kind = None;
    }

    /// A parameter that the scale of `id` depends on, not known and not yet requested.
    #[inline]
    pub fn missing_factor(&self, id: ParameterId) -> Option<ParameterId> {
        let entry = self.entry(id)?;
        let is_known = !matches!(entry.scale, ScaleState::Unread);
        if is_known && entry.parameter.scale.negative.is_none() {
            return None;
        }
        let unread = entry.inputs.iter().map(|at| &self.factors[*at]);
        unread
            .filter(|f| f.is_due() && !self.lacks_parameter(f.parameter))
            .map(|f| f.parameter)
            .next()
    }

    /// Parameters that scales depend on.
    pub fn scale_inputs(&self) -> impl Iterator<Item = ParameterId> {
        self.factors.iter().map(|factor| factor.parameter)
    }

    /// Takes values of parameters that scales depend on, where none was read.
    pub fn adopt_scale_inputs(&mut self, values: &[(ParameterId, i64)]) {
        let unread = |factor: &&mut ScaleFactor| factor.raw.is_none() && !factor.is_direction;
        for factor in self.factors.iter_mut().filter(unread) {
            let value = values.iter().find(|(id, _)| *id == factor.parameter);
            factor.raw = value.map(|(_, raw)| *raw);
        }
        self.update_scales();
    }

    pub fn count_attempt(&mut self, id: ParameterId) {
        if let Some(factor) = self.factors.iter_mut().find(|f| f.parameter == id) {
            factor.attempts = factor.attempts.saturating_add(1);
            if factor.is_spent {
                // It was asked for and did not come: the old direction is none.
                (factor.raw, factor.is_spent) = (None, false);
                self.update_scales();
            }
        }
    }

    #[inline]
    pub fn to_si(&self, id: ParameterId, raw: i64) -> Option<f64> {
        let entry = self.entry(id)?;
        Some(entry.parameter.encoding.number(raw) * self.si_per_raw(id)?)
    }

    pub fn to_raw(&self, id: ParameterId, si: f64) -> Option<i64> {
        if self.is_zero_scaled(id) {
            return None;
        }
        self.entry(id)?.parameter.encoding.raw(si / self.si_per_raw(id)?)
    }

    /// SI value of one raw unit; `None` where it is not known, or the value has no unit.
    pub fn unit_value(&self, id: ParameterId) -> Option<f64> {
        let entry = self.entry(id)?;
        match entry.scale {
            ScaleState::Known(si) => Some(si).filter(|_| entry.parameter.unit != Unit::None),
            ScaleState::Unread | ScaleState::None(_) => None,
        }
    }

    /// SI value of one raw unit; 1 where the value has no unit.
    #[inline]
    pub fn si_per_raw(&self, id: ParameterId) -> Option<f64> {
        match self.entry(id)?.scale {
            ScaleState::Known(si) => Some(si),
            ScaleState::Unread => None,
            ScaleState::None(_) => Some(1.0),
        }
    }

    /// The raw value of an operand. `None` leaves the step out.
    ///
    /// # Errors
    /// The argument is missing, not a number, or out of the range of `like`.
    pub fn operand_value(
        &self,
        operand: Operand,
        command: &Command,
        like: Option<ParameterId>,
    ) -> Result<Option<i64>, Unsupported> {
        let argument = |which| command.argument(which).ok_or(Unsupported::MissingArgument(which));
        let si = match operand {
            Operand::Constant(raw) => return Ok(Some(raw)),
            Operand::Argument(which) => argument(which)?,
            Operand::Magnitude(which) => argument(which)?.abs(),
            Operand::OptionalArgument(which) => match command.argument(which) {
                Some(si) => si,
                None => return Ok(None),
            },
            Operand::OptionalRampTime { argument, speed } => match command.argument(argument) {
                Some(time) if command.raw => time,
                // Nothing ends a ramp of no acceleration.
                Some(rate) if rate > 0.0 => speed.of(command.velocity) / rate,
                Some(_) => return Err(Unsupported::Forbidden(NO_RAMP)),
                None => return Ok(None),
            },
        };
        let id = like.ok_or(Unsupported::BadArgument)?;
        let parameter = self.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
        let raw = if self.is_zero_scaled(id) && command.raw {
            parameter.encoding.raw(si)
        } else {
            self.to_raw(id, si)
        };
        let raw = raw.ok_or(match self.si_per_raw(id) {
            _ if self.is_zero_scaled(id) => Unsupported::Forbidden(NO_SCALE),
            None if self.missing_factor(id).is_none() => Unsupported::Forbidden(NO_SCALE),
            _ => Unsupported::BadArgument,
        })?;
        check_range(parameter, id, raw)?;
        Ok(Some(raw))
    }

    /// The request for a program command; `None` if the drive has no such command.
    pub fn program_request(&self, command: ProgramCommand) -> Option<R> {
        self.driver.programs()?.program_request(command)
    }

    /// Returns whether the reply to [`ProgramCommand::QueryProgram`] means that a program is running.
    pub fn is_program_running(&self, raw: i64) -> bool {
        self.driver.programs().is_some_and(|programs| programs.is_program_running(raw))
    }

    /// The request that ends the drive's own program, if a command has to end it.
    pub fn program_end_request(&self, command: &Command) -> Option<R> {
        let ends = matches!(command.verb, Verb::Stop | Verb::QuickStop) && !command.keep_program;
        self.program_request(ProgramCommand::End).filter(|_| ends)
    }
}

/// Processes a message that the drive at an address sent by itself: updates its axes and queues events.
#[cold]
pub fn handle_unsolicited<R: crate::station::Request, A: Copy + 'static>(
    now: Instant,
    slots: &mut [AxisSlot<R, A>],
    event_queue: &mut Option<Box<EventQueue>>,
    address: u32,
    answer: &A,
) {
    for (n, slot) in slots.iter_mut().enumerate() {
        if drive_address(slot.driver.address()) != address {
            continue;
        }
        for report in slot.driver.decode_unsolicited(answer).into_iter().flatten() {
            let before = event_queue.is_some().then_some(slot.state);
            slot.handle_report(now, report);
            if let (Some(event_queue), Some(before)) = (event_queue.as_mut(), &before) {
                event_queue.push_report(now, n, slot, before, report);
            }
        }
    }
}

/// Processes a reply of one drive of a group for the state of its own axis, if the lane has it.
#[cold]
pub fn record_group_answer<R: crate::station::Request, A: Copy + 'static>(
    now: Instant,
    slots: &mut [AxisSlot<R, A>],
    part: &GroupAnswer,
    profile: &'static Profile,
    id: ParameterId,
) {
    for slot in slots.iter_mut().filter(|slot| slot.driver.address() == part.address) {
        // Parameters that were added to one axis are not those of another.
        if core::ptr::eq(slot.profile, profile) && profile.parameter(id).is_some() {
            slot.record_value(now, id, part.raw);
        }
    }
}

const NO_RAMP: &str = "an acceleration or deceleration is more than zero: this drive is told the time \
                       of the ramp";
const NO_SCALE: &str = "the drive's own setting on which this unit depends (counts of a turn, for \
                        instance) reads zero or cannot be read: set it, or give a profile whose \
                        scale does not need it";

/// The number in the name of a path's parameter: `path 32 speed`.
fn path_number(name: &str) -> Option<u8> {
    name.strip_prefix("path ")?.split_once(' ')?.0.parse().ok()
}

fn constant_si(parameter: &Parameter) -> Option<f64> {
    let scale = parameter.scale;
    scale.is_constant().then(|| scale.factor * parameter.unit.si_factor())
}

fn check_range(parameter: &Parameter, id: ParameterId, raw: i64) -> Result<(), Unsupported> {
    let (min, max) = (parameter.min, parameter.max);
    if parameter.allows(raw) {
        return Ok(());
    }
    Err(Unsupported::OutOfRange { parameter: id, value: raw, min, max })
}
