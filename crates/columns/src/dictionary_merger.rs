//! Merges the dictionaries of several builders, so the same word has the same number in all batches.

use std::sync::Arc;

use arrow_array::cast::AsArray as _;
use arrow_array::types::Int32Type;
use arrow_array::{ArrayRef, DictionaryArray, RecordBatch};
use arrow_schema::ArrowError;

use crate::column::Dictionary;
use crate::schema::TableKind;

/// The words of each column, numbered as they come (DEC-5).
#[derive(Debug, Default)]
pub struct DictionaryMerger {
    columns: Vec<((TableKind, usize), Dictionary)>,
}

impl DictionaryMerger {
    /// Gives the words of a batch the numbers that they have here.
    ///
    /// # Errors
    /// [`ArrowError`] when columns do not make a batch, which they do by construction.
    pub fn renumber(
        &mut self,
        table: TableKind,
        batch: RecordBatch,
    ) -> Result<RecordBatch, ArrowError> {
        let columns = batch.columns().iter().enumerate().map(|(at, column)| {
            match column.as_dictionary_opt::<Int32Type>() {
                None => Ok(Arc::clone(column)),
                Some(words) => renumber_column(words, self.dictionary_of(table, at)),
            }
        });
        let columns = columns.collect::<Result<_, ArrowError>>()?;
        RecordBatch::try_new(batch.schema(), columns)
    }

    fn dictionary_of(&mut self, table: TableKind, column: usize) -> &mut Dictionary {
        let known = self.columns.iter().position(|(of, _)| *of == (table, column));
        let at = known.unwrap_or_else(|| {
            self.columns.push(((table, column), Dictionary::default()));
            self.columns.len() - 1
        });
        &mut self.columns[at].1
    }
}

fn renumber_column(
    column: &DictionaryArray<Int32Type>,
    words: &mut Dictionary,
) -> Result<ArrayRef, ArrowError> {
    let own = column.values().as_string::<i32>();
    let numbers: Vec<i32> = own.iter().map(|word| words.number(word.unwrap_or(""))).collect();
    let same = numbers.iter().zip(0..).all(|(number, own)| *number == own);
    if same {
        return Ok(Arc::new(column.with_values(words.values())));
    }
    // The key of a missing value is arbitrary, and may be outside the dictionary.
    let keys = column.keys().unary(|key| numbers.get(key as usize).copied().unwrap_or(0));
    Ok(Arc::new(DictionaryArray::<Int32Type>::try_new(keys, words.values())?))
}
