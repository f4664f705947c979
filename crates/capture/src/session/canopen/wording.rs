//! Process data in words: what does not hang on their bytes is put together once, when the mapping
//! is learnt, so that a frame's text is copied pieces and its numbers.

use core::fmt::{self, Write as _};

use polepair_core::explain::{Field, Sink as _, Value};
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::explain::say;
use polepair_core::proto::canopen::sdo::Object;

use super::mapping::Mapping;
use crate::explained::Explained;
use crate::page::{Hex, Page, Piece};
use crate::put;
use crate::session::{Name, Quality};

/// The words of one PDO.
#[derive(Clone, Debug)]
pub(crate) struct Wording {
    /// `TPDO1`.
    kind: String,
    /// `tpdo1`.
    verb: Piece,
    words: Vec<Word>,
    /// What stands behind the last value.
    end: Piece,
    profile: Option<&'static Profile>,
}

/// Words for numbers of one value that are kept; those of further ones are put together each time.
const MEANINGS_MAX: usize = 8;

/// The words of one value.
#[derive(Clone, Debug)]
struct Word {
    object: Object,
    name: Name,
    bytes: (u16, u16),
    /// What stands in front of the number, behind the bytes or the value before.
    label: Piece,
    /// What stands behind it, by numbers that came; of one alone where it is steady.
    behind: Vec<(i64, Piece)>,
    /// The same stands behind all numbers.
    steady: bool,
}

impl Wording {
    /// Words for `mapping` of the PDO of that name.
    pub fn new(name: String, mapping: &Mapping, profile: Option<&'static Profile>) -> Self {
        let good = mapping.quality() == Quality::Good;
        let mut join = if good { " (" } else { " (if mapped as usual: " };
        let words = mapping.values(0).map(|(entry, field, place, _)| {
            let (start, end) = (u16::from(field.at), u16::from(field.at + field.bits));
            let bytes = (start / 8, end.div_ceil(8));
            let join = core::mem::replace(&mut join, " | ");
            Word::new(join, entry.object, place.name, bytes, profile)
        });
        let words: Vec<Word> = words.collect();
        // Where bits are mapped to nothing, that is said.
        let end = if words.is_empty() { format!("{join})") } else { ")".to_owned() };
        let (verb, end) = (name.to_lowercase(), Piece::new(end.as_bytes()));
        Self { verb: Piece::new(verb.as_bytes()), words, end, kind: name, profile }
    }

    /// Whether the words of each number that eight bytes hold are kept, or are not to be.
    #[inline]
    pub fn knows(&self, mapping: &Mapping, data: u64) -> bool {
        let mut pairs = self.words.iter().zip(mapping.numbers());
        pairs.all(|(word, place)| word.knows(place.exact(data)))
    }

    /// Keeps the words of each number that eight bytes hold.
    pub fn learn(&mut self, mapping: &Mapping, data: u64) {
        for (word, place) in self.words.iter_mut().zip(mapping.numbers()) {
            word.learn(place.exact(data), self.profile);
        }
    }

    /// Says what the bytes of a frame are.
    pub fn say(&self, mapping: &Mapping, bytes: &[u8], said: &mut Explained) {
        said.kind.push_str(&self.kind);
        said.field(field("data", (0, bytes.len() as u16), Value::Words(bytes)));
        let mut text = core::mem::take(&mut said.text).into_bytes();
        self.verb.put(&mut text);
        for byte in bytes {
            let [high, low] = put::hex(*byte);
            text.extend_from_slice(&[b' ', high, low]);
        }
        for (word, (.., raw)) in self.words.iter().zip(mapping.values(super::word(bytes))) {
            word.say(raw, self.profile, &mut text);
            said.field(field(word.name, word.bytes, Value::Int(raw)));
        }
        self.end.put(&mut text);
        // Names are text, and so is all between them.
        said.text = String::from_utf8(text).unwrap_or_default();
    }

    /// Bytes that a line takes of them at most.
    pub fn room(&self) -> usize {
        let words = self.words.iter().map(|word| word.label.len() + word.longest() + Page::NUMBER);
        self.verb.len() + self.end.len() + words.sum::<usize>()
    }

    /// Puts the same into a line, and its end; false where words are not kept.
    #[inline]
    pub fn put(
        &self,
        mapping: &Mapping,
        data: u64,
        (hex, len): (Hex, u8),
        page: &mut Page,
    ) -> bool {
        page.piece(&self.verb);
        page.word(b' '.into(), 1);
        page.hex(hex, (3 * usize::from(len)).saturating_sub(1));
        for (word, place) in self.words.iter().zip(mapping.numbers()) {
            let raw = place.exact(data);
            let Some(behind) = word.kept(raw) else { return false };
            page.piece(&word.label);
            page.signed(raw);
            page.piece(behind);
        }
        page.piece(&self.end);
        page.word(b'\n'.into(), 1);
        true
    }
}

