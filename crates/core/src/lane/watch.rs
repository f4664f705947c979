//! Steps that wait for the end of a motion: which parameters are read when, and what the
//! [judge](crate::judge) of the axis concludes.
//!
//! An axis has one judge for its last motion; a group has one for each drive that answers. A round reads the drive's
//! own report every 20 ms. Position and speed are added every 100 ms, and at once when the report shows the end of the
//! motion; power, fault and limits every 200 ms. The reasons are read only when the motor stopped elsewhere than at its
//! target.

mod item;

use alloc::vec::Vec;
use core::time::Duration;

use super::job::{PlanRun, StepStage};
use super::measure::{WINDOW_COUNTS_MIN, WINDOW_SHARE};
use super::slot::AxisSlot;
use crate::axis::{Command, MotionReport, Verb};
use crate::error::{Failure, Outcome};
use crate::judge::{MotionGoal, MotionJudge, MotionVerdict};
use crate::plan::{ParameterTest, Step};
use crate::profile::{Encoding, ParameterId, RelativeBase, Signal};
use crate::station::Request;
use crate::time::Instant;
use item::{Item, bits};

/// Interval of reading the drive's own report.
// A TMCL poll at 9,600 baud takes 19 ms, so a slow line is not asked for more than it can carry.
const FLAG_MS: u32 = 20;
/// Interval of reading position and speed while the report shows a running motion.
const MEASURE_MS: u32 = 100;
/// Interval of reading power, fault and limits.
const SAFETY_MS: u32 = 200;
/// Pause before further readings are repeated, as a multiple of their duration.
const ROUND_PAUSE_FACTOR: u32 = 2;
/// Drives of a group that are judged, at most.
const MEMBERS_MAX: usize = 32;
/// Time to look for evidence of a start that was not acknowledged.
// Room for five readings of each of three values on a TMCL line at 9,600 baud.
const PROOF_MS: u32 = 300;

/// The progress of one wait.
#[derive(Clone, Copy, Debug, Default)]
pub struct WatchReads {
    /// Items that are still to be read in this round.
    pending: u16,
    /// The motion that is waited for, as [`MotionWatch::epoch`] counts.
    epoch: Option<u32>,
    began: Option<Instant>,
    round_began: Option<Instant>,
    measure_due: Option<Instant>,
    safety_due: Option<Instant>,
    /// Position and speed are read in this round.
    measured: bool,
    /// Power, fault and limits are.
    has_safety: bool,
    /// The reasons of an end are read in this round.
    examining: bool,
}

/// Next step of a wait.
#[derive(Debug)]
pub enum WatchStep {
    /// Read this parameter.
    Read(ParameterId),
    /// Read this parameter, on which the unit of a position or a speed depends.
    Factor(ParameterId),
    /// Read nothing before then.
    Sleep(Instant),
    /// The wait is over.
    Done,
    /// The wait ended for this reason.
    Failed(Failure),
}

/// The last motion of an axis, or of each drive of a group.
#[derive(Debug)]
pub struct MotionWatch {
    /// Counts the motions of the axis.
    motions: u32,
    /// Number of the motion that is judged.
    epoch: u32,
    members: Vec<(u32, MotionJudge)>,
    /// The judge that each drive of a group begins with.
    first: Option<MotionJudge>,
    /// The last target of a command: what a drive reports may be the target of the moment.
    last_target: Option<i64>,
    /// The motion before, for as long as nothing of the new one is sent.
    before: Option<(u32, Option<MotionJudge>, Option<i64>)>,
    members_before: Vec<(u32, MotionJudge)>,
}

impl MotionWatch {
    /// A watch without a motion. `is_group` reserves memory for the drives of a group.
    pub fn new(is_group: bool) -> Self {
        let members = if is_group { MEMBERS_MAX } else { 1 };
        Self {
            motions: 0,
            epoch: 0,
            members: Vec::with_capacity(members),
            first: None,
            last_target: None,
            before: None,
            members_before: Vec::with_capacity(members),
        }
    }

