//! Cyclic set-points for several axes: the next frames to send, and the replies of the drives.
//!
//! A cycle is one frame for each axis, and the signal that makes all axes accept it. Nothing is allocated
//! after the start. Every error ends it the same way: all axes are stopped in one last cycle, and disarmed.
//!
//! Why: CANOPEN-10, CANOPEN-11.

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use core::time::Duration;

use super::slot::AxisSlot;
use crate::error::{Failure, Outcome, Unsupported};
use crate::profile::{ParameterId, Signal};
use crate::station::{AxisIndex, Request, Ticket};
use crate::stream::cyclic::{
    AXES_MAX, BoundsViolation, CYCLES_MAX, CycleStatistics, CyclicConfig, SetpointBounds,
    SetpointCommand, SetpointKind, SetpointTracker,
};
use crate::time::Instant;

/// Part of the motion that is buffered before it begins, so that a caller who is late at times causes no gap.
const PREFILL: Duration = Duration::from_millis(100);
/// Silence of a drive, together with a number of beats, after which it counts as lost.
const SILENCE_MAX: Duration = Duration::from_millis(100);
// One lost report is usual on a full bus; at long periods four of them are longer than `SILENCE_MAX`.
const SILENT_CYCLES: u32 = 4;
/// A host that is late by more than this is no hiccup: drives that watch it have given up.
const HOST_PAUSE_MAX: Duration = Duration::from_millis(100);
const UNDERRUN: &str = "there was no set-point for the next cycle, so every axis was stopped: \
 feed them \
                   faster, or choose a longer period";
const HOST_PAUSED: &str = "this computer paused for longer than drives may be left alone, so \
 every axis was \
                    stopped: arm and begin anew; a longer period, or less other work, helps";
const START_TOO_FAR: &str = "the path does not begin at the actual position of the axis: move \
 there first, or begin it \
                    there";
const DRIVE_DISABLED: &str = "a drive is no longer enabled or armed, so every axis was stopped: \
 see its fault \
                    and statusword, then arm and begin anew";
const NOT_AT_REST: &str =
    "the last set-point is not one at rest, so every axis was stopped: end with zero";

/// One axis of the beat.
#[derive(Debug)]
struct CyclicAxis {
    axis: u8,
    target: ParameterId,
    bounds: SetpointBounds,
    /// End of the fed set-points; `None` before the first.
    tracker: Option<SetpointTracker>,
    /// Raw set-point of this beat, and of the previous one.
    raw: i64,
    previous_raw: i64,
    /// Time of its last reported position, and whether one arrived since the last beat.
    reported_at: Instant,
    reported: bool,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum CyclicStage {
    /// Holds every axis until all drives have reported and enough set-points are queued.
    Hold,
    Run,
    /// One last beat: come to rest.
    Stop(Outcome),
    Ended,
}

/// Several axes on one beat.
#[derive(Debug)]
pub struct CyclicMotion {
    ticket: Ticket,
    setpoint_kind: SetpointKind,
    period: Duration,
    timeout_scale: u32,
    axes: Box<[CyclicAxis]>,
    /// Raw, those of a cycle side by side.
    queue: VecDeque<i64>,
    complete: bool,
    stage: CyclicStage,
    /// When this beat is due, and which of its frames is next.
    due: Instant,
    next_axis: usize,
    statistics: CycleStatistics,
    outcome: Option<Outcome>,
}

impl CyclicMotion {
    /// With these axes, each of which was made ready.
    ///
    /// # Errors
    /// [`Unsupported`]: an axis that is not armed, or not ready; no axis, too many, or one twice.
    pub fn new<R: Request, A: Copy + 'static>(
        now: Instant,
        ticket: Ticket,
        following: &CyclicConfig<'_>,
        slots: &[AxisSlot<R, A>],
    ) -> Result<Self, Unsupported> {
        let axes = following.axes;
        let twice = axes.iter().enumerate().any(|(n, axis)| axes[..n].contains(axis));
        if axes.is_empty() || axes.len() > AXES_MAX || twice || following.period.is_zero() {
            return Err(Unsupported::BadArgument);
        }
        let members = axes.iter().enumerate().map(|(n, axis)| {
            let slot = slots.get(usize::from(axis.0)).ok_or(Unsupported::NoSuchAxis)?;
            // An axis without bounds would follow any set-point.
            let bounds = *following.bounds.get(n).ok_or(Unsupported::BadArgument)?;
            CyclicAxis::new(now, *axis, slot, following.setpoint, bounds)
        });
        let members: Box<[CyclicAxis]> = members.collect::<Result<_, _>>()?;
        Ok(Self {
            ticket,
            setpoint_kind: following.setpoint,
            period: following.period,
            timeout_scale: following.timeout_scale,
            // All memory is taken here. An allocation in a cycle may take longer than the cycle.
            queue: VecDeque::with_capacity(CYCLES_MAX * members.len()),
            axes: members,
            complete: false,
            stage: CyclicStage::Hold,
            due: now,
            next_axis: 0,
            statistics: CycleStatistics::new(),
            outcome: None,
        })
    }

