//! Set-points for several axes on one beat: what goes out next, and what the drives tell of it.
//!
//! A beat is a frame for each axis and the signal that makes all of them take it over. Nothing is
//! allocated once it has begun. Whatever goes wrong ends it the same way: every axis is told to come
//! to rest, on one last beat, and is disarmed.
//!
//! Why: CANOPEN-10, CANOPEN-11.

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use core::time::Duration;

use super::slot::Slot;
use crate::error::{Failure, Outcome, Unsupported};
use crate::profile::{ParameterId, Signal};
use crate::station::{AxisIndex, Request, Ticket};
use crate::stream::cyclic::{
    AXES_MAX, Account, Bounds, CYCLES_MAX, Excess, Following, Order, Setpoint, Trend,
};
use crate::time::Instant;

/// So much of the motion waits before it begins, so that a caller who is late now and then is not
/// felt.
const AHEAD: Duration = Duration::from_millis(100);
/// A drive that tells nothing for so long, and for so many beats, is lost.
const SILENCE: Duration = Duration::from_millis(100);
const SILENT_BEATS: u32 = 4;
/// A host that is late by more than this is no hiccup: drives that watch it have given up.
const PAUSE: Duration = Duration::from_millis(100);
const DRY: &str = "there was no set-point for the next cycle, so every axis was stopped: feed them \
                   faster, or choose a longer period";
const LATE: &str = "this computer paused for longer than drives may be left alone, so every axis was \
                    stopped: arm and begin anew; a longer period, or less other work, helps";
const AWAY: &str = "the path begins away from where the axis stands: move there first, or begin it \
                    there";
const LEFT: &str = "a drive is no longer enabled or armed, so every axis was stopped: see its fault \
                    and statusword, then arm and begin anew";
const MOVING: &str =
    "the last set-point is not one at rest, so every axis was stopped: end with zero";

/// One axis of the beat.
#[derive(Debug)]
struct Member {
    axis: u8,
    target: ParameterId,
    bounds: Bounds,
    /// Where what was fed so far ends; `None` before its first set-point.
    fed: Option<Trend>,
    /// What goes out with this beat, raw, and what went out with the one before.
    raw: i64,
    before: i64,
    /// When it last told where it is, and whether it has since the last beat.
    heard: Instant,
    told: bool,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Stage {
    /// Every axis is held, until all were heard and there is enough to begin with.
    Hold,
    Run,
    /// One last beat: come to rest.
    Stop(Outcome),
    Over,
}

/// Several axes on one beat.
#[derive(Debug)]
pub struct Cycle {
    ticket: Ticket,
    setpoint: Setpoint,
    period: Duration,
    members: Box<[Member]>,
    /// Raw, those of a cycle side by side.
    waiting: VecDeque<i64>,
    complete: bool,
    stage: Stage,
    /// When this beat is due, and which of its frames is next.
    due: Instant,
    next: usize,
    account: Account,
    outcome: Option<Outcome>,
}

impl Cycle {
    /// With these axes, each of which was made ready.
    ///
    /// # Errors
    /// [`Unsupported`]: an axis that is not armed, or not ready; no axis, too many, or one twice.
    pub fn new<R: Request, A: Copy + 'static>(
        now: Instant,
        ticket: Ticket,
        following: &Following<'_>,
        slots: &[Slot<R, A>],
    ) -> Result<Self, Unsupported> {
        let axes = following.axes;
        let twice = axes.iter().enumerate().any(|(n, axis)| axes[..n].contains(axis));
        if axes.is_empty() || axes.len() > AXES_MAX || twice || following.period.is_zero() {
            return Err(Unsupported::BadArgument);
        }
        let members = axes.iter().enumerate().map(|(n, axis)| {
            let slot = slots.get(usize::from(axis.0)).ok_or(Unsupported::NoSuchAxis)?;
            let bounds = following.bounds.get(n).copied().unwrap_or_default();
            Member::new(now, *axis, slot, following.setpoint, bounds)
        });
        let members: Box<[Member]> = members.collect::<Result<_, _>>()?;
        Ok(Self {
            ticket,
            setpoint: following.setpoint,
            period: following.period,
            waiting: VecDeque::with_capacity(CYCLES_MAX * members.len()),
            members,
            complete: false,
            stage: Stage::Hold,
            due: now,
            next: 0,
            account: Account::new(),
            outcome: None,
        })
    }

    /// Whether it commands an axis now.
    pub fn commands(&self, axis: AxisIndex) -> bool {
        self.runs() && self.has(axis)
    }

    pub fn has(&self, axis: AxisIndex) -> bool {
        self.members.iter().any(|member| member.axis == axis.0)
    }

    pub const fn account(&self) -> &Account {
        &self.account
    }

    pub const fn ticket(&self) -> Ticket {
        self.ticket
    }

    /// True until all that it has to say is said.
    pub fn runs(&self) -> bool {
        self.stage != Stage::Over
    }

    /// When it next has something to say.
    #[inline]
    pub fn due(&self) -> Option<Instant> {
        self.runs().then_some(self.due)
    }

