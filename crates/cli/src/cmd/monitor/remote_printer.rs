//! Prints axes and frames of a running server as lines. The server sends them by itself, so no drive is
//! polled.

use std::time::Duration;

use polepair::url::AxisNumber;
use polepair_capture::jsonl;
use polepair_client::message::{
    AxisInfo, AxisState, FrameDirection, FrameItem, LinkState, LinkView, PendingStopView, StopClass,
};
use polepair_client::{FrameStream, LiveConnection};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::local_printer::{PrintStyle, format_age};
use super::monitored_axis::AxisActivity;
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, RemoteSession};
use crate::terminal::{DataOutput, TextTable, colour_out, print_note};
use polepair_serve::message::SignalValue;

/// Interval of polling received messages.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Time limit of the first state of each axis.
const FIRST_MAX: Duration = Duration::from_secs(2);
/// Silence of a drive after which it is shown as not replying, ms.
const SILENT_MS: f64 = 4000.0;
/// Slower than this is standing still, in rad/s and m/s.
const STANDSTILL_SPEED: f64 = 1e-3;

/// Prints until the time is over, or the user ends it.
pub fn run(
    server: &RemoteSession,
    axes: Vec<AxisInfo>,
    style: PrintStyle,
    period: Duration,
    span: Option<Duration>,
) -> Result {
    let live = server.gateway.live().map_err(remote::refusal_problem)?;
    let frames = (!style.once)
        .then(|| live.subscribe_frames(None))
        .transpose()
        .map_err(remote::refusal_problem)?;
    interrupt::listen(|| {});
    let jsonl = style.jsonl;
    let out = DataOutput::stdout().with_text(!jsonl);
    let mut lines = RemotePrinter {
        out,
        jsonl,
        last_activity: Vec::new(),
        last_link_states: Vec::new(),
        counts: (0, 0, 0),
    };
    let ended = lines.print_until(&live, frames.as_ref(), &axes, style, period, span);
    if !matches!(&ended, Err(problem) if problem.exit != Exit::Interrupted) {
        lines.print_totals(server.gateway.url(), &live, &axes)?;
    }
    ended
}

struct RemotePrinter {
    out: DataOutput,
    jsonl: bool,
    /// Activity of each axis when its table was printed.
    last_activity: Vec<(AxisActivity, usize)>,
    /// Troubles of links when they were printed: their numbers, states and errors' codes.
    last_link_states: Vec<(u16, LinkState, String)>,
    /// Frames, those that break their protocol, those that were lost.
    counts: (u64, u64, u64),
}

impl RemotePrinter {
    fn print_until(
        &mut self,
        live: &LiveConnection,
        frames: Option<&FrameStream>,
        axes: &[AxisInfo],
        style: PrintStyle,
        period: Duration,
        span: Option<Duration>,
    ) -> Result {
        let started_at = clock::now();
        let mut next = started_at;
        loop {
            let (items, lost) = frames
                .map_or(Ok((Vec::new(), 0)), FrameStream::drain)
                .map_err(remote::refusal_problem)?;
            self.counts.2 = lost;
            items.iter().for_each(|item| self.print_frame(item));
            let now = clock::now();
            let states = axis_states(live, axes)?;
            let all_there = states.len() == axes.len()
                || now.since(started_at) > clock::scale_timeout(FIRST_MAX);
            let due = now >= next && all_there;
            self.print_links(&live.links());
            if due {
                // Ticks that were missed are not caught up with.
                next = (next + period).max(now);
                self.print_axes(&states);
            }
            self.out.flush()?;
            if interrupt::was_interrupted() {
                return Err(Problem::interrupted());
            }
            if style.once && due || span.is_some_and(|span| now.since(started_at) >= span) {
                return Ok(Exit::Ok);
            }
            sleep(now, period.min(POLL_INTERVAL));
        }
    }

    fn print_frame(&mut self, item: &FrameItem) {
        self.counts.0 += 1;
        self.counts.1 += u64::from(!item.ok);
        let out = self.out.buffer();
        if self.jsonl {
            return write_frame_json(item, out);
        }
        let arrow = match item.dir {
            Some(FrameDirection::Tx) => '>',
            Some(FrameDirection::Rx) => '<',
            None => ' ',
        };
        let FrameItem { link, raw, protocol, text, ok, .. } = item;
        let (seconds, wrong) = (item.t_us / 1e6, if *ok { "" } else { " !" });
        let line = format!("{seconds:>12.6} {link} {arrow} {protocol:<8} {raw:<26} {text}{wrong}");
        self.out.write_line(&line);
    }

