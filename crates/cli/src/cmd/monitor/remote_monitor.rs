//! Data of the screen from a running server. The server sends them by itself, so no drive is polled. Only
//! Esc sends a command.

use std::time::Duration;

use polepair_client::message::{
    AxisInfo, AxisState, FrameDirection, FrameItem, PendingStopView, StopClass, StopReport,
    StopRequest,
};
use polepair_client::{FrameStream, Gateway, GatewayError, LiveConnection, PendingOperation};
use polepair_core::explain::Direction;
use polepair_core::profile::Signal;
use polepair_core::proto;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::monitored_axis::AxisActivity;
use super::remote_printer::{activity, axis_address, axis_name, exit_note, trouble_lines};
use super::source::{AxisRow, MonitorSource, ShownValue, StopState, StopSummary, format_steady};
use super::traffic::{FrameRow, TrafficLog};
use crate::problem::Result;
use crate::remote::{self, RemoteSession};

/// Time for which a lost server is shown before the screen ends.
const LOST_MAX: Duration = Duration::from_secs(10);
/// Time for which a confirmed stop is shown.
const STOP_SHOWN_MAX: Duration = Duration::from_secs(10);
/// Age of a pending stop above which it is an alarm.
const FRESH_STOP_MAX: Duration = Duration::from_secs(1);
/// Time limit of a running stop at the end.
const STOP_MAX: Duration = Duration::from_secs(2);

/// A server that is watched.
pub struct RemoteMonitor {
    gateway: Gateway,
    live: LiveConnection,
    frames: FrameStream,
    axes: Vec<AxisInfo>,
    /// Last received states: they stay visible when the server is gone.
    states: Vec<Option<(AxisState, Instant)>>,
    traffic: TrafficLog,
    /// The links, as frames name them.
    links: Vec<u16>,
    chosen: usize,
    /// Every axis of the server is meant: a stop then locks motion.
    all_axes: bool,
    started_at: Instant,
    /// The server's time of the first frame, and ours, in nanoseconds.
    first_frame: Option<(f64, u64)>,
    lost: Option<(Instant, GatewayError)>,
    stop: Option<RequestedStop>,
    flaw_count: u64,
}

/// A stop that was asked for here.
struct RequestedStop {
    at: Instant,
    pending: PendingOperation<StopReport>,
    /// Reason of the refusal.
    refused: Option<GatewayError>,
}

impl RemoteMonitor {
    pub fn new(server: &RemoteSession, axes: Vec<AxisInfo>, all: bool) -> Result<Self> {
        let gateway = server.gateway.clone();
        let live = gateway.live().map_err(remote::refusal_problem)?;
        let frames = live.subscribe_frames(None).map_err(remote::refusal_problem)?;
        crate::interrupt::listen(|| {});
        let links = &server.bench.links;
        Ok(Self {
            gateway,
            live,
            frames,
            states: vec![None; axes.len()],
            axes,
            traffic: TrafficLog::for_remote(links.iter().map(|link| link.id.to_string()).collect()),
            links: links.iter().map(|link| link.id).collect(),
            chosen: 0,
            all_axes: all,
            started_at: clock::now(),
            first_frame: None,
            lost: None,
            stop: None,
            flaw_count: 0,
        })
    }

    fn process_updates(&mut self) -> std::result::Result<(), GatewayError> {
        let (items, lost) = self.frames.drain()?;
        self.traffic.lost = lost;
        if self.all_axes {
            // Axes whose link was opened later, or that were taken in, join.
            let mut joined = self.live.axes_from(self.axes.len());
            if self.links.len() > 1 {
                joined.iter_mut().for_each(remote::label_with_link);
            }
            self.axes.extend(joined);
            self.states.resize(self.axes.len(), None);
        }
        for item in items {
            self.add_frame(item);
        }
        for (n, axis) in self.axes.iter().enumerate() {
            if let Some(state) = self.live.state(axis.id)? {
                self.states[n] = Some((state, clock::now()));
            }
        }
        Ok(())
    }

