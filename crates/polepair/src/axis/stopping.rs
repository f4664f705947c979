//! A stop, and how far it is known to have come.
//!
//! It is told to the drive, answered step by step, and then looked for in what the drive measures:
//! its speed, or its position twice. Where a drive tells both, they must agree: a motor whose position
//! runs does not stand, whatever its drive tells of its speed. Only readings that were asked after the
//! last of its steps was answered count. What was read before, or what a trajectory says that the motor
//! should do, does not.
//!
//! Why: STOP-7.

mod requests;

use std::time::Duration;

use super::{Axis, Running};
use crate::error::Error;
use crate::url::Number;
use polepair_core::axis::{State, StopPart, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::plan::{Compare, Step, Test};
use polepair_core::profile::{ParameterId, RamMode, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

/// Between two readings whether the motor stands, at least and at most.
const LOOK_EVERY: Duration = Duration::from_millis(10);
const LOOK_EVERY_MAX: Duration = Duration::from_secs(2);
/// For so long a motor that brakes is looked at without a rest.
const BRAKING: Duration = Duration::from_secs(2);
/// After that the pause is so many times what a reading took: a motor that turns on takes 5 % of its wire.
const REST_TIMES: u32 = 19;
/// Readings of the speed in a row that say so: one may lie in a change of direction.
const STANDS_MIN: u32 = 2;
/// Two positions so far apart that differ by one raw step, or by no more than these speeds make: the
/// motor stands. A servo that holds its place is never quite still.
const AGREE_OVER: Duration = Duration::from_millis(100);
const HOLDS_RADIANS: f64 = 0.05;
const HOLDS_METRES: f64 = 0.001;
/// Beside a speed that says that the motor stands, two positions may differ by so many raw steps, because
/// each may be one off, or by so many times the speed that the stop takes for standing.
const DITHER: u64 = 2;
const SLOW_TIMES: f64 = 2.0;
/// A motor that was told to stop, and of which speed and position do not agree, is told again after so long.
const AGAIN_AFTER: Duration = Duration::from_secs(1);
/// So long a motor whose stop was carried out is waited for until it stands.
pub(super) const REST_MAX: Duration = Duration::from_secs(5);
/// So long a group's drives, which do not tell the same, are asked whether they stand.
const DIFFER_MAX: Duration = Duration::from_secs(10);

/// The stop of one axis, for those who wait for nothing: they look again and again.
#[derive(Debug)]
pub struct Stopping {
    begun: Instant,
    stage: Stage,
    class: Class,
    took: Duration,
    trouble: Option<Error>,
    /// Whether the motor stands is asked again where that is not answered, as anything else.
    patient: bool,
}

/// How far a stop is known to have come.
#[derive(Clone, PartialEq, Debug)]
pub enum Class {
    /// It is on the wire.
    Sent,
    /// The drive answered all of it.
    Acknowledged,
    /// The motor stands: that was measured after the drive had answered.
    Still,
    /// The drive answered all of it, and measures nothing by which it could be seen to stand.
    Unseen,
    /// It could not be sent, or was not confirmed; why.
    Failed(Error),
}

/// What is known of a motor whose stop was carried out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Standing {
    /// Its measured speed, or two of its positions, say that it stands.
    Seen,
    /// Its drive tells nothing of that.
    Untold,
}

#[derive(Debug)]
enum Stage {
    /// Asks whether what a stop writes stays out of permanent memory: it is said again.
    Sparing(Running, RamMode),
    /// Sees to it.
    Spared(Running),
    Telling(Running),
    Watching(Watch),
    /// Tells what a motor that stands is told.
    Releasing(Running, Class),
    Over,
}

impl Stopping {
    /// Sends it.
    #[must_use]
    pub fn begin(axis: &Axis) -> Self {
        let mut stopping = Self::new(axis);
        stopping.tell(axis, false);
        stopping
    }

    /// Sends it again to a drive that did not answer, or whose link was away: each of its requests once,
    /// so that a drive that is gone keeps the others' wire for no longer than one question. A drive
    /// that would write permanent memory by it, because it lost its supply, is told not to first.
    #[must_use]
    pub fn again(axis: &Axis) -> Self {
        let mut stopping = Self::new(axis);
        match axis.stop_spares() {
            Some(ram) => match axis.start_spared(ram.parameter) {
                Ok(running) => stopping.stage = Stage::Sparing(running, ram),
                Err(error) => stopping.fail(error),
            },
            None => stopping.tell(axis, true),
        }
        stopping
    }

    /// Of one that was carried out elsewhere: is it seen to stand?
    fn carried_out(axis: &Axis) -> Self {
        let (mut stopping, now) = (Self::new(axis).patiently(), axis.connection().now());
        stopping.came(Class::Acknowledged, now);
        stopping.watch(axis, now);
        stopping
    }

    /// For who waits for this axis alone: an answer that is lost is asked for again.
    pub(super) fn patiently(mut self) -> Self {
        self.patient = true;
        self
    }

    fn watch(&mut self, axis: &Axis, now: Instant) {
        self.stage = Stage::Watching(Watch { once: !self.patient, ..Watch::new(axis, now) });
    }

    fn new(axis: &Axis) -> Self {
        let (begun, stage) = (axis.connection().now(), Stage::Over);
        Self {
            begun,
            stage,
            class: Class::Sent,
            took: Duration::ZERO,
            trouble: None,
            patient: false,
        }
    }

    fn tell(&mut self, axis: &Axis, once: bool) {
        match axis.start_stop(StopPart::Tell, once) {
            Ok(running) => self.stage = Stage::Telling(running),
            Err(error) => self.fail(error),
        }
    }

    fn fail(&mut self, error: Error) {
        (self.class, self.stage) = (Class::Failed(error), Stage::Over);
    }

    /// How far it has come.
    #[must_use]
    pub fn class(&self) -> &Class {
        &self.class
    }

    /// Why it goes no further, where it was answered and the drive then fell silent, or tells that the
    /// motor stands while its position runs.
    #[must_use]
    pub fn trouble(&self) -> Option<&Error> {
        match &self.stage {
            Stage::Watching(watch) => watch.runs.as_ref(),
            _ => self.trouble.as_ref(),
        }
    }

    /// How long that took.
    #[must_use]
    pub fn took(&self) -> Duration {
        self.took
    }

    /// Whether it came to its end, and that was told for so long.
    #[must_use]
    pub fn is_over(&self, axis: &Axis, told: Duration) -> bool {
        let age = axis.connection().now().since(self.begun);
        matches!(self.class, Class::Still | Class::Unseen) && age > self.took + told
    }

    /// Whether something of it is still to be answered: nothing that moves is to be sent meanwhile.
    #[must_use]
    pub fn is_under_way(&self) -> bool {
        !matches!(self.stage, Stage::Watching(_) | Stage::Over)
    }

    /// Whether nothing of it is on the wire yet: its drive is asked something else first.
    #[must_use]
    pub fn is_held_back(&self) -> bool {
        matches!(self.stage, Stage::Sparing(..) | Stage::Spared(_))
    }

    /// Whether nothing more is known of it unless it is said again.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        matches!(self.stage, Stage::Over)
    }

    /// Whether the drive answered all of it and the last reading says that its motor still turns.
    #[must_use]
    pub fn is_seen_turning(&self) -> bool {
        matches!(&self.stage, Stage::Watching(watch) if watch.turns || watch.runs.is_some())
    }

    /// How fast the motor turned at the last reading, where that says that it does: in a unit of the
    /// drive's own, the same for all readings.
    pub(super) fn rate(&self) -> Option<f64> {
        match &self.stage {
            Stage::Watching(watch) if watch.turns => watch.rate,
            _ => None,
        }
    }

    /// Looks how far it has come. Waits for nothing.
    pub fn look(&mut self, axis: &Axis, now: Instant) {
        self.turn(axis, now);
    }

    /// Waits for its end, at most so long.
    pub fn settle(&mut self, axis: &Axis, at_most: Duration) {
        let end = axis.connection().now() + at_most;
        while !self.has_ended() {
            let left = end.since(axis.connection().now());
            if left.is_zero() {
                return;
            }
            // What it comes to is looked at below.
            let _ = match &mut self.stage {
                Stage::Sparing(running, _)
                | Stage::Spared(running)
                | Stage::Telling(running)
                | Stage::Releasing(running, _) => running.wait(left),
                Stage::Watching(Watch { asked: Some((running, ..)), .. }) => running.wait(left),
                Stage::Watching(watch) => {
                    axis.sleep(watch.next.since(axis.connection().now()).min(left));
                    Ok(None)
                }
                Stage::Over => Ok(None),
            };
            self.turn(axis, axis.connection().now());
        }
    }

    fn turn(&mut self, axis: &Axis, now: Instant) {
        match std::mem::replace(&mut self.stage, Stage::Over) {
            Stage::Sparing(mut running, ram) => match running.poll() {
                Ok(None) => self.stage = Stage::Sparing(running, ram),
                Ok(Some(raw)) if raw == ram.ram => self.tell(axis, false),
                Ok(Some(_)) => match axis.start_write(ram.parameter, ram.ram, false) {
                    Ok(running) => self.stage = Stage::Spared(running),
                    Err(_) => self.tell(axis, false),
                },
                // It answers: to stop is worth a write to its memory.
                Err(error) if !is_of_the_wire(&error) => self.tell(axis, false),
                Err(error) => self.fail(error),
            },
            Stage::Spared(mut running) => match running.poll() {
                Ok(None) => self.stage = Stage::Spared(running),
                Err(error) if is_of_the_wire(&error) => self.fail(error),
                Ok(Some(_)) | Err(_) => self.tell(axis, false),
            },
            Stage::Telling(mut running) => match running.poll() {
                Ok(None) => self.stage = Stage::Telling(running),
                Ok(Some(_)) => {
                    // Where nobody answers it, it may have been lost.
                    let index = axis.index;
                    if axis.connection().with(|axes, _| axes.is_confirmed(index)) {
                        self.came(Class::Acknowledged, now);
                    }
                    self.watch(axis, now);
                    self.turn(axis, now);
                }
                Err(error) => self.fail(error),
            },
            Stage::Watching(mut watch) => match watch.look(axis, now) {
                Ok(None) => self.stage = Stage::Watching(watch),
                Ok(Some(class)) => self.release(axis, class, now),
                Err(error) => self.trouble = Some(error),
            },
            Stage::Releasing(mut running, class) => match running.poll() {
                Ok(None) => self.stage = Stage::Releasing(running, class),
                Ok(Some(_)) => self.came(class, now),
                Err(error) => self.trouble = Some(error),
            },
            Stage::Over => {}
        }
    }

    fn came(&mut self, class: Class, now: Instant) {
        (self.class, self.took) = (class, now.since(self.begun));
    }

    /// The motor stands: what is left of the stop is said.
    fn release(&mut self, axis: &Axis, class: Class, now: Instant) {
        let plan = axis.profile().plan(Verb::Stop);
        if plan.is_none_or(|plan| plan.after_wait().is_empty()) {
            return self.came(class, now);
        }
        match axis.start_stop(StopPart::Release, false) {
            Ok(running) => self.stage = Stage::Releasing(running, class),
            Err(error) => self.trouble = Some(error),
        }
    }
}