    /// Prints the troubles of links, if they changed.
    fn print_links(&mut self, links: &[LinkView]) {
        let now: Vec<_> = links.iter().map(link_summary).collect();
        if now == self.last_link_states {
            return;
        }
        for link in links.iter().filter(|link| !self.last_link_states.contains(&link_summary(link)))
        {
            let lines = remote::link_troubles(link);
            if self.jsonl && (!lines.is_empty() || !self.last_link_states.is_empty()) {
                write_link_json(link, &lines, self.out.buffer());
            } else if !self.jsonl {
                let is_back = lines.is_empty() && !self.last_link_states.is_empty();
                let back = is_back.then(|| format!("link {} is open", link.id));
                lines.into_iter().chain(back).for_each(|line| self.out.write_line(&line));
            }
        }
        self.last_link_states = now;
    }

    /// A table when an axis does something else than in the last one; as JSON each time.
    fn print_axes(&mut self, states: &[(&AxisInfo, AxisState)]) {
        if self.jsonl {
            return states
                .iter()
                .for_each(|(axis, state)| write_axis_json(axis, state, self.out.buffer()));
        }
        let did: Vec<_> = states
            .iter()
            .map(|(_, state)| {
                (activity(state), state.faults.len() + usize::from(state.pending_stop.is_some()))
            })
            .collect();
        if did != self.last_activity {
            self.last_activity = did;
            self.out.buffer().extend_from_slice(axes_table(states).as_bytes());
        }
    }

    /// Totals, and notes for a user who leaves.
    fn print_totals(&mut self, url: &str, live: &LiveConnection, axes: &[AxisInfo]) -> Result<()> {
        let (frames, wrong, lost) = self.counts;
        if self.jsonl {
            self.out
                .write_line(&format!("{{\"frames\":{frames},\"wrong\":{wrong},\"lost\":{lost}}}"))
        } else {
            self.out.write_line(&format!("{frames} frames, {wrong} wrong, {lost} lost"))
        }
        self.out.flush()?;
        for (axis, state) in axis_states(live, axes)? {
            if let Some(output) = exit_note(Some(url), &axis.label, &axis_address(axis), &state) {
                print_note(&output);
            }
        }
        Ok(())
    }
}

fn link_summary(link: &LinkView) -> (u16, LinkState, String) {
    let code = link.error.as_ref().map_or("", |error| &error.code);
    (link.id, link.state, code.to_owned())
}

fn sleep(now: Instant, span: Duration) {
    clock::sleep_until(now + span);
}

/// Axes of which the server has sent a state.
fn axis_states<'a>(
    live: &LiveConnection,
    axes: &'a [AxisInfo],
) -> Result<Vec<(&'a AxisInfo, AxisState)>> {
    axes.iter()
        .filter_map(|axis| live_state(axis, live).transpose())
        .collect::<std::result::Result<_, _>>()
        .map_err(remote::refusal_problem)
}

fn live_state<'a>(
    axis: &'a AxisInfo,
    live: &LiveConnection,
) -> std::result::Result<Option<(&'a AxisInfo, AxisState)>, polepair_client::GatewayError> {
    Ok(live.state(axis.id)?.map(|state| (axis, state)))
}

fn signal_value(state: &AxisState, signal: Signal) -> Option<f64> {
    state.signals.iter().find(|value| value.signal == signal.name()).and_then(|value| value.value)
}

/// Returns whether it turned at its last state, of any age and with any other trouble.
fn is_turning(state: &AxisState) -> bool {
    state.moving.unwrap_or_else(|| {
        signal_value(state, Signal::Velocity).is_some_and(|speed| speed.abs() > STANDSTILL_SPEED)
    })
}

/// Notes for a user who leaves a motor that turns, or may. Without a server no program stops it.
pub fn exit_note(
    url: Option<&str>,
    label: &str,
    number: &str,
    state: &AxisState,
) -> Option<String> {
    let speed = state.signals.iter().find(|value| value.signal == Signal::Velocity.name());
    let speed = speed.and_then(|value| Some(remote::format_value(value.value?, &value.unit)));
    let speed = speed.map_or_else(String::new, |speed| format!(" at {speed}"));
    if state.pending_stop.is_some() && url.is_some() {
        return Some(format!(
            "{label} received a stop, but its standstill is not confirmed: the server repeats the \
             stop; if it turns, cut its supply"
        ));
    }
    is_turning(state).then(|| match url {
        Some(url) => format!(
            "{label} turned{speed} at the last reading and was not stopped; to stop it: \
             polepair --server {url} stop {number}"
        ),
        None => format!(
            "{label} turned{speed} at the last reading, and the server is gone: it may still \
             turn, cut its supply"
        ),
    })
}

