//! `decode FILE --expect EXPECTED.jsonl`: a capture as a test.
//!
//! A line is expected of each frame, in order: a JSON object of which the frame's own, as
//! `--format jsonl` writes it, has every field with that value. What a line leaves out does not
//! matter. Frames that nobody expects and lines that no frame fits are shown like a diff.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use polepair_capture::{Event, Filter, jsonl, text};
use serde_json::Value;

use super::filtered::Filtered;
use crate::capture::{Sink, Source, report};
use crate::problem::{self, Exit, Problem, Result};
use crate::terminal::{Output, say};

/// So far ahead is looked for where frames and lines agree again.
const AHEAD: usize = 64;
/// Differences that are shown.
const SHOWN_MAX: u64 = 100;
/// Where in a capture something stands: another capture of the same differs there.
const PLACES: [&str; 4] = ["number", "asked", "answered", "request"];
/// What is a time, or takes one.
const TIMES: [&str; 2] = ["time", "latency"];

/// What is expected of a capture.
pub struct Expectation {
    path: PathBuf,
    /// The objects, each with the number of its line.
    lines: VecDeque<(usize, Value)>,
    within: Option<f64>,
}

impl Expectation {
    /// Reads the lines. Times count if they may differ by `within` seconds.
    pub fn read(path: &Path, within: Option<f64>) -> Result<Self> {
        let file = std::fs::read_to_string(path);
        let file = file.map_err(|error| problem::file(path, "read", &error))?;
        let lines = (1..).zip(file.lines()).filter(|(_, line)| !line.trim().is_empty());
        let lines = lines.map(|(number, line)| Ok((number, object(path, number, line)?)));
        Ok(Self { path: path.to_owned(), lines: lines.collect::<Result<_>>()?, within })
    }
}

fn object(path: &Path, number: usize, line: &str) -> Result<Value> {
    let wrong = |why: String| {
        let what = format!("{}, line {number}: no JSON object.", path.display());
        Problem::usage("E230", what)
            .why(why)
            .hint("polepair decode GOOD --format jsonl -o EXPECTED.jsonl writes one to begin with")
    };
    match serde_json::from_str(line) {
        Ok(object @ Value::Object(_)) => Ok(object),
        Ok(other) => Err(wrong(format!("It is {other}."))),
        Err(error) => Err(wrong(format!("{error}."))),
    }
}

/// Compares a capture with what is expected of it.
pub fn run(source: Source, path: &Path, filter: Option<Filter>, expected: Expectation) -> Result {
    let mut test = Test::new(expected);
    let decoder = match filter {
        Some(filter) => source.read(path, &mut Filtered::new(filter, Box::new(&mut test)))?,
        None => source.read(path, &mut test)?,
    };
    let read = report(&decoder)?;
    let verdict = test.verdict()?;
    Ok(if verdict == Exit::Ok { read } else { verdict })
}

/// A frame that no line was found for yet.
struct Frame {
    value: Value,
    /// As decode shows it.
    line: String,
    number: u64,
}

struct Test {
    expected: Expectation,
    frames: VecDeque<Frame>,
    /// When the first line's frame was, and when the line says.
    begun: Option<(f64, f64)>,
    agreed: u64,
    differences: u64,
    text: text::Text,
    out: Output,
}

impl Sink for Test {
    fn take(&mut self, event: &Event<'_>) {
        let (mut object, mut line) = (Vec::new(), Vec::new());
        jsonl::write(event, &mut object);
        self.text.write(event, &mut line);
        let value = serde_json::from_slice(&object).unwrap_or_default();
        let line = String::from_utf8_lossy(&line).trim_end().to_owned();
        self.frames.push_back(Frame { value, line, number: event.number });
        self.compare(AHEAD);
    }

    fn settle(&mut self, now: bool) -> Result<()> {
        if now { self.out.flush() } else { self.out.spill() }
    }
}

impl Test {
    fn new(expected: Expectation) -> Self {
        let style = text::Style { notices: text::Notices::None, ..text::Style::default() };
        Self {
            expected,
            frames: VecDeque::new(),
            begun: None,
            agreed: 0,
            differences: 0,
            text: text::Text::new(style),
            out: Output::stdout(),
        }
    }

    /// Compares while more than `kept` frames wait, or the next ones agree.
    fn compare(&mut self, kept: usize) {
        while !self.frames.is_empty() {
            if self.agrees(0, 0) {
                self.agree();
            } else if self.frames.len() > kept {
                self.differ();
            } else {
                return;
            }
        }
    }

    fn agrees(&self, line: usize, frame: usize) -> bool {
        match (self.expected.lines.get(line), self.frames.get(frame)) {
            (Some((_, line)), Some(frame)) => self.first_wrong("", line, &frame.value).is_none(),
            _ => false,
        }
    }

