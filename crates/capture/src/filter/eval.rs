//! Evaluates a filter for a frame.

use core::fmt::{self, Write as _};

use super::fixed_point::NumberRanges;
use super::{FilterTest, ValuePattern, WordPattern, fixed_point};
use crate::decoder::DecodedFrame;
use crate::explanation::{ExplanationField, ExplanationValue, StoredValueSource};
use crate::timestamp::Timestamp;
use polepair_core::convert::ascii_text;
use polepair_core::explain::FieldValue;
use polepair_core::profile::ParameterAddress;
use polepair_core::proto;

/// Bytes of an error's words that are looked through.
const ERROR_MAX: usize = 256;

/// Input of a test.
pub(super) struct TestInput<'a> {
    pub frame: &'a DecodedFrame<'a>,
    /// Time of the capture's first record.
    pub first_time: Option<Timestamp>,
}

impl FilterTest {
    pub(super) fn matches(&self, subject: &TestInput<'_>) -> bool {
        let event = subject.frame;
        match self {
            Self::All(tests) => tests.iter().all(|test| test.matches(subject)),
            Self::Any(tests) => tests.iter().any(|test| test.matches(subject)),
            Self::Not(test) => !test.matches(subject),
            Self::Flag(flag) => flag(event),
            Self::Number(number, within) => number(event).is_some_and(|n| within.contains(n)),
            Self::Time(within) => {
                let since =
                    |first: Timestamp| Some(i128::from(event.time?.0) - i128::from(first.0));
                subject.first_time.and_then(since).is_some_and(|time| within.contains(time))
            }
            Self::Word(word, words) => words.matches(word(event)),
            Self::Link(words) => words.matches(event.link),
            Self::Kind(words) => words.matches(&event.explanation.kind),
            Self::Text(words) => {
                words.matches(&event.explanation.text) || defect_matches(event, words)
            }
            Self::Error(words) => defect_matches(event, words),
            Self::Bytes(part) => {
                part.is_empty() || event.bytes.windows(part.len()).any(|window| window == part)
            }
            Self::Field(name, either) => {
                let mut items = event.explanation.fields().filter(|item| item.name == name);
                items.any(|item| either.matches(&item))
            }
            Self::Object(addresses, values) => {
                let found =
                    addresses.iter().find(|(protocol, _)| event.protocol == Some(*protocol));
                found.is_some_and(|(_, address)| concerns(event, address, values.as_ref()))
            }
            Self::Notice(notice_test) => {
                event.notices.iter().any(|notice| notice_test.matches(notice))
            }
        }
    }
}

impl ValuePattern {
    fn matches(&self, item: &ExplanationField<'_>) -> bool {
        let number = match item.value {
            ExplanationValue::Int(value) => Some(fixed_point::from_integer(value)),
            ExplanationValue::Hex(value, _) => Some(fixed_point::from_integer(value)),
            ExplanationValue::Real(value) => Some(fixed_point::from_real(value)),
            ExplanationValue::Text(text) if self.words.matches(text) => return true,
            ExplanationValue::Text(_) => None,
            ExplanationValue::Words(words) => return self.matches_words(words),
        };
        number.is_some_and(|number| self.numbers.contains(number))
            || (!item.meaning.is_empty() && self.words.matches(item.meaning))
    }

    fn matches_words(&self, words: &[u8]) -> bool {
        let words = words.chunks(2).map(|w| w.iter().fold(0, |sum, b| sum << 8 | i64::from(*b)));
        words.into_iter().any(|word| self.numbers.contains(fixed_point::from_integer(word)))
    }
}

const fn as_field_value(value: ExplanationValue<'_>) -> FieldValue<'_> {
    match value {
        ExplanationValue::Int(number) => FieldValue::Int(number),
        ExplanationValue::Hex(number, digits) => FieldValue::Hex(number, digits),
        ExplanationValue::Real(number) => FieldValue::Real(number),
        ExplanationValue::Text(text) => FieldValue::Text(text),
        ExplanationValue::Words(words) => FieldValue::Words(words),
    }
}

/// Returns whether a frame is about a parameter: it asks for it, or carries its value.
fn concerns(
    event: &DecodedFrame<'_>,
    address: &ParameterAddress,
    values: Option<&NumberRanges>,
) -> bool {
    let Some(dissector) = event.protocol.and_then(proto::find_dissector) else { return false };
    let carried = event.explanation.frame_values().iter().filter(|carried| {
        let own = match carried.source {
            StoredValueSource::Parameter(parameter) => Some((parameter.index, parameter.space)),
            StoredValueSource::Named(word) => match dissector.parse_address(word) {
                Some(Ok(other)) => Some(index_and_space(&other)),
                _ => None,
            },
        };
        // A parameter of the profile is every motor's.
        let like = address.like.filter(|_| carried.motor > 0);
        own == Some(like.unwrap_or(index_and_space(address)))
    });
    let field = |name: &str| {
        let mut all = event.explanation.fields();
        all.find(|field| field.name == name).map(|field| as_field_value(field.value))
    };
    let mut numbers = carried.map(|carried| carried.raw).peekable();
    let Some(values) = values else {
        return numbers.peek().is_some() || dissector.concerns(address, &field);
    };
    // The value is a field if the frame itself names its subject.
    let own = || field("value").filter(|_| dissector.concerns(address, &field));
    let own = if numbers.peek().is_none() { own().and_then(FieldValue::integer) } else { None };
    numbers.chain(own).any(|number| values.contains(fixed_point::from_integer(number)))
}

fn index_and_space(other: &ParameterAddress) -> (u16, u8) {
    (other.index, other.space)
}

fn defect_matches(event: &DecodedFrame<'_>, words: &WordPattern) -> bool {
    let Some(wrong) = event.defect else { return false };
    let mut fixed_text = FixedText { bytes: [0; ERROR_MAX], len: 0 };
    // A longer text is searched as far as it goes.
    let _ = write!(fixed_text, "{wrong}");
    let output = ascii_text(&fixed_text.bytes[..fixed_text.len]);
    words.matches(output)
}

/// Words without a heap.
struct FixedText {
    bytes: [u8; ERROR_MAX],
    len: usize,
}

impl fmt::Write for FixedText {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let end = self.len + text.len();
        let slot = self.bytes.get_mut(self.len..end).ok_or(fmt::Error)?;
        slot.copy_from_slice(text.as_bytes());
        self.len = end;
        Ok(())
    }
}