pub fn activity(state: &AxisState) -> AxisActivity {
    let newest = state.signals.iter().map(|signal| signal.age_ms).fold(f64::MAX, f64::min);
    match state.enabled {
        _ if state.signals.is_empty() => AxisActivity::Unknown,
        _ if newest > SILENT_MS => AxisActivity::Silent,
        _ if !state.faults.is_empty() => AxisActivity::Fault,
        _ if is_turning(state) => AxisActivity::Turning,
        Some(true) => AxisActivity::Holding,
        Some(false) => AxisActivity::Off,
        None => AxisActivity::Standing,
    }
}

/// Address of an axis as the server's verbs take it.
pub fn axis_address(axis: &AxisInfo) -> String {
    format!("{}#{}", axis.link, AxisNumber(axis.number))
}

pub fn axis_name(axis: &AxisInfo) -> String {
    let number = axis_address(axis);
    if axis.name.is_empty() { number } else { format!("{number} {}", axis.name) }
}

/// The axes, and below them their faults with cause and remedy.
fn axes_table(states: &[(&AxisInfo, AxisState)]) -> String {
    let heads = ["axis", "drive", "state", "mode", "position", "velocity", "torque", "age"];
    let mut table = TextTable::with_heads(&heads);
    for (axis, state) in states {
        let cell = |signal: Signal| match find_signal(signal, &state.signals)
            .and_then(|s| Some((s.value?, &*s.unit)))
        {
            Some((value, unit)) => remote::format_value(value, unit),
            None => "-".to_owned(),
        };
        let effort = if find_signal(Signal::Torque, &state.signals).is_some() {
            Signal::Torque
        } else {
            Signal::Current
        };
        let oldest = state.signals.iter().map(|signal| signal.age_ms).reduce(f64::max);
        table.add_row([
            axis_name(axis),
            axis.profile.clone(),
            activity(state).word().to_owned(),
            state.mode.clone().unwrap_or_else(|| "-".to_owned()),
            cell(Signal::Position),
            cell(Signal::Velocity),
            cell(effort),
            oldest.map_or_else(
                || "-".to_owned(),
                |ms| format_age(Duration::from_secs_f64(ms.clamp(0.0, 1e9) / 1e3)),
            ),
        ]);
    }
    let mut text = table.render(colour_out());
    for (axis, state) in states {
        for line in trouble_lines(state) {
            text.push_str(&format!("{}: {line}\n", axis.label));
        }
    }
    text
}

fn find_signal(wanted: Signal, state_signals: &[SignalValue]) -> Option<&SignalValue> {
    state_signals.iter().find(|s| s.signal == wanted.name())
}

/// Line for an axis with a pending stop.
fn pending_stop_line(pending: &PendingStopView) -> String {
    let now_ms = clock::wall_ns(clock::now()) as f64 / 1e6;
    let seconds = ((now_ms - pending.since_ms) / 1e3).max(0.0);
    let word = match pending.class {
        StopClass::Acknowledged => "acknowledged, standstill not confirmed",
        StopClass::Sent => "not confirmed",
        _ => "not sent yet",
    };
    format!("MAY BE TURNING, CUT ITS SUPPLY: stop sent {seconds:.0} s ago, {word}")
}

pub fn trouble_lines(state: &AxisState) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(stop) = &state.pending_stop {
        lines.push(pending_stop_line(stop));
        if let Some(error) = &stop.error {
            lines.push(format!("  why: {}", error.message));
        }
    }
    for fault in &state.faults {
        lines.push(format!("FAULT {}", fault.name));
        for (word, sentence) in [("cause", &fault.cause), ("remedy", &fault.remedy)] {
            if !sentence.is_empty() {
                lines.push(format!("  {word}: {sentence}"));
            }
        }
    }
    lines
}

fn write_text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(text.as_bytes());
}

fn write_pair(out: &mut Vec<u8>, key: &str, text: &str) {
    write_text(out, &format!(",\"{key}\":"));
    jsonl::write_string(out, text);
}

