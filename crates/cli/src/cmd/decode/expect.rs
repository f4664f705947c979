//! `decode FILE --expect EXPECTED.jsonl`: compares a capture with expected lines.
//!
//! One line is expected for each frame, in order. A line is a JSON object. A frame matches if it has all
//! fields of the line with the same values, as `--format jsonl` prints them. Unmatched frames and lines are
//! printed like a diff.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use polepair_capture::{DecodedFrame, FrameFilter, jsonl, text};
use serde_json::Value;

use super::filtered_sink::FilteredSink;
use crate::capture::{CaptureSource, EventSink, report_left_out};
use crate::data_output::DataOutput;
use crate::problem::{self, Exit, Problem, Result};
use crate::terminal::print_note;

/// Number of frames and lines in which the next agreement is searched.
const LOOKAHEAD: usize = 64;
/// Differences that are shown.
const DIFFERENCES_SHOWN_MAX: u64 = 100;
/// Fields with a place in a capture: another capture of the same differs there.
const POSITION_FIELDS: [&str; 4] = ["number", "asked", "answered", "request"];
/// Fields with a time or a duration.
const TIME_FIELDS: [&str; 2] = ["time", "latency"];

/// Expected lines of a capture.
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
        let file = file.map_err(|error| problem::file_problem(path, "read", &error))?;
        let lines = (1..).zip(file.lines()).filter(|(_, line)| !line.trim().is_empty());
        let lines = lines.map(|(number, line)| Ok((number, parse_object(path, number, line)?)));
        Ok(Self { path: path.to_owned(), lines: lines.collect::<Result<_>>()?, within })
    }
}

fn parse_object(path: &Path, number: usize, line: &str) -> Result<Value> {
    match serde_json::from_str(line) {
        Ok(object @ Value::Object(_)) => Ok(object),
        Ok(other) => Err(no_json_object(format!("It is {other}."), number, path)),
        Err(error) => Err(no_json_object(format!("{error}."), number, path)),
    }
}

fn no_json_object(why: String, number: usize, path: &Path) -> Problem {
    let what = format!("{}, line {number}: no JSON object.", path.display());
    Problem::usage("E230", what)
        .why(why)
        .hint("`polepair decode GOOD --format jsonl -o EXPECTED.jsonl` writes one to begin with")
}

/// Compares a capture with the expected lines.
pub fn run_test(
    source: CaptureSource,
    path: &Path,
    filter: Option<FrameFilter>,
    expected: Expectation,
) -> Result {
    let mut test = ExpectationTest::new(expected);
    let decoder = match filter {
        Some(filter) => source.decode(path, &mut FilteredSink::new(filter, Box::new(&mut test)))?,
        None => source.decode(path, &mut test)?,
    };
    let read = report_left_out(&decoder)?;
    let verdict = test.finish_test()?;
    Ok(if verdict == Exit::Ok { read } else { verdict })
}

/// A frame that no line was found for yet.
struct UnmatchedFrame {
    value: Value,
    /// Line as `decode` prints it.
    line: String,
    number: u64,
}

struct ExpectationTest {
    expected: Expectation,
    frames: VecDeque<UnmatchedFrame>,
    /// Time of the first line's frame, and the time in the line.
    time_origin: Option<(f64, f64)>,
    matched: u64,
    differences: u64,
    text: text::FrameTextWriter,
    out: DataOutput,
}

impl EventSink for ExpectationTest {
    fn handle_event(&mut self, event: &DecodedFrame<'_>) {
        let (mut object, mut line) = (Vec::new(), Vec::new());
        jsonl::write_frame(event, &mut object);
        self.text.write(event, &mut line);
        let value = serde_json::from_slice(&object).expect("a frame is one JSON object");
        let line = String::from_utf8_lossy(&line).trim_end().to_owned();
        self.frames.push_back(UnmatchedFrame { value, line, number: event.number });
        self.match_pending(LOOKAHEAD);
    }

    fn flush(&mut self, now: bool) -> Result<()> {
        if now { self.out.flush() } else { self.out.flush_if_full() }
    }
}

impl ExpectationTest {
    fn new(expected: Expectation) -> Self {
        let style =
            text::TextStyle { notices: text::NoticeLevel::None, ..text::TextStyle::default() };
        Self {
            expected,
            frames: VecDeque::new(),
            time_origin: None,
            matched: 0,
            differences: 0,
            text: text::FrameTextWriter::new(style),
            out: DataOutput::stdout(),
        }
    }

    /// Compares while more than `kept` frames wait, or the next ones agree.
    fn match_pending(&mut self, stored: usize) {
        while !self.frames.is_empty() {
            if self.matches(0, 0) {
                self.accept_match();
            } else if self.frames.len() > stored {
                self.report_difference();
            } else {
                return;
            }
        }
    }

    fn matches(&self, line: usize, frame: usize) -> bool {
        match (self.expected.lines.get(line), self.frames.get(frame)) {
            (Some((_, line)), Some(frame)) => self.first_mismatch("", line, &frame.value).is_none(),
            _ => false,
        }
    }

