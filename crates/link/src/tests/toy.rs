//! A lane and a device that speak the smallest protocol there is: eight bytes asked, eight bytes
//! answered, number and value. The device answers with the value plus one.

use std::collections::VecDeque;

use polepair_core::axis::{Axes, AxisStatus, Command, RehearsalStep, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::profile::{AddressRole, ParameterId, Profile};
use polepair_core::station::{AxisIndex, Counters, LineEvent, Station, Ticket, Timed};
use polepair_core::time::{Instant, earliest};

/// Asked by a stop.
pub(super) const STOP_VALUE: u32 = 0x5709_5709;
/// A lane holds so many jobs, whatever the number of threads.
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
    /// It waits so long for an answer.
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

impl Axes for ToyLane {
    fn address_change(
        &self,
        _axis: AxisIndex,
        _parameter: ParameterId,
        _raw: i64,
    ) -> Result<Option<AddressRole>, Unsupported> {
        Ok(None)
    }
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

    fn send_text(
        &mut self,
        _now: Instant,
        _ticket: Ticket,
        _axis: AxisIndex,
        _text: &str,
    ) -> Result<(), Unsupported> {
        Err(Unsupported::BadText)
    }

    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        self.outcomes.pop_front()
    }

    fn rehearse(
        &self,
        _axis: AxisIndex,
        _command: Command,
        _show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn to_si(&self, _axis: AxisIndex, _parameter: ParameterId, _raw: i64) -> Option<f64> {
        None
    }

    fn to_raw(&self, _axis: AxisIndex, _parameter: ParameterId, _si: f64) -> Option<i64> {
        None
    }

    fn counters(&self) -> Counters {
        Counters { late: self.late, ..Counters::default() }
    }
}

/// The drive's end.
#[derive(Default)]
pub(super) struct ToyDevice {
    received: Vec<u8>,
    replies: VecDeque<(Instant, [u8; 8])>,
    /// Answers so much later, and not at all when that is none.
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

/// What is on the wire, either way.
pub(super) fn frame(number: u32, value: u32) -> [u8; 8] {
    (u64::from(value) << 32 | u64::from(number)).to_le_bytes()
}

fn split(bytes: &[u8]) -> (u32, u32) {
    let word =
        |at: usize| bytes[at..at + 4].iter().rev().fold(0, |sum, b| sum << 8 | u32::from(*b));
    (word(0), word(4))
}