/// What is measured of a motor that was told to stop.
#[derive(Debug)]
struct Watch {
    since: Instant,
    /// The first is asked for; what the drive does not tell is left out.
    sources: Vec<Source>,
    asked: Option<(Running, Instant, Source)>,
    /// A drive that is silent is asked once.
    once: bool,
    next: Instant,
    /// Readings of the speed in a row that passed, and how many they were at the last position.
    stands: u32,
    looks: u32,
    /// The first of the positions that agree, and when it was asked for.
    position: Option<(Instant, i64)>,
    /// The last reading says that the motor turns.
    turns: bool,
    /// The speed says that it stands, and the last two positions do not.
    runs: Option<Error>,
    /// They do as well.
    agrees: bool,
    /// The speed that was read last.
    speed: i64,
    /// How fast that is, or how far the position went in a second.
    rate: Option<f64>,
    /// Parameters that were read because the scale of the position depends on them.
    factors: usize,
}

/// What tells whether a motor stands.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Source {
    Speed(ParameterId, Test),
    Position(ParameterId),
    /// What the scale of the position depends on.
    Factor(ParameterId),
}

impl Source {
    /// What there is for an axis, the most telling first: a speed for which the stop says what is none,
    /// a position, any other speed.
    fn of(axis: &Axis) -> Vec<Self> {
        let parameter = |signal| axis.profile().signal(signal).map(|source| source.parameter);
        let position = parameter(Signal::Position).map(Self::Position);
        let Some(speed) = parameter(Signal::Velocity) else {
            return position.into_iter().collect();
        };
        match axis.standing_speed() {
            Some(test) => [Self::Speed(speed, test)].into_iter().chain(position).collect(),
            None => {
                let test = Test { mask: -1, compare: Compare::Equal, value: 0 };
                position.into_iter().chain([Self::Speed(speed, test)]).collect()
            }
        }
    }

