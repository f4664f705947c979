//! Axes and frames of a running server, as lines. It tells them by itself: nothing is asked of a drive.

use std::time::Duration;

use polepair_capture::jsonl;
use polepair_client::message::{
    AxisInfo, AxisState, FrameDirection, FrameItem, LinkState, LinkView, StopClass, StopOwed,
};
use polepair_client::{Frames, Live};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::axes::Doing;
use super::plain::{Style, age};
use crate::interrupt;
use crate::joined::{self, Joined};
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{Output, Table, colour_out, say};

/// How often it is looked what came.
const LOOK: Duration = Duration::from_millis(20);
/// How long the first word of each axis is waited for.
const FIRST_MAX: Duration = Duration::from_secs(2);
/// A drive of which nothing was heard for so long does not answer, ms.
const SILENT_MS: f64 = 4000.0;
/// Slower than this is standing still, in rad/s and m/s.
const STANDING: f64 = 1e-3;

/// Prints until the time is over, or somebody ends it.
pub fn run(
    server: &Joined,
    axes: Vec<AxisInfo>,
    style: Style,
    period: Duration,
    span: Option<Duration>,
) -> Result {
    let live = server.gateway.live().map_err(joined::refused)?;
    let frames = (!style.once).then(|| live.frames(None)).transpose().map_err(joined::refused)?;
    interrupt::listen(|| {});
    let (out, jsonl) = (Output::stdout(), style.jsonl);
    let mut lines = Lines { out, jsonl, did: Vec::new(), wanting: Vec::new(), seen: (0, 0, 0) };
    let ended = lines.print(&live, frames.as_ref(), &axes, style, period, span);
    if !matches!(&ended, Err(problem) if problem.exit != Exit::Interrupted) {
        lines.close(server.gateway.url(), &live, &axes)?;
    }
    ended
}

struct Lines {
    out: Output,
    jsonl: bool,
    /// What each axis did when its table was printed.
    did: Vec<(Doing, usize)>,
    /// What was missing of links when it was printed: their numbers, states and errors' codes.
    wanting: Vec<(u16, LinkState, String)>,
    /// Frames, those that break their protocol, those that were lost.
    seen: (u64, u64, u64),
}

impl Lines {
    fn print(
        &mut self,
        live: &Live,
        frames: Option<&Frames>,
        axes: &[AxisInfo],
        style: Style,
        period: Duration,
        span: Option<Duration>,
    ) -> Result {
        let begun = clock::now();
        let mut next = begun;
        loop {
            let (items, lost) =
                frames.map_or(Ok((Vec::new(), 0)), Frames::drain).map_err(joined::refused)?;
            self.seen.2 = lost;
            items.iter().for_each(|item| self.frame(item));
            let now = clock::now();
            let states = states(live, axes)?;
            let all_there = states.len() == axes.len() || now.since(begun) > FIRST_MAX;
            let due = now >= next && all_there;
            self.links(&live.links());
            if due {
                // What was too slow is not caught up with.
                next = (next + period).max(now);
                self.axes(&states);
            }
            self.out.flush()?;
            if interrupt::came() {
                return Err(Problem::interrupted());
            }
            if style.once && due || span.is_some_and(|span| now.since(begun) >= span) {
                return Ok(Exit::Ok);
            }
            sleep(now, period.min(LOOK));
        }
    }

    fn frame(&mut self, item: &FrameItem) {
        self.seen.0 += 1;
        self.seen.1 += u64::from(!item.ok);
        let out = self.out.buffer();
        if self.jsonl {
            return frame_object(item, out);
        }
        let arrow = match item.dir {
            Some(FrameDirection::Tx) => '>',
            Some(FrameDirection::Rx) => '<',
            None => ' ',
        };
        let FrameItem { link, raw, protocol, text, ok, .. } = item;
        let (seconds, wrong) = (item.t_us / 1e6, if *ok { "" } else { " !" });
        let line = format!("{seconds:>12.6} {link} {arrow} {protocol:<8} {raw:<26} {text}{wrong}");
        self.out.line(&line);
    }

