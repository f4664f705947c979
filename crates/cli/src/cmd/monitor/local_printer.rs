//! Prints axes and frames of a link as lines, for pipes, files and programs.

use std::time::Duration;

use polepair::url::AxisNumber;
use polepair_capture::{DecodedFrame, jsonl, text};
use polepair_core::profile::Signal;
use polepair_link::clock;

use super::model::Monitor;
use super::monitored_axis::{AxisActivity, MonitoredAxis};
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, DataOutput, TextTable, print_note};

/// Interval of polling received frames.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Interval of reports on the link as JSON.
const LINK_EVERY: Duration = Duration::from_secs(1);

/// Style of the output.
#[derive(Clone, Copy, Debug)]
pub struct PrintStyle {
    /// True for JSON objects.
    pub jsonl: bool,
    /// One round of questions.
    pub once: bool,
}

/// Prints until the time is over, or the user ends it.
pub fn run(mut monitor: Monitor, style: PrintStyle, span: Option<Duration>) -> Result {
    let mut lines = LocalPrinter::new(style.jsonl);
    let ended = print_until(&mut monitor, style, span, &mut lines);
    if !matches!(&ended, Err(problem) if problem.exit != Exit::Interrupted) {
        lines.print_link(&monitor);
        lines.out.flush()?;
        monitor.exit_notes().iter().for_each(|line| print_note(line));
    }
    ended
}

fn print_until(
    monitor: &mut Monitor,
    style: PrintStyle,
    span: Option<Duration>,
    lines: &mut LocalPrinter,
) -> Result {
    let mut reported_at = Duration::ZERO;
    loop {
        if monitor.poll(&mut |event| lines.print_frame(event))? {
            monitor.wait_answers(&mut |event| lines.print_frame(event));
            lines.print_axes(monitor);
        }
        let age = monitor.age();
        if style.jsonl && age >= reported_at + LINK_EVERY {
            reported_at = age;
            lines.print_link(monitor);
        }
        lines.out.flush()?;
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        if style.once || span.is_some_and(|span| age >= span) {
            return Ok(Exit::Ok);
        }
        monitor.sleep(POLL_INTERVAL.min(monitor.period()));
    }
}

struct LocalPrinter {
    out: DataOutput,
    jsonl: bool,
    text: text::FrameTextWriter,
    /// Activity of each axis when its table was printed.
    last_activity: Vec<(AxisActivity, usize)>,
}

impl LocalPrinter {
    fn new(jsonl: bool) -> Self {
        let style =
            text::TextStyle { colour: terminal::colour_out(), ..text::TextStyle::default() };
        Self {
            out: DataOutput::stdout().with_text(!jsonl),
            jsonl,
            text: text::FrameTextWriter::new(style),
            last_activity: Vec::new(),
        }
    }

    fn print_frame(&mut self, event: &DecodedFrame<'_>) {
        if self.jsonl {
            jsonl::write_frame(event, self.out.buffer())
        } else {
            self.text.write(event, self.out.buffer())
        }
    }

    /// A table when an axis does something else than in the last one; as JSON each time.
    fn print_axes(&mut self, monitor: &Monitor) {
        if self.jsonl {
            return monitor.axes.iter().for_each(|axis| write_axis_json(axis, self.out.buffer()));
        }
        let did: Vec<(AxisActivity, usize)> =
            monitor.axes.iter().map(|axis| (axis.activity(), axis.faults().len())).collect();
        if did != self.last_activity {
            self.last_activity = did;
            self.out.buffer().extend_from_slice(axes_table(&monitor.axes).as_bytes());
        }
    }

    fn print_link(&mut self, monitor: &Monitor) {
        if self.jsonl {
            write_link_json(monitor, self.out.buffer())
        } else {
            self.out.write_line(&summary_line(monitor))
        }
    }
}

/// The axes, and below them their faults with cause and remedy.
fn axes_table(axes: &[MonitoredAxis]) -> String {
    let heads = ["axis", "drive", "state", "mode", "position", "velocity", "torque", "age"];
    let mut table = TextTable::with_heads(&heads);
    for watched in axes {
        table.add_row([
            watched.name(),
            watched.axis.profile().name.to_owned(),
            watched.activity().word().to_owned(),
            signal_cell(Signal::Mode, watched),
            signal_cell(Signal::Position, watched),
            signal_cell(Signal::Velocity, watched),
            watched.effort().map_or_else(|| "-".to_owned(), |shown| shown.to_string()),
            watched.age().map_or_else(|| "-".to_owned(), format_age),
        ]);
    }
    let mut text = table.render(terminal::colour_out());
    for watched in axes {
        for (line, _) in trouble_lines(watched) {
            text.push_str(&format!("{}: {line}\n", watched.axis.label()));
        }
    }
    text
}

