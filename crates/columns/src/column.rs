//! Columns that grow row by row and are handed over as Arrow arrays, without a copy.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::types::{ArrowPrimitiveType, Int32Type};
use arrow_array::{
    ArrayRef, BinaryArray, DictionaryArray, Int32Array, PrimitiveArray, StringArray,
};
use arrow_buffer::{Buffer, NullBuffer, NullBufferBuilder, OffsetBuffer, ScalarBuffer};
use arrow_schema::ArrowError;

/// Different words of one column; a capture with more of them is hostile.
const WORDS_MAX: usize = 1 << 16;
/// What further ones are called.
const BEYOND: &str = "(more words than can be kept)";

/// Numbers, some of which may be missing.
#[derive(Debug)]
pub(crate) struct Numbers<T: ArrowPrimitiveType> {
    values: Vec<T::Native>,
    nulls: NullBufferBuilder,
}

impl<T: ArrowPrimitiveType> Default for Numbers<T> {
    fn default() -> Self {
        Self { values: Vec::new(), nulls: NullBufferBuilder::new(0) }
    }
}

impl<T: ArrowPrimitiveType> Numbers<T> {
    #[inline]
    pub fn push(&mut self, value: T::Native) {
        self.values.push(value);
        self.nulls.append_non_null();
    }

    pub fn push_maybe(&mut self, value: Option<T::Native>) {
        self.values.push(value.unwrap_or_default());
        self.nulls.append(value.is_some());
    }

    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// What was gathered; the column begins anew.
    pub fn take(&mut self) -> PrimitiveArray<T> {
        let capacity = self.values.len();
        let values = core::mem::replace(&mut self.values, Vec::with_capacity(capacity));
        PrimitiveArray::new(values.into(), self.nulls.finish())
    }
}

/// Words that are kept once. Their numbers stay from batch to batch.
#[derive(Debug, Default)]
pub(crate) struct Dictionary {
    numbers: HashMap<Box<str>, i32>,
    words: Vec<Box<str>>,
    last: i32,
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

    fn look_up(&mut self, word: &str) -> i32 {
        let known = self.numbers.get(word).copied();
        self.last = known.unwrap_or_else(|| self.add(word));
        self.last
    }

    fn add(&mut self, word: &str) -> i32 {
        let word = if self.words.len() < WORDS_MAX { word } else { BEYOND };
        if let Some(number) = self.numbers.get(word) {
            return *number;
        }
        let number = self.words.len() as i32;
        self.words.push(word.into());
        self.numbers.insert(word.into(), number);
        number
    }

    fn values(&self) -> ArrayRef {
        Arc::new(StringArray::from_iter_values(&self.words))
    }
}

/// A column of words.
#[derive(Debug, Default)]
pub(crate) struct Words {
    pub dictionary: Dictionary,
    keys: Numbers<Int32Type>,
}

impl Words {
    #[inline]
    pub fn push(&mut self, word: &str) {
        self.keys.push(self.dictionary.number(word));
    }

    pub fn push_maybe(&mut self, word: Option<&str>) {
        self.keys.push_maybe(word.map(|word| self.dictionary.number(word)));
    }

    pub fn take(&mut self) -> Result<ArrayRef, ArrowError> {
        dictionary(self.keys.take(), &self.dictionary)
    }
}

fn dictionary(keys: Int32Array, words: &Dictionary) -> Result<ArrayRef, ArrowError> {
    Ok(Arc::new(DictionaryArray::<Int32Type>::try_new(keys, words.values())?))
}

/// A column that says the same in every row.
#[derive(Debug, Default)]
pub(crate) struct Same {
    word: String,
    zeros: Buffer,
}

impl Same {
    pub fn new(word: &str) -> Self {
        Self { word: word.to_owned(), ..Self::default() }
    }

    pub fn rows(&mut self, rows: usize) -> Result<ArrayRef, ArrowError> {
        if self.zeros.len() < rows * size_of::<i32>() {
            self.zeros = Buffer::from_vec(vec![0i32; rows]);
        }
        let keys = Int32Array::new(ScalarBuffer::new(self.zeros.clone(), 0, rows), None);
        let values: ArrayRef = Arc::new(StringArray::from_iter_values([&self.word]));
        Ok(Arc::new(DictionaryArray::<Int32Type>::try_new(keys, values)?))
    }
}

/// Byte strings.
#[derive(Debug)]
pub(crate) struct Bytes {
    ends: Vec<i32>,
    bytes: Vec<u8>,
}

impl Default for Bytes {
    fn default() -> Self {
        Self { ends: vec![0], bytes: Vec::new() }
    }
}

impl Bytes {
    #[inline]
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        self.ends.push(self.bytes.len() as i32);
    }

    /// Bytes of all rows together.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }

    fn parts(&mut self) -> (OffsetBuffer<i32>, Buffer) {
        let Self { ends, bytes } = core::mem::take(self);
        self.bytes.reserve(bytes.len());
        self.ends.reserve(ends.len());
        (OffsetBuffer::new(ends.into()), bytes.into())
    }

    pub fn take(&mut self) -> Result<ArrayRef, ArrowError> {
        let (ends, bytes) = self.parts();
        Ok(Arc::new(BinaryArray::try_new(ends, bytes, None)?))
    }

    /// The rows as text, which they must be.
    pub fn take_text(&mut self) -> Result<ArrayRef, ArrowError> {
        let (ends, bytes) = self.parts();
        Ok(Arc::new(StringArray::try_new(ends, bytes, None)?))
    }
}

/// Microseconds of nanoseconds.
pub(crate) fn micros(
    ns: &PrimitiveArray<arrow_array::types::Int64Type>,
) -> arrow_array::TimestampMicrosecondArray {
    let nulls: Option<NullBuffer> = arrow_array::Array::nulls(ns).cloned();
    let micros: Vec<i64> = ns.values().iter().map(|ns| ns.div_euclid(1000)).collect();
    arrow_array::TimestampMicrosecondArray::new(micros.into(), nulls).with_timezone("UTC")
}
