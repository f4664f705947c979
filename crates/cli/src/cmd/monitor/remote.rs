//! Source of a monitor on a server. The server sends values and frames by itself, so no drive is polled.

use std::time::Duration;

use polepair::interface::FaultReport;
use polepair::remote::drive_unit;
use polepair::url::AxisNumber;
use polepair_client::message::{
    AxisInfo, AxisState, FrameDirection, FrameItem, LinkState, LinkView, PendingStopView,
    SignalValue, StopClass, StopReport, StopRequest,
};
use polepair_client::{FrameStream, Gateway, GatewayError, LiveConnection, PendingOperation};
use polepair_core::explain::Direction;
use polepair_core::profile::Signal;
use polepair_core::proto;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::model::Monitor;
use super::source::{
    ActivityReadings, AxisActivity, AxisRow, FrameSink, LinkReport, MonitorSource, ShownFrame,
    SignalRow, SourceStatus, StopState, StopSummary, Trouble, fault_lines, speed_text,
    turning_note,
};
use super::traffic::{FrameRow, TrafficLog};
use crate::problem::Result;
use crate::remote::{self, RemoteSession};

/// Time for which a confirmed stop is shown.
const STOP_SHOWN_MAX: Duration = Duration::from_secs(10);
/// Age of a pending stop above which it is an alarm.
const FRESH_STOP_MAX: Duration = Duration::from_secs(1);
/// Time limit of a running stop at the end.
const STOP_MAX: Duration = Duration::from_secs(2);
/// Time limit of the first state of each axis.
const FIRST_MAX: Duration = Duration::from_secs(2);
/// Silence of a drive after which it is shown as not replying, ms.
const SILENT_MS: f64 = 4000.0;
/// Speed below which a motor is at standstill, in rad/s and m/s.
const STANDSTILL_SPEED: f64 = 1e-3;

/// Display of a server: which axes and frames, and how often.
pub struct RemoteView {
    /// The selected axes.
    pub axes: Vec<AxisInfo>,
    /// True if every axis of the server is meant: a stop then locks motion.
    pub all_axes: bool,
    /// True if frames are shown.
    pub frames: bool,
    /// Interval of rounds of values.
    pub period: Duration,
    /// Time for which a lost server is shown.
    pub lost_max: Duration,
}

/// A server.
pub struct RemoteSource {
    gateway: Gateway,
    live: LiveConnection,
    frames: Option<FrameStream>,
    axes: Vec<AxisInfo>,
    /// Last received states: they stay visible when the server is gone.
    states: Vec<Option<(AxisState, Instant)>>,
    /// The links, as frames name them.
    links: Vec<u16>,
    all_axes: bool,
    period: Duration,
    started_at: Instant,
    next_round: Instant,
    /// The server's time of the first frame, and ours, in nanoseconds.
    first_frame: Option<(f64, u64)>,
    lost: Option<(Instant, GatewayError)>,
    lost_max: Duration,
    stop: Option<RequestedStop>,
}

/// A stop that was requested by this monitor.
struct RequestedStop {
    at: Instant,
    pending: PendingOperation<StopReport>,
    /// Reason of the refusal.
    refused: Option<GatewayError>,
}

impl Monitor<RemoteSource> {
    /// A monitor of a server.
    ///
    /// # Errors
    /// The server cannot be reached.
    pub fn with_server(server: &RemoteSession, view: RemoteView) -> Result<Self> {
        let gateway = server.gateway.clone();
        let url = gateway.url().to_owned();
        let live = gateway.live().map_err(remote::refusal_problem)?;
        let frames = view.frames.then(|| live.subscribe_frames(None)).transpose();
        let frames = frames.map_err(remote::refusal_problem)?;
        crate::interrupt::listen(|| {});
        let links: Vec<u16> = server.bench.links.iter().map(|link| link.id).collect();
        let traffic = TrafficLog::for_remote(links.iter().map(u16::to_string).collect());
        let now = clock::now();
        let source = RemoteSource {
            gateway,
            live,
            frames,
            states: vec![None; view.axes.len()],
            axes: view.axes,
            links,
            all_axes: view.all_axes,
            period: view.period,
            started_at: now,
            next_round: now,
            first_frame: None,
            lost: None,
            lost_max: view.lost_max,
            stop: None,
        };
        Ok(Self::new(source, &url, traffic))
    }
}

impl MonitorSource for RemoteSource {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn sleep(&self, span: Duration) {
        clock::sleep_until(clock::now() + span);
    }