    fn parameter(self) -> ParameterId {
        match self {
            Self::Speed(id, _) | Self::Position(id) | Self::Factor(id) => id,
        }
    }
}

impl Watch {
    fn new(axis: &Axis, now: Instant) -> Self {
        let (since, sources) = (now, Source::of(axis));
        Self {
            since,
            sources,
            asked: None,
            once: true,
            next: now,
            stands: 0,
            looks: 0,
            position: None,
            turns: false,
            runs: None,
            agrees: false,
            speed: 0,
            rate: None,
            factors: 0,
        }
    }

    /// Whether positions are to agree with a speed that says what is none.
    fn compares(&self) -> bool {
        matches!(self.sources[..], [Source::Speed(..), Source::Position(_)])
    }

    /// What is asked next: a position behind each speed that says that the motor stands.
    fn source(&self, axis: &Axis) -> Option<Source> {
        match self.sources[..] {
            [Source::Speed(..), place @ Source::Position(id)] if self.stands > self.looks => {
                Some(axis.unread_factor(id, self.factors).map_or(place, Source::Factor))
            }
            _ => self.sources.first().copied(),
        }
    }

    /// What is known when it is; an error when the drive answers no longer.
    fn look(&mut self, axis: &Axis, now: Instant) -> Result<Option<Class>, Error> {
        let Some(source) = self.source(axis) else { return Ok(Some(Class::Unseen)) };
        let Some((running, asked, source)) = &mut self.asked else {
            if now >= self.next {
                self.ask(axis, source, now);
            }
            return Ok(None);
        };
        let (asked, source) = (*asked, *source);
        let read = match running.poll() {
            Ok(None) => return Ok(None),
            Ok(Some(raw)) => Ok(raw),
            Err(error) => Err(error),
        };
        self.asked = None;
        let rest = now.since(asked) * REST_TIMES;
        self.next = now
            + match now.since(self.since) < BRAKING {
                true => LOOK_EVERY,
                false => rest.clamp(LOOK_EVERY, LOOK_EVERY_MAX),
            };
        match read {
            Ok(raw) => {
                let stands = self.says(axis, source, raw, (asked, now));
                if let Some((since, _)) = self.position
                    && (self.stands >= STANDS_MIN || !self.compares())
                {
                    // Nothing is told by what is read before.
                    self.next = self.next.max(since + AGREE_OVER);
                }
                Ok(stands.then_some(Class::Still))
            }
            Err(error) if is_of_the_wire(&error) => Err(error),
            Err(error) => {
                let differ = matches!(failure(&error), Some(Failure::NotReady { .. }))
                    && self.sources.first() == Some(&source);
                if !differ || now.since(self.since) >= DIFFER_MAX {
                    self.leave_out(source);
                    self.next = now;
                }
                Ok(None)
            }
        }
    }

