//! One axis of a lane: its driver, what is known of it, and the scales between raw and SI.

use alloc::boxed::Box;
use alloc::vec::Vec;

use super::news::Tidings;
use super::path::Path;
use super::transfer::Transfer;
use crate::axis::{Command, Driver, Part, Reading, State, Told};
use crate::error::{Failure, Unsupported};
use crate::plan::{Operand, Step};
use crate::profile::{Access, Parameter, ParameterId, Profile, Scale, SignalSource};
use crate::station::Counters;
use crate::stream::cyclic::Setpoint;
use crate::time::Instant;

/// A driver behind a pointer, so that one lane serves several families.
pub type BoxedDriver<R, A> = Box<dyn Driver<Request = R, Answer = A> + Send>;

/// Makes the driver of a product at an address.
pub type MakeDriver<R, A> = fn(&'static Profile, u32) -> BoxedDriver<R, A>;

/// A parameter that some scale depends on, and what is known of it.
#[derive(Clone, Copy, Debug)]
struct Factor {
    parameter: ParameterId,
    raw: Option<i64>,
    /// A value that was told and that it cannot have.
    odd: Option<i64>,
    /// How often it was asked: a drive that refuses it is not asked for ever.
    asked: u8,
}

/// Times a factor is asked at most while what comes cannot be right.
const ODD_MAX: u8 = 3;

impl Factor {
    const fn new(parameter: ParameterId) -> Self {
        Self { parameter, raw: None, odd: None, asked: 0 }
    }

    /// Whether it is to be asked: once, and again after a value that it cannot have.
    const fn is_due(&self) -> bool {
        let most = if self.odd.is_some() { ODD_MAX } else { 1 };
        self.raw.is_none() && self.asked < most
    }

    /// Takes a reading. What it cannot have may belong to another question, where answers do not say
    /// what they answer; a drive that has it all the same says so again.
    /// Returns whether it was believed.
    fn accept_reading(&mut self, raw: i64, possible: bool) -> bool {
        let believed = possible || self.odd == Some(raw);
        if believed {
            (self.raw, self.odd) = (Some(raw), None);
        } else {
            self.odd = Some(raw);
        }
        believed
    }
}

pub struct Slot<R, A> {
    pub driver: BoxedDriver<R, A>,
    pub profile: &'static Profile,
    pub state: State,
    /// What it was last made ready to follow.
    pub follows: Option<Setpoint>,
    /// The path that is streamed to it.
    pub path: Option<Box<Path>>,
    /// What is on its way into its memory or out of it; the last one, when that has ended.
    pub transfer: Option<Box<Transfer>>,
    /// What had been counted when its last request was given to the host, and what came until that
    /// ended in silence, for the last one that did.
    pub asked_at: Counters,
    pub heard: Counters,
    /// It said what it cannot have, which may answer another question.
    pub mistaken: bool,
    factors: Vec<Factor>,
    /// What is needed of a parameter again and again, by [`ParameterId`].
    entries: Vec<Entry<R>>,
}

/// What is needed of a parameter again and again, worked out once.
#[derive(Clone, Debug)]
struct Entry<R> {
    parameter: &'static Parameter,
    /// The request that reads it.
    read: Result<R, Unsupported>,
    /// SI value of one raw unit; `None` when other parameters have a say in it.
    si: Option<f64>,
    /// Its place among the factors.
    factor: Option<usize>,
    /// The signals that it tells.
    sources: Box<[SignalSource]>,
    /// Not every drive of the profile has it.
    optional: bool,
    /// This one said that it does not.
    lacking: bool,
}

impl<R, A> core::fmt::Debug for Slot<R, A> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Slot").field("profile", &self.profile.name).finish_non_exhaustive()
    }
}

