//! Tables of a capture without a copy: as Arrow C streams, and as arrays for NumPy.
//!
//! Neither Arrow nor NumPy is imported. A stream is a capsule, an array has `__array_interface__`, and both
//! keep their memory alive.

use std::sync::{Arc, Mutex};
use std::thread::{self, Builder};
use std::{fmt, mem};

use arrow_array::cast::AsArray;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::types::{
    Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, TimestampMicrosecondType,
};
use arrow_array::{
    Array, ArrayRef, BinaryArray, DictionaryArray, RecordBatch, RecordBatchIterator,
};
use arrow_buffer::Buffer;
use arrow_data::ArrayData;
use arrow_schema::ffi::FFI_ArrowSchema;
use arrow_schema::{ArrowError, DataType, TimeUnit};
use polepair_columns::TableKind;
use pyo3::exceptions::{PyKeyError, PyMemoryError, PyRuntimeError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyCapsule, PyDict};

/// Bytes of a column of byte strings that is filled up: one long row among many short ones would take
/// more than a machine has.
const PADDED_BYTES_MAX: usize = 1 << 30;

/// One table of a decoded capture.
#[pyclass(frozen, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Columns {
    table: TableKind,
    batches: Vec<RecordBatch>,
}

/// A stretch of memory that NumPy takes as an array, without a copy.
#[pyclass(frozen, module = "polepair._polepair")]
pub struct Lent {
    buffer: Buffer,
    kind: &'static str,
    shape: (usize, Option<usize>),
}

impl fmt::Debug for Lent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Lent({} of {:?})", self.kind, self.shape)
    }
}

#[pymethods]
impl Lent {
    /// Memory of the array, by the third version of NumPy's array interface.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let value = PyDict::new(py);
        value.set_item("version", 3)?;
        value.set_item("typestr", self.kind)?;
        match self.shape {
            (rows, None) => value.set_item("shape", (rows,))?,
            (rows, Some(width)) => value.set_item("shape", (rows, width))?,
        }
        let read_only = true;
        value.set_item("data", (self.buffer.as_ptr() as usize, read_only))?;
        Ok(value)
    }
}

/// Values, which of them are there (`None` for all), and the words that they number.
type LentColumn = (Lent, Option<Lent>, Option<Vec<String>>);

#[pymethods]
impl Columns {
    /// Name of the table: frames, signals, transactions, events.
    #[getter]
    fn name(&self) -> &'static str {
        self.table.name()
    }

    fn __len__(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Each column's name and type.
    fn fields(&self) -> Vec<(String, String)> {
        let schema = self.table.schema();
        schema.fields().iter().map(|f| (f.name().clone(), f.data_type().to_string())).collect()
    }

    /// The schema, as Arrow's C data interface has it.
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema = FFI_ArrowSchema::try_from(&*self.table.schema()).map_err(arrow_error)?;
        PyCapsule::new_with_value(py, schema, c"arrow_schema")
    }

    /// The rows, as Arrow's C stream interface has them: lent, not copied.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        // A consumer may ask for another schema and takes what it gets.
        drop(requested_schema);
        let batches = self.batches.clone().into_iter().map(Ok);
        let reader = RecordBatchIterator::new(batches, self.table.schema());
        let stream = FFI_ArrowArrayStream::new(Box::new(reader));
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }

    /// A column of numbers, times or words.
    fn lend(&self, py: Python<'_>, column: &str) -> PyResult<LentColumn> {
        let pieces = self.pieces(column)?;
        let numbered = pieces.last().and_then(|last| last.as_dictionary_opt::<Int32Type>());
        let words = numbered.map(dictionary_words);
        let values = |piece: &ArrayRef| match piece.as_dictionary_opt::<Int32Type>() {
            Some(numbered) => numbered.keys().to_data(),
            None => piece.to_data(),
        };
        let values: Vec<ArrayData> = pieces.iter().map(values).collect();
        let kind = values.first().and_then(|values| numpy_type(values.data_type()));
        let kind = kind.ok_or_else(|| PyKeyError::new_err(column.to_owned()))?;
        let missing = values.iter().any(|values| values.null_count() > 0);
        let valid = missing.then(|| validity_mask(&values));
        let rows = values.iter().map(ArrayData::len).sum();
        let buffer = match &values[..] {
            [one] => value_buffer(one),
            all => py.detach(|| concatenate(all)),
        };
        Ok((Lent { buffer, kind, shape: (rows, None) }, valid, words))
    }

    /// A column of byte strings as one row each, filled up with zeros, and how long each is.
    fn lend_bytes(&self, py: Python<'_>, column: &str) -> PyResult<(Lent, Lent)> {
        let pieces = self.pieces(column)?;
        let pieces: Vec<&BinaryArray> =
            pieces.iter().map(|piece| binary_array(piece, column)).collect::<PyResult<_>>()?;
        let places = pieces.iter().flat_map(|piece| piece.value_offsets().windows(2));
        let lengths: Vec<i32> = places.map(|slots| slots[1] - slots[0]).collect();
        let (rows, width) = (lengths.len(), lengths.iter().copied().fold(0, i32::max) as usize);
        if width.saturating_mul(rows) > PADDED_BYTES_MAX {
            let max = PADDED_BYTES_MAX >> 30;
            let what =
                format!("{rows} rows as long as the longest, {width} bytes, are over {max} GiB");
            return Err(PyMemoryError::new_err(format!("{what}: take to_arrow() or to_polars()")));
        }
        let filled = py.detach(|| {
            let mut whole = vec![0; width * rows];
            copy_parallel(
                &pieces,
                |piece: &&BinaryArray| width * piece.len(),
                &mut whole,
                |piece, into| copy_padded(piece, width, into),
            );
            whole
        });
        let filled =
            Lent { buffer: Buffer::from_vec(filled), kind: "|u1", shape: (rows, Some(width)) };
        let lengths = Lent { buffer: Buffer::from_vec(lengths), kind: "<i4", shape: (rows, None) };
        Ok((filled, lengths))
    }

    /// A column of byte strings as objects.
    fn byte_strings<'py>(
        &self,
        py: Python<'py>,
        column: &str,
    ) -> PyResult<Vec<Bound<'py, PyBytes>>> {
        let array = self.column(py, column)?;
        Ok(binary_array(&array, column)?
            .iter()
            .flatten()
            .map(|row| PyBytes::new(py, row))
            .collect())
    }

    /// The first rows of a column, as people read them.
    fn cells(&self, column: &str, count: usize) -> PyResult<Vec<String>> {
        let at = self.table.schema().index_of(column);
        let at = at.map_err(|_| PyKeyError::new_err(column.to_owned()))?;
        let pieces = self.batches.iter().map(|batch| batch.column(at));
        let cells = pieces.flat_map(|array| (0..array.len()).map(|row| cell_text(array, row)));
        Ok(cells.take(count).collect())
    }

    /// A column of sentences.
    fn texts(&self, py: Python<'_>, column: &str) -> PyResult<Vec<String>> {
        let array = self.column(py, column)?;
        let texts = array.as_string_opt::<i32>();
        let texts = texts.ok_or_else(|| PyKeyError::new_err(column.to_owned()))?;
        Ok(texts.iter().flatten().map(str::to_owned).collect())
    }
}