    fn add_frame(&mut self, item: FrameItem) {
        let (theirs, own_wall_ns) =
            *self.first_frame.get_or_insert_with(|| (item.t_us, own_wall_ns()));
        // The server's times differ from this computer's by an unknown amount: only differences are used.
        let since = ((item.t_us - theirs).max(0.0) * 1e3) as u64;
        self.flaw_count += u64::from(!item.ok);
        let wire = self.links.iter().position(|link| *link == item.link).unwrap_or(0);
        let (id, bytes) = parse_raw(&item.raw);
        let (text, wrong) = match item.text.rsplit_once(" ! ").filter(|_| !item.ok) {
            Some((text, wrong)) => (text.to_owned(), wrong.to_owned()),
            None => (item.text.clone(), String::new()),
        };
        // Texts that differ only in numbers are of one kind.
        let kind = match id {
            Some((id, extended)) => format!("{id:08X} {extended}"),
            None => format!("{:?} {:?} {}", item.dir, item.axis, first_word(&text)),
        };
        let row = FrameRow {
            number: 0,
            time: own_wall_ns + since,
            wire,
            direction: item.dir.map(|direction| match direction {
                FrameDirection::Tx => Direction::ToDrive,
                FrameDirection::Rx => Direction::ToHost,
            }),
            protocol: proto::find_dissector(&item.protocol).map(|found| found.name()),
            id,
            bytes,
            changed: 0,
            text,
            wrong,
            search_text: String::new(),
        };
        self.traffic.add_explained(row, &kind);
    }

    fn aged_state(&self, n: usize) -> Option<AxisState> {
        let (mut state, at) = self.states[n].clone()?;
        let ms = clock::now().since(at).as_secs_f64() * 1e3;
        state.signals.iter_mut().for_each(|signal| signal.age_ms += ms);
        Some(state)
    }

    /// Progress of the stop that was requested here.
    fn stop_summary(&self, axis: &AxisInfo) -> Option<StopSummary> {
        let requested_stop = self.stop.as_ref()?;
        let now = clock::now();
        let received = self.live.last_stop(axis.id).filter(|(_, at)| *at >= requested_stop.at);
        let Some((stopped, at)) = received else {
            let took = now.since(requested_stop.at);
            return requested_stop
                .refused
                .is_none()
                .then_some(StopSummary { state: StopState::Sent, elapsed: took });
        };
        let class = match stopped.class {
            StopClass::Standing => StopState::Standstill,
            StopClass::Acknowledged => StopState::Acknowledged,
            StopClass::Sent if stopped.error.is_none() => StopState::Sent,
            StopClass::Sent | StopClass::Pending | StopClass::Failed => {
                StopState::Failed(stop_error_text(&stopped.error))
            }
        };
        let over = class == StopState::Standstill && now.since(at) > STOP_SHOWN_MAX;
        let took = Duration::from_secs_f64(stopped.ms.clamp(0.0, 1e9) / 1e3);
        (!over).then_some(StopSummary { state: class, elapsed: took })
    }
}

fn stop_error_text(stopped_error: &Option<GatewayError>) -> String {
    match stopped_error {
        Some(error) => error.message.clone(),
        None => "no drive replied".to_owned(),
    }
}

fn first_word(text: &str) -> &str {
    text.split_once(char::is_whitespace).map_or(text, |(word, _)| word)
}

fn own_wall_ns() -> u64 {
    clock::wall_ns(clock::now())
}

impl MonitorSource for RemoteMonitor {
    fn url(&self) -> &str {
        self.gateway.url()
    }

    fn age(&self) -> Duration {
        clock::now().since(self.started_at)
    }

    fn started_ns(&self) -> u64 {
        clock::wall_ns(self.started_at)
    }

    fn traffic(&self) -> &TrafficLog {
        &self.traffic
    }

    fn traffic_mut(&mut self) -> &mut TrafficLog {
        self.flaw_count = 0;
        &mut self.traffic
    }

    fn count(&self) -> usize {
        self.axes.len()
    }

    fn axis(&self, n: usize) -> AxisRow {
        let axis = &self.axes[n];
        let mut seen = AxisRow {
            name: axis_name(axis),
            label: axis.label.clone(),
            drive: [axis.profile.clone(), axis.drive.clone()],
            activity: AxisActivity::Unknown,
            stop: self.stop_summary(axis),
            mode: None,
            position: None,
            velocity: None,
            effort: None,
            age: None,
            troubles: Vec::new(),
            facts: Vec::new(),
        };
        if let Some(state) = self.aged_state(n) {
            fill_summary(&state, &mut seen);
        }
        if let Some(state) = self.aged_state(n).filter(|_| self.lost.is_none()) {
            seen.stop = merge_stop(seen.stop, state.pending_stop.as_ref());
        }
        if let (None, Err(gone)) = (&self.lost, self.live.check_link(axis.id)) {
            seen.activity = AxisActivity::Silent;
            seen.troubles.insert(0, (gone.message, true));
        }
        seen
    }

