//! Columns that grow row by row, and become Arrow arrays without a copy.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::types::{ArrowPrimitiveType, Int32Type};
use arrow_array::{
    Array as _, ArrayRef, BinaryArray, DictionaryArray, Int32Array, PrimitiveArray, StringArray,
};
use arrow_buffer::{Buffer, NullBuffer, NullBufferBuilder, OffsetBuffer};
use arrow_schema::ArrowError;

/// Different words of one column; a capture with more of them is hostile.
const WORDS_MAX: usize = 1 << 16;
/// Word for further words of a full column.
const OVERFLOW_WORD: &str = "(more words than can be kept)";

/// Numbers, some of which may be missing.
#[derive(Debug)]
pub(crate) struct NumberColumn<T: ArrowPrimitiveType> {
    values: Vec<T::Native>,
    validity: Validity,
}

/// Rows that have a number.
#[derive(Debug)]
enum Validity {
    AllValid,
    AllNull,
    Mixed(NullBufferBuilder),
}

impl<T: ArrowPrimitiveType> Default for NumberColumn<T> {
    fn default() -> Self {
        Self { values: Vec::new(), validity: Validity::AllValid }
    }
}

impl<T: ArrowPrimitiveType> NumberColumn<T> {
    #[inline]
    pub fn push(&mut self, value: T::Native) {
        self.note_validity(true);
        self.values.push(value);
    }

    #[inline]
    pub fn push_option(&mut self, value: Option<T::Native>) {
        self.note_validity(value.is_some());
        self.values.push(value.unwrap_or_default());
    }

    #[inline]
    fn note_validity(&mut self, is: bool) {
        match (&self.validity, is) {
            (Validity::AllValid, true) | (Validity::AllNull, false) => {}
            _ => self.mix_validity(is),
        }
    }

    /// The next row is not as all were so far.
    fn mix_validity(&mut self, is: bool) {
        let rows = self.values.len();
        let was = matches!(self.validity, Validity::AllValid);
        match &mut self.validity {
            Validity::Mixed(builder) => builder.append(is),
            _ if rows == 0 => {
                self.validity = if is { Validity::AllValid } else { Validity::AllNull }
            }
            there => {
                let mut builder = NullBufferBuilder::new(rows + 1);
                if was {
                    builder.append_n_non_nulls(rows)
                } else {
                    builder.append_n_nulls(rows)
                }
                builder.append(is);
                *there = Validity::Mixed(builder);
            }
        }
    }

    /// Reserves memory for `rows` more rows. A new column gets exactly that: fresh memory costs more than its use.
    pub fn reserve(&mut self, rows: usize) {
        reserve_rows(&mut self.values, rows);
    }

    /// Rows that all have a number.
    #[inline]
    pub fn extend(&mut self, rows: impl ExactSizeIterator<Item = T::Native>) {
        self.note_all_validity(true, rows.len());
        self.values.extend(rows);
    }

    /// Appends the same value `rows` times.
    pub fn repeat(&mut self, value: Option<T::Native>, rows: usize) {
        self.note_all_validity(value.is_some(), rows);
        self.values.resize(self.values.len() + rows, value.unwrap_or_default());
    }

    /// Makes rows that all have a number, and gives them to be filled in.
    pub fn extend_default(&mut self, rows: usize) -> &mut [T::Native] {
        let before = self.values.len();
        self.repeat(Some(T::Native::default()), rows);
        &mut self.values[before..]
    }

    /// The last rows.
    pub fn last_mut(&mut self, rows: usize) -> &mut [T::Native] {
        debug_assert!(rows <= self.values.len());
        let before = self.values.len() - rows;
        &mut self.values[before..]
    }

    fn note_all_validity(&mut self, is: bool, rows: usize) {
        if rows > 0 {
            self.note_validity(is);
            if let Validity::Mixed(builder) = &mut self.validity {
                if is {
                    builder.append_n_non_nulls(rows - 1)
                } else {
                    builder.append_n_nulls(rows - 1)
                }
            }
        }
    }

    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Takes the column; the builder starts again.
    pub fn finish(&mut self) -> PrimitiveArray<T> {
        let rows = self.values.len();
        let values = core::mem::take(&mut self.values);
        let nulls = match core::mem::replace(&mut self.validity, Validity::AllValid) {
            Validity::AllValid => None,
            Validity::AllNull => Some(NullBuffer::new_null(rows)),
            Validity::Mixed(mut builder) => builder.finish(),
        };
        PrimitiveArray::new(values.into(), nulls)
    }
}