    fn poll(
        &mut self,
        _chosen: usize,
        traffic: &mut TrafficLog,
        show: &mut FrameSink<'_>,
    ) -> Result<bool> {
        if let Some(requested_stop) = &mut self.stop
            && requested_stop.refused.is_none()
        {
            requested_stop.refused = requested_stop.pending.wait(Duration::ZERO).err();
        }
        let now = clock::now();
        if self.lost.is_none()
            && let Err(gone) = self.process_updates(traffic, show)
        {
            // Values stay on the screen, marked as outdated: a glance shows where the axes were.
            self.lost = Some((now, gone));
        }
        if let Some((since, why)) = &self.lost
            && now.since(*since) >= self.lost_max
        {
            return Err(remote::refusal_problem(why.clone()));
        }
        // Without this wait the first round of a server would be empty.
        let all_there = self.states.iter().all(Option::is_some)
            || now.since(self.started_at) > clock::scale_timeout(FIRST_MAX);
        let due = now >= self.next_round && all_there;
        if due {
            // Missed rounds are not caught up with.
            self.next_round = (self.next_round + self.period).max(now);
        }
        Ok(due)
    }

    fn axes(&self) -> Vec<AxisRow> {
        (0..self.axes.len()).map(|n| self.axis_row(n)).collect()
    }

    fn status(&self) -> SourceStatus {
        let is_here = self.lost.is_none();
        let links = if is_here { self.live.links() } else { Vec::new() };
        SourceStatus {
            trouble: self.lost.as_ref().map(|(since, why)| {
                let seconds = clock::now().since(*since).as_secs();
                format!("SERVER GONE for {seconds} s, all values are outdated: {}", why.message)
            }),
            lock: self.live.motion_lock().filter(|_| is_here).map(|lock| {
                let why = match &*lock.reason {
                    "" => String::new(),
                    reason => format!(" ({reason})"),
                };
                let by = lock.by;
                format!("LOCKED: {by} stopped all axes{why}; release it on the server's page")
            }),
            links: links.iter().map(link_report).collect(),
            stop_problem: self.stop.as_ref().and_then(|stop| stop.refused.as_ref()).map(
                |refused| {
                    let why = &refused.message;
                    format!("STOP NOT CONFIRMED: {why}; cut the power if it turns")
                },
            ),
            ..SourceStatus::default()
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
        // The outcome of the stop in the meantime.
        let _ = self.receive_states();
        let url = self.live.check().is_ok().then(|| self.gateway.url());
        for (n, axis) in self.axes.iter().enumerate() {
            let Some(state) = self.aged_state(n) else { continue };
            let address = format!("{}#{}", axis.link, AxisNumber(axis.number));
            let rows = signal_rows(axis, &state);
            let velocity = rows.iter().find(|row| row.signal == Signal::Velocity);
            lines.extend(exit_note(url, &axis.label, &address, velocity, &state));
        }
        lines
    }
}

impl RemoteSource {
    fn process_updates(
        &mut self,
        traffic: &mut TrafficLog,
        show: &mut FrameSink<'_>,
    ) -> std::result::Result<(), GatewayError> {
        if let Some(frames) = &self.frames {
            let (items, lost) = frames.drain()?;
            traffic.lost = lost;
            for item in items {
                self.add_frame(item, traffic, show);
            }
        }
        if self.all_axes {
            // Axes whose link was opened later, or that were taken in, join.
            let mut joined = self.live.axes_from(self.axes.len());
            if self.links.len() > 1 {
                joined.iter_mut().for_each(remote::label_with_link);
            }
            self.axes.extend(joined);
            self.states.resize(self.axes.len(), None);
        }
        self.receive_states()
    }

    fn receive_states(&mut self) -> std::result::Result<(), GatewayError> {
        for (axis, known) in self.axes.iter().zip(&mut self.states) {
            if let Some(state) = self.live.state(axis.id)? {
                *known = Some((state, clock::now()));
            }
        }
        Ok(())
    }

    fn add_frame(&mut self, item: FrameItem, traffic: &mut TrafficLog, show: &mut FrameSink<'_>) {
        let own_ns = || clock::wall_ns(clock::now());
        let (theirs, own_wall_ns) = *self.first_frame.get_or_insert_with(|| (item.t_us, own_ns()));
        // The server's times differ from this computer's by an unknown amount: only differences are used.
        let since = ((item.t_us - theirs).max(0.0) * 1e3) as u64;
        let wire = match self.links.iter().position(|link| *link == item.link) {
            Some(wire) => wire,
            // A link that the server opened later.
            None => {
                self.links.push(item.link);
                traffic.add_remote_wire(item.link.to_string())
            }
        };
        let (id, bytes) = parse_raw(&item.raw);
        let (text, wrong) = match item.text.rsplit_once(" ! ").filter(|_| !item.ok) {
            Some((text, wrong)) => (text.to_owned(), wrong.to_owned()),
            None if item.ok => (item.text, String::new()),
            None => (item.text, "no frame of a known protocol".to_owned()),
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
            axis: item.axis,
            id,
            bytes,
            changed: 0,
            text,
            wrong,
            search_text: String::new(),
        };
        let (row, link) = traffic.add_explained(row, &kind);
        show(ShownFrame::Explained { row, link });
    }