    /// Begins another motion, or none.
    fn replace(&mut self, first: Option<MotionJudge>) {
        self.motions = self.motions.wrapping_add(1);
        self.members.clear();
        debug_assert!(self.members.is_empty(), "a new motion has no readings");
        (self.epoch, self.first, self.before) = (self.motions, first, None);
    }

    /// Keeps the result of the motion until a part of the next one is sent.
    fn keep_motion(&mut self) {
        core::mem::swap(&mut self.members, &mut self.members_before);
        self.before = Some((self.epoch, self.first, self.last_target));
    }

    /// No plan that starts a motion runs any more.
    pub fn end_start(&mut self) {
        self.before = None;
    }

    /// Nothing of the new motion was sent: the one before goes on.
    fn restore(&mut self) {
        let Some((epoch, first, last_target)) = self.before.take() else { return };
        core::mem::swap(&mut self.members, &mut self.members_before);
        (self.epoch, self.first, self.last_target) = (epoch, first, last_target);
    }

    /// Report of the n-th drive's motion.
    pub fn report(&self, n: usize) -> Option<MotionReport> {
        let (address, judge) = self.members.get(n)?;
        Some(MotionReport {
            address: *address,
            start: judge.start(),
            position: judge.position(),
            target: judge.target(),
            flag: judge.flag(),
            arrived: judge.is_at_target(),
        })
    }

    /// Records a mode reading of any request.
    pub fn note_mode(&mut self, mode: i64) {
        self.members.iter_mut().for_each(|(_, judge)| judge.observe_mode(mode));
    }

    fn judge(&mut self, address: u32) -> Option<&mut MotionJudge> {
        let at = match self.members.iter().position(|(member, _)| *member == address) {
            Some(at) => at,
            // Room was made with the slot: nothing is allocated while motors turn.
            None if self.members.len() < self.members.capacity() => {
                self.members.push((address, self.first?));
                self.members.len() - 1
            }
            None => return None,
        };
        self.members.get_mut(at).map(|(_, judge)| judge)
    }
}

