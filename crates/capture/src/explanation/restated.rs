//! Explanations that are made from the one of an earlier frame, for frames that differ in numbers alone.
//!
//! Why: DEC-6.

use polepair_core::explain::{NumberPlace, NumberStyle};

use super::{Explanation, ExplanationDetail, StoredField, StoredValue};

/// Bytes of a frame whose explanation may be restated, at most.
pub(crate) const RESTATED_MAX: usize = 16;

/// A number of an explanation, with its bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedNumber {
    pub place: NumberPlace,
    pub item: PlacedItem,
}

impl PlacedNumber {
    /// Returns whether it depends on the number in which form it is shown.
    fn may_have_words(&self) -> bool {
        let is_limited = match self.item {
            PlacedItem::Text { style, .. } => {
                matches!(style, NumberStyle::Hex(_) | NumberStyle::Scaled(_))
            }
            _ => false,
        };
        is_limited || !self.place.named.is_empty()
    }
}

/// Use of the number in the explanation.
#[derive(Clone, Copy, Debug)]
pub(super) enum PlacedItem {
    /// A piece of the text, from byte `at` on.
    Text { at: usize, len: usize, style: NumberStyle },
    /// The value of a field.
    Field(usize),
    /// A value that the frame carries.
    Value(usize),
    /// Nowhere: texts and fields are left out.
    Unused,
}

/// A number in a text.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TextNumber {
    /// First byte in the text, and the byte after the last.
    pub start: usize,
    pub end: usize,
    pub place: NumberPlace,
    pub style: NumberStyle,
}

impl Explanation {
    /// Bytes of the frame that are numbers and nothing else, a bit for each; `None` where a frame that differs in them
    /// needs an explanation of its own.
    pub(crate) fn number_bytes(&self, frame: &[u8]) -> Option<u16> {
        let mut mask = 0;
        for PlacedNumber { place, .. } in &self.numbers {
            let (start, len) = (usize::from(place.start), usize::from(place.len));
            if len == 0 || start + len > frame.len().min(RESTATED_MAX) {
                return None;
            }
            mask |= (start..start + len).fold(0, |bits, at| bits | 1 << at);
        }
        self.fields
            .iter()
            .enumerate()
            .all(|(at, it)| self.is_restatable(at, it, mask))
            .then_some(mask)
    }

    /// Returns whether a field is known for any content of the bytes in `mask`.
    fn is_restatable(&self, at: usize, field: &StoredField, mask: u16) -> bool {
        let bytes = usize::from(field.start)..usize::from(field.end).min(RESTATED_MAX);
        let is_constant = bytes.clone().all(|at| mask >> at & 1 == 0);
        let is_number = |known: &PlacedNumber| {
            matches!(known.item, PlacedItem::Field(of) if of == at)
                && usize::from(known.place.start) <= bytes.start
                && bytes.end <= usize::from(known.place.start + known.place.len)
        };
        // Words are the frame's own bytes.
        matches!(field.value, StoredValue::Words(from, to) if to - from == bytes.len())
            || is_constant
            || self.numbers.iter().any(is_number)
    }

    /// The numbers of the text, in its order.
    pub(crate) fn text_numbers(&self) -> impl Iterator<Item = TextNumber> + '_ {
        self.numbers.iter().filter_map(|number| match number.item {
            PlacedItem::Text { at, len, style } => {
                Some(TextNumber { start: at, end: at + len, place: number.place, style })
            }
            PlacedItem::Field(_) | PlacedItem::Value(_) | PlacedItem::Unused => None,
        })
    }

    /// Becomes the explanation of a frame that differs from the one of `known` in [numbers](Self::number_bytes) alone,
    /// without its text and fields. False if one of the numbers has words of its own; then nothing of it counts.
    pub(crate) fn restate_values(&mut self, known: &Self, frame: &[u8]) -> bool {
        self.clear();
        self.kind.push_str(&known.kind);
        self.axis = known.axis;
        self.frame_values.extend_from_slice(&known.frame_values);
        known.numbers.iter().all(|number| {
            if !number.may_have_words() && !matches!(number.item, PlacedItem::Value(_)) {
                return true;
            }
            let Some(raw) = number.place.decode(frame) else { return false };
            match number.item {
                PlacedItem::Text { style, .. } => return style.fits(raw),
                PlacedItem::Value(at) => self.frame_values[at].raw = raw,
                PlacedItem::Field(_) | PlacedItem::Unused => {}
            }
            true
        })
    }

    /// Adds text and fields to what [`restate_values`](Self::restate_values) made.
    pub(crate) fn restate_text(&mut self, known: &Self, frame: &[u8]) {
        if self.detail != ExplanationDetail::Full {
            return;
        }
        self.bytes.clone_from(&known.bytes);
        self.fields.clone_from(&known.fields);
        for field in &self.fields {
            if let StoredValue::Words(from, to) = field.value
                && let Some(words) = frame.get(usize::from(field.start)..usize::from(field.end))
                && words.len() == to - from
            {
                self.bytes[from..to].copy_from_slice(words);
            }
        }
        self.text.clear();
        let mut from = 0;
        for number in &known.numbers {
            let Some(raw) = number.place.decode(frame) else { continue };
            match number.item {
                PlacedItem::Text { at, len, style } => {
                    self.text.push_str(&known.text[from..at]);
                    if let Some(digits) = style.text_of(raw) {
                        self.text.push_str(digits.as_str());
                    }
                    from = at + len;
                }
                PlacedItem::Field(at) => {
                    let value = &mut self.fields[at].value;
                    *value = match *value {
                        StoredValue::Int(_) => StoredValue::Int(raw),
                        StoredValue::Hex(_, digits) => {
                            StoredValue::Hex(raw.cast_unsigned(), digits)
                        }
                        StoredValue::Real(_) => StoredValue::Real(raw as f64 / 10.0),
                        StoredValue::Text(..) | StoredValue::Words(..) => *value,
                    };
                }
                PlacedItem::Value(_) | PlacedItem::Unused => {}
            }
        }
        self.text.push_str(&known.text[from..]);
    }
}