    fn ask(&mut self, axis: &Axis, source: Source, now: Instant) {
        match axis.start_look(source.parameter(), self.once) {
            Ok(running) => self.asked = Some((running, now, source)),
            Err(Error::Unsupported { why: Unsupported::Busy, .. }) => {
                self.next = now + LOOK_EVERY;
            }
            Err(_) => self.leave_out(source),
        }
    }

    /// The drive does not tell it.
    fn leave_out(&mut self, source: Source) {
        match source {
            // A position without a scale cannot be held against a speed.
            Source::Factor(_) => self.sources.retain(|other| !matches!(other, Source::Position(_))),
            source => self.sources.retain(|other| *other != source),
        }
    }

    /// Whether the motor stands, by a value that was asked for and then told.
    fn says(&mut self, axis: &Axis, source: Source, raw: i64, at: (Instant, Instant)) -> bool {
        match source {
            Source::Speed(_, test) => {
                (self.turns, self.speed) = (!test.passes(raw), raw);
                self.rate = Some(raw.unsigned_abs() as f64);
                if self.turns {
                    (self.stands, self.looks, self.position) = (0, 0, None);
                    (self.runs, self.agrees) = (None, false);
                } else {
                    self.stands += 1;
                }
            }
            Source::Factor(_) => {
                self.factors += 1;
                return false;
            }
            Source::Position(id) if self.compares() => {
                self.looks = self.stands;
                self.compare(axis, id, raw, at);
            }
            Source::Position(id) => {
                let (since, first) = *self.position.get_or_insert((at.0, raw));
                let over = at.0.since(since);
                if over < AGREE_OVER {
                    return false;
                }
                self.turns = raw.abs_diff(first) > 1 && axis.drifts(id, (first, raw), over, 0.0);
                if self.turns {
                    self.position = Some((at.0, raw));
                    self.rate = Some(raw.abs_diff(first) as f64 / over.as_secs_f64());
                }
                return !self.turns;
            }
        }
        self.stands >= STANDS_MIN && (self.agrees || !self.compares())
    }

