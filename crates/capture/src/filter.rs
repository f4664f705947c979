//! Filter expressions such as `axis = 2 and not ok`: parsed once, evaluated for each frame without
//! allocation.
//!
//! Why: CAP-4.

mod eval;
mod fixed_point;
mod glob;
mod parser;
mod token;

use core::fmt;

use crate::decoder::DecodedFrame;
use crate::session::{AnomalyKind, SessionNotice};
use crate::timestamp::Timestamp;
use fixed_point::NumberRanges;
pub use glob::Glob;
use polepair_core::profile::ParameterAddress;

/// A question about a frame.
#[derive(Clone, Debug)]
pub struct FrameFilter {
    test: FilterTest,
    first_time: Option<Timestamp>,
}

/// Fault in the text of a filter.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FilterError {
    text: String,
    /// The first character that is wrong.
    pub position: usize,
    /// Number of valid entries.
    pub len: usize,
    /// Expected text at that position.
    pub message: String,
    /// The nearest known word.
    pub nearest: Option<String>,
}

impl FrameFilter {
    /// Reads a filter.
    ///
    /// # Errors
    /// [`FilterError`] with the place and the expected words.
    pub fn parse(text: &str) -> Result<Self, FilterError> {
        parser::parse_filter(text).map(|test| Self { test, first_time: None })
    }

    /// Returns whether a frame is wanted. Times count from the first frame that was asked about.
    pub fn matches(&mut self, event: &DecodedFrame<'_>) -> bool {
        self.first_time = self.first_time.or(event.time);
        self.test.matches(&eval::TestInput { frame: event, first_time: self.first_time })
    }
}

impl fmt::Display for FilterError {
    /// The text, a caret below the place, and the expected words.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (at, len) = (self.position, self.len.max(1));
        write!(f, "{}\n{:at$}{:^<len$} {}", self.text, "", "", self.message)
    }
}

/// A test, as a tree.
#[derive(Clone, Debug)]
enum FilterTest {
    All(Vec<Self>),
    Any(Vec<Self>),
    Not(Box<Self>),
    Flag(fn(&DecodedFrame<'_>) -> bool),
    /// A number of the frame, in billionths.
    Number(fn(&DecodedFrame<'_>) -> Option<i128>, NumberRanges),
    /// Seconds since the first frame, in billionths.
    Time(NumberRanges),
    /// A word of the frame.
    Word(fn(&DecodedFrame<'_>) -> &'static str, WordPattern),
    Link(WordPattern),
    Kind(WordPattern),
    Text(WordPattern),
    Error(WordPattern),
    Bytes(Vec<u8>),
    Field(String, ValuePattern),
    /// About a parameter, by its address in each protocol that has such addresses; its value, where one
    /// is asked for.
    Object(Vec<(&'static str, ParameterAddress)>, Option<NumberRanges>),
    Notice(NoticeTest),
}

/// A test of a frame's notices: one of them has to match.
#[derive(Clone, Debug)]
enum NoticeTest {
    Anomaly(Vec<AnomalyKind>),
    Fault(Option<ValuePattern>),
    Signal(Glob, Option<NumberRanges>),
    Change(Option<Glob>, Option<WordPattern>),
    Exchange(Option<WordPattern>),
    Op(WordPattern),
    /// Seconds, in billionths.
    Latency(NumberRanges),
    Retries(NumberRanges),
}

/// Words of which one has to fit.
#[derive(Clone, Debug, Default)]
struct WordPattern {
    globs: Vec<Glob>,
    substrings: Vec<String>,
}

/// Numbers or words.
#[derive(Clone, Debug, Default)]
struct ValuePattern {
    numbers: NumberRanges,
    words: WordPattern,
}

impl WordPattern {
    fn matches(&self, text: &str) -> bool {
        self.globs.iter().any(|glob| glob.matches(text))
            || self.substrings.iter().any(|part| glob::contains_ignore_case(text, part))
    }
}

impl NoticeTest {
    fn matches(&self, notice: &SessionNotice) -> bool {
        match (self, notice) {
            (Self::Anomaly(kinds), SessionNotice::Anomaly(anomaly)) => {
                kinds.is_empty() || kinds.contains(&anomaly.kind)
            }
            (Self::Fault(None), SessionNotice::Fault(_)) => true,
            (Self::Fault(Some(either)), SessionNotice::Fault(fault)) => {
                either.numbers.contains(fixed_point::from_integer(i64::from(fault.code)))
                    || either.words.matches(fault.text)
            }
            (Self::Signal(glob, values), SessionNotice::Signal(signal)) => {
                glob.matches_signal(signal.axis, signal.name)
                    && values
                        .as_ref()
                        .is_none_or(|v| v.contains(fixed_point::from_real(signal.value)))
            }
            (Self::Change(what, to), SessionNotice::Change(change)) => {
                what.as_ref().is_none_or(|glob| glob.matches(change.what))
                    && to.as_ref().is_none_or(|to| to.matches(change.to))
            }
            (Self::Exchange(None), SessionNotice::Exchange(_)) => true,
            (Self::Exchange(Some(words)), SessionNotice::Exchange(e)) => {
                words.matches(e.outcome.as_str())
            }
            (Self::Op(words), SessionNotice::Exchange(exchange)) => words.matches(exchange.op),
            (Self::Latency(within), SessionNotice::Exchange(exchange)) => {
                exchange.latency().is_some_and(|ns| within.contains(i128::from(ns)))
            }
            (Self::Retries(within), SessionNotice::Exchange(e)) => {
                within.contains(fixed_point::from_integer(i64::from(e.retries)))
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests;