impl Columns {
    /// A table of batches in their order, whose words one `DictionaryMerger` numbered.
    pub fn new(table: TableKind, batches: Vec<RecordBatch>) -> Result<Self, ArrowError> {
        let width = table.schema().fields().len();
        let mut columns: Vec<Vec<ArrayRef>> = (0..width)
            .map(|at| batches.iter().map(|batch| batch.column(at).clone()).collect())
            .collect();
        columns.iter_mut().for_each(|column| share_dictionary(column));
        let rows = |at: usize| columns.iter().map(|column| column[at].clone()).collect();
        let batches = (0..batches.len()).map(|at| RecordBatch::try_new(table.schema(), rows(at)));
        Ok(Self { table, batches: batches.collect::<Result<_, _>>()? })
    }

    /// A column in the pieces that it came in; an empty one where there are none.
    fn pieces(&self, name: &str) -> PyResult<Vec<ArrayRef>> {
        let schema = self.table.schema();
        let at = schema.index_of(name).map_err(|_| PyKeyError::new_err(name.to_owned()))?;
        if self.batches.is_empty() {
            return Ok(vec![arrow_array::new_empty_array(schema.field(at).data_type())]);
        }
        Ok(self.batches.iter().map(|batch| batch.column(at).clone()).collect())
    }

    /// A whole column: where it lies if it came in one piece, else put together.
    fn column(&self, py: Python<'_>, name: &str) -> PyResult<ArrayRef> {
        let pieces = self.pieces(name)?;
        if let [one] = &pieces[..] {
            return Ok(one.clone());
        }
        let pieces: Vec<&dyn Array> = pieces.iter().map(AsRef::as_ref).collect();
        py.detach(|| arrow_select::concat::concat(&pieces)).map_err(arrow_error)
    }
}

/// Buffer with the values of a piece.
fn value_buffer(values: &ArrayData) -> Buffer {
    let width = values.data_type().primitive_width().unwrap_or(1);
    values.buffers()[0].slice_with_length(values.offset() * width, values.len() * width)
}

/// The values of pieces one behind the other.
fn concatenate(pieces: &[ArrayData]) -> Buffer {
    let pieces: Vec<Buffer> = pieces.iter().map(value_buffer).collect();
    let mut whole = vec![0; pieces.iter().map(Buffer::len).sum()];
    copy_parallel(&pieces, Buffer::len, &mut whole, |piece, into| into.copy_from_slice(piece));
    Buffer::from_vec(whole)
}