    pub fn take_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        self.outcome.take().map(|outcome| (self.ticket, outcome))
    }

    /// Takes as many whole cycles as there is room for, and tells how many; `None` once it has
    /// ended.
    pub fn feed<R: Request, A: Copy + 'static>(
        &mut self,
        slots: &[Slot<R, A>],
        setpoints: &[f64],
        complete: bool,
    ) -> Option<usize> {
        if !matches!(self.stage, Stage::Hold | Stage::Run) || self.complete {
            return None;
        }
        let axes = self.members.len();
        let room = CYCLES_MAX - self.waiting.len() / axes;
        let (all, mut taken) = (setpoints.len() / axes, Ok(()));
        for cycle in setpoints.chunks_exact(axes).take(room) {
            taken = taken.and_then(|()| self.take(slots, cycle));
        }
        self.complete = complete && all <= room;
        let rests = |member: &Member| member.fed.is_none_or(|fed| fed.may_end(self.setpoint));
        if self.complete && !self.members.iter().all(rests) {
            taken = taken.and(Err(Failure::NotReady { hint: MOVING }));
        }
        match taken {
            Ok(()) => Some(all.min(room)),
            Err(failure) => {
                self.fail(failure);
                None
            }
        }
    }

    /// Takes the set-points of one cycle, each held to its bounds.
    fn take<R: Request, A: Copy + 'static>(
        &mut self,
        slots: &[Slot<R, A>],
        cycle: &[f64],
    ) -> Result<(), Failure> {
        let period = self.period.as_secs_f64();
        for (member, si) in self.members.iter_mut().zip(cycle) {
            let slot = &slots[usize::from(member.axis)];
            let raw =
                member.judge(slot, self.setpoint, *si, period).map_err(Failure::Impossible)?;
            self.waiting.push_back(raw);
        }
        Ok(())
    }

    /// The next thing to say, if it is time.
    #[inline]
    pub fn poll<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [Slot<R, A>],
    ) -> Option<R> {
        if now < self.due || self.stage == Stage::Over {
            return None;
        }
        if self.next == 0 && !matches!(self.stage, Stage::Stop(_)) {
            self.begin(now, slots);
            let (goes, over) = (self.stage == Stage::Run, self.stage == Stage::Over);
            for member in &self.members {
                let state = &mut slots[usize::from(member.axis)].state;
                state.going = (state.going || goes) && !over;
            }
        }
        let order = match self.stage {
            Stage::Over => return None,
            Stage::Stop(_) => Order::Stop,
            Stage::Hold | Stage::Run => Order::Go,
        };
        // A drive whose mapping is no longer known cannot be told; it has restarted.
        while let Some(member) = self.members.get(self.next) {
            self.next += 1;
            let driver = &slots[usize::from(member.axis)].driver;
            if let Some(request) = driver.follow(self.setpoint, member.raw, order) {
                return Some(request);
            }
        }
        let beat = slots[usize::from(self.members[0].axis)].driver.beat();
        self.sent(now, slots);
        beat
    }

    /// The beat itself is on its way.
    fn sent<R: Request, A: Copy + 'static>(&mut self, now: Instant, slots: &mut [Slot<R, A>]) {
        self.next = 0;
        if let Stage::Stop(outcome) = self.stage {
            (self.stage, self.outcome) = (Stage::Over, Some(outcome));
            for member in &self.members {
                slots[usize::from(member.axis)].state.armed = false;
            }
            return;
        }
        self.account.beats += 1;
        self.account.lateness.note(now.since(self.due).as_nanos() as u64);
        self.due = self.due + self.period;
        self.members.iter_mut().for_each(|member| member.told = false);
    }

    /// A beat begins: is everybody there, and what comes next?
    fn begin<R: Request, A: Copy + 'static>(&mut self, now: Instant, slots: &[Slot<R, A>]) {
        let late = now.since(self.due);
        if late > PAUSE.max(self.period) && self.account.beats > 0 {
            return self.fail(Failure::NotReady { hint: LATE });
        }
        let missed = (late.as_nanos() / self.period.as_nanos()) as u32;
        self.account.missed += u64::from(missed);
        self.due = self.due + self.period * missed;
        if let Some(failure) = self.absent(now, slots) {
            return self.fail(failure);
        }
        match self.stage {
            Stage::Hold if self.may_run() => {
                self.stage = Stage::Run;
                self.advance();
            }
            Stage::Run => self.advance(),
            _ => {}
        }
    }

    /// What is wrong with a drive that has not told its state.
    fn absent<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &[Slot<R, A>],
    ) -> Option<Failure> {
        let patience = SILENCE.max(self.period * SILENT_BEATS);
        let mut absent = None;
        for member in self.members.iter().filter(|_| self.account.beats > 0) {
            self.account.late += u64::from(!member.told);
            if !slots[usize::from(member.axis)].state.armed {
                absent = Some(Failure::NotReady { hint: LEFT });
            } else if now.since(member.heard) > patience {
                absent = Some(Failure::Silent);
            }
        }
        absent
    }

    /// Every drive has answered a beat, and there is enough to begin with.
    fn may_run(&self) -> bool {
        let cycles = self.waiting.len() / self.members.len();
        let enough = self.period * cycles as u32 >= AHEAD || cycles == CYCLES_MAX || self.complete;
        self.account.beats > 0 && enough && self.members.iter().all(|member| member.told)
    }

    /// The set-points of the next cycle.
    fn advance(&mut self) {
        if self.waiting.is_empty() {
            if !self.complete {
                return self.fail(Failure::NotReady { hint: DRY });
            }
            self.stage = Stage::Over;
            self.outcome = Some(Outcome::Done(self.account.cycles.cast_signed()));
            return;
        }
        for member in &mut self.members {
            member.before = member.raw;
            member.raw = self.waiting.pop_front().unwrap_or(member.raw);
        }
        self.account.cycles += 1;
    }

    /// An axis told something: is it well, and where it should be?
    pub fn heard<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        address: u32,
        slots: &[Slot<R, A>],
    ) {
        if !matches!(self.stage, Stage::Hold | Stage::Run) {
            return;
        }
        let of = |member: &&mut Member| slots[usize::from(member.axis)].driver.address() == address;
        let Some(member) = self.members.iter_mut().find(of) else { return };
        let slot = &slots[usize::from(member.axis)];
        let fault = slot.state.reading(Signal::Fault);
        if fault.at == Some(now) && fault.raw != 0 {
            return self.fail(Failure::Faulted { code: fault.raw as u32 });
        }
        let actual = slot.state.reading(actual(self.setpoint));
        if actual.at != Some(now) {
            return;
        }
        (member.heard, member.told) = (now, true);
        if slot.state.reading(Signal::Enabled).raw == 0 {
            return self.fail(Failure::NotReady { hint: LEFT });
        }
        if self.stage == Stage::Run
            && let Some(asked) = slot.to_si(member.target, member.before)
        {
            self.account.lag = self.account.lag.max((asked - actual.value).abs());
        }
    }

    /// A stop of one of its axes came: all of them stop, ahead of it.
    pub fn cancel(&mut self) {
        self.fail(Failure::Cancelled);
    }

    /// The link is down: nobody can be told any more.
    pub fn lose(&mut self) {
        self.fail(Failure::LinkDown);
        if let Stage::Stop(outcome) = self.stage {
            (self.stage, self.outcome) = (Stage::Over, Some(outcome));
        }
    }

    fn fail(&mut self, failure: Failure) {
        self.stage = match self.stage {
            Stage::Hold => Stage::Stop(Outcome::NotDone(failure)),
            Stage::Run => Stage::Stop(Outcome::Unknown(failure)),
            Stage::Stop(_) | Stage::Over => return,
        };
        (self.next, self.due) = (0, Instant::ZERO);
    }
}