impl<R: Request, A: Copy + 'static> AxisSlot<R, A> {
    /// Begins to judge a motion: results of the last one are forgotten.
    fn begin_watch(&mut self, goal: MotionGoal, command: Option<&Command>) {
        let mut judge = MotionJudge::new(goal, self.tolerance(command));
        if self.readable_signal(Signal::Position).is_none() {
            judge.mark_without_position();
        }
        if self.readable_signal(Signal::Velocity).is_none() {
            judge.mark_without_speed();
        }
        let single = (!self.driver.is_group()).then(|| self.driver.address());
        self.motion.replace(Some(judge));
        self.motion.members.extend(single.map(|address| (address, judge)));
    }

    /// The parameter of a signal that the drive has.
    pub fn readable_signal(&self, signal: Signal) -> Option<ParameterId> {
        let id = self.profile.signal(signal)?.parameter;
        (!self.lacks_parameter(id) && self.read_request(id).is_ok()).then_some(id)
    }

    /// A parameter that the unit of a position or a speed depends on, and that was not read yet.
    fn unread_watch_factor(&self) -> Option<ParameterId> {
        let measured = [Signal::Position, Signal::Velocity];
        measured.into_iter().find_map(|signal| self.missing_factor(self.readable_signal(signal)?))
    }

    /// A parameter that is read before a motion with a goal is started, so that its end can be judged.
    pub fn unread_goal_factor(&self, run: &PlanRun) -> Option<ParameterId> {
        let has_goal = run.verb.is_some_and(|verb| targets_position(verb) || verb == Verb::Home);
        has_goal.then(|| self.unread_watch_factor()).flatten()
    }

    /// Begins a verb: a motion has a goal from now on, and what waits is for this motion.
    pub fn begin_motion(&mut self, run: &mut PlanRun) {
        let Some(verb) = run.verb else { return };
        let goal = match verb {
            _ if targets_position(verb) => MotionGoal::Position([None; 2]),
            Verb::Home => MotionGoal::Reference,
            _ if verb.is_stop() || verb.starts_motion() && verb != Verb::Begin => {
                return self.forget_motion();
            }
            _ => return,
        };
        self.motion.keep_motion();
        // The motion before stays known until this one has started: a refused start changes nothing of it.
        let before = self.motion.before;
        self.begin_watch(goal, Some(&run.command));
        self.motion.before = before;
        // A reading from before the start belongs to another motion, and proves nothing of this
        // one.
        if self.state.motion_active {
            self.motion.members.iter_mut().for_each(|(_, judge)| judge.mark_follows_motion());
        }
        let counts_from_target = match verb {
            Verb::MoveOn => true,
            Verb::MoveBy | Verb::CurveBy | Verb::PrepareBy => {
                self.profile.motion.relative_from != RelativeBase::Actual
            }
            _ => false,
        };
        let mut pending = Item::BEFORE;
        if counts_from_target {
            pending |= bits(&[Item::TargetPosition]);
        }
        // The speed shows whether a turning motor was started, and the flag whether a standing one was.
        if verb != Verb::MoveTo || self.source(Item::Flag, None).is_none() {
            pending |= bits(&[Item::Velocity]);
        }
        // A code that was read already is not read again: it is what the drive may keep.
        match self.state.reading(Signal::Fault) {
            read if read.at.is_some() => {
                let fault = self.stopping_fault(read.raw);
                self.motion.first.iter_mut().for_each(|judge| judge.set_fault_before(fault));
                let members = self.motion.members.iter_mut();
                members.for_each(|(_, judge)| judge.set_fault_before(fault));
            }
            _ => pending |= bits(&[Item::Fault]),
        }
        run.watch = WatchReads { pending, ..WatchReads::default() };
        run.stage = StepStage::Before;
    }

    /// Forgets the motion: a stop, or a command without a target, replaces it.
    pub fn forget_motion(&mut self) {
        self.motion.replace(None);
    }

    /// The last set-point was sent: the axis is waited for at this position.
    pub fn expect_position(&mut self, now: Instant, raw: i64) {
        self.begin_watch(MotionGoal::Position([Some(raw), None]), None);
        self.motion.last_target = Some(raw);
        self.acknowledge_motion(now);
    }

    /// The parameter that is read next before a motion is started.
    pub fn next_before(&self, run: &mut PlanRun) -> Option<ParameterId> {
        self.next_item(&mut run.watch.pending, None)
    }

    /// Computes the targets of the motion, once the position of the axis is known.
    pub fn set_targets(&mut self, run: &PlanRun) {
        let command = run.command;
        let Some(verb) = run.verb.filter(|verb| targets_position(*verb)) else { return };
        let Some(id) = self.profile.signal(Signal::Position).map(|source| source.parameter) else {
            return;
        };
        let way = command.target.and_then(|target| self.target_counts(id, target, command.raw));
        let encoding = self.parameter(id).map_or(Encoding::I32, |p| p.encoding);
        let unscaled = self.unit_value(id).is_none();
        let last = self.motion.last_target;
        let relative = self.profile.motion.relative_from;
        let mut next_target = None;
        for (_, judge) in &mut self.motion.members {
            let before = judge.target_before().or(last);
            let targets = match (verb, relative) {
                (Verb::MoveTo | Verb::CurveTo | Verb::PrepareTo, _) => {
                    [way.and_then(|way| encoding.raw(way)), None]
                }
                (Verb::MoveOn, _) => [
                    offset_target(last, encoding, way),
                    offset_target(judge.target_before(), encoding, way),
                ],
                (_, RelativeBase::Target) => [offset_target(before, encoding, way), None],
                (_, RelativeBase::Actual) => [offset_target(judge.start(), encoding, way), None],
                (_, RelativeBase::Either) => [
                    offset_target(judge.start(), encoding, way),
                    offset_target(before, encoding, way),
                ],
            };
            if unscaled {
                let share = way.map_or(0.0, |way| way.abs() * WINDOW_SHARE);
                judge.set_window(share.max(WINDOW_COUNTS_MIN));
            }
            judge.set_goal(MotionGoal::Position(targets));
            if !matches!(verb, Verb::MoveTo | Verb::CurveTo | Verb::PrepareTo | Verb::MoveOn)
                && relative != RelativeBase::Target
            {
                judge.mark_relative();
            }
            next_target = targets[0];
        }
        self.motion.last_target = next_target;
    }

    /// A plan has ended: a motion of which nothing was sent leaves the one before as it is.
    pub fn end_motion_plan(&mut self, now: Instant, verb: Option<Verb>, outcome: Outcome) {
        if !verb.is_some_and(|verb| targets_position(verb) || verb == Verb::Home) {
            return;
        }
        match outcome {
            Outcome::NotDone(_) => self.motion.restore(),
            _ => self.acknowledge_motion(now),
        }
        self.motion.end_start();
    }

    /// All of a motion's start was acknowledged.
    fn acknowledge_motion(&mut self, now: Instant) {
        self.motion.members.iter_mut().for_each(|(_, judge)| judge.begin(now));
    }

    /// Source of a reading, for a wait whose step has a flag of its own.
    fn source(
        &self,
        item: Item,
        flag: Option<(ParameterId, ParameterTest)>,
    ) -> Option<ParameterId> {
        let rules = &self.profile.motion;
        let signal = |signal| self.readable_signal(signal);
        let id = match item {
            Item::Flag => match flag {
                Some((id, _)) => id,
                None => match self.motion.first.map(|judge| judge.goal()) {
                    Some(MotionGoal::Standstill) => {
                        signal(Signal::Moving).or_else(|| signal(Signal::Reached))?
                    }
                    _ => signal(Signal::Reached).or_else(|| signal(Signal::Moving))?,
                },
            },
            Item::Position => signal(Signal::Position)?,
            Item::Velocity => signal(Signal::Velocity)?,
            Item::Fault => signal(Signal::Fault)?,
            Item::Enabled => signal(Signal::Enabled)?,
            Item::PositiveLimit => signal(Signal::PositiveLimit)?,
            Item::NegativeLimit => signal(Signal::NegativeLimit)?,
            Item::Mode => signal(Signal::Mode)?,
            Item::TargetPosition => signal(Signal::TargetPosition)?,
            Item::Window => rules.window?,
            Item::Halted => rules.halted?.0,
            Item::Stalled => rules.stalled?.0,
        };
        (!self.lacks_parameter(id) && self.read_request(id).is_ok()).then_some(id)
    }

    /// The next parameter of a round. Items that the drive does not have are taken out.
    fn next_item(
        &self,
        pending: &mut u16,
        flag: Option<(ParameterId, ParameterTest)>,
    ) -> Option<ParameterId> {
        for item in Item::ALL {
            let bit = 1 << item as u16;
            if *pending & bit == 0 {
                continue;
            }
            match self.source(item, flag) {
                Some(id) => return Some(id),
                None => *pending &= !bit,
            }
        }
        None
    }

    /// Next step of a wait.
    pub fn poll_watch(&mut self, now: Instant, run: &mut PlanRun, step: Step) -> WatchStep {
        let Some((flag, within_ms)) = wait_of(step) else { return WatchStep::Done };
        if run.watch.began.is_none() {
            // A motion is judged from the end of its start on.
            if matches!(step, Step::Arrival { .. }) && self.motion.before.is_some() {
                return WatchStep::Sleep(now.plus_ms(FLAG_MS));
            }
            if let Some(factor) = self.unread_watch_factor() {
                return WatchStep::Factor(factor);
            }
            self.begin_wait(now, run, step);
        }
        // Another motion has begun on this axis: its readings would be taken for those of the one waited for.
        if run.watch.epoch != Some(self.motion.epoch) {
            return WatchStep::Failed(Failure::Cancelled);
        }
        loop {
            // A slow line is not kept busy with what decides nothing any more.
            let began = run.watch.began.unwrap_or(now);
            let mut judges = self.motion.members.iter().map(|(_, judge)| judge);
            if judges.all(|judge| judge.is_current(began))
                && self.combined_verdict(now) == MotionVerdict::Arrived
            {
                return WatchStep::Done;
            }
            if let Some(id) = self.next_item(&mut run.watch.pending, flag) {
                return WatchStep::Read(id);
            }
            let flagged = self.motion.members.iter().any(|(_, judge)| judge.flag() == Some(true));
            if flagged && !run.watch.measured {
                run.watch.pending = Item::MEASURED;
                run.watch.measured = true;
                continue;
            }
            if core::mem::take(&mut run.watch.examining) {
                self.motion.members.iter_mut().for_each(|(_, judge)| judge.mark_examined(now));
            }
            match self.combined_verdict(now) {
                MotionVerdict::Pending => {}
                MotionVerdict::Examine => {
                    run.watch.pending = Item::REASONS;
                    run.watch.examining = true;
                    continue;
                }
                verdict => return self.end_watch(step, verdict),
            }
            let limit = run.wait_limit_ms(within_ms);
            if run.watch.began.is_some_and(|began| now > began.plus_ms(limit)) {
                return WatchStep::Failed(Failure::NotReached);
            }
            self.begin_round(now, run, step);
            return WatchStep::Sleep(now.plus_ms(FLAG_MS));
        }
    }

    fn begin_wait(&mut self, now: Instant, run: &mut PlanRun, step: Step) {
        let goal = self.motion.first.map(|judge| judge.goal());
        match (step, goal) {
            (Step::Standstill { .. }, _) => self.begin_watch(MotionGoal::Standstill, None),
            (Step::Homed { .. }, Some(MotionGoal::Reference)) => {}
            (Step::Homed { .. }, _) => self.begin_watch(MotionGoal::Reference, Some(&run.command)),
            (_, Some(MotionGoal::Position(_))) => {}
            _ => self.begin_watch(MotionGoal::Idle, None),
        }
        self.acknowledge_motion(now);
        // A motor in motion since the last command had power.
        let enabled = self.state.reading(Signal::Enabled);
        if enabled.at.is_some() && enabled.raw != 0 {
            self.motion.members.iter_mut().for_each(|(_, judge)| judge.mark_enabled());
        }
        run.watch = WatchReads {
            epoch: Some(self.motion.epoch),
            began: Some(now),
            ..WatchReads::default()
        };
        self.begin_round(now, run, step);
        // Once in a wait: it is a setting.
        if matches!(step, Step::Arrival { .. }) {
            run.watch.pending |= bits(&[Item::Window]);
        }
    }

    fn begin_round(&mut self, now: Instant, run: &mut PlanRun, step: Step) {
        let has_flag = self.source(Item::Flag, wait_of(step).and_then(|(flag, _)| flag)).is_some();
        let stops = matches!(step, Step::Standstill { .. });
        let watch = &mut run.watch;
        // On a slow line most of the time is for the report, which ends the wait.
        let cost = watch.round_began.map_or(Duration::ZERO, |began| now.since(began));
        if watch.measured {
            watch.measure_due = Some(pause_after(MEASURE_MS, now, cost));
        }
        if watch.has_safety {
            watch.safety_due = Some(pause_after(SAFETY_MS, now, cost));
        }
        watch.round_began = Some(now.plus_ms(FLAG_MS));
        watch.pending = 0;
        if has_flag && !stops {
            watch.pending |= bits(&[Item::Flag]);
        }
        watch.measured = !has_flag || stops || is_due_by(watch.measure_due, now);
        if watch.measured {
            watch.pending |= Item::MEASURED;
        }
        watch.has_safety = !stops && is_due_by(watch.safety_due, now);
        if watch.has_safety {
            watch.pending |= Item::SAFETY;
        }
        // Without any measured value the drive's report is all there is.
        let measures =
            [Item::Position, Item::Velocity].map(|item| self.source(item, None).is_some());
        if stops && measures == [false; 2] {
            watch.pending |= bits(&[Item::Flag]);
        }
    }

    /// The verdict of all drives: the first that is not done counts.
    fn combined_verdict(&self, now: Instant) -> MotionVerdict {
        let verdicts = || self.motion.members.iter().map(|(_, judge)| judge.verdict(now));
        match verdicts().find(is_pending_verdict) {
            // The reasons are read once all drives have ended.
            Some(_) if verdicts().any(|verdict| verdict == MotionVerdict::Pending) => {
                MotionVerdict::Pending
            }
            Some(verdict) => verdict,
            None => verdicts()
                .find(|verdict| *verdict != MotionVerdict::Arrived)
                .or_else(|| verdicts().next())
                .unwrap_or(MotionVerdict::Unconfirmed),
        }
    }

    fn end_watch(&self, step: Step, verdict: MotionVerdict) -> WatchStep {
        match verdict {
            MotionVerdict::Arrived => WatchStep::Done,
            // The caller of a stop learns elsewhere that nothing could be measured.
            MotionVerdict::Unconfirmed if matches!(step, Step::Standstill { .. }) => {
                WatchStep::Done
            }
            MotionVerdict::Unconfirmed => WatchStep::Failed(Failure::Unconfirmed),
            MotionVerdict::Faulted(code) => WatchStep::Failed(Failure::Faulted { code }),
            MotionVerdict::PowerLost => WatchStep::Failed(Failure::PowerLost),
            MotionVerdict::Ended(reason) => WatchStep::Failed(Failure::Elsewhere(reason)),
            MotionVerdict::Pending | MotionVerdict::Examine => {
                WatchStep::Failed(Failure::NotReached)
            }
        }
    }

    /// Takes a value that was read for a wait, or before a start.
    pub fn observe(
        &mut self,
        now: Instant,
        address: u32,
        run: &WatchValue,
        id: ParameterId,
        raw: i64,
    ) {
        let seen = self.observation(id, raw, run.flag);
        let target = (self.source(Item::TargetPosition, None) == Some(id)).then_some(raw);
        let window =
            (self.profile.motion.window == Some(id)).then(|| self.own_window(id, raw)).flatten();
        // More drives than `MEMBERS_MAX` answered: those beyond are not judged, and the group's end is not
        // delayed by them.
        let Some(judge) = self.motion.judge(address) else { return };
        if run.before {
            judge.observe_before(now, &seen);
            if let Some(target) = target {
                judge.set_target_before(target);
            }
            return;
        }
        if let Some(window) = window {
            judge.set_window(window);
        }
        judge.observe(now, &seen);
    }

    /// Marks a parameter as read, or as not readable now.
    pub fn mark_read(&self, run: &mut PlanRun, id: ParameterId) {
        let flag = run.current_step().and_then(wait_of).and_then(|(flag, _)| flag);
        for item in Item::ALL {
            if self.source(item, flag) == Some(id) {
                run.watch.pending &= !(1 << item as u16);
            }
        }
    }

    /// Marks a parameter as missing: its signals are never known.
    pub fn mark_missing(&mut self, id: ParameterId) {
        let (position, speed) =
            (self.is_signal_of(Signal::Position, id), self.is_signal_of(Signal::Velocity, id));
        let first = self.motion.first.as_mut();
        let members = self.motion.members.iter_mut().map(|(_, judge)| judge);
        for judge in first.into_iter().chain(members) {
            // Without this, the wait would look for a position until its time is over.
            if position {
                judge.mark_without_position();
            }
            if speed {
                judge.mark_without_speed();
            }
        }
    }

    fn is_signal_of(&self, signal: Signal, id: ParameterId) -> bool {
        self.profile.signal(signal).is_some_and(|source| source.parameter == id)
    }

    /// Begins to look for evidence of a start that was not acknowledged. False where none is possible.
    pub fn begin_start_proof(&mut self, now: Instant, run: &mut PlanRun) -> bool {
        let is_start = run.verb.is_some_and(targets_position) && run.undo_reason.is_none();
        if !is_start || self.driver.is_group() {
            return false;
        }
        let mut pending = Item::MEASURED | bits(&[Item::Flag]);
        if self.next_item(&mut pending, None).is_none() {
            return false;
        }
        run.watch = WatchReads { pending, began: Some(now), ..WatchReads::default() };
        true
    }

    /// Returns whether the time is over in which a start without acknowledgement may be proven.
    pub fn is_proof_over(&self, now: Instant, run: &PlanRun) -> bool {
        debug_assert!(!self.driver.is_group(), "the start of a group is not proven");
        let late = run.watch.began.is_none_or(|began| now > began.plus_ms(PROOF_MS));
        let proven = self.motion.members.iter().all(|(_, judge)| judge.proves_start());
        let mut pending = run.watch.pending;
        late && self.next_item(&mut pending, None).is_none() && !proven
    }

    /// Looks whether a start that was not acknowledged was executed: `Done` if it was.
    pub fn poll_start_proof(&self, now: Instant, run: &mut PlanRun) -> WatchStep {
        if let Some(id) = self.next_item(&mut run.watch.pending, None) {
            return WatchStep::Read(id);
        }
        if self.motion.members.iter().all(|(_, judge)| judge.proves_start()) {
            return WatchStep::Done;
        }
        run.watch.pending = Item::MEASURED | bits(&[Item::Flag]);
        WatchStep::Sleep(now.plus_ms(FLAG_MS))
    }
}