    fn accept_match(&mut self) {
        let line = self.expected.lines.pop_front();
        let frame = self.frames.pop_front();
        self.matched += 1;
        if let (Some((_, line)), Some(frame), None) = (line, frame, self.time_origin) {
            self.time_origin = row_time(&frame.value).zip(row_time(&line));
        }
    }

    /// Prints the lines before the nearest place where both agree again.
    fn report_difference(&mut self) {
        let (lines, frames) = self.next_match();
        for step in 0..lines.max(frames) {
            let line = if step < lines { self.expected.lines.pop_front() } else { None };
            let frame = if step < frames { self.frames.pop_front() } else { None };
            self.print_difference(line, frame);
        }
    }

    /// Number of lines and frames before the nearest place where both agree again.
    fn next_match(&self) -> (usize, usize) {
        let lines = self.expected.lines.len().min(LOOKAHEAD);
        let found = (1..=2 * LOOKAHEAD).find_map(|steps| {
            // Pairs first: a frame that differs is likelier than one too many and one too few.
            let mut splits: Vec<usize> = (0..=steps.min(lines)).collect();
            splits.sort_by_key(|skip| skip.abs_diff(steps - skip));
            splits.into_iter().map(|skip| (skip, steps - skip)).find(|(l, f)| self.matches(*l, *f))
        });
        found.unwrap_or((lines.min(1), 1))
    }

    /// Shows a line that no frame fits, a frame that no line fits, or both that differ.
    fn print_difference(&mut self, line: Option<(usize, Value)>, frame: Option<UnmatchedFrame>) {
        self.differences += 1;
        if self.differences > DIFFERENCES_SHOWN_MAX {
            return;
        }
        if let (Some((number, line)), Some(frame)) = (&line, &frame)
            && let Some(why) = self.first_mismatch("", line, &frame.value)
        {
            self.out.write_line(&format!("! line {number}: {why}"));
        }
        if let Some((number, line)) = line {
            self.out.write_line(&format!("- line {number}: {line}"));
        }
        if let Some(frame) = frame {
            self.out.write_line(&format!("+ frame {}: {}", frame.number, frame.line));
        }
    }

    /// The first field of `wanted` that `is` does not have so, in words.
    fn first_mismatch(&self, name: &str, wanted: &Value, is: &Value) -> Option<String> {
        match (wanted, is) {
            (Value::Object(wanted), Value::Object(is)) => {
                wanted.iter().find_map(|(key, wanted)| {
                    let position =
                        POSITION_FIELDS.contains(&key.as_str()) && !name.ends_with("fields");
                    let name = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                    let is = is.get(key).unwrap_or(&Value::Null);
                    if position {
                        None
                    } else if TIME_FIELDS.contains(&key.as_str()) {
                        self.time_mismatch(&name, wanted, is)
                    } else {
                        self.first_mismatch(&name, wanted, is)
                    }
                })
            }
            (Value::Array(wanted), Value::Array(all)) if wanted.len() == all.len() => {
                let pairs = wanted.iter().zip(all);
                pairs.into_iter().find_map(|(wanted, is)| self.first_mismatch(name, wanted, is))
            }
            _ if wanted == is => None,
            _ => Some(format!("{name} is {is}, not {wanted}")),
        }
    }

    fn time_mismatch(&self, name: &str, wanted: &Value, is: &Value) -> Option<String> {
        let within = self.expected.within?;
        let (Some(wanted), Some(is)) = (wanted.as_f64(), is.as_f64()) else {
            return (wanted != is).then(|| format!("{name} is {is}, not {wanted}"));
        };
        // Moments count from the first, spans by themselves.
        let started = self.time_origin.filter(|_| name == "time");
        let off = match (started, name) {
            (None, "time") => 0.0,
            _ => is - wanted - started.map_or(0.0, |(is, wanted)| is - wanted),
        };
        (off.abs() > within).then(|| format!("{name} is off by {off:+.6} s"))
    }

    /// Compares the remaining lines and prints the result.
    fn finish_test(mut self) -> Result {
        self.match_pending(0);
        let rest = std::mem::take(&mut self.expected.lines);
        rest.into_iter().for_each(|line| self.print_difference(Some(line), None));
        self.out.flush()?;
        let (agreed, path) = (self.matched, self.expected.path.display());
        if self.differences == 0 {
            print_note(&format!("{agreed} frames match {path}"));
            return Ok(Exit::Ok);
        }
        let more = self.differences.saturating_sub(DIFFERENCES_SHOWN_MAX);
        let more = if more > 0 { format!(" ({more} of them not shown)") } else { String::new() };
        print_note(&format!("{} differences{more}; {agreed} frames match", self.differences));
        Ok(Exit::Negative)
    }
}

fn row_time(value: &Value) -> Option<f64> {
    value.get("time").and_then(Value::as_f64)
}
