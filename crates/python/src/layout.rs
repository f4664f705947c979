//! Values packed in the bytes of a frame, as in process data: one after the other, least significant bit
//! first (CiA 301, chapter 7.4.7).

use pyo3::exceptions::{PyOverflowError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};

/// Bytes of a frame that hold values; CAN FD has no more.
const BYTES_MAX: usize = 64;

/// Layout of the values of a frame.
#[pyclass(frozen, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Layout {
    layouts: Vec<ValueLayout>,
    names: Vec<String>,
    bytes: usize,
}

/// Place and type of one value.
#[derive(Clone, Copy, Debug)]
struct ValueLayout {
    bit: u32,
    bits: u32,
    kind: ValueType,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum ValueType {
    Unsigned,
    Signed,
    Float,
    /// Bits that mean nothing.
    Gap,
}

#[pymethods]
impl Layout {
    /// `u16 status, i32 position, f32 torque, u1 ready, 7`: a type with its bits and a name each; a number alone skips
    /// that many bits.
    #[new]
    fn new(text: &str) -> PyResult<Self> {
        let (mut places, mut names, mut bit) = (Vec::new(), Vec::new(), 0);
        for word in text.split(',').map(str::trim) {
            let (kind, name) = word.split_once(char::is_whitespace).unwrap_or((word, ""));
            let (kind, bits) = parse_type(kind).ok_or_else(|| {
                let known = "u1 to u64, i2 to i64, f32, f64, or a number of bits to leave out";
                PyValueError::new_err(format!("`{word}` is no value: {known}, then a name"))
            })?;
            if kind != ValueType::Gap {
                if name.trim().is_empty() {
                    return Err(PyValueError::new_err(format!("`{word}` has no name")));
                }
                names.push(name.trim().to_owned());
                places.push(ValueLayout { bit, bits, kind });
            }
            bit += bits;
        }
        let bytes = bit.div_ceil(8) as usize;
        if bytes > BYTES_MAX {
            let what = format!("these are {bytes} bytes; a frame has {BYTES_MAX} at most");
            return Err(PyValueError::new_err(what));
        }
        Ok(Self { layouts: places, names, bytes })
    }

    /// The values' names, in order.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    /// Bytes that it takes.
    #[getter]
    fn size(&self) -> usize {
        self.bytes
    }

    /// The values of a frame, in order. Bytes behind them are left out.
    fn unpack<'py>(
        &self,
        py: Python<'py>,
        data: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        match data.cast::<PyBytes>() {
            Ok(bytes) => self.unpack_values(py, bytes.as_bytes()),
            Err(_) => self.unpack_values(py, &data.extract::<Vec<u8>>()?),
        }
    }

    /// The bytes of a frame with these values.
    #[pyo3(signature = (*values))]
    fn pack<'py>(
        &self,
        py: Python<'py>,
        values: &Bound<'py, PyTuple>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let mut bytes = [0; BYTES_MAX];
        if values.len() != self.layouts.len() {
            let what = format!("{} values for {} places", values.len(), self.layouts.len());
            return Err(PyValueError::new_err(what));
        }
        for ((value_layout, value), name) in self.layouts.iter().zip(values.iter()).zip(&self.names)
        {
            let raw = value_layout.python_to_raw(&value, name)?;
            value_layout.write_bits(raw, &mut bytes);
        }
        Ok(PyBytes::new(py, &bytes[..self.bytes]))
    }

    fn __repr__(&self) -> String {
        format!("<Layout of {} bytes: {}>", self.bytes, self.names.join(", "))
    }
}

impl Layout {
    fn unpack_values<'py>(&self, py: Python<'py>, data: &[u8]) -> PyResult<Bound<'py, PyTuple>> {
        if data.len() < self.bytes {
            let what = format!("{} bytes are too few for {}", data.len(), self.bytes);
            return Err(PyValueError::new_err(what));
        }
        PyTuple::new(
            py,
            self.layouts
                .iter()
                .map(|value_layout| value_layout.raw_to_python(py, value_layout.read_bits(data))),
        )
    }
}

impl ValueLayout {
    /// The bits as a number without a sign.
    fn read_bits(self, data: &[u8]) -> u64 {
        let (first, shift) = ((self.bit / 8) as usize, self.bit % 8);
        let mut consumed = [0; 16];
        let have = data.len().min(first + 9);
        consumed[..have - first].copy_from_slice(&data[first..have]);
        let all = (u128::from_le_bytes(consumed) >> shift) as u64;
        all & (u64::MAX >> (64 - self.bits))
    }

    fn write_bits(self, raw: u64, data: &mut [u8; BYTES_MAX]) {
        let (first, shift) = ((self.bit / 8) as usize, self.bit % 8);
        let raw = u128::from(raw & (u64::MAX >> (64 - self.bits))) << shift;
        for (into, from) in data[first..].iter_mut().zip(raw.to_le_bytes()) {
            *into |= from;
        }
    }

    fn raw_to_python<'py>(self, py: Python<'py>, raw: u64) -> Bound<'py, PyAny> {
        let number = |number: i64| -> Bound<'py, PyAny> {
            let Ok(number) = number.into_pyobject(py);
            number.into_any()
        };
        match self.kind {
            ValueType::Signed => {
                number((raw << (64 - self.bits)).cast_signed() >> (64 - self.bits))
            }
            ValueType::Float if self.bits == 32 => {
                python_real(f32::from_bits(raw as u32).into(), py)
            }
            ValueType::Float => python_real(f64::from_bits(raw), py),
            ValueType::Unsigned | ValueType::Gap => {
                let Ok(number) = raw.into_pyobject(py);
                number.into_any()
            }
        }
    }

    /// A value as its bits.
    fn python_to_raw(self, value: &Bound<'_, PyAny>, name: &str) -> PyResult<u64> {
        match self.kind {
            ValueType::Float if self.bits == 32 => Ok((value.extract::<f32>()?.to_bits()).into()),
            ValueType::Float => Ok(value.extract::<f64>()?.to_bits()),
            ValueType::Signed => {
                let number: i64 = value.extract()?;
                let fits = number >> (self.bits - 1) == number >> 63;
                if fits { Ok(number.cast_unsigned()) } else { Err(self.overflow_error(name)) }
            }
            ValueType::Unsigned | ValueType::Gap => {
                let number: u64 = value.extract()?;
                if number <= u64::MAX >> (64 - self.bits) {
                    Ok(number)
                } else {
                    Err(self.overflow_error(name))
                }
            }
        }
    }

    fn overflow_error(&self, name: &str) -> PyErr {
        let what = format!("`{name}` does not fit into {} bits", self.bits);
        PyOverflowError::new_err(what)
    }
}

fn python_real<'py>(real: f64, py: Python<'py>) -> Bound<'py, PyAny> {
    let Ok(real) = real.into_pyobject(py);
    real.into_any()
}

fn parse_type(word: &str) -> Option<(ValueType, u32)> {
    let (kind, bits) = match word.split_at_checked(1)? {
        ("u", bits) => (ValueType::Unsigned, bits),
        ("i", bits) => (ValueType::Signed, bits),
        ("f", bits) => (ValueType::Float, bits),
        _ => (ValueType::Gap, word),
    };
    let bits: u32 = bits.parse().ok()?;
    let known = match kind {
        ValueType::Unsigned => (1..=64).contains(&bits),
        ValueType::Signed => (2..=64).contains(&bits),
        ValueType::Float => matches!(bits, 32 | 64),
        ValueType::Gap => (1..=512).contains(&bits),
    };
    known.then_some((kind, bits))
}
