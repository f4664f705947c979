//! Asks a frame.

use core::fmt::{self, Write as _};

use super::{Either, Test, Words, fixed};
use crate::decoder::Event;
use crate::explained::{Item, ItemValue};
use crate::stamp::Stamp;

/// Bytes of an error's words that are looked through.
const ERROR_MAX: usize = 256;

/// What is asked.
pub(super) struct Subject<'a> {
    pub event: &'a Event<'a>,
    /// When the capture begins.
    pub first: Option<Stamp>,
}

impl Test {
    pub(super) fn holds(&self, subject: &Subject<'_>) -> bool {
        let event = subject.event;
        match self {
            Self::All(tests) => tests.iter().all(|test| test.holds(subject)),
            Self::Any(tests) => tests.iter().any(|test| test.holds(subject)),
            Self::Not(test) => !test.holds(subject),
            Self::Flag(flag) => flag(event),
            Self::Number(number, within) => number(event).is_some_and(|n| within.has(n)),
            Self::Time(within) => {
                let since = |first: Stamp| Some(i128::from(event.time?.0) - i128::from(first.0));
                subject.first.and_then(since).is_some_and(|time| within.has(time))
            }
            Self::Word(word, words) => words.fit(word(event)),
            Self::Link(words) => words.fit(event.link),
            Self::Kind(words) => words.fit(&event.explained.kind),
            Self::Text(words) => words.fit(&event.explained.text) || wrong(event, words),
            Self::Error(words) => wrong(event, words),
            Self::Bytes(part) => {
                part.is_empty() || event.bytes.windows(part.len()).any(|window| window == part)
            }
            Self::Field(name, either) => {
                let mut items = event.explained.items().filter(|item| item.name == name);
                items.any(|item| either.fit(&item))
            }
            Self::Told(told) => event.notices.iter().any(|notice| told.fits(notice)),
        }
    }
}

impl Either {
    fn fit(&self, item: &Item<'_>) -> bool {
        let number = match item.value {
            ItemValue::Int(value) => Some(fixed::whole(value)),
            ItemValue::Hex(value, _) => Some(fixed::whole(value)),
            ItemValue::Real(value) => Some(fixed::real(value)),
            ItemValue::Text(text) if self.words.fit(text) => return true,
            ItemValue::Text(_) => None,
            ItemValue::Words(words) => return self.fit_words(words),
        };
        number.is_some_and(|number| self.numbers.has(number))
            || (!item.meaning.is_empty() && self.words.fit(item.meaning))
    }

    fn fit_words(&self, words: &[u8]) -> bool {
        let words = words.chunks(2).map(|w| w.iter().fold(0, |sum, b| sum << 8 | i64::from(*b)));
        words.into_iter().any(|word| self.numbers.has(fixed::whole(word)))
    }
}

fn wrong(event: &Event<'_>, words: &Words) -> bool {
    let Some(wrong) = event.wrong else { return false };
    let mut told = Told { bytes: [0; ERROR_MAX], len: 0 };
    // What is longer is looked through as far as it goes.
    let _ = write!(told, "{wrong}");
    let told = core::str::from_utf8(&told.bytes[..told.len]).unwrap_or_default();
    words.fit(told)
}

/// Words without a heap.
struct Told {
    bytes: [u8; ERROR_MAX],
    len: usize,
}

impl fmt::Write for Told {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let end = self.len + text.len();
        let place = self.bytes.get_mut(self.len..end).ok_or(fmt::Error)?;
        place.copy_from_slice(text.as_bytes());
        self.len = end;
        Ok(())
    }
}
