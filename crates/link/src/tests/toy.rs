//! A lane and a device that speak the smallest protocol there is: eight bytes asked, eight bytes
//! answered, number and value. The device answers with the value plus one.

use std::collections::VecDeque;

use polepair_core::axis::{
    AxisCommands, AxisData, AxisDirectory, AxisEvent, AxisPaths, AxisPrograms, AxisRequests,
    AxisScales, AxisStatus, AxisText, AxisTraffic, Command, GroupAnswer, MotionReport, Refusal,
    RehearsalStep, StopPart, TextRehearsal, UnmetWait, Verb,
};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::explain::RawFrame;
use polepair_core::judge::Tolerance;
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::profile::{AddressRole, NoScale, Parameter, ParameterId, Profile};
use polepair_core::program::{
    MemoryBlock, MemoryRules, MemoryTransfer, ProgramCommand, TransferKind,
};
use polepair_core::station::{AxisIndex, Counters, LineEvent, Station, Ticket, Timed};
use polepair_core::stream::cyclic::{CycleStatistics, CyclicConfig};
use polepair_core::stream::{PathKind, Point};
use polepair_core::time::{Instant, earliest};

/// Asked by a stop.
pub(super) const STOP_VALUE: u32 = 0x5709_5709;
/// Number of jobs that a lane holds, whatever the number of threads.
const QUEUE_MAX: usize = 64;
const BAUD: u32 = 115_200;

#[derive(Clone, Copy)]
struct ToyJob {
    ticket: Ticket,
    value: u32,
    /// Exchanges still to be made, with a pause before each: a plan.
    left: u32,
    at: Instant,
}

#[derive(Default)]
pub(super) struct ToyLane {
    queue: VecDeque<ToyJob>,
    plans: Vec<ToyJob>,
    outstanding: Option<(ToyJob, u32, bool, Instant)>,
    number: u32,
    received: Vec<u8>,
    outcomes: VecDeque<(Ticket, Outcome)>,
    pub(super) ups: u32,
    pub(super) late: u64,
    fast: bool,
    reply_timeout_ms: u32,
}

impl ToyLane {
    /// Reply time-out of the lane.
    pub(super) fn with_reply_timeout(reply_timeout_ms: u32) -> Self {
        Self { reply_timeout_ms, ..Self::default() }
    }

    fn finish(&mut self, ticket: Ticket, outcome: Outcome) {
        self.outcomes.push_back((ticket, outcome));
    }

    fn handle_answer(&mut self, now: Instant, number: u32, value: u32) {
        match self.outstanding.take() {
            Some((mut job, requested, _, _)) if requested == number => {
                if job.left == 0 {
                    return self.finish(job.ticket, Outcome::Done(value.into()));
                }
                job.left -= 1;
                job.at = now.plus_ms(10);
                self.plans.push(job);
            }
            other => {
                self.late += 1;
                self.outstanding = other;
            }
        }
    }
}

impl Timed for ToyLane {
    fn handle_timeout(&mut self, now: Instant) {
        if let Some((job, _, _, due)) = self.outstanding
            && due <= now
        {
            self.outstanding = None;
            self.finish(job.ticket, Outcome::Unknown(Failure::Silent));
        }
        let (due, later) = std::mem::take(&mut self.plans).into_iter().partition(|j| j.at <= now);
        self.plans = later;
        self.queue.extend::<Vec<ToyJob>>(due);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let plans = self.plans.iter().map(|job| job.at).min();
        earliest(self.outstanding.map(|(_, _, _, due)| due), plans)
    }
}

impl Station<Stream> for ToyLane {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.received.extend_from_slice(unit);
        while self.received.len() >= 8 {
            let (number, value) = split(&self.received);
            self.received.drain(..8);
            self.handle_answer(now, number, value);
        }
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        match event {
            LineEvent::Down => {
                self.received.clear();
                let on_wire = self.outstanding.take().map(|(job, ..)| job);
                let jobs = on_wire.into_iter().chain(self.plans.drain(..));
                let ended = jobs.chain(self.queue.drain(..));
                let lost = Outcome::Unknown(Failure::LinkDown);
                self.outcomes.extend(ended.map(|job| (job.ticket, lost)));
            }
            LineEvent::Up => self.ups += 1,
            _ => {}
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        if self.outstanding.is_none() {
            let job = self.queue.pop_front()?;
            self.number += 1;
            self.outstanding = Some((job, self.number, false, now.plus_ms(self.reply_timeout_ms)));
        }
        let (job, number, sent, _) = self.outstanding.as_mut()?;
        if std::mem::replace(sent, true) {
            return None;
        }
        out[..8].copy_from_slice(&frame(*number, job.value));
        Some(8)
    }