    /// What is missing of links, when it is something else than before.
    fn links(&mut self, links: &[LinkView]) {
        let brief = |link: &LinkView| {
            let code = link.error.as_ref().map_or("", |error| &error.code);
            (link.id, link.state, code.to_owned())
        };
        let now: Vec<_> = links.iter().map(brief).collect();
        if now == self.wanting {
            return;
        }
        for link in links.iter().filter(|link| !self.wanting.contains(&brief(link))) {
            let lines = joined::wanting(link);
            if self.jsonl && (!lines.is_empty() || !self.wanting.is_empty()) {
                link_object(link, &lines, self.out.buffer());
            } else if !self.jsonl {
                let is_back = lines.is_empty() && !self.wanting.is_empty();
                let back = is_back.then(|| format!("link {} is open", link.id));
                lines.into_iter().chain(back).for_each(|line| self.out.line(&line));
            }
        }
        self.wanting = now;
    }

    /// A table when an axis does something else than in the last one; as JSON each time.
    fn axes(&mut self, states: &[(&AxisInfo, AxisState)]) {
        if self.jsonl {
            return states.iter().for_each(|(axis, state)| object(axis, state, self.out.buffer()));
        }
        let do_now = |(_, state): &(&AxisInfo, AxisState)| {
            (doing(state), state.faults.len() + usize::from(state.owed.is_some()))
        };
        let did: Vec<_> = states.iter().map(do_now).collect();
        if did != self.did {
            self.did = did;
            self.out.buffer().extend_from_slice(table(states).as_bytes());
        }
    }

    /// What came in all, and what a person who leaves must know.
    fn close(&mut self, url: &str, live: &Live, axes: &[AxisInfo]) -> Result<()> {
        let (frames, wrong, lost) = self.seen;
        match self.jsonl {
            true => {
                self.out.line(&format!("{{\"frames\":{frames},\"wrong\":{wrong},\"lost\":{lost}}}"))
            }
            false => self.out.line(&format!("{frames} frames, {wrong} wrong, {lost} lost")),
        }
        self.out.flush()?;
        for (axis, state) in states(live, axes)? {
            if let Some(told) = left(Some(url), &axis.label, &number(axis), &state) {
                say(&told);
            }
        }
        Ok(())
    }
}

fn sleep(now: Instant, span: Duration) {
    clock::sleep_until(now + span);
}

/// The axes of which the server has said something.
fn states<'a>(live: &Live, axes: &'a [AxisInfo]) -> Result<Vec<(&'a AxisInfo, AxisState)>> {
    let state = |axis: &'a AxisInfo| Ok(live.state(axis.id)?.map(|state| (axis, state)));
    axes.iter()
        .filter_map(|axis| state(axis).transpose())
        .collect::<std::result::Result<_, _>>()
        .map_err(joined::refused)
}

fn value(state: &AxisState, signal: Signal) -> Option<f64> {
    state.signals.iter().find(|told| told.signal == signal.name()).and_then(|told| told.value)
}

/// Whether it turned when it was last heard of, however long ago that is and whatever else it has.
fn turns(state: &AxisState) -> bool {
    let by_speed = || value(state, Signal::Velocity).is_some_and(|speed| speed.abs() > STANDING);
    state.moving.unwrap_or_else(by_speed)
}

/// What a person must know who leaves a motor that turns, or may. Without a server nobody stops it.
pub fn left(url: Option<&str>, label: &str, number: &str, state: &AxisState) -> Option<String> {
    let speed = state.signals.iter().find(|told| told.signal == Signal::Velocity.name());
    let speed = speed.and_then(|told| Some(joined::shown(told.value?, &told.unit)));
    let speed = speed.map_or_else(String::new, |speed| format!(" at {speed}"));
    if state.owed.is_some() && url.is_some() {
        return Some(format!(
            "{label} was told to stop and not seen standing: the server says it again; if it turns, cut \
             its supply"
        ));
    }
    turns(state).then(|| match url {
        Some(url) => format!(
            "{label} turned{speed} when last asked and was left so; this stops it: \
             polepair --server {url} stop {number}"
        ),
        None => format!(
            "{label} turned{speed} when last heard of, and the server is gone: it may still turn, \
             cut its supply"
        ),
    })
}