    /// Returns whether it commands an axis now.
    pub fn is_commanding(&self, axis: AxisIndex) -> bool {
        self.is_running() && self.has_axis(axis)
    }

    pub fn has_axis(&self, axis: AxisIndex) -> bool {
        self.axes.iter().any(|member| member.axis == axis.0)
    }

    pub const fn statistics(&self) -> &CycleStatistics {
        &self.statistics
    }

    pub const fn ticket(&self) -> Ticket {
        self.ticket
    }

    /// True until its last frame is sent.
    pub fn is_running(&self) -> bool {
        self.stage != CyclicStage::Ended
    }

    /// Time of its next request.
    #[inline]
    pub fn due(&self) -> Option<Instant> {
        self.is_running().then_some(self.due)
    }

    /// The end, once. Axes that followed positions are waited for at the last of them from then on.
    pub fn take_outcome<R: Request, A: Copy + 'static>(
        &mut self,
        slots: &mut [AxisSlot<R, A>],
    ) -> Option<(Ticket, Outcome)> {
        let outcome = self.outcome.take()?;
        let follows_positions = self.setpoint_kind == SetpointKind::Position;
        if follows_positions && matches!(outcome, Outcome::Done(_)) {
            for member in &self.axes {
                let slot = &mut slots[usize::from(member.axis)];
                let position = slot.readable_signal(Signal::Position);
                let si = slot.to_si(member.target, member.raw);
                if let Some(raw) = position.and_then(|id| slot.to_raw(id, si?)) {
                    slot.expect_position(self.due, raw);
                }
            }
        }
        Some((self.ticket, outcome))
    }

    /// Takes as many whole cycles as there is room for, and returns how many; `None` once it has ended.
    pub fn feed_cycles<R: Request, A: Copy + 'static>(
        &mut self,
        slots: &[AxisSlot<R, A>],
        setpoints: &[f64],
        complete: bool,
    ) -> Option<usize> {
        if !matches!(self.stage, CyclicStage::Hold | CyclicStage::Run) || self.complete {
            return None;
        }
        let axes = self.axes.len();
        debug_assert_eq!(self.queue.len() % axes, 0, "the queue holds whole cycles");
        let capacity = CYCLES_MAX - self.queue.len() / axes;
        let (all, mut taken) = (setpoints.len() / axes, Ok(()));
        for cycle in setpoints.chunks_exact(axes).take(capacity) {
            taken = taken.and_then(|()| self.queue_cycle(slots, cycle));
        }
        self.complete = complete && all <= capacity;
        let rests =
            |member: &CyclicAxis| member.tracker.is_none_or(|fed| fed.may_end(self.setpoint_kind));
        if self.complete && !self.axes.iter().all(rests) {
            taken = taken.and(Err(Failure::NotReady { hint: NOT_AT_REST }));
        }
        match taken {
            Ok(()) => Some(all.min(capacity)),
            Err(failure) => {
                self.fail(failure);
                None
            }
        }
    }

    /// Takes the set-points of one cycle, each held to its bounds.
    fn queue_cycle<R: Request, A: Copy + 'static>(
        &mut self,
        slots: &[AxisSlot<R, A>],
        cycle: &[f64],
    ) -> Result<(), Failure> {
        let period = self.period.as_secs_f64();
        for (member, si) in self.axes.iter_mut().zip(cycle) {
            let slot = &slots[usize::from(member.axis)];
            let raw = member
                .check_setpoint(slot, self.setpoint_kind, *si, period)
                .map_err(Failure::Impossible)?;
            self.queue.push_back(raw);
        }
        Ok(())
    }

    /// The next request, if it is due.
    #[inline]
    pub fn poll_request<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [AxisSlot<R, A>],
    ) -> Option<R> {
        if now < self.due || self.stage == CyclicStage::Ended {
            return None;
        }
        if self.next_axis == 0 && !matches!(self.stage, CyclicStage::Stop(_)) {
            self.begin_cycle(now, slots);
            let (goes, over) = (self.stage == CyclicStage::Run, self.stage == CyclicStage::Ended);
            for member in &self.axes {
                let state = &mut slots[usize::from(member.axis)].state;
                state.motion_active = (state.motion_active || goes) && !over;
            }
        }
        let command = match self.stage {
            CyclicStage::Ended => return None,
            CyclicStage::Stop(_) => SetpointCommand::Stop,
            CyclicStage::Hold | CyclicStage::Run => SetpointCommand::Follow,
        };
        // A drive of unknown mapping cannot be commanded; it has restarted.
        while let Some(member) = self.axes.get(self.next_axis) {
            self.next_axis += 1;
            let driver = &slots[usize::from(member.axis)].driver;
            let request = driver.cycles().and_then(|cycles| {
                cycles.setpoint_request(self.setpoint_kind, member.raw, command)
            });
            if let Some(request) = request {
                return Some(request);
            }
        }
        let first = &slots[usize::from(self.axes[0].axis)].driver;
        let beat = first.cycles().and_then(|cycles| cycles.sync_request());
        self.finish_cycle(now, slots);
        beat
    }

    /// The beat itself is on its way.
    fn finish_cycle<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [AxisSlot<R, A>],
    ) {
        self.next_axis = 0;
        if let CyclicStage::Stop(outcome) = self.stage {
            (self.stage, self.outcome) = (CyclicStage::Ended, Some(outcome));
            for member in &self.axes {
                slots[usize::from(member.axis)].state.armed = false;
            }
            return;
        }
        self.statistics.syncs += 1;
        self.statistics.lateness.record(now.since(self.due).as_nanos() as u64);
        // From the planned time, not from now: otherwise each delay would shift all later beats.
        self.due = self.due + self.period;
        self.axes.iter_mut().for_each(|member| member.reported = false);
    }

    /// Begins a beat: checks that all axes take part, and selects the next set-points.
    fn begin_cycle<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &[AxisSlot<R, A>],
    ) {
        let late = now.since(self.due);
        if late > HOST_PAUSE_MAX.max(self.period) * self.timeout_scale && self.statistics.syncs > 0
        {
            return self.fail(Failure::NotReady { hint: HOST_PAUSED });
        }
        let missed = (late.as_nanos() / self.period.as_nanos()) as u32;
        self.statistics.missed_cycles += u64::from(missed);
        // Missed beats are left out. To make them up would send a burst, and drives would jump.
        self.due = self.due + self.period * missed;
        if let Some(failure) = self.check_reports(now, slots) {
            return self.fail(failure);
        }
        match self.stage {
            CyclicStage::Hold if self.is_ready() => {
                self.stage = CyclicStage::Run;
                self.advance();
            }
            CyclicStage::Run => self.advance(),
            _ => {}
        }
    }

    /// The failure of a drive that has not reported its state.
    fn check_reports<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &[AxisSlot<R, A>],
    ) -> Option<Failure> {
        debug_assert!(!self.axes.is_empty(), "a beat has axes");
        let patience = SILENCE_MAX.max(self.period * SILENT_CYCLES) * self.timeout_scale;
        let mut absent = None;
        for member in self.axes.iter().filter(|_| self.statistics.syncs > 0) {
            self.statistics.late_reports += u64::from(!member.reported);
            if !slots[usize::from(member.axis)].state.armed {
                absent = Some(Failure::NotReady { hint: DRIVE_DISABLED });
            } else if now.since(member.reported_at) > patience {
                absent = Some(Failure::Silent);
            }
        }
        absent
    }

    /// Every drive has answered a beat, and there is enough to begin with.
    fn is_ready(&self) -> bool {
        let cycles = self.queue.len() / self.axes.len();
        let enough =
            self.period * cycles as u32 >= PREFILL || cycles == CYCLES_MAX || self.complete;
        self.statistics.syncs > 0 && enough && self.axes.iter().all(|member| member.reported)
    }

    /// The set-points of the next cycle.
    fn advance(&mut self) {
        if self.queue.is_empty() {
            if !self.complete {
                return self.fail(Failure::NotReady { hint: UNDERRUN });
            }
            self.stage = CyclicStage::Ended;
            self.outcome = Some(Outcome::Done(self.statistics.cycles.cast_signed()));
            return;
        }
        for member in &mut self.axes {
            member.previous_raw = member.raw;
            debug_assert!(!self.queue.is_empty(), "a cycle has a set-point for each axis");
            member.raw = self.queue.pop_front().unwrap_or(member.raw);
        }
        self.statistics.cycles += 1;
    }

    /// Checks a drive's report: its state and its position against the set-point.
    pub fn handle_report<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        address: u32,
        slots: &[AxisSlot<R, A>],
    ) {
        if !matches!(self.stage, CyclicStage::Hold | CyclicStage::Run) {
            return;
        }
        let of =
            |member: &&mut CyclicAxis| slots[usize::from(member.axis)].driver.address() == address;
        let Some(member) = self.axes.iter_mut().find(of) else { return };
        let slot = &slots[usize::from(member.axis)];
        let fault = slot.state.reading(Signal::Fault);
        if fault.at == Some(now) && fault.raw != 0 {
            return self.fail(Failure::Faulted { code: slot.profile.fault_word(fault.raw) });
        }
        let actual = slot.state.reading(actual_signal(self.setpoint_kind));
        if actual.at != Some(now) {
            return;
        }
        (member.reported_at, member.reported) = (now, true);
        if slot.state.reading(Signal::Enabled).raw == 0 {
            return self.fail(Failure::NotReady { hint: DRIVE_DISABLED });
        }
        if self.stage == CyclicStage::Run
            && let Some(requested) = slot.to_si(member.target, member.previous_raw)
        {
            self.statistics.max_following_error =
                self.statistics.max_following_error.max((requested - actual.value).abs());
        }
    }

    /// Cancels the motion: one of its axes was stopped, so all of them stop.
    pub fn cancel(&mut self) {
        self.fail(Failure::Cancelled);
    }

    /// Ends the motion after the loss of the link.
    pub fn handle_link_down(&mut self) {
        self.fail(Failure::LinkDown);
        if let CyclicStage::Stop(outcome) = self.stage {
            (self.stage, self.outcome) = (CyclicStage::Ended, Some(outcome));
        }
    }

    fn fail(&mut self, failure: Failure) {
        self.stage = match self.stage {
            CyclicStage::Hold => CyclicStage::Stop(Outcome::NotDone(failure)),
            CyclicStage::Run => CyclicStage::Stop(Outcome::Unknown(failure)),
            CyclicStage::Stop(_) | CyclicStage::Ended => return,
        };
        // Due at once: the stop of all axes does not wait for the next beat.
        (self.next_axis, self.due) = (0, Instant::ZERO);
    }
}