impl<R: crate::station::Request, A: Copy + 'static> Slot<R, A> {
    pub fn new(driver: BoxedDriver<R, A>) -> Self {
        let profile = driver.profile();
        let mut factors: Vec<Factor> = Vec::new();
        for scale in profile.parameters.iter().map(|p| p.scale) {
            for parameter in [scale.times, scale.over].into_iter().flatten() {
                if !factors.iter().any(|f| f.parameter == parameter) {
                    factors.push(Factor::new(parameter));
                }
            }
        }
        let mut slot = Self {
            driver,
            profile,
            state: State::UNKNOWN,
            follows: None,
            path: None,
            transfer: None,
            asked_at: Counters::default(),
            heard: Counters::default(),
            mistaken: false,
            factors,
            entries: Vec::with_capacity(profile.parameters.len()),
        };
        for (id, parameter) in (0..=u16::MAX).map(ParameterId).zip(profile.parameters) {
            slot.describe(id, parameter);
        }
        slot
    }

    fn describe(&mut self, id: ParameterId, parameter: &'static Parameter) {
        let signals = self.profile.signals.iter();
        self.entries.push(Entry {
            parameter,
            read: match parameter.access {
                Access::Write => Err(Unsupported::WriteOnly(id)),
                _ => self.driver.read(parameter),
            },
            si: constant_si(parameter),
            factor: self.factors.iter().position(|f| f.parameter == id),
            sources: signals.filter(|signal| signal.parameter == id).copied().collect(),
            optional: self.profile.optional.contains(&id),
            lacking: false,
        });
    }

    /// The request that reads a parameter, if it exists and may be read.
    #[inline]
    pub fn read(&self, id: ParameterId) -> Result<&R, Unsupported> {
        let entry = self.entry(id).ok_or(Unsupported::NoSuchParameter)?;
        entry.read.as_ref().map_err(|unsupported| *unsupported)
    }

    /// The same, where the scale needs nothing else: what happens most, looked up once.
    #[inline]
    pub fn plain_read(&self, id: ParameterId) -> Option<&R> {
        let entry = self.entry(id).filter(|entry| entry.si.is_some())?;
        entry.read.as_ref().ok()
    }

    #[inline]
    fn entry(&self, id: ParameterId) -> Option<&Entry<R>> {
        self.entries.get(usize::from(id.0))
    }

    /// The parameter, if it may be written with that value.
    pub fn writable(&self, id: ParameterId, raw: i64) -> Result<&'static Parameter, Unsupported> {
        let parameter = self.profile.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
        if parameter.access == Access::Read {
            return Err(Unsupported::ReadOnly(id));
        }
        in_range(parameter, id, raw)?;
        Ok(parameter)
    }

    /// The raw value of a parameter in what the drive answered, taken into the state and the scales.
    ///
    /// # Errors
    /// What the driver finds wrong with the answer.
    #[inline]
    pub fn answered(&mut self, now: Instant, id: ParameterId, answer: &A) -> Result<i64, Failure> {
        let entry = self.entries.get(usize::from(id.0));
        let raw = self.driver.answer(entry.map(|entry| entry.parameter), answer)?;
        self.note(now, id, raw);
        Ok(raw)
    }

    /// Takes a raw reading of a parameter into the state and the scales.
    #[inline]
    pub fn note(&mut self, now: Instant, id: ParameterId, raw: i64) {
        let Some(entry) = self.entries.get(usize::from(id.0)) else { return };
        if let Some(factor) = entry.factor.and_then(|at| self.factors.get_mut(at)) {
            let possible = (entry.parameter.min..=entry.parameter.max).contains(&raw);
            self.mistaken |= !factor.accept_reading(raw, possible);
        }
        if entry.sources.is_empty() {
            return;
        }
        let si = entry.si.or_else(|| self.si_by_factors(id)).unwrap_or(f64::NAN);
        for source in &entry.sources {
            let masked = raw & source.mask;
            let (raw, value) = match source.equals {
                Some(equals) => (i64::from(masked == equals), f64::from(masked == equals)),
                None => (masked, masked as f64 * si),
            };
            self.state.note(source.signal, Reading { value, raw, at: Some(now) });
        }
    }

    /// Takes what the drive said unasked.
    fn take(&mut self, now: Instant, told: Told) {
        match told {
            Told::Parameter(id, raw) => self.note(now, id, raw),
            Told::Presence(presence) if presence.forgets() => self.forget(),
            Told::Presence(_) => {}
            Told::Signal(signal, raw) => {
                self.state.note(signal, Reading { value: raw as f64, raw, at: Some(now) });
            }
        }
    }

    /// Whether the drive said that it has no such parameter.
    #[inline]
    pub fn lacks(&self, id: ParameterId) -> bool {
        self.entry(id).is_some_and(|entry| entry.lacking)
    }

    /// Takes a refusal of what was asked of a parameter: one that says that an optional one is not
    /// there is remembered.
    #[cold]
    pub fn refused(&mut self, id: ParameterId, code: u32) {
        let lacking = self.driver.lacks(code);
        let Some(entry) = self.entries.get_mut(usize::from(id.0)) else { return };
        entry.lacking |= lacking && entry.optional;
    }

    /// Whether a step is passed without a word because the drive lacks what it names: what is written
    /// there has no effect to be missed, what is read there decides nothing. One that brings what the
    /// caller asked for, or asks whether the drive is ready, is not.
    pub fn leaves_out(&self, step: &Step) -> bool {
        match *step {
            Step::Write(id, Operand::Is(_))
            | Step::Ensure(id, _)
            | Step::Read(id)
            | Step::Skip { read: id, .. }
            | Step::Without { read: id, .. }
            | Step::NoFault { read: id, .. }
            | Step::Until { read: id, .. } => self.lacks(id),
            Step::Copy { from, to } => self.lacks(from) || self.lacks(to),
            _ => false,
        }
    }

    /// The signals that a parameter tells.
    pub fn sources(&self, id: ParameterId) -> &[SignalSource] {
        self.entry(id).map_or(&[], |entry| &entry.sources)
    }

    /// Forgets what a restarted drive may have changed.
    pub fn forget(&mut self) {
        for factor in &mut self.factors {
            *factor = Factor::new(factor.parameter);
        }
        for entry in &mut self.entries {
            entry.lacking = false;
        }
        self.state.armed = false;
        self.follows = None;
    }

    /// A parameter that the scale of `id` depends on, not known and not yet asked for.
    #[inline]
    pub fn missing(&self, id: ParameterId) -> Option<ParameterId> {
        if self.entry(id)?.si.is_some() {
            return None;
        }
        let scale = self.profile.parameter(id)?.scale;
        let unknown = |p: ParameterId| {
            let due = |f: &Factor| f.parameter == p && f.is_due();
            self.factors.iter().any(due) && !self.lacks(p)
        };
        [scale.times, scale.over].into_iter().flatten().find(|p| unknown(*p))
    }

    pub fn tried(&mut self, id: ParameterId) {
        if let Some(factor) = self.factors.iter_mut().find(|f| f.parameter == id) {
            factor.asked = factor.asked.saturating_add(1);
        }
    }

    #[inline]
    pub fn to_si(&self, id: ParameterId, raw: i64) -> Option<f64> {
        Some(raw as f64 * self.si(id)?)
    }

    pub fn to_raw(&self, id: ParameterId, si: f64) -> Option<i64> {
        let raw = libm::round(si / self.si(id)?);
        // Beyond this a float no longer counts single steps; no drive has such a number.
        (raw.abs() < 9.0e15).then_some(raw as i64)
    }

    /// SI value of one raw unit.
    #[inline]
    fn si(&self, id: ParameterId) -> Option<f64> {
        match self.entry(id)?.si {
            Some(si) => Some(si),
            None => self.si_by_factors(id),
        }
    }

    #[cold]
    fn si_by_factors(&self, id: ParameterId) -> Option<f64> {
        let parameter = self.profile.parameter(id)?;
        let scale = parameter.scale;
        if [scale.times, scale.over].into_iter().flatten().any(|id| self.lacks(id)) {
            return Some(1.0);
        }
        Some(self.factor(scale)? * parameter.unit.si())
    }

    fn factor(&self, scale: Scale) -> Option<f64> {
        let known = |id: Option<ParameterId>| match id {
            None => Some(1.0),
            Some(id) => self.factors.iter().find(|f| f.parameter == id)?.raw.map(|raw| raw as f64),
        };
        let over = known(scale.over)?;
        (over != 0.0).then_some(scale.factor * known(scale.times)? / over)
    }

    /// The raw value of an operand. `None` leaves the step out.
    ///
    /// # Errors
    /// The argument is missing, not a number, or out of the range of `like`.
    pub fn operand(
        &self,
        operand: Operand,
        command: &Command,
        like: Option<ParameterId>,
    ) -> Result<Option<i64>, Unsupported> {
        let si = match operand {
            Operand::Is(raw) => return Ok(Some(raw)),
            Operand::Argument(which) => command.argument(which).ok_or(Unsupported::BadArgument)?,
            Operand::Given(which) => match command.argument(which) {
                Some(si) => si,
                None => return Ok(None),
            },
        };
        let id = like.ok_or(Unsupported::BadArgument)?;
        let parameter = self.profile.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
        let raw = self.to_raw(id, si).ok_or(match self.si(id) {
            None if self.missing(id).is_none() => Unsupported::Forbidden(NO_SCALE),
            _ => Unsupported::BadArgument,
        })?;
        in_range(parameter, id, raw)?;
        Ok(Some(raw))
    }

    /// Whether steps could be carried out, as far as is known by now.
    pub fn check_all(&self, steps: &[Step], command: &Command) -> Result<(), Unsupported> {
        steps.iter().try_for_each(|step| self.check(step, command).map(drop))
    }

    /// Whether a step could be carried out, as far as is known by now: `Ok(false)` when a scale is
    /// still missing.
    pub fn check(&self, step: &Step, command: &Command) -> Result<bool, Unsupported> {
        let (operand, like) = match *step {
            Step::Write(id, operand) => (operand, Some(id)),
            Step::Send { operand, like, .. } => (operand, like),
            _ => return Ok(true),
        };
        if let (Operand::Argument(which) | Operand::Given(which), Some(id)) = (operand, like) {
            match command.argument(which) {
                Some(si) if !si.is_finite() => return Err(Unsupported::BadArgument),
                Some(_) if self.lacks(id) => return Err(Unsupported::Forbidden(LACKING)),
                Some(_) if self.missing(id).is_some() => return Ok(false),
                _ => {}
            }
        }
        let raw = self.operand(operand, command, like)?;
        if let (Step::Write(id, _), Some(raw)) = (*step, raw) {
            self.writable(id, raw)?;
        }
        Ok(true)
    }
}