/// Words that are kept once. Their numbers stay from batch to batch.
#[derive(Debug, Default)]
pub(crate) struct Dictionary {
    numbers: HashMap<Box<str>, i32>,
    words: Vec<Box<str>>,
    last: i32,
    cache: WordCache,
}

impl Dictionary {
    /// The number of a word.
    #[inline]
    pub fn number(&mut self, word: &str) -> i32 {
        match self.words.get(self.last as usize) {
            Some(last) if **last == *word => self.last,
            _ => self.look_up(word),
        }
    }

    /// Number of a static word, found by its address without reading its letters.
    #[inline]
    pub fn number_of_static(&mut self, word: &'static str) -> i32 {
        if let Some(number) = self.cache.get(word) {
            return number;
        }
        let number = self.look_up(word);
        self.cache.insert(word, number);
        number
    }

    fn look_up(&mut self, word: &str) -> i32 {
        let known = self.numbers.get(word).copied();
        self.last = known.unwrap_or_else(|| self.add(word));
        self.last
    }

    fn add(&mut self, word: &str) -> i32 {
        let word = if self.words.len() < WORDS_MAX { word } else { OVERFLOW_WORD };
        if let Some(number) = self.numbers.get(word) {
            return *number;
        }
        debug_assert!(self.words.len() <= WORDS_MAX);
        let number = self.words.len() as i32;
        self.words.push(word.into());
        self.numbers.insert(word.into(), number);
        number
    }

    pub fn values(&self) -> ArrayRef {
        Arc::new(StringArray::from_iter_values(&self.words))
    }
}

