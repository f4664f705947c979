//! Text of process data. The constant parts are built when the mapping is learnt; a frame's text is these
//! parts and its numbers.

use core::fmt::{self, Write as _};

use polepair_core::explain::{ExplainSink as _, Field, FieldValue};
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cia402::{OperationMode, STATUSWORD};
use polepair_core::proto::canopen::explain::meanings;
use polepair_core::proto::canopen::sdo::ObjectIndex;

use super::mapping::{Mapping, NumberBits};
use crate::explanation::Explanation;
use crate::line_buffer::{HexColumns, LineBuffer, TextPiece};
use crate::number_text;
use crate::session::{InternedName, Quality};

/// The words of one PDO.
#[derive(Clone, Debug)]
pub(crate) struct ProcessText {
    /// `TPDO1`.
    kind: String,
    /// `tpdo1`.
    prefix: TextPiece,
    values: Vec<ValueText>,
    /// Indices of those whose words depend on the number.
    varying: Vec<usize>,
    /// Text behind the last value.
    end: TextPiece,
    names: NameSource,
}

/// The names of objects and bits.
#[derive(Clone, Copy, Debug)]
struct NameSource {
    profile: Option<&'static Profile>,
    mode: OperationMode,
}

/// Text before the values of a mapping that the capture does not show.
const SUPPOSED: &str = " (if mapped as usual: ";

/// Words for numbers of one value that are kept; those of further ones are put together each time.
const SUFFIXES_MAX: usize = 8;

/// The words of one value.
#[derive(Clone, Debug)]
struct ValueText {
    object: ObjectIndex,
    name: InternedName,
    bits: NumberBits,
    bytes: (u16, u16),
    /// Text in front of the number, behind the bytes or the value before.
    label: TextPiece,
    /// True if the text behind a number depends on it.
    varies: bool,
    /// Texts behind it, by numbers.
    suffixes: Vec<(i64, TextPiece)>,
    /// Text behind all numbers, until it is joined with the next one.
    constant_suffix: Option<TextPiece>,
}

impl ProcessText {
    /// Words for `mapping` of the PDO of that name.
    pub fn new(
        name: String,
        mapping: &Mapping,
        profile: Option<&'static Profile>,
        mode: OperationMode,
    ) -> Self {
        let good = mapping.quality() == Quality::Good;
        let start = if good { " (" } else { SUPPOSED };
        // Bits without a mapping are named.
        let end = if mapping.is_empty() { format!("{start})") } else { ")".to_owned() };
        Self::with_joins(name, mapping, NameSource { profile, mode }, [start, " | ", &end])
    }

    /// The dissector's words for `mapping`, which is not known; `mapping_index` is the object that would state it.
    pub fn supposed(
        name: String,
        mapping: &Mapping,
        profile: Option<&'static Profile>,
        mapping_index: u16,
    ) -> Self {
        let end = if mapping.is_empty() {
            format!(" (by its mapping, 0x{mapping_index:04X})")
        } else {
            ")".to_owned()
        };
        let names = NameSource { profile, mode: OperationMode::None };
        Self::with_joins(name, mapping, names, [SUPPOSED, ", ", &end])
    }

    /// Words with these texts before the first value, between two, and behind the last.
    fn with_joins(name: String, mapping: &Mapping, names: NameSource, joins: [&str; 3]) -> Self {
        let [mut join, further, end] = joins;
        let words = mapping.entry_values(0).map(|(entry, field, mapped_value, _)| {
            let (start, end) = (u16::from(field.start), u16::from(field.start + field.bits));
            let place = (mapped_value.bits, (start / 8, end.div_ceil(8)));
            let join = core::mem::replace(&mut join, further);
            ValueText::new(join, entry.object, mapped_value.name, place, names)
        });
        let mut values: Vec<ValueText> = words.collect();
        let (verb, end) = (name.to_lowercase(), TextPiece::new(end.as_bytes()));
        // A constant text behind a value is one piece with the text that follows.
        let mut suffix = TextPiece::default();
        for value in &mut values {
            value.label = suffix.joined(&value.label);
            suffix = value.constant_suffix.take().unwrap_or_default();
        }
        let end = suffix.joined(&end);
        let varying = (0..values.len()).filter(|at| values[*at].varies).collect();
        Self { prefix: TextPiece::new(verb.as_bytes()), values, varying, end, kind: name, names }
    }

