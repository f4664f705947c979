//! Prints axes and frames as lines, for pipes, files and programs.

use std::time::Duration;

use polepair::url::AxisNumber;
use polepair_capture::{jsonl, text};
use polepair_core::explain::Direction;
use polepair_core::profile::Signal;
use polepair_link::clock;

use super::model::Monitor;
use super::source::{AxisActivity, AxisRow, LinkReport, ShownFrame, SignalRow, format_age};
use super::traffic::FrameRow;
use crate::data_output::DataOutput;
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, TextTable, print_note};

/// Interval of polling received frames.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Interval of reports on the link as JSON.
const LINK_EVERY: Duration = Duration::from_secs(1);

/// Style of the output.
#[derive(Clone, Copy, Debug)]
pub struct PrintStyle {
    /// True for JSON objects.
    pub jsonl: bool,
    /// One round of values.
    pub once: bool,
    /// Interval of rounds.
    pub period: Duration,
}

/// Prints until the time is over, or the user ends it.
pub fn run(monitor: &mut Monitor, style: PrintStyle, span: Option<Duration>) -> Result {
    let mut printer = Printer::new(style.jsonl);
    let ended = print_until(monitor, style, span, &mut printer);
    if !matches!(&ended, Err(problem) if problem.exit != Exit::Interrupted) {
        printer.print_totals(monitor);
        printer.out.flush()?;
        monitor.source.exit_notes().iter().for_each(|line| print_note(line));
    }
    ended
}

fn print_until(
    monitor: &mut Monitor,
    style: PrintStyle,
    span: Option<Duration>,
    printer: &mut Printer,
) -> Result {
    let mut reported_at = Duration::ZERO;
    loop {
        let round = monitor.poll(&mut |frame| printer.print_frame(frame))?;
        printer.print_links(&monitor.status().links);
        if round {
            printer.print_axes(monitor);
        }
        let age = monitor.age();
        if style.jsonl && age >= reported_at + LINK_EVERY {
            reported_at = age;
            printer.print_totals(monitor);
        }
        printer.out.flush()?;
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        if style.once && round || span.is_some_and(|span| age >= span) {
            return Ok(Exit::Ok);
        }
        monitor.source.sleep(POLL_INTERVAL.min(style.period));
    }
}

struct Printer {
    out: DataOutput,
    jsonl: bool,
    text: text::FrameTextWriter,
    /// Activity and number of troubles of each axis when the table was last printed.
    last_activity: Vec<(AxisActivity, usize)>,
    /// Number, state and error code of each link when they were last printed.
    last_links: Vec<(u16, &'static str, String)>,
}

impl Printer {
    fn new(jsonl: bool) -> Self {
        let style =
            text::TextStyle { colour: terminal::colour_out(), ..text::TextStyle::default() };
        Self {
            out: DataOutput::stdout().with_text(!jsonl),
            jsonl,
            text: text::FrameTextWriter::new(style),
            last_activity: Vec::new(),
            last_links: Vec::new(),
        }
    }

    fn print_frame(&mut self, frame: ShownFrame<'_>) {
        match (frame, self.jsonl) {
            (ShownFrame::Decoded(event), true) => jsonl::write_frame(event, self.out.buffer()),
            (ShownFrame::Decoded(event), false) => self.text.write(event, self.out.buffer()),
            (ShownFrame::Explained { row, link }, true) => {
                write_frame_json(row, link, self.out.buffer());
            }
            (ShownFrame::Explained { row, link }, false) => {
                row.with_decoded(link, |event| self.text.write(event, self.out.buffer()));
            }
        }
    }

    /// Prints the troubles of links, if they changed.
    fn print_links(&mut self, links: &[LinkReport]) {
        let now: Vec<_> =
            links.iter().map(|link| (link.id, link.state, link.code.clone())).collect();
        if now == self.last_links {
            return;
        }
        let is_first = self.last_links.is_empty();
        for (link, key) in links.iter().zip(&now) {
            if self.last_links.contains(key) {
                continue;
            }
            if self.jsonl && !(is_first && link.troubles.is_empty()) {
                write_link_json(link, self.out.buffer());
            } else if !self.jsonl && !is_first && link.troubles.is_empty() {
                self.out.write_line(&format!("link {} is open", link.id));
            } else if !self.jsonl {
                link.troubles.iter().for_each(|line| self.out.write_line(line));
            }
        }
        self.last_links = now;
    }

    /// Prints a table if the activity of an axis differs from that in the last one; as JSON each time.
    fn print_axes(&mut self, monitor: &Monitor) {
        let axes = monitor.axes();
        if self.jsonl {
            let now_ns = clock::wall_ns(monitor.source.now());
            return axes.iter().for_each(|axis| write_axis_json(axis, now_ns, self.out.buffer()));
        }
        let activity: Vec<(AxisActivity, usize)> =
            axes.iter().map(|axis| (axis.activity, axis.troubles.len())).collect();
        if activity != self.last_activity {
            self.last_activity = activity;
            self.out.buffer().extend_from_slice(axes_table(&axes).as_bytes());
        }
    }