    fn agree(&mut self) {
        let line = self.expected.lines.pop_front();
        let frame = self.frames.pop_front();
        self.agreed += 1;
        if let (Some((_, line)), Some(frame), None) = (line, frame, self.begun) {
            let time = |value: &Value| value.get("time").and_then(Value::as_f64);
            self.begun = time(&frame.value).zip(time(&line));
        }
    }

    /// Shows what stands before the nearest place where both agree again.
    fn differ(&mut self) {
        let (lines, frames) = self.nearest();
        for step in 0..lines.max(frames) {
            let line = if step < lines { self.expected.lines.pop_front() } else { None };
            let frame = if step < frames { self.frames.pop_front() } else { None };
            self.show(line, frame);
        }
    }

    /// How many lines and frames stand before the nearest place where both agree again.
    fn nearest(&self) -> (usize, usize) {
        let lines = self.expected.lines.len().min(AHEAD);
        let found = (1..=2 * AHEAD).find_map(|steps| {
            // Pairs first: a frame that differs is likelier than one too many and one too few.
            let mut splits: Vec<usize> = (0..=steps.min(lines)).collect();
            splits.sort_by_key(|skip| skip.abs_diff(steps - skip));
            splits.into_iter().map(|skip| (skip, steps - skip)).find(|(l, f)| self.agrees(*l, *f))
        });
        found.unwrap_or((lines.min(1), 1))
    }

    /// Shows a line that no frame fits, a frame that no line fits, or both that differ.
    fn show(&mut self, line: Option<(usize, Value)>, frame: Option<Frame>) {
        self.differences += 1;
        if self.differences > SHOWN_MAX {
            return;
        }
        if let (Some((number, line)), Some(frame)) = (&line, &frame)
            && let Some(why) = self.first_wrong("", line, &frame.value)
        {
            self.out.line(&format!("! line {number}: {why}"));
        }
        if let Some((number, line)) = line {
            self.out.line(&format!("- line {number}: {line}"));
        }
        if let Some(frame) = frame {
            self.out.line(&format!("+ frame {}: {}", frame.number, frame.line));
        }
    }

    /// The first field of `wanted` that `is` does not have so, in words.
    fn first_wrong(&self, name: &str, wanted: &Value, is: &Value) -> Option<String> {
        match (wanted, is) {
            (Value::Object(wanted), Value::Object(is)) => {
                wanted.iter().find_map(|(key, wanted)| {
                    let place = PLACES.contains(&key.as_str()) && !name.ends_with("fields");
                    let name = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                    let is = is.get(key).unwrap_or(&Value::Null);
                    match TIMES.contains(&key.as_str()) {
                        _ if place => None,
                        true => self.wrong_time(&name, wanted, is),
                        false => self.first_wrong(&name, wanted, is),
                    }
                })
            }
            (Value::Array(wanted), Value::Array(all)) if wanted.len() == all.len() => {
                let pairs = wanted.iter().zip(all);
                pairs.into_iter().find_map(|(wanted, is)| self.first_wrong(name, wanted, is))
            }
            _ if wanted == is => None,
            _ => Some(format!("{name} is {is}, not {wanted}")),
        }
    }

    fn wrong_time(&self, name: &str, wanted: &Value, is: &Value) -> Option<String> {
        let within = self.expected.within?;
        let (Some(wanted), Some(is)) = (wanted.as_f64(), is.as_f64()) else {
            return (wanted != is).then(|| format!("{name} is {is}, not {wanted}"));
        };
        // Moments count from the first, spans by themselves.
        let begun = self.begun.filter(|_| name == "time");
        let off = match (begun, name) {
            (None, "time") => 0.0,
            _ => is - wanted - begun.map_or(0.0, |(is, wanted)| is - wanted),
        };
        (off.abs() > within).then(|| format!("{name} is off by {off:+.6} s"))
    }

    /// Compares what is left and tells how it ended.
    fn verdict(mut self) -> Result {
        self.compare(0);
        let rest = std::mem::take(&mut self.expected.lines);
        rest.into_iter().for_each(|line| self.show(Some(line), None));
        self.out.flush()?;
        let (agreed, path) = (self.agreed, self.expected.path.display());
        if self.differences == 0 {
            say(&format!("{agreed} frames are as {path} expects"));
            return Ok(Exit::Ok);
        }
        let more = self.differences.saturating_sub(SHOWN_MAX);
        let more = if more > 0 { format!(" ({more} of them not shown)") } else { String::new() };
        say(&format!("{} differences{more}; {agreed} frames are as expected", self.differences));
        Ok(Exit::Negative)
    }
}