    /// Returns whether the words of each number that eight bytes hold are kept, or are not to be.
    #[inline]
    pub fn has_text(&self, data: u64) -> bool {
        let mut varying = self.varying.iter().map(|at| &self.values[*at]);
        varying.all(|word| word.has_suffix(word.bits.extract(data)))
    }

    /// Forgets the words that are those of another mode.
    pub fn set_mode(&mut self, mode: OperationMode) {
        self.names.mode = mode;
        let words = self.values.iter_mut().filter(|word| word.object == STATUSWORD);
        words.for_each(|word| word.suffixes.clear());
    }

    /// Keeps the words of each number that eight bytes hold.
    pub fn learn_text(&mut self, data: u64) {
        for word in &mut self.values {
            word.learn_suffix(word.bits.extract(data), self.names);
        }
    }

    /// Explains the bytes of a frame.
    pub fn explain(&self, bytes: &[u8], explanation: &mut Explanation) {
        explanation.kind.push_str(&self.kind);
        explanation.field(field("data", (0, bytes.len() as u16), FieldValue::Words(bytes)));
        let mut text = core::mem::take(&mut explanation.text).into_bytes();
        self.prefix.append_to(&mut text);
        for byte in bytes {
            let [high, low] = number_text::hex_digits(*byte);
            text.extend_from_slice(&[b' ', high, low]);
        }
        let data = super::bytes_to_word(bytes);
        for word in &self.values {
            let raw = word.bits.extract(data);
            word.append_to(raw, self.names, &mut text);
            explanation.field(field(word.name, word.bytes, FieldValue::Int(raw)));
        }
        self.end.append_to(&mut text);
        // Names are text, and so is all between them.
        explanation.text =
            String::from_utf8(text).expect("names are text, and so is all between them");
    }

    /// Bytes that a line takes of them at most.
    pub fn len_max(&self) -> usize {
        let words = self
            .values
            .iter()
            .map(|word| word.label.len() + word.longest_suffix() + LineBuffer::NUMBER_MAX);
        self.prefix.len() + self.end.len() + words.sum::<usize>()
    }

    /// Puts the same into a line, and its end; false where words are not kept.
    #[inline]
    pub fn append_line(&self, data: u64, hex: HexColumns, page: &mut LineBuffer) -> bool {
        page.push_piece(&self.prefix);
        page.push_word(b' '.into(), 1);
        page.push_hex(hex, hex.width());
        for word in &self.values {
            let raw = word.bits.extract(data);
            page.push_piece(&word.label);
            page.push_signed(raw);
            if word.varies {
                let Some(behind) = word.suffix(raw) else { return false };
                page.push_piece(behind);
            }
        }
        page.push_piece(&self.end);
        page.push_word(b'\n'.into(), 1);
        true
    }
}