pub fn doing(state: &AxisState) -> Doing {
    let newest = state.signals.iter().map(|signal| signal.age_ms).fold(f64::MAX, f64::min);
    match state.enabled {
        _ if state.signals.is_empty() => Doing::Unknown,
        _ if newest > SILENT_MS => Doing::Silent,
        _ if !state.faults.is_empty() => Doing::Fault,
        _ if turns(state) => Doing::Turns,
        Some(true) => Doing::Holds,
        Some(false) => Doing::Off,
        None => Doing::Stands,
    }
}

/// As the server's verbs take it.
pub fn number(axis: &AxisInfo) -> String {
    format!("{}#{}", axis.link, axis.number)
}

pub fn who(axis: &AxisInfo) -> String {
    let number = number(axis);
    if axis.name.is_empty() { number } else { format!("{number} {}", axis.name) }
}

/// The axes, and below them their faults with cause and remedy.
fn table(states: &[(&AxisInfo, AxisState)]) -> String {
    let heads = ["axis", "drive", "state", "mode", "position", "velocity", "torque", "age"];
    let mut table = Table::with_heads(&heads);
    for (axis, state) in states {
        let told = |wanted: Signal| state.signals.iter().find(|s| s.signal == wanted.name());
        let cell = |signal: Signal| match told(signal).and_then(|s| Some((s.value?, &*s.unit))) {
            Some((value, unit)) => joined::shown(value, unit),
            None => "-".to_owned(),
        };
        let effort = if told(Signal::Torque).is_some() { Signal::Torque } else { Signal::Current };
        let oldest = state.signals.iter().map(|signal| signal.age_ms).reduce(f64::max);
        table.row([
            who(axis),
            axis.profile.clone(),
            doing(state).word().to_owned(),
            state.mode.clone().unwrap_or_else(|| "-".to_owned()),
            cell(Signal::Position),
            cell(Signal::Velocity),
            cell(effort),
            oldest.map_or_else(
                || "-".to_owned(),
                |ms| age(Duration::from_secs_f64(ms.clamp(0.0, 1e9) / 1e3)),
            ),
        ]);
    }
    let mut text = table.render(colour_out());
    for (axis, state) in states {
        for line in troubles(state) {
            text.push_str(&format!("{}: {line}\n", axis.label));
        }
    }
    text
}

/// What to say of an axis that is owed a stop.
fn owed(owed: &StopOwed) -> String {
    let now_ms = clock::wall_ns(clock::now()) as f64 / 1e6;
    let seconds = ((now_ms - owed.since_ms) / 1e3).max(0.0);
    let word = match owed.class {
        StopClass::Acknowledged => "taken, not seen standing",
        StopClass::Sent => "not confirmed",
        _ => "not sent yet",
    };
    format!("MAY BE TURNING, CUT ITS SUPPLY: told to stop {seconds:.0} s ago, {word}")
}