fn is_pending_verdict(verdict: &MotionVerdict) -> bool {
    matches!(verdict, MotionVerdict::Pending | MotionVerdict::Examine)
}

fn is_due_by(at: Option<Instant>, now: Instant) -> bool {
    at.is_none_or(|at| at <= now.plus_ms(FLAG_MS))
}

fn pause_after(ms: u32, now: Instant, cost: Duration) -> Instant {
    now + Duration::from_millis(ms.into()).max(cost * ROUND_PAUSE_FACTOR)
}

fn offset_target(base: Option<i64>, encoding: Encoding, way: Option<f64>) -> Option<i64> {
    let sum = encoding.number(base?) + way?;
    encoding.raw(sum)
}

/// Purpose of a reading.
#[derive(Clone, Copy, Debug)]
pub struct WatchValue {
    /// Before the start of a motion.
    pub before: bool,
    /// The flag of the step that waits, where it has one of its own.
    pub flag: Option<(ParameterId, ParameterTest)>,
}

impl WatchValue {
    /// Purpose in the current step of a run.
    pub fn of(run: &PlanRun) -> Self {
        let flag = run.current_step().and_then(wait_of).and_then(|(flag, _)| flag);
        Self { before: run.is_before_start(), flag }
    }
}

/// The flag of a step that waits for a motion, and its time limit.
fn wait_of(step: Step) -> Option<(Option<(ParameterId, ParameterTest)>, u32)> {
    match step {
        Step::Standstill { within_ms } => Some((None, within_ms)),
        Step::Homed { read, test, within_ms } => Some((Some((read, test)), within_ms)),
        Step::Arrival { flag, within_ms } => Some((flag, within_ms)),
        _ => None,
    }
}

/// Returns whether a verb goes to a position.
pub fn targets_position(verb: Verb) -> bool {
    verb.is_move() || matches!(verb, Verb::PrepareTo | Verb::PrepareBy)
}