const fn field(name: InternedName, bytes: (u16, u16), value: FieldValue<'_>) -> Field<'_> {
    let (start, end) = bytes;

    Field { name, start, end, value, meaning: "" }
}

impl ValueText {
    fn new(
        join: &str,
        object: ObjectIndex,
        name: InternedName,
        place: (NumberBits, (u16, u16)),
        names: NameSource,
    ) -> Self {
        let ((bits, bytes), profile) = (place, names.profile);

        let varies = !meanings::has_constant_meaning(object, profile);
        let mut label = join.to_owned();
        let mut clean = RemarkText(&mut label);
        if meanings::object_name(object, profile).is_empty() {
            let _ = write!(clean, "{name} = ");
        }
        let _ = meanings::write_label(object, profile, &mut clean);
        let label = TextPiece::new(label.as_bytes());
        let constant_suffix = (!varies).then(|| Self::suffix_for(object, 0, names));
        Self { object, name, bits, bytes, label, varies, suffixes: Vec::new(), constant_suffix }
    }

    /// Text behind a number.
    fn suffix_for(object: ObjectIndex, raw: i64, names: NameSource) -> TextPiece {
        let mut behind = String::new();
        let _ = meanings::write_meaning(object, raw, names.profile, &mut RemarkText(&mut behind));
        if object == STATUSWORD {
            name_status_bits(names.mode, &mut behind);
        }
        TextPiece::new(behind.as_bytes())
    }

    /// Bytes of the longest that is kept.
    fn longest_suffix(&self) -> usize {
        self.suffixes.iter().map(|(_, words)| words.len()).fold(0, usize::max)
    }

    #[inline]
    fn suffix(&self, raw: i64) -> Option<&TextPiece> {
        self.suffixes.iter().find(|(of, _)| *of == raw).map(|(_, words)| words)
    }

    #[inline]
    fn has_suffix(&self, raw: i64) -> bool {
        !self.varies || self.suffixes.len() == SUFFIXES_MAX || self.suffix(raw).is_some()
    }

    fn learn_suffix(&mut self, raw: i64, names: NameSource) {
        if !self.has_suffix(raw) {
            self.suffixes.push((raw, Self::suffix_for(self.object, raw, names)));
        }
    }

    fn append_to(&self, raw: i64, names: NameSource, text: &mut Vec<u8>) {
        self.label.append_to(text);
        number_text::append_signed(raw, text);
        match (self.varies, self.suffix(raw)) {
            (false, _) => {}
            (true, Some(words)) => words.append_to(text),
            (true, None) => Self::suffix_for(self.object, raw, names).append_to(text),
        }
    }
}

/// Names the bits of a statusword by the mode, where that is known.
pub(super) fn name_status_bits(mode: OperationMode, text: &mut String) {
    for (usual, exact) in meanings::status_bits_by_mode(mode) {
        if usual != exact && text.contains(usual) {
            *text = text.replace(usual, exact);
        }
    }
}

/// Keeps out what would end a remark or an instruction.
pub(super) struct RemarkText<'a>(pub &'a mut String);

impl fmt::Write for RemarkText<'_> {
    fn write_str(&mut self, piece: &str) -> fmt::Result {
        let stored = piece.chars().filter(|c| !matches!(c, '(' | ')'));
        self.0.extend(stored.map(|c| if c == ';' { ',' } else { c }));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use polepair_drives::cia402::profile::CIA402;
    use polepair_drives::syntron_ts::profile::SYNTRON_TS_CANOPEN;

    use polepair_core::proto::canopen::pdo::BitField;

    use super::{
        NameSource, NumberBits, ObjectIndex, OperationMode, RemarkText, ValueText, meanings,
    };

    /// Every object of the standards and of two drives, with numbers one after the other.
    #[test]
    fn words_put_together_are_those_of_each_value() {
        let indices = (0x1000..0x1020).chain(0x1400..0x1404).chain(0x1600..0x1604);
        let standard = indices.chain(0x6040..0x6100).flat_map(|index| [(index, 0), (index, 1)]);
        for profile in [None, Some(&CIA402), Some(&SYNTRON_TS_CANOPEN)] {
            let own = profile.map_or(&[][..], |profile| profile.parameters);
            let own = own.iter().map(|parameter| (parameter.index, parameter.space));
            let names = NameSource { profile, mode: OperationMode::None };
            let bits = NumberBits::new(BitField { start: 0, bits: 32 }, true);
            for (index, sub) in standard.clone().chain(own) {
                let object = ObjectIndex::new(index, sub);
                let mut word = ValueText::new(" | ", object, "0x2000:1", (bits, (0, 4)), names);
                for raw in [0, 7, 7, -1, 0x1637, 0x000F, 0x6061_0008, i64::MAX, 0, -12345] {
                    let (mut text, mut plain) = (Vec::new(), " | ".to_owned());
                    word.learn_suffix(raw, names);
                    word.append_to(raw, names, &mut text);
                    word.constant_suffix.iter().for_each(|suffix| suffix.append_to(&mut text));
                    if meanings::object_name(object, profile).is_empty() {
                        plain.push_str("0x2000:1 = ");
                    }
                    meanings::write_value(object, raw, profile, &mut RemarkText(&mut plain))
                        .expect("text");
                    assert_eq!(String::from_utf8(text).expect("text"), plain, "{object:?}");
                }
            }
        }
    }
}