    fn line(&self) -> SerialLine {
        SerialLine::new_8n1(if self.fast { 512_000 } else { BAUD })
    }
}

impl AxisDirectory for ToyLane {
    fn axis_count(&self) -> usize {
        1
    }

    fn address(&self, _axis: AxisIndex) -> Option<u32> {
        Some(self.ups)
    }

    fn profile(&self, _axis: AxisIndex) -> Option<&'static Profile> {
        None
    }

    fn state(&self, _axis: AxisIndex) -> Option<&AxisStatus> {
        None
    }

    fn parameter(&self, _axis: AxisIndex, _id: ParameterId) -> Option<&'static Parameter> {
        None
    }

    fn add_parameter(
        &mut self,
        _axis: AxisIndex,
        _parameter: &'static Parameter,
    ) -> Option<ParameterId> {
        None
    }

    fn is_confirmed(&self, _axis: AxisIndex) -> bool {
        true
    }

    fn refusal(&self, _axis: AxisIndex, _code: u32) -> Refusal {
        Refusal::Final
    }

    fn lacks_parameter(&self, _axis: AxisIndex, _parameter: ParameterId) -> bool {
        false
    }

    fn add_axis(
        &mut self,
        _lane: usize,
        _profile: &'static Profile,
        _address: u32,
    ) -> Option<AxisIndex> {
        None
    }

    fn can_add_axis(&self, _lane: usize, _address: u32) -> bool {
        false
    }
}

impl AxisRequests for ToyLane {
    fn read_parameter(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _parameter: ParameterId,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoSuchParameter)
    }

    fn write_parameter(
        &mut self,
        now: Instant,
        ticket: Ticket,
        _axis: AxisIndex,
        _parameter: ParameterId,
        raw: i64,
        _keep: bool,
    ) -> Result<(), Unsupported> {
        let value = u32::try_from(raw).map_err(|_| Unsupported::BadArgument)?;
        if self.queue.len() == QUEUE_MAX {
            return Err(Unsupported::Busy);
        }
        self.queue.push_back(ToyJob { ticket, value, left: 0, at: now });
        Ok(())
    }

    fn address_change(
        &self,
        _axis: AxisIndex,
        _parameter: ParameterId,
        _raw: i64,
    ) -> Result<Option<AddressRole>, Unsupported> {
        Ok(None)
    }

    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        self.outcomes.pop_front()
    }

    fn unread_prerequisite(&self, _axis: AxisIndex, _n: usize) -> Option<ParameterId> {
        None
    }

    fn report_setting(
        &self,
        _axis: AxisIndex,
        _parameters: &[ParameterId],
        _interval_ms: u16,
    ) -> Option<(ParameterId, i64)> {
        None
    }

    fn disable_retries(&mut self, _ticket: Ticket) {}

    fn poll_group_answer(&mut self, _ticket: Ticket) -> Option<GroupAnswer> {
        None
    }
}

impl AxisScales for ToyLane {
    fn to_si(&self, _axis: AxisIndex, _parameter: ParameterId, _raw: i64) -> Option<f64> {
        None
    }

    fn to_raw(&self, _axis: AxisIndex, _parameter: ParameterId, _si: f64) -> Option<i64> {
        None
    }

    fn scale_input(&self, _axis: AxisIndex, _parameter: ParameterId) -> Option<i64> {
        None
    }

    fn scale_error(&self, _axis: AxisIndex, _parameter: ParameterId) -> Option<NoScale> {
        None
    }
}

impl AxisCommands for ToyLane {
    fn set_armed(&mut self, _axis: AxisIndex, armed: bool) {
        self.fast = armed;
    }

    /// `Stop` goes first; anything else is a plan of ten exchanges.
    fn command(
        &mut self,
        now: Instant,
        ticket: Ticket,
        _axis: AxisIndex,
        command: Command,
    ) -> Result<(), Unsupported> {
        let stop = command.verb == Verb::Stop;
        let (value, left) = if stop { (STOP_VALUE, 0) } else { (7, 9) };
        let job = ToyJob { ticket, value, left, at: now };
        if stop {
            self.queue.push_front(job)
        } else {
            self.queue.push_back(job)
        }
        Ok(())
    }