    fn print_totals(&mut self, monitor: &Monitor) {
        if self.jsonl {
            write_totals_json(monitor, self.out.buffer())
        } else {
            self.out.write_line(&totals_line(monitor))
        }
    }
}

/// The axes, and below them their troubles.
fn axes_table(axes: &[AxisRow]) -> String {
    let heads = ["axis", "drive", "state", "mode", "position", "velocity", "torque", "age"];
    let mut table = TextTable::with_heads(&heads);
    for axis in axes {
        table.add_row([
            axis.short_name(),
            axis.profile.clone(),
            axis.activity.word().to_owned(),
            signal_cell(axis.signal(Signal::Mode)),
            signal_cell(axis.signal(Signal::Position)),
            signal_cell(axis.signal(Signal::Velocity)),
            signal_cell(axis.effort()),
            axis.age().map_or_else(|| "-".to_owned(), format_age),
        ]);
    }
    let mut text = table.render(terminal::colour_out());
    for axis in axes {
        for trouble in &axis.troubles {
            text.push_str(&format!("{}: {}\n", axis.label, trouble.line));
        }
    }
    text
}

fn signal_cell(signal: Option<&SignalRow>) -> String {
    signal.map_or_else(|| "-".to_owned(), SignalRow::to_string)
}

fn totals_line(monitor: &Monitor) -> String {
    let mut text = format!("{} frames", monitor.traffic.counts().0);
    if monitor.age() >= LINK_EVERY {
        text.push_str(&format!(" in {}", format_age(monitor.age())));
    }
    for (name, load) in monitor.traffic.wires() {
        if let Some(load) = load {
            text.push_str(&format!(", {name} {:.1} % busy", load * 100.0));
        }
    }
    for (count, word) in monitor.flaws() {
        if count > 0 {
            text.push_str(&format!(", {count} {word}"));
        }
    }
    text
}

fn write_axis_json(axis: &AxisRow, now_ns: u64, out: &mut Vec<u8>) {
    push_text(
        out,
        &format!(
            "{{\"time\":{:.6},\"axis\":{}",
            now_ns as f64 / 1e9,
            AxisNumber(axis.number).json()
        ),
    );
    if let Some(link) = axis.link {
        push_text(out, &format!(",\"link\":{link}"));
    }
    push_pair(out, "name", &axis.name);
    push_pair(out, "drive", &axis.profile);
    push_pair(out, "protocol", &axis.protocol);
    push_pair(out, "state", axis.activity.word());
    push_text(out, ",\"signals\":{");
    for (n, signal) in axis.signals.iter().enumerate() {
        push_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, signal.signal.name());
        push_text(out, ":{\"value\":");
        jsonl::write_real(out, signal.value);
        push_pair(out, "unit", &signal.unit);
        if let Some(word) = &signal.word {
            push_pair(out, "word", word);
        }
        push_text(out, &format!(",\"age\":{:.6}}}", signal.age.as_secs_f64()));
    }
    push_text(out, "},\"troubles\":");
    push_list(out, axis.troubles.iter().map(|trouble| trouble.line.trim()));
    push_text(out, "}\n");
}

fn write_link_json(link: &LinkReport, out: &mut Vec<u8>) {
    push_text(out, &format!("{{\"link\":{}", link.id));
    push_pair(out, "url", &link.url);
    push_pair(out, "state", link.state);
    push_text(out, ",\"troubles\":");
    push_list(out, link.troubles.iter().map(String::as_str));
    push_text(out, "}\n");
}

fn write_totals_json(monitor: &Monitor, out: &mut Vec<u8>) {
    let now = clock::wall_ns(monitor.source.now()) as f64 / 1e9;
    push_text(out, &format!("{{\"time\":{now:.6},\"url\":"));
    jsonl::write_string(out, &monitor.url);
    let (age, rate) = (monitor.age().as_secs_f64(), monitor.traffic.per_second());
    let count = monitor.traffic.counts().0;
    push_text(out, &format!(",\"age\":{age:.3},\"frames\":{count},\"per second\":{rate:.1}"));
    for (count, word) in monitor.flaws() {
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

/// Writes a frame with the keys that `decode --format jsonl` has too; a server sends no fields and no kind.
fn write_frame_json(row: &FrameRow, link: &str, out: &mut Vec<u8>) {
    push_text(out, &format!("{{\"time\":{:.6}", row.time as f64 / 1e9));
    push_pair(out, "link", link);
    push_text(
        out,
        match row.direction {
            Some(Direction::ToDrive) => ",\"direction\":\"tx\"",
            Some(Direction::ToHost) => ",\"direction\":\"rx\"",
            None => ",\"direction\":null",
        },
    );
    push_optional(out, "protocol", row.protocol);
    let bytes: String = row.bytes.iter().map(|byte| format!("{byte:02X}")).collect();
    push_pair(out, "bytes", &bytes);
    let id = row.id.map_or_else(|| "null".to_owned(), |(id, _)| id.to_string());
    let extended = row.id.map_or("null", |(_, extended)| if extended { "true" } else { "false" });
    let axis = row.axis.map_or_else(|| "null".to_owned(), |axis| axis.to_string());
    push_text(out, &format!(",\"id\":{id},\"extended\":{extended},\"axis\":{axis}"));
    push_pair(out, "text", &row.text);
    push_text(out, &format!(",\"ok\":{}", row.wrong.is_empty()));
    push_optional(out, "error", Some(&*row.wrong).filter(|wrong| !wrong.is_empty()));
    push_text(out, &format!(",\"number\":{}}}\n", row.number + 1));
}

fn push_text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(text.as_bytes())
}

fn push_pair(out: &mut Vec<u8>, key: &str, text: &str) {
    push_optional(out, key, Some(text));
}

fn push_optional(out: &mut Vec<u8>, key: &str, text: Option<&str>) {
    push_text(out, &format!(",\"{key}\":"));
    match text {
        Some(text) => jsonl::write_string(out, text),
        None => push_text(out, "null"),
    }
}

fn push_list<'a>(out: &mut Vec<u8>, lines: impl Iterator<Item = &'a str>) {
    push_text(out, "[");
    for (n, line) in lines.enumerate() {
        push_text(out, if n > 0 { "," } else { "" });
        jsonl::write_string(out, line);
    }
    push_text(out, "]");
}
