//! Encodes requests of a protocol's text, and decodes single values without text.

use std::fmt;

use polepair_core::error::WireError;
use polepair_core::explain::{
    Context, Direction, Dissector, EncodeError, EncodeOptions, ExplainSink, Field, FieldValue,
    WireKind,
};
use polepair_core::medium::STREAM_UNIT_MAX;
use polepair_core::proto;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyString, PyTuple};

use crate::errors::{corrupt_error, usage_error};

/// Texts whose bytes are kept; further ones are made anew each time.
const CACHE_MAX: usize = 1 << 10;

/// A protocol's texts as bytes, and its frames as values.
#[pyclass(frozen, module = "polepair._polepair")]
pub struct Codec {
    dissector: &'static dyn Dissector,
    addressing: EncodeOptions,
    cache: Py<PyDict>,
}

impl fmt::Debug for Codec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Codec({})", self.dissector.name())
    }
}

/// Bytes, and CAN identifier with its width.
type EncodedTuple<'py> = (Bound<'py, PyBytes>, Option<u32>, bool);

#[pymethods]
impl Codec {
    #[new]
    #[pyo3(signature = (protocol, axis=None, host=None, via=None))]
    fn new(
        py: Python<'_>,
        protocol: &str,
        axis: Option<u32>,
        host: Option<u32>,
        via: Option<&str>,
    ) -> PyResult<Self> {
        let dissector = proto::find_dissector(protocol).ok_or_else(|| {
            let known: Vec<_> = proto::dissectors().iter().map(|known| known.name()).collect();
            let what = format!("there is no protocol `{protocol}`");
            usage_error(py, "E203", &what, &format!("protocols are {}", known.join(", ")))
        })?;
        let via = match via {
            None => WireKind::Default,
            Some("serial") => WireKind::Serial,
            Some("rs485") => WireKind::Rs485,
            Some("can") => WireKind::Can,
            Some(_) => return Err(PyValueError::new_err("via is serial, rs485 or can")),
        };
        let profile = polepair_drives::usual_profile(dissector);
        let addressing =
            EncodeOptions { axis, groups: false, to_host: false, host, profile, wire: via };
        Ok(Self { dissector, addressing, cache: PyDict::new(py).unbind() })
    }

    /// The protocol's word.
    #[getter]
    fn protocol(&self) -> &'static str {
        self.dissector.name()
    }

    /// Bytes of a text. An earlier result is cached.
    fn encode<'py>(
        &self,
        py: Python<'py>,
        text: &Bound<'py, PyString>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let value = self.cache.bind(py);
        if let Some(bytes) = value.get_item(text)? {
            return Ok(bytes);
        }
        let (bytes, _, _) = self.make(py, text.to_str()?)?;
        if value.len() < CACHE_MAX {
            value.set_item(text, &bytes)?;
        }
        Ok(bytes.into_any())
    }

    /// The bytes of a text, and its CAN identifier with its width.
    fn make<'py>(&self, py: Python<'py>, text: &str) -> PyResult<EncodedTuple<'py>> {
        let mut out = [0; STREAM_UNIT_MAX];
        match self.dissector.encode(text, &self.addressing, &mut out) {
            Ok(made) => Ok((PyBytes::new(py, &out[..made.len]), made.id, made.extended)),
            Err(EncodeError::Forbidden(why)) => {
                Err(usage_error(py, "E222", &format!("`{text}` cannot be sent so: {why}"), ""))
            }
            Err(EncodeError::Text(error)) => {
                let language = self.dissector.language();
                let what = format!("`{text}` is not {language}: expected {}", error.expected);
                Err(usage_error(py, "E241", &what, &format!("at character {}", error.at + 1)))
            }
        }
    }

    /// One field of a drive's frame, by the name that explaining has for it: an int, a float, a str,
    /// or a tuple of 16-bit words.
    #[pyo3(signature = (frame, field, request=None, id=None))]
    fn value<'py>(
        &self,
        py: Python<'py>,
        frame: &[u8],
        field: &str,
        request: Option<&[u8]>,
        id: Option<u32>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let direction = Some(Direction::ToHost);
        let context = Context { direction, request, id, ..Context::default() };
        let mut found = FieldExtractor { py, field, value: None, error: None };
        self.dissector.explain(frame, &context, &mut found);
        if let Some(wrong) = found.error {
            return Err(corrupt_error(
                py,
                &format!("this frame breaks {}: {wrong}", self.protocol()),
            ));
        }
        let what = || usage_error(py, "E213", &format!("this frame has no `{field}`"), "");
        found.value.unwrap_or_else(|| Err(what()))
    }

    fn __repr__(&self) -> String {
        format!("<Codec of {}>", self.protocol())
    }
}

/// Takes one field of a frame, and leaves its words.
struct FieldExtractor<'py, 'n> {
    py: Python<'py>,
    field: &'n str,
    value: Option<PyResult<Bound<'py, PyAny>>>,
    error: Option<WireError>,
}

impl ExplainSink for FieldExtractor<'_, '_> {
    fn kind(&mut self, _kind: &str) {}

    fn axis(&mut self, _axis: u32) {}

    fn text(&mut self, _piece: &str) {}

    fn wants_text(&self) -> bool {
        false
    }

    fn wants_values(&self) -> bool {
        false
    }

    fn field(&mut self, field: Field<'_>) {
        if field.name == self.field {
            self.value = Some(field_to_python(self.py, field.value));
        }
    }

    fn error(&mut self, error: WireError) {
        self.error.get_or_insert(error);
    }
}

/// A field's value as Python has it.
pub fn field_to_python<'py>(py: Python<'py>, value: FieldValue<'_>) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        FieldValue::Int(value) => value.into_pyobject(py)?.into_any(),
        FieldValue::Hex(value, _) => value.into_pyobject(py)?.into_any(),
        FieldValue::Real(value) => value.into_pyobject(py)?.into_any(),
        FieldValue::Text(value) => value.into_pyobject(py)?.into_any(),
        FieldValue::Words(words) => {
            let (pairs, _) = words.as_chunks::<2>();
            PyTuple::new(py, pairs.iter().copied().map(u16::from_be_bytes))?.into_any()
        }
    })
}
