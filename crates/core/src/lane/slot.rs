//! One axis of a lane: its driver, what is known of it, and the scales between raw and SI.

use alloc::boxed::Box;
use alloc::vec::Vec;

use crate::axis::{Command, Driver, Reading, State};
use crate::error::Unsupported;
use crate::plan::{Operand, Step};
use crate::profile::{Access, Parameter, ParameterId, Profile, Scale};
use crate::time::Instant;

/// A driver behind a pointer, so that one lane serves several families.
pub type BoxedDriver<R, A> = Box<dyn Driver<Request = R, Answer = A> + Send>;

/// A parameter that some scale depends on, and what is known of it.
#[derive(Clone, Copy, Debug)]
struct Factor {
    parameter: ParameterId,
    raw: Option<i64>,
    /// Asked once already: a drive that refuses it is not asked for ever.
    tried: bool,
}

pub struct Slot<R, A> {
    pub driver: BoxedDriver<R, A>,
    pub profile: &'static Profile,
    pub state: State,
    factors: Vec<Factor>,
    /// Per parameter: whether a reading of it tells a signal or a factor.
    telling: Vec<bool>,
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
                    factors.push(Factor { parameter, raw: None, tried: false });
                }
            }
        }
        let tells = |id: ParameterId| {
            profile.signals.iter().any(|s| s.parameter == id)
                || factors.iter().any(|f| f.parameter == id)
        };
        let ids = (0..profile.parameters.len()).filter_map(|n| u16::try_from(n).ok());
        let telling = ids.map(|n| tells(ParameterId(n))).collect();
        Self { driver, profile, state: State::UNKNOWN, factors, telling }
    }

    /// The parameter, if it exists and may be accessed that way.
    pub fn readable(&self, id: ParameterId) -> Result<&'static Parameter, Unsupported> {
        let parameter = self.profile.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
        match parameter.access {
            Access::Write => Err(Unsupported::WriteOnly(id)),
            _ => Ok(parameter),
        }
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

    /// Takes a raw reading of a parameter into the state and the scales.
    pub fn note(&mut self, now: Instant, id: ParameterId, raw: i64) {
        if !self.telling.get(usize::from(id.0)).is_some_and(|t| *t) {
            return;
        }
        if let Some(factor) = self.factors.iter_mut().find(|f| f.parameter == id) {
            factor.raw = Some(raw);
        }
        for source in self.profile.signals.iter().filter(|s| s.parameter == id) {
            let masked = raw & source.mask;
            let (raw, value) = match source.equals {
                Some(equals) => (i64::from(masked == equals), f64::from(masked == equals)),
                None => (masked, self.to_si(id, masked).unwrap_or(f64::NAN)),
            };
            self.state.note(source.signal, Reading { value, raw, at: Some(now) });
        }
    }

    /// Forgets what a restarted drive may have changed.
    pub fn forget(&mut self) {
        for factor in &mut self.factors {
            (factor.raw, factor.tried) = (None, false);
        }
        self.state.armed = false;
    }

    /// A parameter that the scale of `id` depends on, not known and not yet asked for.
    pub fn missing(&self, id: ParameterId) -> Option<ParameterId> {
        if self.factors.is_empty() {
            return None;
        }
        let scale = self.profile.parameter(id)?.scale;
        let unknown = |p: ParameterId| {
            self.factors.iter().any(|f| f.parameter == p && f.raw.is_none() && !f.tried)
        };
        [scale.times, scale.over].into_iter().flatten().find(|p| unknown(*p))
    }

    pub fn tried(&mut self, id: ParameterId) {
        if let Some(factor) = self.factors.iter_mut().find(|f| f.parameter == id) {
            factor.tried = true;
        }
    }

    pub fn to_si(&self, id: ParameterId, raw: i64) -> Option<f64> {
        let parameter = self.profile.parameter(id)?;
        Some(raw as f64 * self.factor(parameter.scale)? * parameter.unit.si())
    }

    pub fn to_raw(&self, id: ParameterId, si: f64) -> Option<i64> {
        let parameter = self.profile.parameter(id)?;
        let raw = si / (self.factor(parameter.scale)? * parameter.unit.si());
        let raw = libm::round(raw);
        // Beyond this a float no longer counts single steps; no drive has such a number.
        (raw.abs() < 9.0e15).then_some(raw as i64)
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
        let raw = self.to_raw(id, si).ok_or(Unsupported::BadArgument)?;
        in_range(parameter, id, raw)?;
        Ok(Some(raw))
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

fn in_range(parameter: &Parameter, id: ParameterId, raw: i64) -> Result<(), Unsupported> {
    let (min, max) = (parameter.min, parameter.max);
    if (min..=max).contains(&raw) {
        return Ok(());
    }
    Err(Unsupported::OutOfRange { parameter: id, value: raw, min, max })
}