/// Puts pieces one behind the other, each in its part of `whole`: on several threads, because page faults of fresh
/// memory cost more than the copy.
fn copy_parallel<T: Sync>(
    pieces: &[T],
    len: impl Fn(&T) -> usize + Sync,
    whole: &mut [u8],
    put: impl Fn(&T, &mut [u8]) + Sync,
) {
    /// Bytes that are worth a thread.
    const BYTES_MIN: usize = 1 << 20;
    let threads = whole.len().div_ceil(BYTES_MIN).clamp(1, crate::capture::thread_count());
    let share = whole.len().div_ceil(threads).max(1);
    let (mut pieces, mut whole, mut shares) = (pieces, whole, Vec::with_capacity(threads));
    while !pieces.is_empty() {
        let (mut count, mut bytes) = (0, 0);
        while bytes < share && count < pieces.len() {
            bytes += len(&pieces[count]);
            count += 1;
        }
        let (mine, part);
        (mine, pieces) = pieces.split_at(count);
        (part, whole) = mem::take(&mut whole).split_at_mut(bytes);
        shares.push((mine, part));
    }
    let shares = Mutex::new(shares.into_iter());
    let work = || {
        while let Some((mine, mut part)) = next_share(&shares) {
            for piece in mine {
                let into;
                (into, part) = mem::take(&mut part).split_at_mut(len(piece));
                put(piece, into);
            }
        }
    };
    thread::scope(|scope| {
        for _ in 1..threads {
            // If no more threads can be started, the running ones do the work.
            let _ = Builder::new().spawn_scoped(scope, work);
        }
        work();
    });
}

/// The next share of pieces and bytes that no thread has yet.
fn next_share<S>(shares: &Mutex<impl Iterator<Item = S>>) -> Option<S> {
    shares.lock().ok()?.next()
}

/// Error for columns that cannot be built, which is a fault of this library.
pub fn arrow_error(error: ArrowError) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

/// A value as people read it; empty where there is none.
fn cell_text(array: &ArrayRef, row: usize) -> String {
    if array.is_null(row) {
        return String::new();
    }
    match array.data_type() {
        DataType::Dictionary(..) => {
            let numbered = array.as_dictionary::<Int32Type>();
            let word = numbered.keys().value(row) as usize;
            numbered.values().as_string::<i32>().value(word).to_owned()
        }
        DataType::Utf8 => array.as_string::<i32>().value(row).to_owned(),
        DataType::Binary => {
            let bytes = array.as_binary::<i32>().value(row);
            bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
        }
        DataType::Int8 => array.as_primitive::<Int8Type>().value(row).to_string(),
        DataType::Int16 => array.as_primitive::<Int16Type>().value(row).to_string(),
        DataType::Int32 => array.as_primitive::<Int32Type>().value(row).to_string(),
        DataType::Int64 => array.as_primitive::<Int64Type>().value(row).to_string(),
        DataType::Float64 => array.as_primitive::<Float64Type>().value(row).to_string(),
        DataType::Timestamp(..) => {
            let us = array.as_primitive::<TimestampMicrosecondType>().value(row);
            format!("{}.{:06}", us.div_euclid(1_000_000), us.rem_euclid(1_000_000))
        }
        _ => String::new(),
    }
}

/// The type as NumPy writes it.
fn numpy_type(of: &DataType) -> Option<&'static str> {
    Some(match of {
        DataType::Int8 => "|i1",
        DataType::Int16 => "<i2",
        DataType::Int32 => "<i4",
        DataType::Int64 => "<i8",
        DataType::Float64 => "<f8",
        DataType::Timestamp(TimeUnit::Microsecond, _) => "<M8[us]",
        _ => return None,
    })
}

/// Mask of present values, a byte each.
fn validity_mask(pieces: &[ArrayData]) -> Lent {
    let mut there = Vec::with_capacity(pieces.iter().map(ArrayData::len).sum());
    for piece in pieces {
        match piece.nulls() {
            Some(nulls) => there.extend(nulls.iter().map(u8::from)),
            None => there.resize(there.len() + piece.len(), 1),
        }
    }
    let shape = (there.len(), None);
    Lent { buffer: Buffer::from_vec(there), kind: "|b1", shape }
}

fn dictionary_words(numbered: &DictionaryArray<Int32Type>) -> Vec<String> {
    let words = numbered.values().as_string::<i32>();
    words.iter().map(|word| word.unwrap_or_default().to_owned()).collect()
}

fn binary_array<'a>(array: &'a ArrayRef, column: &str) -> PyResult<&'a BinaryArray> {
    array.as_binary_opt::<i32>().ok_or_else(|| PyKeyError::new_err(column.to_owned()))
}

/// Rows of one width, into zeros that fill them up.
fn copy_padded(rows: &BinaryArray, width: usize, into: &mut [u8]) {
    let all = rows.value_data();
    let places = rows.value_offsets().windows(2);
    for (into, slots) in into.chunks_exact_mut(width.max(1)).zip(places) {
        let row = &all[slots[0] as usize..slots[1] as usize];
        into[..row.len()].copy_from_slice(row);
    }
}

/// Gives the pieces of a column of words one dictionary: that of the last, of which each before it
/// has the beginning.
fn share_dictionary(pieces: &mut [ArrayRef]) {
    let last = pieces.last().and_then(|last| last.as_dictionary_opt::<Int32Type>());
    let Some(words) = last.map(|last| last.values().clone()) else { return };
    for piece in pieces {
        *piece = Arc::new(piece.as_dictionary::<Int32Type>().with_values(words.clone()));
    }
}