    /// Holds a position against the one before, where the speed says that the motor stands.
    fn compare(
        &mut self,
        axis: &Axis,
        id: ParameterId,
        raw: i64,
        (asked, told): (Instant, Instant),
    ) {
        if axis.si(id, raw).is_none() {
            return self.leave_out(Source::Factor(id));
        }
        let (since, first) = *self.position.get_or_insert((asked, raw));
        if asked.since(since) < AGREE_OVER {
            return;
        }
        // No longer than this lies between them, so that they are not called faster than they are.
        let over = told.since(since);
        let slow = axis.standing_speed_si().unwrap_or(0.0) * SLOW_TIMES;
        let runs = raw.abs_diff(first) > DITHER && axis.drifts(id, (first, raw), over, slow);
        self.runs = runs.then(|| axis.does_not_agree(self.speed, (id, first, raw), over));
        (self.agrees, self.position) = (!runs, Some((asked, raw)));
        if runs {
            self.stands = 0;
            self.looks = 0;
        }
    }
}

fn failure(error: &Error) -> Option<Failure> {
    let Error::Failed { outcome, .. } = error else { return None };
    outcome.failure()
}

/// Whether a request ended so because the drive was not heard: it may be answered once it is said again.
fn is_of_the_wire(error: &Error) -> bool {
    use Failure::{Cancelled, LinkDown, Misbehaved, Silent};
    let failed = matches!(failure(error), Some(Silent | Misbehaved | Cancelled | LinkDown));
    failed || matches!(error, Error::Link(_))
}

impl Axis {
    /// Whether the last velocity that was read is more than what the drive's stop takes for standing;
    /// `None` where none was read.
    #[must_use]
    pub fn turns(&self) -> Option<bool> {
        self.turns_in(&self.state())
    }

    pub(super) fn turns_in(&self, state: &State) -> Option<bool> {
        let reading = state.reading(Signal::Velocity);
        reading.at?;
        let standing = self.standing_speed();
        Some(standing.map_or(reading.raw != 0, |test| !test.passes(reading.raw)))
    }

    /// Waits until its motor, which another verb brings to rest, is seen to stand: where that waited for a
    /// measured speed itself, by its position.
    pub(crate) fn see_standing(&self, stopped: Result<(), Error>) -> Result<Standing, Error> {
        stopped?;
        let is_group = Number(self.number).is_group();
        let places = self.profile.signal(Signal::Position).is_some();
        if self.standing_speed().is_some() && (is_group || !places) {
            return Ok(Standing::Seen);
        }
        let end = self.connection.now() + REST_MAX;
        let mut stopping = Stopping::carried_out(self);
        let mut left = REST_MAX;
        while !left.is_zero() && !stopping.has_ended() {
            stopping.settle(self, left.min(AGAIN_AFTER));
            left = end.since(self.connection.now());
            if stopping.trouble().is_some() && !stopping.has_ended() && !left.is_zero() {
                stopping = Stopping::begin(self);
            }
        }
        let (turns, trouble) = (stopping.is_seen_turning(), stopping.trouble().cloned());
        match (stopping.class, trouble) {
            (Class::Still, _) => Ok(Standing::Seen),
            (Class::Unseen, _) => Ok(Standing::Untold),
            (Class::Failed(error), _) | (_, Some(error)) => Err(error),
            // Drives of a group rarely tell the same.
            _ if is_group && !turns => Ok(Standing::Untold),
            _ => Err(self.not_at_rest(REST_MAX)),
        }
    }

