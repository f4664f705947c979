//! Values packed into the bytes of a frame, as process data are: one behind the other, bit by bit,
//! the least significant first (CiA 301, chapter 7.4.7).

use pyo3::exceptions::{PyOverflowError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};

/// Bytes of a frame that hold values; CAN FD has no more.
const BYTES_MAX: usize = 64;

/// Where each value of a frame lies.
#[pyclass(frozen, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Layout {
    places: Vec<Place>,
    names: Vec<String>,
    bytes: usize,
}

/// Where one value lies, and what it is.
#[derive(Clone, Copy, Debug)]
struct Place {
    bit: u32,
    bits: u32,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    Unsigned,
    Signed,
    Real,
    /// Bits that mean nothing.
    Gap,
}

#[pymethods]
impl Layout {
    /// `u16 status, i32 position, f32 torque, u1 ready, 7`: a type with its bits and a name each; a
    /// number alone leaves so many bits out.
    #[new]
    fn new(text: &str) -> PyResult<Self> {
        let (mut places, mut names, mut bit) = (Vec::new(), Vec::new(), 0);
        for word in text.split(',').map(str::trim) {
            let (kind, name) = word.split_once(char::is_whitespace).unwrap_or((word, ""));
            let (kind, bits) = kind_of(kind).ok_or_else(|| {
                let known = "u1 to u64, i2 to i64, f32, f64, or a number of bits to leave out";
                PyValueError::new_err(format!("`{word}` is no value: {known}, then a name"))
            })?;
            if kind != Kind::Gap {
                if name.trim().is_empty() {
                    return Err(PyValueError::new_err(format!("`{word}` has no name")));
                }
                names.push(name.trim().to_owned());
                places.push(Place { bit, bits, kind });
            }
            bit += bits;
        }
        let bytes = bit.div_ceil(8) as usize;
        if bytes > BYTES_MAX {
            let what = format!("these are {bytes} bytes; a frame has {BYTES_MAX} at most");
            return Err(PyValueError::new_err(what));
        }
        Ok(Self { places, names, bytes })
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
            Ok(bytes) => self.values(py, bytes.as_bytes()),
            Err(_) => self.values(py, &data.extract::<Vec<u8>>()?),
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
        if values.len() != self.places.len() {
            let what = format!("{} values for {} places", values.len(), self.places.len());
            return Err(PyValueError::new_err(what));
        }
        for ((place, value), name) in self.places.iter().zip(values.iter()).zip(&self.names) {
            let raw = place.raw(&value, name)?;
            place.put(raw, &mut bytes);
        }
        Ok(PyBytes::new(py, &bytes[..self.bytes]))
    }

    fn __repr__(&self) -> String {
        format!("<Layout of {} bytes: {}>", self.bytes, self.names.join(", "))
    }
}

impl Layout {
    fn values<'py>(&self, py: Python<'py>, data: &[u8]) -> PyResult<Bound<'py, PyTuple>> {
        if data.len() < self.bytes {
            let what = format!("{} bytes are too few for {}", data.len(), self.bytes);
            return Err(PyValueError::new_err(what));
        }
        let value = |place: &Place| place.value(py, place.get(data));
        PyTuple::new(py, self.places.iter().map(value))
    }
}

impl Place {
    /// The bits as a number without a sign.
    fn get(self, data: &[u8]) -> u64 {
        let (first, shift) = ((self.bit / 8) as usize, self.bit % 8);
        let mut taken = [0; 16];
        let have = data.len().min(first + 9);
        taken[..have - first].copy_from_slice(&data[first..have]);
        let all = (u128::from_le_bytes(taken) >> shift) as u64;
        all & (u64::MAX >> (64 - self.bits))
    }

    fn put(self, raw: u64, data: &mut [u8; BYTES_MAX]) {
        let (first, shift) = ((self.bit / 8) as usize, self.bit % 8);
        let raw = u128::from(raw & (u64::MAX >> (64 - self.bits))) << shift;
        for (into, from) in data[first..].iter_mut().zip(raw.to_le_bytes()) {
            *into |= from;
        }
    }

    fn value<'py>(self, py: Python<'py>, raw: u64) -> Bound<'py, PyAny> {
        let number = |number: i64| -> Bound<'py, PyAny> {
            let Ok(number) = number.into_pyobject(py);
            number.into_any()
        };
        let real = |real: f64| -> Bound<'py, PyAny> {
            let Ok(real) = real.into_pyobject(py);
            real.into_any()
        };
        match self.kind {
            Kind::Signed => number((raw << (64 - self.bits)).cast_signed() >> (64 - self.bits)),
            Kind::Real if self.bits == 32 => real(f32::from_bits(raw as u32).into()),
            Kind::Real => real(f64::from_bits(raw)),
            Kind::Unsigned | Kind::Gap => {
                let Ok(number) = raw.into_pyobject(py);
                number.into_any()
            }
        }
    }

    /// A value as its bits.
    fn raw(self, value: &Bound<'_, PyAny>, name: &str) -> PyResult<u64> {
        let beyond = || {
            let what = format!("`{name}` does not fit into {} bits", self.bits);
            PyOverflowError::new_err(what)
        };
        match self.kind {
            Kind::Real if self.bits == 32 => Ok((value.extract::<f32>()?.to_bits()).into()),
            Kind::Real => Ok(value.extract::<f64>()?.to_bits()),
            Kind::Signed => {
                let number: i64 = value.extract()?;
                let fits = number >> (self.bits - 1) == number >> 63;
                if fits { Ok(number.cast_unsigned()) } else { Err(beyond()) }
            }
            Kind::Unsigned | Kind::Gap => {
                let number: u64 = value.extract()?;
                if number <= u64::MAX >> (64 - self.bits) { Ok(number) } else { Err(beyond()) }
            }
        }
    }
}

fn kind_of(word: &str) -> Option<(Kind, u32)> {
    let (kind, bits) = match word.split_at_checked(1)? {
        ("u", bits) => (Kind::Unsigned, bits),
        ("i", bits) => (Kind::Signed, bits),
        ("f", bits) => (Kind::Real, bits),
        _ => (Kind::Gap, word),
    };
    let bits: u32 = bits.parse().ok()?;
    let known = match kind {
        Kind::Unsigned => (1..=64).contains(&bits),
        Kind::Signed => (2..=64).contains(&bits),
        Kind::Real => matches!(bits, 32 | 64),
        Kind::Gap => (1..=512).contains(&bits),
    };
    known.then_some((kind, bits))
}