    /// The last state of an axis; its values have aged since it was received.
    fn aged_state(&self, n: usize) -> Option<AxisState> {
        let (mut state, at) = self.states[n].clone()?;
        let ms = clock::now().since(at).as_secs_f64() * 1e3;
        state.signals.iter_mut().for_each(|signal| signal.age_ms += ms);
        Some(state)
    }

    fn axis_row(&self, n: usize) -> AxisRow {
        let axis = &self.axes[n];
        let state = self.aged_state(n);
        let gone = if self.lost.is_none() { self.live.check_link(axis.id).err() } else { None };
        let faults = state.as_ref().map_or_else(Vec::new, active_faults);
        let pending = state.as_ref().and_then(|state| state.pending_stop.as_ref());
        let own = self.stop_summary(axis);
        let silence = gone.as_ref().map(|gone| Trouble { line: gone.message.clone(), stops: true });
        let stopping = pending.map_or_else(Vec::new, pending_stop_lines);
        AxisRow {
            number: axis.number,
            link: Some(axis.link),
            name: axis.name.clone(),
            label: axis.label.clone(),
            protocol: axis.protocol.clone(),
            profile: axis.profile.clone(),
            title: axis.drive.clone(),
            activity: match &state {
                _ if gone.is_some() => AxisActivity::Silent,
                Some(state) => activity(state, &faults),
                None => AxisActivity::Unknown,
            },
            stop: if self.lost.is_none() { merge_stop(own, pending) } else { own },
            signals: state.as_ref().map_or_else(Vec::new, |state| signal_rows(axis, state)),
            troubles: silence.into_iter().chain(stopping).chain(fault_lines(&faults)).collect(),
            owner: state.and_then(|state| state.lease).map(|lease| lease.owner),
        }
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

fn active_faults(state: &AxisState) -> Vec<FaultReport> {
    state.faults.iter().cloned().map(FaultReport::from).collect()
}

/// Signals of a state, in the units of the drive's profile where this program knows it.
fn signal_rows(axis: &AxisInfo, state: &AxisState) -> Vec<SignalRow> {
    let rows = Signal::ALL.into_iter().filter_map(|signal| {
        let value = state.signals.iter().find(|value| value.signal == signal.name())?;
        let (unit, factor) = match drive_unit(axis, &value.signal, &value.unit) {
            Some(unit) => (unit.symbol().into(), unit.si_factor()),
            None => (value.unit.clone().into(), 1.0),
        };
        Some(SignalRow {
            signal,
            value: value.value.map_or(f64::NAN, |si| si / factor),
            unit,
            word: state.mode.clone().filter(|_| signal == Signal::Mode).map(Into::into),
            age: duration_from_ms(value.age_ms),
        })
    });
    rows.collect()
}

fn signal_value(state: &AxisState, signal: Signal) -> Option<&SignalValue> {
    state.signals.iter().find(|value| value.signal == signal.name())
}

/// Returns whether the motor turned at the last state, of any age and with any other trouble.
fn is_turning(state: &AxisState) -> Option<bool> {
    state.moving.or_else(|| {
        let speed = signal_value(state, Signal::Velocity)?.value?;
        Some(speed.abs() > STANDSTILL_SPEED)
    })
}

fn activity(state: &AxisState, faults: &[FaultReport]) -> AxisActivity {
    let newest = state.signals.iter().map(|signal| signal.age_ms).fold(f64::MAX, f64::min);
    let has_values = !state.signals.is_empty();
    AxisActivity::from_readings(&ActivityReadings {
        is_silent: has_values && newest > SILENT_MS,
        has_values,
        faults,
        is_turning: is_turning(state),
        is_enabled: state.enabled,
    })
}

/// Note for a user who leaves a motor that turns, or may. Without a server no program stops it.
fn exit_note(
    url: Option<&str>,
    label: &str,
    address: &str,
    velocity: Option<&SignalRow>,
    state: &AxisState,
) -> Option<String> {
    if state.pending_stop.is_some() && url.is_some() {
        return Some(format!(
            "{label} received a stop, but its standstill is not confirmed: the server repeats the \
             stop; if it turns, cut its supply"
        ));
    }
    is_turning(state)?.then(|| match url {
        Some(url) => {
            turning_note(label, velocity, &format!("polepair --server {url} stop {address}"))
        }
        None => format!(
            "{label} turned{} at the last reading, and the server is gone: it may still turn, cut \
             its supply",
            speed_text(velocity)
        ),
    })
}

fn link_report(link: &LinkView) -> LinkReport {
    LinkReport {
        id: link.id,
        url: link.url.clone(),
        state: match link.state {
            LinkState::Open => "open",
            LinkState::Lost => "lost",
            LinkState::NotOpen => "not_open",
        },
        code: link.error.as_ref().map_or_else(String::new, |error| error.code.to_string()),
        troubles: remote::link_troubles(link),
    }
}

/// Lines for an axis with a pending stop.
fn pending_stop_lines(pending: &PendingStopView) -> Vec<Trouble> {
    let now_ms = clock::wall_ns(clock::now()) as f64 / 1e6;
    let seconds = ((now_ms - pending.since_ms) / 1e3).max(0.0);
    let word = match pending.class {
        StopClass::Acknowledged => "acknowledged, standstill not confirmed",
        StopClass::Sent => "not confirmed",
        _ => "not sent yet",
    };
    let line = format!("MAY BE TURNING, CUT ITS SUPPLY: stop sent {seconds:.0} s ago, {word}");
    let why = pending.error.as_ref().map(|error| format!("  why: {}", error.message));
    let why = why.map(|line| Trouble { line, stops: false });
    [Trouble { line, stops: true }].into_iter().chain(why).collect()
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
    use polepair_client::message::{ActiveFault, StopCause};

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

    #[test]
    fn a_motor_that_fell_silent_while_it_turned_is_reported_with_what_stops_it() {
        let (signal, unit) = (Signal::Velocity.name().to_owned(), "rad/s".to_owned());
        let read = SignalValue { signal, value: Some(31.5), unit, age_ms: 9000.0 };
        let mut state = AxisState {
            id: 0,
            mode: None,
            enabled: Some(true),
            armed: true,
            moving: None,
            signals: vec![read],
            faults: Vec::new(),
            lease: None,
            pending_stop: None,
            panel: None,
        };
        let velocity = SignalRow {
            signal: Signal::Velocity,
            value: 31.5,
            unit: "rad/s".into(),
            word: None,
            age: Duration::from_secs(9),
        };
        let note = |url, state: &AxisState| exit_note(url, "axis 3", "0#3", Some(&velocity), state);
        let reported = |state: &AxisState| note(Some("http://127.0.0.1:7365"), state);
        let whole = "axis 3 turned at 31.5 rad/s at the last reading and was not stopped; to stop it: \
                     polepair --server http://127.0.0.1:7365 stop 0#3";
        assert_eq!(
            (activity(&state, &active_faults(&state)), reported(&state).as_deref()),
            (AxisActivity::Silent, Some(whole))
        );
        let gone = note(None, &state).expect("it is told");
        assert!(gone.ends_with("the server is gone: it may still turn, cut its supply"), "{gone}");
        state.signals[0].age_ms = 10.0;
        assert_eq!(activity(&state, &[]), AxisActivity::Turning);
        let word = || "overcurrent".to_owned();
        let (name, symbol, cause, remedy) = (word(), word(), word(), word());
        state.faults = vec![ActiveFault { code: 1, name, symbol, cause, remedy, warning: false }];
        assert_eq!(
            (activity(&state, &active_faults(&state)), reported(&state).as_deref()),
            (AxisActivity::Fault, Some(whole))
        );
        state.moving = Some(false);
        assert_eq!(reported(&state), None);
        let alarm = |state: &AxisState| {
            state
                .pending_stop
                .iter()
                .flat_map(pending_stop_lines)
                .filter(|trouble| trouble.line.contains("CUT ITS SUPPLY"))
                .count()
        };
        assert_eq!(alarm(&state), 0);
        state.pending_stop = Some(PendingStopView {
            since_ms: 0.0,
            why: polepair_client::message::StopCause::Stop,
            by: "ann".into(),
            class: StopClass::Sent,
            attempts: 3,
            error: None,
        });
        assert_eq!(alarm(&state), 1);
        // The stop is pending with any last reading.
        assert!(
            reported(&state).is_some_and(|output| output.contains("standstill is not confirmed"))
        );
    }
}