    /// How long its motor may take to stand once it was told to stop.
    pub(crate) fn rest_max(&self) -> Duration {
        let steps = self.profile.plan(Verb::Stop).map_or(&[][..], |plan| plan.steps);
        let waits = steps.iter().filter_map(|step| match step {
            Step::Until { within_ms, .. } => Some(Duration::from_millis((*within_ms).into())),
            _ => None,
        });
        waits.fold(REST_MAX, Duration::max)
    }

    /// It was told to stop, and turns on after so long.
    pub(crate) fn not_at_rest(&self, after: Duration) -> Error {
        let what = format!("is not at rest after {} s", after.as_secs());
        self.turns_on(&what, "give its ramp more time, or cut its power")
    }

    /// Its speed says that the motor stands, and two positions say that it does not.
    fn does_not_agree(
        &self,
        speed: i64,
        (id, from, to): (ParameterId, i64, i64),
        over: Duration,
    ) -> Error {
        let told = |id, raw| match self.si(id, raw).and_then(|_| self.value(id, raw).ok()) {
            Some(value) => value.to_string(),
            None => raw.to_string(),
        };
        let velocity = self.profile.signal(Signal::Velocity);
        let speed = velocity.map_or_else(String::new, |source| told(source.parameter, speed));
        let (from, to, ms) = (told(id, from), told(id, to), over.as_millis());
        let what = format!(
            "tells a speed of {speed}, but its position went from {from} to {to} in {ms} ms"
        );
        self.turns_on(&what, "cut its power; then see why its speed is not measured")
    }

    fn turns_on(&self, what: &str, hint: &str) -> Error {
        Error::Failed {
            what: format!("{} was told to stop and {what}", self.label()),
            went: String::new(),
            outcome: Outcome::Unknown(Failure::NotReached),
            may_turn: true,
            heard: Box::default(),
            hint: hint.to_owned(),
        }
    }

    fn si(&self, id: ParameterId, raw: i64) -> Option<f64> {
        self.connection.with(|axes, _| axes.to_si(self.index, id, raw))
    }

    /// Whether a motor went further in that time than one that holds its place, or turns at that speed.
    fn drifts(&self, id: ParameterId, (from, to): (i64, i64), over: Duration, speed: f64) -> bool {
        let holds = match self.profile.parameter(id).map(|parameter| parameter.unit) {
            Some(Unit::Millimetre) => HOLDS_METRES,
            _ => HOLDS_RADIANS,
        };
        let went = self.si(id, from).zip(self.si(id, to)).map(|(from, to)| (to - from).abs());
        went.is_none_or(|went| went > holds.max(speed) * over.as_secs_f64())
    }

    /// The nth parameter that the scale of this one depends on, while that is not known.
    fn unread_factor(&self, id: ParameterId, nth: usize) -> Option<ParameterId> {
        let scale = self.profile.parameter(id)?.scale;
        let factors = [scale.times, scale.over].into_iter().flatten();
        factors.filter(|_| self.si(id, 0).is_none()).nth(nth)
    }

    /// The greatest speed that the drive's stop takes for none.
    fn standing_speed_si(&self) -> Option<f64> {
        let speed = self.profile.signal(Signal::Velocity)?.parameter;
        Some(self.si(speed, self.standing_speed()?.value)?.abs())
    }

    /// What the drive's stop takes for no measured speed, where it waits for that.
    fn standing_speed(&self) -> Option<Test> {
        let speed = self.profile.signal(Signal::Velocity)?.parameter;
        let steps = self.profile.plan(Verb::Stop).map_or(&[][..], |plan| plan.steps);
        steps.iter().find_map(|step| match step {
            Step::Until { read, test, .. } if *read == speed => Some(*test),
            _ => None,
        })
    }
}