const fn field(name: Name, (start, end): (u16, u16), value: Value<'_>) -> Field<'_> {
    Field { name, start, end, value, meaning: "" }
}

impl Word {
    fn new(
        join: &str,
        object: Object,
        name: Name,
        bytes: (u16, u16),
        profile: Option<&'static Profile>,
    ) -> Self {
        let steady = say::is_steady(object, profile);
        let mut label = join.to_owned();
        let mut clean = Clean(&mut label);
        if say::name(object, profile).is_empty() {
            let _ = write!(clean, "{name} = ");
        }
        let _ = say::label(object, profile, &mut clean);
        let label = Piece::new(label.as_bytes());
        let mut word = Self { object, name, bytes, label, behind: Vec::new(), steady };
        if steady {
            word.behind.push((0, word.mean(0, profile)));
        }
        word
    }

    /// What stands behind a number.
    fn mean(&self, raw: i64, profile: Option<&'static Profile>) -> Piece {
        let mut behind = String::new();
        let _ = say::meaning(self.object, raw, profile, &mut Clean(&mut behind));
        Piece::new(behind.as_bytes())
    }

    /// Bytes of the longest that is kept.
    fn longest(&self) -> usize {
        self.behind.iter().map(|(_, words)| words.len()).max().unwrap_or(0)
    }

    #[inline]
    fn kept(&self, raw: i64) -> Option<&Piece> {
        let mut behind = self.behind.iter();
        behind.find(|(of, _)| self.steady || *of == raw).map(|(_, words)| words)
    }

    #[inline]
    fn knows(&self, raw: i64) -> bool {
        self.steady || self.behind.len() == MEANINGS_MAX || self.kept(raw).is_some()
    }

    fn learn(&mut self, raw: i64, profile: Option<&'static Profile>) {
        if !self.knows(raw) {
            self.behind.push((raw, self.mean(raw, profile)));
        }
    }

    fn say(&self, raw: i64, profile: Option<&'static Profile>, text: &mut Vec<u8>) {
        self.label.put(text);
        put::signed(raw, text);
        match self.kept(raw) {
            Some(words) => words.put(text),
            None => self.mean(raw, profile).put(text),
        }
    }
}

/// Keeps out what would end a remark or an instruction.
pub(super) struct Clean<'a>(pub &'a mut String);

impl fmt::Write for Clean<'_> {
    fn write_str(&mut self, piece: &str) -> fmt::Result {
        let kept = piece.chars().filter(|c| !matches!(c, '(' | ')'));
        self.0.extend(kept.map(|c| if c == ';' { ',' } else { c }));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use polepair_core::drives::cia402::profile::CIA402;
    use polepair_core::drives::syntron_ts::profile::SYNTRON_TS_CANOPEN;

    use super::{Clean, Object, Word, say};

    /// Every object of the standards and of two drives, with numbers one after the other.
    #[test]
    fn words_put_together_are_those_of_each_value() {
        let indices = (0x1000..0x1020).chain(0x1400..0x1404).chain(0x1600..0x1604);
        let standard = indices.chain(0x6040..0x6100).flat_map(|index| [(index, 0), (index, 1)]);
        for profile in [None, Some(&CIA402), Some(&SYNTRON_TS_CANOPEN)] {
            let own = profile.map_or(&[][..], |profile| profile.parameters);
            let own = own.iter().map(|parameter| (parameter.index, parameter.space));
            for (index, sub) in standard.clone().chain(own) {
                let object = Object::new(index, sub);
                let mut word = Word::new(" | ", object, "0x2000:1", (0, 4), profile);
                for raw in [0, 7, 7, -1, 0x1637, 0x000F, 0x6061_0008, i64::MAX, 0, -12345] {
                    let (mut text, mut plain) = (Vec::new(), " | ".to_owned());
                    word.learn(raw, profile);
                    word.say(raw, profile, &mut text);
                    if say::name(object, profile).is_empty() {
                        plain.push_str("0x2000:1 = ");
                    }
                    say::value(object, raw, profile, &mut Clean(&mut plain)).expect("text");
                    assert_eq!(String::from_utf8(text).expect("text"), plain, "{object:?}");
                }
            }
        }
    }
}