fn write_link_json(link: &LinkView, lines: &[String], out: &mut Vec<u8>) {
    let state = match link.state {
        LinkState::Open => "open",
        LinkState::Lost => "lost",
        LinkState::NotOpen => "not_open",
    };
    write_text(out, &format!("{{\"link\":{}", link.id));
    write_pair(out, "url", &link.url);
    write_pair(out, "state", state);
    write_text(out, ",\"troubles\":[");
    for (n, line) in lines.iter().enumerate() {
        write_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, line);
    }
    write_text(out, "]}\n");
}

fn write_axis_json(axis: &AxisInfo, state: &AxisState, out: &mut Vec<u8>) {
    let now = clock::wall_ns(clock::now()) as f64 / 1e9;
    let (number, link) = (AxisNumber(axis.number).json(), axis.link);
    write_text(out, &format!("{{\"time\":{now:.6},\"axis\":{number},\"link\":{link}"));
    write_pair(out, "name", &axis.name);
    write_pair(out, "drive", &axis.profile);
    write_pair(out, "protocol", &axis.protocol);
    write_pair(out, "state", activity(state).word());
    write_text(out, ",\"signals\":{");
    for (n, signal_value) in state.signals.iter().enumerate() {
        write_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, &signal_value.signal);
        write_text(out, ":{\"value\":");
        jsonl::write_real(out, signal_value.value.unwrap_or(f64::NAN));
        write_pair(out, "unit", &signal_value.unit);
        write_text(out, &format!(",\"age\":{:.6}}}", signal_value.age_ms / 1e3));
    }
    write_text(out, "},\"troubles\":[");
    for (n, line) in trouble_lines(state).iter().enumerate() {
        write_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, line.trim());
    }
    write_text(out, "]}\n");
}

/// `since` counts seconds from the server's start.
fn write_frame_json(item: &FrameItem, out: &mut Vec<u8>) {
    write_text(out, &format!("{{\"since\":{:.6},\"link\":{}", item.t_us / 1e6, item.link));
    let direction = match item.dir {
        Some(FrameDirection::Tx) => "tx",
        Some(FrameDirection::Rx) => "rx",
        None => "",
    };
    write_pair(out, "direction", direction);
    write_pair(out, "raw", &item.raw);
    write_pair(out, "protocol", &item.protocol);
    write_pair(out, "text", &item.text);
    let axis = item.axis.map_or("null".to_owned(), |axis| axis.to_string());
    write_text(out, &format!(",\"axis\":{axis},\"ok\":{}}}\n", item.ok));
}

#[cfg(test)]
mod tests {
    use polepair_client::message::{ActiveFault, SignalValue};

    use super::*;

    #[test]
    fn a_motor_that_fell_silent_while_it_turned_is_told_with_what_stops_it() {
        let (signal, unit) = (Signal::Velocity.name().to_owned(), "rad/s".to_owned());
        let velocity = SignalValue { signal, value: Some(31.5), unit, age_ms: 9000.0 };
        let mut state = AxisState {
            id: 0,
            mode: None,
            enabled: Some(true),
            armed: true,
            moving: None,
            signals: vec![velocity],
            faults: Vec::new(),
            lease: None,
            pending_stop: None,
            panel: None,
        };
        let reported =
            |state: &AxisState| exit_note(Some("http://127.0.0.1:7365"), "axis 3", "0#3", state);
        let whole = "axis 3 turned at 31.5 rad/s at the last reading and was not stopped; to stop it: \
                     polepair --server http://127.0.0.1:7365 stop 0#3";
        assert_eq!(
            (activity(&state), reported(&state).as_deref()),
            (AxisActivity::Silent, Some(whole))
        );
        let gone = exit_note(None, "axis 3", "0#3", &state).expect("it is told");
        assert!(gone.ends_with("the server is gone: it may still turn, cut its supply"), "{gone}");
        state.signals[0].age_ms = 10.0;
        assert_eq!(activity(&state), AxisActivity::Turning);
        let word = || "overcurrent".to_owned();
        let (name, symbol, cause, remedy) = (word(), word(), word(), word());
        state.faults = vec![ActiveFault { code: 1, name, symbol, cause, remedy, warning: false }];
        assert_eq!(
            (activity(&state), reported(&state).as_deref()),
            (AxisActivity::Fault, Some(whole))
        );
        state.moving = Some(false);
        assert_eq!(reported(&state), None);
        let alarm = |state: &AxisState| {
            trouble_lines(state).iter().filter(|line| line.contains("CUT ITS SUPPLY")).count()
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