/// Takes what the drive at an address said unasked into the state of its axes, and tells listeners.
#[cold]
pub fn unasked<R: crate::station::Request, A: Copy + 'static>(
    now: Instant,
    slots: &mut [Slot<R, A>],
    tidings: &mut Option<Box<Tidings>>,
    (address, answer): (u32, &A),
) {
    for (n, slot) in slots.iter_mut().enumerate() {
        if slot.driver.address() != address {
            continue;
        }
        for told in slot.driver.unasked(answer).into_iter().flatten() {
            let before = tidings.is_some().then_some(slot.state);
            slot.take(now, told);
            if let (Some(tidings), Some(before)) = (tidings.as_mut(), &before) {
                tidings.told(now, n, (slot, before), told);
            }
        }
    }
}

/// Takes what one drive of a group answered into the state of its own axis, if the lane has it.
#[cold]
pub fn told<R: crate::station::Request, A: Copy + 'static>(
    now: Instant,
    slots: &mut [Slot<R, A>],
    part: &Part,
    (profile, id): (&'static Profile, ParameterId),
) {
    let of_drive = |slot: &&mut Slot<R, A>| slot.driver.address() == part.address;
    for slot in slots.iter_mut().filter(of_drive) {
        if core::ptr::eq(slot.profile, profile) {
            slot.note(now, id, part.raw);
        }
    }
}

const LACKING: &str = "the drive has no object for this: its maker left out what the standard does \
                       not demand";
const NO_SCALE: &str = "the drive's own setting on which this unit depends (counts of a turn, for \
                        instance) reads zero or cannot be read: set it, or give a profile whose \
                        scale does not need it";

fn constant_si(parameter: &Parameter) -> Option<f64> {
    let scale = parameter.scale;
    let constant = scale.times.is_none() && scale.over.is_none();
    constant.then(|| scale.factor * parameter.unit.si())
}

fn in_range(parameter: &Parameter, id: ParameterId, raw: i64) -> Result<(), Unsupported> {
    let (min, max) = (parameter.min, parameter.max);
    if (min..=max).contains(&raw) {
        return Ok(());
    }
    Err(Unsupported::OutOfRange { parameter: id, value: raw, min, max })
}