    fn rehearse(
        &self,
        _axis: AxisIndex,
        _command: Command,
        _show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn stop(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _command: Command,
        _part: StopPart,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn unmet_wait(&self, _axis: AxisIndex) -> Option<UnmetWait> {
        None
    }

    fn motion_report(&self, _axis: AxisIndex, _n: usize) -> Option<MotionReport> {
        None
    }

    fn tolerance(&self, _axis: AxisIndex) -> Option<Tolerance> {
        None
    }
}

impl AxisText for ToyLane {
    fn send_text(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _text: &str,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::BadText)
    }

    fn rehearse_text(
        &self,
        _axis: AxisIndex,
        _text: &str,
        _show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<TextRehearsal, Unsupported> {
        Err(Unsupported::BadText)
    }

    fn send_frame(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _frame: &RawFrame<'_>,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::BadBytes)
    }
}

impl AxisData for ToyLane {
    fn read_data(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _parameter: ParameterId,
        _block: bool,
        _max: u16,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn write_data(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _parameter: ParameterId,
        _size: u32,
        _block: bool,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn poll_bytes(&mut self, _ticket: Ticket, _out: &mut [u8]) -> Option<usize> {
        None
    }

    fn feed_bytes(&mut self, _ticket: Ticket, _bytes: &[u8]) -> Option<usize> {
        None
    }
}

impl AxisPaths for ToyLane {
    fn start_path(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _kind: PathKind,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn feed_points(
        &mut self,
        _ticket: Ticket,
        _points: &[Point],
        _complete: bool,
    ) -> Option<usize> {
        None
    }

    fn start_cyclic(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _following: &CyclicConfig<'_>,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn feed_cycles(
        &mut self,
        _ticket: Ticket,
        _setpoints: &[f64],
        _complete: bool,
    ) -> Option<usize> {
        None
    }

    fn cycle_statistics(&self, _axis: AxisIndex) -> Option<&CycleStatistics> {
        None
    }

    fn cycle_ns(&self, _axes: &[AxisIndex]) -> Option<u64> {
        None
    }
}

impl AxisPrograms for ToyLane {
    fn memory_rules(&self, _axis: AxisIndex) -> Option<&'static MemoryRules> {
        None
    }

    fn start_transfer(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _kind: TransferKind,
        _pieces: &[MemoryBlock],
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn last_transfer(&self, _axis: AxisIndex) -> Option<&MemoryTransfer> {
        None
    }

    fn send_program_command(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _command: ProgramCommand,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }
}

impl AxisTraffic for ToyLane {
    fn counters(&self) -> Counters {
        Counters { late: self.late, ..Counters::default() }
    }

    fn silence_counters(&self, _axis: AxisIndex) -> Counters {
        Counters::default()
    }

    fn enable_events(&mut self, _on: bool) {}

    fn poll_axis_event(&mut self, _now: Instant) -> Option<AxisEvent> {
        None
    }

    fn sends_keepalive(&self) -> bool {
        false
    }

    fn handle_resume(&mut self, _now: Instant) {}
}

/// The drive's end.
#[derive(Default)]
pub(super) struct ToyDevice {
    received: Vec<u8>,
    replies: VecDeque<(Instant, [u8; 8])>,
    /// Delay of the reply; `None` for no reply.
    pub(super) delay_ms: Option<u32>,
    pub(super) request_count: u32,
}

impl ToyDevice {
    pub(super) fn with_delay(ms: u32) -> Self {
        Self { delay_ms: Some(ms), ..Self::default() }
    }

    pub(super) fn mute() -> Self {
        Self::default()
    }
}

impl Timed for ToyDevice {
    fn handle_timeout(&mut self, _now: Instant) {}

    fn poll_timeout(&self) -> Option<Instant> {
        self.replies.front().map(|(at, _)| *at)
    }
}

impl Station<Stream> for ToyDevice {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.received.extend_from_slice(unit);
        while self.received.len() >= 8 {
            let (number, value) = split(&self.received);
            self.received.drain(..8);
            self.request_count += 1;
            let Some(delay) = self.delay_ms else { continue };
            self.replies.push_back((now.plus_ms(delay), frame(number, value.wrapping_add(1))));
        }
    }

    fn handle_line(&mut self, _now: Instant, _event: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let (at, reply) = *self.replies.front()?;
        if at > now {
            return None;
        }
        self.replies.pop_front();
        out[..8].copy_from_slice(&reply);
        Some(8)
    }

    fn line(&self) -> SerialLine {
        SerialLine::new_8n1(BAUD)
    }
}

/// Bytes of a frame, in either direction.
pub(super) fn frame(number: u32, value: u32) -> [u8; 8] {
    (u64::from(value) << 32 | u64::from(number)).to_le_bytes()
}

fn split(bytes: &[u8]) -> (u32, u32) {
    let word =
        |at: usize| bytes[at..at + 4].iter().rev().fold(0, |sum, b| sum << 8 | u32::from(*b));
    (word(0), word(4))
}