impl Member {
    fn new<R: Request, A: Copy + 'static>(
        now: Instant,
        axis: AxisIndex,
        slot: &Slot<R, A>,
        setpoint: Setpoint,
        bounds: Bounds,
    ) -> Result<Self, Unsupported> {
        const NOT_READY: &str = "the drive was not made ready to follow such set-points";
        if !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        let target = slot.driver.followed(setpoint).filter(|_| slot.follows == Some(setpoint));
        let target = target.ok_or(Unsupported::Forbidden(NOT_READY))?;
        let raw = match setpoint {
            Setpoint::Position => slot.state.reading(Signal::Position).raw,
            Setpoint::Velocity | Setpoint::Torque => 0,
        };
        let axis = axis.0;
        Ok(Self { axis, target, bounds, fed: None, raw, before: raw, heard: now, told: true })
    }

    /// The raw value of the next set-point, if it is within all bounds.
    fn judge<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &Slot<R, A>,
        setpoint: Setpoint,
        si: f64,
        period: f64,
    ) -> Result<i64, Unsupported> {
        let raw = slot.to_raw(self.target, si).ok_or(Unsupported::BadArgument)?;
        slot.writable(self.target, raw)?;
        let first = self.fed.is_none();
        let held = || slot.to_si(self.target, self.raw).map(Trend::resting);
        let mut trend = self.fed.or_else(held).ok_or(Unsupported::BadArgument)?;
        let leaps = || (si - trend.last).abs() > self.bounds.apart(period);
        if first && setpoint == Setpoint::Position && leaps() {
            return Err(Unsupported::Forbidden(AWAY));
        }
        let judged = trend.take(&self.bounds, setpoint, si, period);
        judged.map_err(|excess: Excess| Unsupported::Forbidden(excess.hint()))?;
        self.fed = Some(trend);
        Ok(raw)
    }
}

/// What tells how well a drive obeys.
const fn actual(setpoint: Setpoint) -> Signal {
    match setpoint {
        Setpoint::Position => Signal::Position,
        Setpoint::Velocity => Signal::Velocity,
        Setpoint::Torque => Signal::Torque,
    }
}
