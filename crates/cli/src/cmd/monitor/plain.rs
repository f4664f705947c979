//! Axes and frames as lines: for pipes, files, and programs.

use std::time::Duration;

use polepair_capture::{Event, jsonl, text};
use polepair_core::profile::{Severity, Signal};
use polepair_link::clock;

use super::axes::{Doing, Watched};
use super::model::Monitor;
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, Output, Table, say};

/// How often it is looked what came.
const LOOK: Duration = Duration::from_millis(20);
/// How often the link is told of, as JSON.
const LINK_EVERY: Duration = Duration::from_secs(1);

/// How it is printed.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    /// As JSON objects.
    pub jsonl: bool,
    /// One round of questions.
    pub once: bool,
}

/// Prints until the time is over, or somebody ends it.
pub fn run(mut monitor: Monitor, style: Style, span: Option<Duration>) -> Result {
    let mut lines = Lines::new(style.jsonl);
    let ended = print(&mut monitor, style, span, &mut lines);
    if !matches!(&ended, Err(problem) if problem.exit != Exit::Interrupted) {
        lines.link(&monitor);
        lines.out.flush()?;
        monitor.farewell().iter().for_each(|line| say(line));
    }
    ended
}

fn print(monitor: &mut Monitor, style: Style, span: Option<Duration>, lines: &mut Lines) -> Result {
    let mut told = Duration::ZERO;
    loop {
        if monitor.look(&mut |event| lines.frame(event))? {
            monitor.settle(&mut |event| lines.frame(event));
            lines.axes(monitor);
        }
        let age = monitor.age();
        if style.jsonl && age >= told + LINK_EVERY {
            told = age;
            lines.link(monitor);
        }
        lines.out.flush()?;
        if interrupt::came() {
            return Err(Problem::interrupted());
        }
        if style.once || span.is_some_and(|span| age >= span) {
            return Ok(Exit::Ok);
        }
        monitor.sleep(LOOK.min(monitor.period()));
    }
}

struct Lines {
    out: Output,
    jsonl: bool,
    text: text::Text,
    /// What each axis did when its table was printed.
    did: Vec<(Doing, usize)>,
}

impl Lines {
    fn new(jsonl: bool) -> Self {
        let style = text::Style { colour: terminal::colour_out(), ..text::Style::default() };
        Self { out: Output::stdout(), jsonl, text: text::Text::new(style), did: Vec::new() }
    }

    fn frame(&mut self, event: &Event<'_>) {
        match self.jsonl {
            true => jsonl::write(event, self.out.buffer()),
            false => self.text.write(event, self.out.buffer()),
        }
    }

    /// A table when an axis does something else than in the last one; as JSON each time.
    fn axes(&mut self, monitor: &Monitor) {
        if self.jsonl {
            return monitor.axes.iter().for_each(|axis| object(axis, self.out.buffer()));
        }
        let do_now = |axis: &Watched| (axis.doing(), axis.faults().len());
        let did: Vec<(Doing, usize)> = monitor.axes.iter().map(do_now).collect();
        if did != self.did {
            self.did = did;
            self.out.buffer().extend_from_slice(table(&monitor.axes).as_bytes());
        }
    }

    fn link(&mut self, monitor: &Monitor) {
        match self.jsonl {
            true => link_object(monitor, self.out.buffer()),
            false => self.out.line(&summary(monitor)),
        }
    }
}

/// The axes, and below them their faults with cause and remedy.
fn table(axes: &[Watched]) -> String {
    let heads = ["axis", "drive", "state", "mode", "position", "velocity", "torque", "age"];
    let mut table = Table::with_heads(&heads);
    for watched in axes {
        let cell = |signal| watched.shown(signal).map_or_else(|| "-".to_owned(), |s| s.to_string());
        table.row([
            watched.name(),
            watched.axis.profile().name.to_owned(),
            watched.doing().word().to_owned(),
            cell(Signal::Mode),
            cell(Signal::Position),
            cell(Signal::Velocity),
            watched.effort().map_or_else(|| "-".to_owned(), |shown| shown.to_string()),
            watched.age().map_or_else(|| "-".to_owned(), age),
        ]);
    }
    let mut text = table.render(terminal::colour_out());
    for watched in axes {
        for (line, _) in troubles(watched) {
            text.push_str(&format!("{}: {line}\n", watched.axis.label()));
        }
    }
    text
}

