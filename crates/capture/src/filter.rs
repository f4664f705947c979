//! Which frames of a capture are wanted: `axis = 2 and not ok`, read once, then asked of each frame
//! without allocating.
//!
//! Why: CAP-4.

mod eval;
mod fixed;
mod glob;
mod parse;
mod token;

use core::fmt;

use crate::decoder::Event;
use crate::session::{Notice, Oddity};
use crate::stamp::Stamp;
use fixed::Within;
pub use glob::Glob;

/// A question about a frame.
#[derive(Clone, Debug)]
pub struct Filter {
    test: Test,
    first: Option<Stamp>,
}

/// Why a text is no filter.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FilterError {
    text: String,
    /// The first character that is wrong.
    pub at: usize,
    /// How many are.
    pub len: usize,
    /// What was expected there.
    pub what: String,
    /// The known word nearest to what stands there.
    pub nearest: Option<String>,
}

impl Filter {
    /// Reads a filter.
    ///
    /// # Errors
    /// [`FilterError`] with the place and what was expected there.
    pub fn parse(text: &str) -> Result<Self, FilterError> {
        parse::filter(text).map(|test| Self { test, first: None })
    }

    /// Whether a frame is wanted. Times count from the first frame that was asked about.
    pub fn wants(&mut self, event: &Event<'_>) -> bool {
        self.first = self.first.or(event.time);
        self.test.holds(&eval::Subject { event, first: self.first })
    }
}

impl fmt::Display for FilterError {
    /// The text, a caret below the place, and what was expected.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (at, len) = (self.at, self.len.max(1));
        write!(f, "{}\n{:at$}{:^<len$} {}", self.text, "", "", self.what)
    }
}

/// What is asked, as a tree.
#[derive(Clone, Debug)]
enum Test {
    All(Vec<Self>),
    Any(Vec<Self>),
    Not(Box<Self>),
    Flag(fn(&Event<'_>) -> bool),
    /// A number of the frame, in billionths.
    Number(fn(&Event<'_>) -> Option<i128>, Within),
    /// Seconds since the first frame, in billionths.
    Time(Within),
    /// A word of the frame.
    Word(fn(&Event<'_>) -> &'static str, Words),
    Link(Words),
    Kind(Words),
    Text(Words),
    Error(Words),
    Bytes(Vec<u8>),
    Field(String, Either),
    Told(Told),
}

/// What is asked of a frame's notices: one of them has to fit.
#[derive(Clone, Debug)]
enum Told {
    Odd(Vec<Oddity>),
    Fault(Option<Either>),
    Signal(Glob, Option<Within>),
    Change(Option<Glob>, Option<Words>),
    Exchange(Option<Words>),
    Op(Words),
    /// Seconds, in billionths.
    Latency(Within),
    Retries(Within),
}

/// Words of which one has to fit.
#[derive(Clone, Debug, Default)]
struct Words {
    equal: Vec<Glob>,
    within: Vec<String>,
}

/// Numbers or words.
#[derive(Clone, Debug, Default)]
struct Either {
    numbers: Within,
    words: Words,
}

impl Words {
    fn fit(&self, text: &str) -> bool {
        self.equal.iter().any(|glob| glob.fits(text))
            || self.within.iter().any(|part| glob::contains(text, part))
    }
}

impl Told {
    fn fits(&self, notice: &Notice) -> bool {
        match (self, notice) {
            (Self::Odd(kinds), Notice::Odd(odd)) => kinds.is_empty() || kinds.contains(&odd.kind),
            (Self::Fault(None), Notice::Fault(_)) => true,
            (Self::Fault(Some(either)), Notice::Fault(fault)) => {
                either.numbers.has(fixed::whole(i64::from(fault.code)))
                    || either.words.fit(fault.text)
            }
            (Self::Signal(glob, values), Notice::Signal(signal)) => {
                glob.fits_signal(signal.axis, signal.name)
                    && values.as_ref().is_none_or(|v| v.has(fixed::real(signal.value)))
            }
            (Self::Change(what, to), Notice::Change(change)) => {
                what.as_ref().is_none_or(|glob| glob.fits(change.what))
                    && to.as_ref().is_none_or(|to| to.fit(change.to))
            }
            (Self::Exchange(None), Notice::Exchange(_)) => true,
            (Self::Exchange(Some(words)), Notice::Exchange(e)) => words.fit(e.outcome.word()),
            (Self::Op(words), Notice::Exchange(exchange)) => words.fit(exchange.op),
            (Self::Latency(within), Notice::Exchange(exchange)) => {
                exchange.latency().is_some_and(|ns| within.has(i128::from(ns)))
            }
            (Self::Retries(within), Notice::Exchange(e)) => {
                within.has(fixed::whole(i64::from(e.retries)))
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests;