    fn chosen(&self) -> usize {
        self.chosen
    }

    fn choose(&mut self, n: usize) {
        self.chosen = n;
    }

    fn is_listen_only(&self) -> bool {
        false
    }

    fn trouble(&self) -> Option<String> {
        let (since, why) = self.lost.as_ref()?;
        let seconds = clock::now().since(*since).as_secs();
        let why = &why.message;
        Some(format!("SERVER GONE for {seconds} s, all values are outdated: {why}"))
    }

    fn lock(&self) -> Option<String> {
        let lock = self.live.motion_lock().filter(|_| self.lost.is_none())?;
        let why =
            if lock.reason.is_empty() { String::new() } else { format!(" ({})", lock.reason) };
        Some(format!("LOCKED: {} stopped all axes{why}; release it on the server's page", lock.by))
    }

    fn link_troubles(&self) -> Vec<String> {
        let links = if self.lost.is_none() { self.live.links() } else { Vec::new() };
        links.iter().flat_map(remote::link_troubles).collect()
    }

    fn flaw_counts(&self) -> Vec<(u64, &'static str)> {
        vec![(self.flaw_count, "wrong"), (self.traffic.lost, "lost")]
    }

    fn no_flaws_text(&self) -> &'static str {
        "no errors"
    }

    fn poll(&mut self) -> Result<()> {
        if let Some(requested_stop) = &mut self.stop
            && requested_stop.refused.is_none()
        {
            requested_stop.refused = requested_stop.pending.wait(Duration::ZERO).err();
        }
        let now = clock::now();
        if self.lost.is_none()
            && let Err(gone) = self.process_updates()
        {
            // Values stay on the screen, marked as outdated: a glance shows where the axes were.
            self.lost = Some((now, gone));
        }
        self.traffic.update_rates(now);
        match &self.lost {
            Some((since, why)) if now.since(*since) > LOST_MAX => {
                Err(remote::refusal_problem(why.clone()))
            }
            _ => Ok(()),
        }
    }

    fn stop(&mut self) {
        let ids = self.axes.iter().map(|axis| axis.id).collect();
        let axes = (!self.all_axes).then_some(ids);
        let request =
            StopRequest { axes, reason: "polepair monitor".to_owned(), ..StopRequest::default() };
        // In a thread: the key that stops must not wait for the drawing, nor the drawing for the reply.
        let pending = self.gateway.spawn(move |gateway| gateway.stop(&request));
        self.stop = Some(RequestedStop { at: clock::now(), pending, refused: None });
    }

    fn stop_problem(&self) -> Option<String> {
        let refused = self.stop.as_ref()?.refused.as_ref()?;
        Some(format!("STOP NOT CONFIRMED: {}; cut the power if it turns", refused.message))
    }

    fn exit_notes(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        match self
            .stop
            .as_mut()
            .map(|requested_stop| requested_stop.pending.wait(clock::scale_timeout(STOP_MAX)))
        {
            None => {}
            Some(Err(why)) => lines.push(format!("the stop is not confirmed: {}", why.message)),
            Some(Ok(None)) => lines.push(
                "the stop is not confirmed: the server does not answer; cut the power if it turns"
                    .into(),
            ),
            Some(Ok(Some(stopped))) => {
                lines.extend(stopped.axes.iter().filter(|axis| axis.error.is_some()).map(|axis| {
                    let why = axis.error.as_ref().map_or("", |error| &*error.message);
                    format!("axis {} may not have stopped: {why}", axis.id)
                }));
            }
        }
        // Its result in the meantime.
        let _ = self.process_updates();
        let here = self.live.check().is_ok().then(|| self.url());
        for n in 0..self.axes.len() {
            let (axis, state) = (&self.axes[n], self.aged_state(n));
            let output = state.and_then(|s| exit_note(here, &axis.label, &axis_address(axis), &s));
            lines.extend(output);
        }
        lines
    }
}