/// What is wrong with an axis, a line each, and whether it stopped the drive.
pub fn troubles(watched: &Watched) -> Vec<(String, bool)> {
    let mut lines = Vec::new();
    if let Some((_, why)) = &watched.silent {
        lines.push((why.clone(), true));
    }
    for fault in watched.faults() {
        let Some(fault) = fault else {
            let code = watched.shown(Signal::Fault).map_or(0, |shown| shown.raw);
            lines.push((format!("FAULT code {code}: not known to this profile"), true));
            continue;
        };
        let stops = fault.severity == Severity::Fault;
        let word = if stops { "FAULT" } else { "warning" };
        lines.push((format!("{word} {}: {}", fault.name, fault.text), stops));
        for (word, sentence) in [("cause", fault.cause), ("remedy", fault.remedy)] {
            if !sentence.is_empty() {
                lines.push((format!("  {word}: {sentence}"), false));
            }
        }
    }
    lines
}

/// An age as people say it.
pub fn age(age: Duration) -> String {
    match age.as_millis() {
        ms @ 0..1000 => format!("{ms} ms"),
        ms @ 1000..100_000 => format!("{:.1} s", ms as f64 / 1e3),
        ms => format!("{} s", ms / 1000),
    }
}

fn summary(monitor: &Monitor) -> String {
    let (count, wrong) = monitor.traffic.counts();
    let mut text = format!("{count} frames");
    if monitor.age() >= LINK_EVERY {
        text.push_str(&format!(" in {}", age(monitor.age())));
    }
    for (name, load) in monitor.traffic.wires() {
        if let Some(load) = load {
            text.push_str(&format!(", {name} {:.1} % busy", load * 100.0));
        }
    }
    for (count, word) in trouble_counts(monitor, wrong) {
        if count > 0 {
            text.push_str(&format!(", {count} {word}"));
        }
    }
    text
}

/// What went wrong on the link, by its word.
pub fn trouble_counts(monitor: &Monitor, wrong: u64) -> [(u64, &'static str); 8] {
    let counters = monitor.counters().unwrap_or_default();
    let losses = monitor.losses();
    [
        (counters.silent, "silent"),
        (counters.resent, "resent"),
        (counters.late, "late"),
        (counters.foreign, "foreign"),
        (counters.corrupt, "corrupt"),
        (wrong, "wrong"),
        (losses.errors, "bus errors"),
        (monitor.traffic.lost + losses.overrun + losses.malformed, "lost"),
    ]
}

fn object(watched: &Watched, out: &mut Vec<u8>) {
    let now = clock::wall_ns(watched.axis.connection().now());
    let add = |out: &mut Vec<u8>, text: &str| out.extend_from_slice(text.as_bytes());
    let pair = |out: &mut Vec<u8>, key: &str, text: &str| {
        add(out, &format!(",\"{key}\":"));
        jsonl::string(out, text);
    };
    add(out, &format!("{{\"time\":{:.6},\"axis\":{}", now as f64 / 1e9, watched.axis.number()));
    pair(out, "name", watched.axis.name());
    pair(out, "drive", watched.axis.profile().name);
    pair(out, "protocol", watched.axis.protocol());
    pair(out, "state", watched.doing().word());
    add(out, ",\"signals\":{");
    let shown = Signal::ALL.into_iter().filter_map(|s| Some((s, watched.shown(s)?)));
    for (n, (signal, shown)) in shown.enumerate() {
        add(out, if n > 0 { "," } else { "" });
        jsonl::string(out, signal.name());
        add(out, ":{\"value\":");
        jsonl::real(out, shown.value);
        pair(out, "unit", shown.unit);
        if let Some(word) = shown.word {
            pair(out, "word", word);
        }
        add(out, &format!(",\"age\":{:.6}}}", shown.age.as_secs_f64()));
    }
    add(out, "},\"troubles\":[");
    for (n, (line, _)) in troubles(watched).iter().enumerate() {
        add(out, if n > 0 { "," } else { "" });
        jsonl::string(out, line.trim());
    }
    add(out, "]}\n");
}

fn link_object(monitor: &Monitor, out: &mut Vec<u8>) {
    let add = |out: &mut Vec<u8>, text: &str| out.extend_from_slice(text.as_bytes());
    let (count, wrong) = monitor.traffic.counts();
    add(out, &format!("{{\"time\":{:.6},\"url\":", clock::wall_ns(monitor.now()) as f64 / 1e9));
    jsonl::string(out, &monitor.url);
    let (age, rate) = (monitor.age().as_secs_f64(), monitor.traffic.per_second());
    add(out, &format!(",\"age\":{age:.3},\"frames\":{count},\"per second\":{rate:.1}"));
    for (count, word) in trouble_counts(monitor, wrong) {
        add(out, &format!(",\"{word}\":{count}"));
    }
    add(out, ",\"load\":{");
    for (n, (name, load)) in monitor.traffic.wires().enumerate() {
        add(out, if n > 0 { "," } else { "" });
        jsonl::string(out, name);
        let load = load.map_or("null".to_owned(), |load| format!("{load:.4}"));
        add(out, &format!(":{load}"));
    }
    add(out, "}}\n");
}