pub fn troubles(state: &AxisState) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(stop) = &state.owed {
        lines.push(owed(stop));
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

fn add(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(text.as_bytes());
}

fn pair(out: &mut Vec<u8>, key: &str, text: &str) {
    add(out, &format!(",\"{key}\":"));
    jsonl::string(out, text);
}

fn link_object(link: &LinkView, lines: &[String], out: &mut Vec<u8>) {
    let state = match link.state {
        LinkState::Open => "open",
        LinkState::Lost => "lost",
        LinkState::NotOpen => "not_open",
    };
    add(out, &format!("{{\"link\":{}", link.id));
    pair(out, "url", &link.url);
    pair(out, "state", state);
    add(out, ",\"troubles\":[");
    for (n, line) in lines.iter().enumerate() {
        add(out, if n > 0 { "," } else { "" });
        jsonl::string(out, line);
    }
    add(out, "]}\n");
}

fn object(axis: &AxisInfo, state: &AxisState, out: &mut Vec<u8>) {
    let now = clock::wall_ns(clock::now()) as f64 / 1e9;
    let (number, link) = (axis.number, axis.link);
    add(out, &format!("{{\"time\":{now:.6},\"axis\":{number},\"link\":{link}"));
    pair(out, "name", &axis.name);
    pair(out, "drive", &axis.profile);
    pair(out, "protocol", &axis.protocol);
    pair(out, "state", doing(state).word());
    add(out, ",\"signals\":{");
    for (n, told) in state.signals.iter().enumerate() {
        add(out, if n > 0 { "," } else { "" });
        jsonl::string(out, &told.signal);
        add(out, ":{\"value\":");
        jsonl::real(out, told.value.unwrap_or(f64::NAN));
        pair(out, "unit", &told.unit);
        add(out, &format!(",\"age\":{:.6}}}", told.age_ms / 1e3));
    }
    add(out, "},\"troubles\":[");
    for (n, line) in troubles(state).iter().enumerate() {
        add(out, if n > 0 { "," } else { "" });
        jsonl::string(out, line.trim());
    }
    add(out, "]}\n");
}

/// `since` counts seconds from the server's start.
fn frame_object(item: &FrameItem, out: &mut Vec<u8>) {
    add(out, &format!("{{\"since\":{:.6},\"link\":{}", item.t_us / 1e6, item.link));
    let direction = match item.dir {
        Some(FrameDirection::Tx) => "tx",
        Some(FrameDirection::Rx) => "rx",
        None => "",
    };
    pair(out, "direction", direction);
    pair(out, "raw", &item.raw);
    pair(out, "protocol", &item.protocol);
    pair(out, "text", &item.text);
    let axis = item.axis.map_or("null".to_owned(), |axis| axis.to_string());
    add(out, &format!(",\"axis\":{axis},\"ok\":{}}}\n", item.ok));
}

#[cfg(test)]
mod tests {
    use polepair_client::message::{FaultTold, SignalValue};

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
            owed: None,
            panel: None,
        };
        let told = |state: &AxisState| left(Some("http://127.0.0.1:7365"), "axis 3", "0#3", state);
        let whole = "axis 3 turned at 31.5 rad/s when last asked and was left so; this stops it: \
                     polepair --server http://127.0.0.1:7365 stop 0#3";
        assert_eq!((doing(&state), told(&state).as_deref()), (Doing::Silent, Some(whole)));
        let gone = left(None, "axis 3", "0#3", &state).expect("it is told");
        assert!(gone.ends_with("the server is gone: it may still turn, cut its supply"), "{gone}");
        state.signals[0].age_ms = 10.0;
        assert_eq!(doing(&state), Doing::Turns);
        let word = || "overcurrent".to_owned();
        let (name, symbol, cause, remedy) = (word(), word(), word(), word());
        state.faults = vec![FaultTold { code: 1, name, symbol, cause, remedy, warning: false }];
        assert_eq!((doing(&state), told(&state).as_deref()), (Doing::Fault, Some(whole)));
        state.moving = Some(false);
        assert_eq!(told(&state), None);
        let alarm = |state: &AxisState| {
            troubles(state).iter().filter(|line| line.contains("CUT ITS SUPPLY")).count()
        };
        assert_eq!(alarm(&state), 0);
        state.owed = Some(StopOwed {
            since_ms: 0.0,
            why: polepair_client::message::OwedWhy::Stop,
            by: "ann".into(),
            class: StopClass::Sent,
            said: 3,
            error: None,
        });
        assert_eq!(alarm(&state), 1);
        // It is owed that whatever it was last read to do.
        assert!(told(&state).is_some_and(|told| told.contains("not seen standing")));
    }
}