fn signal_cell(signal: Signal, watched: &MonitoredAxis) -> String {
    watched.display_value(signal).map_or_else(|| "-".to_owned(), |s| s.to_string())
}

/// Troubles of an axis, a line each, and whether it stopped the drive.
pub fn trouble_lines(watched: &MonitoredAxis) -> Vec<(String, bool)> {
    let mut lines = Vec::new();
    if let Some((_, why)) = &watched.silent {
        lines.push((why.clone(), true));
    }
    for fault in watched.faults() {
        let word = if fault.is_warning { "warning" } else { "FAULT" };
        lines.push((format!("{word} {}: {}", fault.name, fault.text), !fault.is_warning));
        for (word, sentence) in [("cause", &fault.cause), ("remedy", &fault.remedy)] {
            if !sentence.is_empty() {
                lines.push((format!("  {word}: {sentence}"), false));
            }
        }
    }
    lines
}

/// An age for people.
pub fn format_age(age: Duration) -> String {
    match age.as_millis() {
        ms @ 0..1000 => format!("{ms} ms"),
        ms @ 1000..100_000 => format!("{:.1} s", ms as f64 / 1e3),
        ms => format!("{} s", ms / 1000),
    }
}

fn summary_line(monitor: &Monitor) -> String {
    let (count, wrong) = monitor.traffic.counts();
    let mut text = format!("{count} frames");
    if monitor.age() >= LINK_EVERY {
        text.push_str(&format!(" in {}", format_age(monitor.age())));
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

/// Counts of errors of the link, by their words.
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

fn write_axis_json(watched: &MonitoredAxis, out: &mut Vec<u8>) {
    let now = clock::wall_ns(watched.axis.connection().now());
    let pair = |out: &mut Vec<u8>, key: &str, text: &str| {
        push_text(out, &format!(",\"{key}\":"));
        jsonl::write_string(out, text);
    };
    push_text(
        out,
        &format!(
            "{{\"time\":{:.6},\"axis\":{}",
            now as f64 / 1e9,
            AxisNumber(watched.axis.number()).json()
        ),
    );
    pair(out, "name", watched.axis.name());
    pair(out, "drive", watched.axis.profile().name);
    pair(out, "protocol", watched.axis.protocol());
    pair(out, "state", watched.activity().word());
    push_text(out, ",\"signals\":{");
    let shown = Signal::ALL.into_iter().filter_map(|s| Some((s, watched.display_value(s)?)));
    for (n, (signal, shown)) in shown.enumerate() {
        push_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, signal.name());
        push_text(out, ":{\"value\":");
        jsonl::write_real(out, shown.value);
        pair(out, "unit", shown.unit);
        if let Some(word) = shown.word {
            pair(out, "word", word);
        }
        push_text(out, &format!(",\"age\":{:.6}}}", shown.age.as_secs_f64()));
    }
    push_text(out, "},\"troubles\":[");
    for (n, (line, _)) in trouble_lines(watched).iter().enumerate() {
        push_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, line.trim());
    }
    push_text(out, "]}\n");
}

fn push_text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(text.as_bytes())
}

fn write_link_json(monitor: &Monitor, out: &mut Vec<u8>) {
    let (count, wrong) = monitor.traffic.counts();
    push_text(
        out,
        &format!("{{\"time\":{:.6},\"url\":", clock::wall_ns(monitor.now()) as f64 / 1e9),
    );
    jsonl::write_string(out, &monitor.url);
    let (age, rate) = (monitor.age().as_secs_f64(), monitor.traffic.per_second());
    push_text(out, &format!(",\"age\":{age:.3},\"frames\":{count},\"per second\":{rate:.1}"));
    for (count, word) in trouble_counts(monitor, wrong) {
        push_text(out, &format!(",\"{word}\":{count}"));
    }
    push_text(out, ",\"load\":{");
    for (n, (name, load)) in monitor.traffic.wires().enumerate() {
        push_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, name);
        let load = load.map_or("null".to_owned(), |load| format!("{load:.4}"));
        push_text(out, &format!(":{load}"));
    }
    push_text(out, "}}\n");
}