/// Numbers of words by where these lie in memory; one that takes the place of another is looked up
/// again.
struct WordCache([(&'static str, i32); CACHE_SLOTS]);

/// Number of words of a column that are found by their address: a power of two.
const CACHE_SLOTS: usize = 256;

impl Default for WordCache {
    fn default() -> Self {
        Self([("", -1); CACHE_SLOTS])
    }
}

impl core::fmt::Debug for WordCache {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{CACHE_SLOTS}")
    }
}

impl WordCache {
    #[inline]
    fn slot(word: &'static str) -> usize {
        /// 2 to the 64th by the golden ratio: near places become far ones.
        const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;
        let index = word.as_ptr() as u64 ^ (word.len() as u64) << 48;
        (index.wrapping_mul(SPREAD) >> 32) as usize & (CACHE_SLOTS - 1)
    }

    #[inline]
    fn get(&self, word: &'static str) -> Option<i32> {
        let (known, number) = self.0[Self::slot(word)];
        (core::ptr::eq(known, word) && number >= 0).then_some(number)
    }

    fn insert(&mut self, word: &'static str, number: i32) {
        self.0[Self::slot(word)] = (word, number);
    }
}

/// A column of words.
#[derive(Debug, Default)]
pub(crate) struct WordColumn {
    pub dictionary: Dictionary,
    keys: NumberColumn<Int32Type>,
}

impl WordColumn {
    #[inline]
    pub fn push(&mut self, word: &str) {
        self.keys.push(self.dictionary.number(word));
    }

    /// A word that stays where it is.
    #[inline]
    pub fn push_static(&mut self, word: &'static str) {
        self.keys.push(self.dictionary.number_of_static(word));
    }

    pub fn push_option(&mut self, word: Option<&'static str>) {
        self.keys.push_option(word.map(|word| self.dictionary.number_of_static(word)));
    }

    /// Words by their numbers in the dictionary.
    pub const fn keys(&mut self) -> &mut NumberColumn<Int32Type> {
        &mut self.keys
    }

    pub fn finish(&mut self) -> Result<ArrayRef, ArrowError> {
        dictionary_array(self.keys.finish(), &self.dictionary)
    }
}

fn dictionary_array(keys: Int32Array, words: &Dictionary) -> Result<ArrayRef, ArrowError> {
    Ok(Arc::new(DictionaryArray::<Int32Type>::try_new(keys, words.values())?))
}

/// A column with the same value in every row.
#[derive(Debug, Default)]
pub(crate) struct ConstantColumn {
    word: String,
    /// The longest array so far; shorter ones are slices of it.
    longest: Option<DictionaryArray<Int32Type>>,
}

impl ConstantColumn {
    pub fn new(word: &str) -> Self {
        Self { word: word.to_owned(), ..Self::default() }
    }

    pub fn array(&mut self, rows: usize) -> Result<ArrayRef, ArrowError> {
        if let Some(most) = self.longest.as_ref().filter(|most| most.len() >= rows) {
            return Ok(Arc::new(most.slice(0, rows)));
        }
        let keys = Int32Array::from_value(0, rows.next_power_of_two());
        let values: ArrayRef = Arc::new(StringArray::from_iter_values([&self.word]));
        let most = DictionaryArray::<Int32Type>::try_new(keys, values)?;
        let made = Arc::new(most.slice(0, rows));
        self.longest = Some(most);
        Ok(made)
    }
}

/// Byte strings.
#[derive(Debug)]
pub(crate) struct BytesColumn {
    ends: Vec<i32>,
    bytes: Vec<u8>,
}

impl Default for BytesColumn {
    fn default() -> Self {
        Self { ends: vec![0], bytes: Vec::new() }
    }
}

impl BytesColumn {
    #[inline]
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        self.ends.push(self.bytes.len() as i32);
    }

    /// Appends of each eight bytes the first `len`.
    #[inline]
    pub fn extend(&mut self, rows: impl ExactSizeIterator<Item = ([u8; 8], u8)>) {
        let mut end = self.bytes.len();
        // Eight bytes for each row, so that each is copied as one word whatever its length.
        self.bytes.resize(end + 8 * rows.len(), 0);
        let bytes = &mut self.bytes[..];
        self.ends.extend(rows.map(|(row, len)| {
            if let Some(place) = bytes[end..].first_chunk_mut() {
                *place = row;
            }
            end += usize::from(len);
            end as i32
        }));
        debug_assert!(end <= self.bytes.len());
        self.bytes.truncate(end);
    }

    /// Reserves memory for `rows` more rows of at most eight bytes.
    pub fn reserve(&mut self, rows: usize) {
        reserve_rows(&mut self.bytes, 8 * rows);
        reserve_rows(&mut self.ends, rows);
    }

    /// Bytes of all rows together.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }

    fn take_parts(&mut self) -> (OffsetBuffer<i32>, Buffer) {
        let Self { ends, bytes } = core::mem::take(self);
        (OffsetBuffer::new(ends.into()), bytes.into())
    }

    pub fn finish(&mut self) -> Result<ArrayRef, ArrowError> {
        let (ends, bytes) = self.take_parts();
        Ok(Arc::new(BinaryArray::try_new(ends, bytes, None)?))
    }

    /// The rows as text, which they must be.
    pub fn finish_text(&mut self) -> Result<ArrayRef, ArrowError> {
        let (ends, bytes) = self.take_parts();
        Ok(Arc::new(StringArray::try_new(ends, bytes, None)?))
    }
}

/// Reserves memory for `more` rows: exactly, in an empty column.
fn reserve_rows<T>(values: &mut Vec<T>, more: usize) {
    match values.len() {
        0 | 1 => values.reserve_exact(more),
        _ => values.reserve(more),
    }
}

/// Microseconds of nanoseconds.
pub(crate) fn to_micros(
    ns: &PrimitiveArray<arrow_array::types::Int64Type>,
) -> arrow_array::TimestampMicrosecondArray {
    let nulls: Option<NullBuffer> = arrow_array::Array::nulls(ns).cloned();
    // Times are not negative, and unsigned numbers take less time to divide.
    let micros = ns.values().iter().map(|ns| (ns.cast_unsigned() / 1000).cast_signed());
    let micros: Vec<i64> = micros.collect();
    arrow_array::TimestampMicrosecondArray::new(micros.into(), nulls).with_timezone("UTC")
}