impl CyclicAxis {
    fn new<R: Request, A: Copy + 'static>(
        now: Instant,
        axis: AxisIndex,
        slot: &AxisSlot<R, A>,
        setpoint: SetpointKind,
        bounds: SetpointBounds,
    ) -> Result<Self, Unsupported> {
        const NOT_READY: &str = "the drive was not made ready to follow such set-points";
        if !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        let target = slot
            .driver
            .cycles()
            .and_then(|cycles| cycles.setpoint_parameter(setpoint))
            .filter(|_| slot.setpoint_kind == Some(setpoint));
        let target = target.ok_or(Unsupported::Forbidden(NOT_READY))?;
        let raw = match setpoint {
            SetpointKind::Position => slot.state.reading(Signal::Position).raw,
            SetpointKind::Velocity | SetpointKind::Torque => 0,
        };
        let axis = axis.0;
        Ok(Self {
            axis,
            target,
            bounds,
            tracker: None,
            raw,
            previous_raw: raw,
            reported_at: now,
            reported: true,
        })
    }

    /// The raw value of the next set-point, if it is within all bounds.
    fn check_setpoint<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &AxisSlot<R, A>,
        setpoint: SetpointKind,
        si: f64,
        period: f64,
    ) -> Result<i64, Unsupported> {
        let raw = slot.to_raw(self.target, si).ok_or(Unsupported::BadArgument)?;
        slot.check_writable(self.target, raw)?;
        let first = self.tracker.is_none();
        let mut trend = self
            .tracker
            .or_else(|| slot.to_si(self.target, self.raw).map(SetpointTracker::at_rest))
            .ok_or(Unsupported::BadArgument)?;
        let leaps = || (si - trend.last).abs() > self.bounds.max_start_offset(period);
        if first && setpoint == SetpointKind::Position && leaps() {
            return Err(Unsupported::Forbidden(START_TOO_FAR));
        }
        let judged = trend.accept(&self.bounds, setpoint, si, period);
        judged.map_err(|excess: BoundsViolation| Unsupported::Forbidden(excess.hint()))?;
        self.tracker = Some(trend);
        Ok(raw)
    }
}

/// Signal that shows how well a drive follows.
const fn actual_signal(setpoint: SetpointKind) -> Signal {
    match setpoint {
        SetpointKind::Position => Signal::Position,
        SetpointKind::Velocity => Signal::Velocity,
        SetpointKind::Torque => Signal::Torque,
    }
}