/// Combines the stop that was requested here with the pending stop of any client, which is shown until it ends.
fn merge_stop(own: Option<StopSummary>, pending: Option<&PendingStopView>) -> Option<StopSummary> {
    match (own, pending) {
        (Some(own), Some(_)) if own.elapsed < FRESH_STOP_MAX && !own.state.is_failed() => Some(own),
        (_, Some(pending)) => Some(pending_stop_summary(pending)),
        (Some(own), None) if own.state.is_failed() => None,
        (own, None) => own,
    }
}

/// Summary of a pending stop.
fn pending_stop_summary(pending: &PendingStopView) -> StopSummary {
    let since_ms = clock::wall_ns(clock::now()) as f64 / 1e6 - pending.since_ms;
    let why = match &pending.error {
        Some(error) => error.message.clone(),
        None => "its standstill is not confirmed yet".to_owned(),
    };
    StopSummary { state: StopState::Failed(why), elapsed: duration_from_ms(since_ms) }
}

fn fill_summary(state: &AxisState, seen: &mut AxisRow) {
    let value = |signal: Signal| {
        let signal_value =
            state.signals.iter().find(|signal_value| signal_value.signal == signal.name())?;
        Some(ShownValue {
            text: format_steady(signal_value.value?, &signal_value.unit),
            age: duration_from_ms(signal_value.age_ms),
        })
    };
    let ages = || state.signals.iter().map(|signal| signal.age_ms);
    let newest = duration_from_ms(ages().fold(f64::MAX, f64::min));
    seen.activity = activity(state);
    seen.mode = state.mode.clone().map(|text| ShownValue { text, age: newest });
    seen.position = value(Signal::Position);
    seen.velocity = value(Signal::Velocity);
    seen.effort = value(Signal::Torque).or_else(|| value(Signal::Current));
    seen.age = ages().reduce(f64::max).map(duration_from_ms);
    seen.troubles = trouble_lines(state)
        .into_iter()
        .map(|line| {
            let stops = !line.starts_with(' ');
            (line, stops)
        })
        .collect();
    for (word, signal) in [
        ("target", Signal::TargetPosition),
        ("target", Signal::TargetVelocity),
        ("supply", Signal::Voltage),
        ("", Signal::Temperature),
    ] {
        seen.facts.extend(value(signal).map(|value| (word, value)));
    }
    if let Some(lease) = &state.lease {
        seen.facts.push(("controlled by", ShownValue { text: lease.owner.clone(), age: newest }));
    }
}

fn duration_from_ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms.clamp(0.0, 1e9) / 1e3)
}

/// `123#0102` or `0102` as identifier and bytes.
fn parse_raw(raw: &str) -> (Option<(u32, bool)>, Vec<u8>) {
    let (id, data) = match raw.split_once('#') {
        Some((id, data)) => (u32::from_str_radix(id, 16).ok().map(|n| (n, id.len() > 3)), data),
        None => (None, raw),
    };
    (
        id,
        (0..data.len())
            .step_by(2)
            .map_while(|at| u8::from_str_radix(data.get(at..at + 2)?, 16).ok())
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use polepair_client::message::StopCause;

    use super::*;

    #[test]
    fn a_stop_is_an_alarm_exactly_as_long_as_it_is_pending() {
        let pending = PendingStopView {
            since_ms: clock::wall_ns(clock::now()) as f64 / 1e6 - 5000.0,
            why: StopCause::LinkLost,
            by: "server".into(),
            class: StopClass::Failed,
            attempts: 0,
            error: None,
        };
        let own =
            |class, ms| Some(StopSummary { state: class, elapsed: Duration::from_millis(ms) });
        let class = |own, pending| merge_stop(own, pending).map(|stop| stop.state);
        let alarm = |shown: Option<StopState>| shown.is_some_and(|class| class.is_failed());
        assert!(alarm(class(None, Some(&pending))) && class(None, None).is_none());
        assert_eq!(class(own(StopState::Sent, 100), Some(&pending)), Some(StopState::Sent));
        assert!(alarm(class(own(StopState::Sent, 3000), Some(&pending))));
        assert!(alarm(class(own(StopState::Failed("silent".into()), 10), Some(&pending))));
        assert_eq!(class(own(StopState::Failed("silent".into()), 10), None), None, "dismissed");
        assert_eq!(class(own(StopState::Standstill, 3000), None), Some(StopState::Standstill));
    }
}
