//! Captures: decoded frames as Python objects.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use arrow_array::RecordBatch;
use arrow_schema::ArrowError;
use polepair::config::Config;
use polepair_capture::parallel::{self, JOBS_MAX};
use polepair_capture::session::SessionNotice;
use polepair_capture::{
    CaptureDecoder as Inner, CaptureFormat, DecodedFrame as Found, ExplanationValue, Rules,
};
use polepair_columns::{
    BatchBuilder, BuiltBatches, CaptureOrigin, DictionaryMerger, TableKind, TablesBuilder,
};
use polepair_core::explain::Direction;
use polepair_core::profile::Profile;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::{PyBytes, PyDict};

use crate::columns::{Columns, arrow_error};
use crate::errors::{to_py_error, usage_error};

/// Bytes of a file that are read at once.
const READ_SIZE: usize = 1 << 18;

/// Explains a capture piece by piece, or makes columns of it.
#[pyclass(frozen, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Decoder {
    options: DecodeOptions,
    state: Mutex<DecoderState>,
}

/// Options of a decode.
#[derive(Debug)]
struct DecodeOptions {
    path: PathBuf,
    rules: Option<Rules>,
    profile: Option<&'static Profile>,
    format: Option<CaptureFormat>,
}

/// Progress of a decode.
#[derive(Debug)]
struct DecoderState {
    decoder: Inner,
    /// `None` at its end.
    file: Option<File>,
}

/// One frame of a capture, or bytes that are none.
#[pyclass(frozen, get_all, name = "Event", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyFrame {
    /// Number of the frame in the capture, from 1.
    number: u64,
    /// Nanoseconds since the capture's epoch.
    time_ns: Option<u64>,
    /// On which link.
    link: String,
    /// `tx` from the host, `rx` to it.
    direction: Option<&'static str>,
    /// The protocol that explains it.
    protocol: Option<&'static str>,
    /// Bytes of the frame.
    bytes: Py<PyBytes>,
    /// CAN identifier.
    id: Option<u32>,
    /// A CAN identifier of 29 bits.
    extended: bool,
    /// A CAN remote request.
    remote: bool,
    /// True for the host's own request, returned by its adapter.
    echo: bool,
    /// The protocol's word for it.
    kind: String,
    /// The axis, station or module that it concerns.
    axis: Option<u32>,
    /// Fields of the frame by name.
    fields: Py<PyDict>,
    /// The one-line meaning.
    text: String,
    /// Fault of the frame.
    error: Option<String>,
    /// Notices of its conversation at this frame: a kind, and its facts by name.
    notices: Vec<(&'static str, Py<PyDict>)>,
}

#[pymethods]
impl PyFrame {
    fn __repr__(&self) -> String {
        let Self { number, link, text, .. } = self;
        let trouble = self.error.as_deref().map_or(String::new(), |error| format!(" ! {error}"));
        format!("<Event {number} {link} {}: {text}{trouble}>", self.protocol.unwrap_or("-"))
    }
}

#[pymethods]
impl Decoder {
    /// Opens a capture. Without rules it is read ahead until the protocols are certain.
    #[new]
    #[pyo3(signature = (path, rules=None, profile=None, format=None))]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        rules: Option<&str>,
        profile: Option<&str>,
        format: Option<&str>,
    ) -> PyResult<Self> {
        let format = format.map(|word| parse_format(py, word)).transpose()?;
        let profile = profile.map(|word| find_profile(py, word)).transpose()?;
        let rules = rules.map(|text| parse_rules(py, text)).transpose()?;
        let decode_options = DecodeOptions { path, rules, profile, format };
        let opened =
            py.detach(|| Ok((decode_options.build_decoder()?, File::open(&decode_options.path)?)));
        let (decoder, file) = opened.map_err(|error| decode_options.read_error(error))?;
        let reading = Mutex::new(DecoderState { decoder, file: Some(file) });
        Ok(Self { options: decode_options, state: reading })
    }

    /// Detected protocol of each link and its certainty so far; empty where rules named it.
    #[getter]
    fn verdicts(&self, py: Python<'_>) -> Vec<String> {
        self.lock(py).decoder.detections().iter().map(ToString::to_string).collect()
    }

    /// Places that could not be read.
    #[getter]
    fn damage(&self, py: Python<'_>) -> Vec<String> {
        let reading = self.lock(py);
        reading.decoder.statistics().damage.iter().map(ToString::to_string).collect()
    }

    /// The whole capture as columns, whatever was read of it before.
    fn tables(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Vec<Columns>> {
        let wanted: Vec<TableKind> = names
            .iter()
            .map(|name| {
                TableKind::from_name(name).ok_or_else(|| {
                    let all = TableKind::ALL.map(TableKind::name).join(", ");
                    usage_error(
                        py,
                        "E250",
                        &format!("`{name}` is no table"),
                        &format!("tables are {all}"),
                    )
                })
            })
            .collect::<PyResult<_>>()?;
        let opened =
            py.detach(|| Ok((self.options.build_decoder()?, File::open(&self.options.path)?)));
        let (inner, file) = opened.map_err(|error| self.options.read_error(error))?;
        let made = TableCollector::new(&self.options.path, &wanted);
        py.detach(|| made.decode(inner.without_text(), file))
    }

    /// The next frames; empty at the end.
    fn read(&self, py: Python<'_>) -> PyResult<Vec<PyFrame>> {
        let mut reading = self.lock(py);
        let DecoderState { decoder, file } = &mut *reading;
        let mut events = Vec::new();
        let mut buffer = vec![0; READ_SIZE];
        while let Some(open) = file.as_mut().filter(|_| events.is_empty()) {
            let count = py.detach(|| open.read(&mut buffer))?;
            let mut failed = None;
            let mut keep = |found: &Found<'_>| match PyFrame::new(py, found) {
                Ok(event) => events.push(event),
                Err(error) => failed = Some(error),
            };
            match count {
                0 => {
                    decoder.finish(&mut keep);
                    *file = None;
                }
                count => decoder.feed(&buffer[..count], &mut keep),
            }
            failed.map_or(Ok(()), Err)?;
            py.check_signals()?;
        }
        Ok(events)
    }
}

impl DecodeOptions {
    /// A decoder by the rules; without any it detects the protocols.
    fn build_decoder(&self) -> std::io::Result<Inner> {
        let decoder = match &self.rules {
            Some(rules) => Inner::new(rules.clone()).with_read_options(self.format.into()),
            None => Inner::detect(Box::new(File::open(&self.path)?), self.format.into())?,
        };
        Ok(decoder.with_profile(self.profile))
    }

    fn read_error(&self, error: std::io::Error) -> PyErr {
        PyOSError::new_err(format!("{}: {error}", self.path.display()))
    }
}

impl Decoder {
    /// Other threads go on while this one waits for its turn.
    fn lock<'a>(&'a self, py: Python<'a>) -> MutexGuard<'a, DecoderState> {
        self.state.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }
}

/// Threads that are of use.
pub fn thread_count() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from).min(JOBS_MAX)
}

/// Collects the tables of a decode in progress.
struct TableCollector {
    /// One for each thread.
    builders: Vec<BatchBuilder>,
    batches: Vec<(TableKind, Vec<RecordBatch>)>,
    numbering: DictionaryMerger,
}

impl TableCollector {
    fn new(path: &Path, wanted: &[TableKind]) -> Self {
        let origin = CaptureOrigin { source: String::new(), file: path.display().to_string() };
        let batches = wanted.iter().map(|table| (*table, Vec::new())).collect();
        let builders = (0..thread_count())
            .map(|_| BatchBuilder::new(TablesBuilder::new(wanted, &origin)))
            .collect();
        Self { builders, batches, numbering: DictionaryMerger::default() }
    }

    /// Decodes the file to its end. Ctrl-C is checked on the caller's thread between pieces: the other threads use no
    /// Python and wait for none.
    fn decode(mut self, mut decoder: Inner, file: File) -> PyResult<Vec<Columns>> {
        let Self { builders, batches, numbering } = &mut self;
        let caller = std::thread::current().id();
        let fill = &mut |piece: &mut Vec<u8>, max| {
            (&file).take(max as u64).read_to_end(piece)?;
            Ok(())
        };
        let put = &mut |builder: &mut BatchBuilder| {
            append_batches(batches, numbering, builder.take_built())?;
            if std::thread::current().id() == caller {
                // While Python ends, no signal can be checked.
                Python::try_attach(|py| py.check_signals()).unwrap_or(Ok(()))
            } else {
                Ok(())
            }
        };
        parallel::decode(&mut decoder, builders, fill, put)?;
        if let Some(last) = builders.first_mut() {
            decoder.finish_sessions(&mut |event| {
                last.tables.add_final_notices(event.link, event.notices)
            });
            last.flush();
            append_batches(batches, numbering, last.take_built())?;
        }
        let tables = self.batches.into_iter().map(|(table, rows)| Columns::new(table, rows));
        tables.collect::<Result<_, ArrowError>>().map_err(arrow_error)
    }
}

/// Puts batches behind those of their tables, their words numbered as in those.
fn append_batches(
    batches: &mut [(TableKind, Vec<RecordBatch>)],
    numbering: &mut DictionaryMerger,
    built: BuiltBatches,
) -> PyResult<()> {
    for (table, batch) in built.map_err(arrow_error)? {
        let batch = numbering.renumber(table, batch).map_err(arrow_error)?;
        let of = batches.iter_mut().find(|(of, _)| *of == table);
        of.into_iter().for_each(|(_, rows)| rows.push(batch.clone()));
    }
    Ok(())
}

impl PyFrame {
    pub fn new(py: Python<'_>, found: &Found<'_>) -> PyResult<Self> {
        let fields = PyDict::new(py);
        for item in found.explanation.fields() {
            fields.set_item(item.name, item_value(py, item.value)?)?;
        }
        Ok(Self {
            number: found.number,
            time_ns: found.time.map(|time| time.0),
            link: found.link.to_owned(),
            direction: found.direction.map(|direction| match direction {
                Direction::ToDrive => "tx",
                Direction::ToHost => "rx",
            }),
            protocol: found.protocol,
            bytes: PyBytes::new(py, found.bytes).unbind(),
            id: found.id,
            extended: found.extended,
            remote: found.remote,
            echo: found.echo,
            kind: found.explanation.kind.clone(),
            axis: found.explanation.axis,
            fields: fields.unbind(),
            text: found.explanation.text.clone(),
            error: found.defect.map(|wrong| wrong.to_string()),
            notices: found
                .notices
                .iter()
                .map(|notice| notice_tuple(py, notice))
                .collect::<PyResult<_>>()?,
        })
    }
}

/// A field's value as Python has it.
pub fn item_value<'py>(
    py: Python<'py>,
    value: ExplanationValue<'_>,
) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        ExplanationValue::Int(value) => value.into_pyobject(py)?.into_any(),
        ExplanationValue::Hex(value, _) => value.into_pyobject(py)?.into_any(),
        ExplanationValue::Real(value) => value.into_pyobject(py)?.into_any(),
        ExplanationValue::Text(value) => value.into_pyobject(py)?.into_any(),
        ExplanationValue::Words(words) => {
            let (pairs, _) = words.as_chunks::<2>();
            let words: Vec<u16> = pairs.iter().copied().map(u16::from_be_bytes).collect();
            words.into_pyobject(py)?
        }
    })
}

/// A notice as its kind and its facts.
fn notice_tuple(py: Python<'_>, notice: &SessionNotice) -> PyResult<(&'static str, Py<PyDict>)> {
    let facts = PyDict::new(py);
    let kind = match notice {
        SessionNotice::Signal(signal) => {
            facts.set_item("axis", signal.axis)?;
            facts.set_item("name", signal.name)?;
            facts.set_item("value", signal.value)?;
            facts.set_item("exact", signal.exact)?;
            facts.set_item("unit", signal.unit)?;
            facts.set_item("quality", signal.quality as u8)?;
            facts.set_item("request", signal.request)?;
            "signal"
        }
        SessionNotice::Exchange(exchange) => {
            facts.set_item("axis", exchange.axis)?;
            facts.set_item("op", exchange.op)?;
            facts.set_item("asked", exchange.requested.0)?;
            facts.set_item("answered", exchange.answered.map(|(number, _)| number))?;
            facts.set_item("latency_ns", exchange.latency())?;
            facts.set_item("outcome", exchange.outcome.as_str())?;
            facts.set_item("retries", exchange.retries)?;
            "exchange"
        }
        SessionNotice::Change(change) => {
            facts.set_item("axis", change.axis)?;
            facts.set_item("what", change.what)?;
            facts.set_item("from", change.from)?;
            facts.set_item("to", change.to)?;
            "change"
        }
        SessionNotice::Fault(fault) => {
            facts.set_item("axis", fault.axis)?;
            facts.set_item("code", fault.code)?;
            facts.set_item("text", fault.text)?;
            facts.set_item("cause", fault.cause)?;
            facts.set_item("remedy", fault.remedy)?;
            facts.set_item("gone", fault.gone)?;
            "fault"
        }
        SessionNotice::Anomaly(anomaly) => {
            facts.set_item("axis", anomaly.axis)?;
            facts.set_item("kind", anomaly.kind.as_str())?;
            facts.set_item("text", &anomaly.text)?;
            "odd"
        }
    };
    Ok((kind, facts.unbind()))
}

fn parse_format(py: Python<'_>, word: &str) -> PyResult<CaptureFormat> {
    CaptureFormat::from_name(word).ok_or_else(|| {
        let known: Vec<_> = CaptureFormat::names().collect();
        usage_error(py, "E248", &format!("there is no format `{word}`"), &known.join(", "))
    })
}

fn parse_rules(py: Python<'_>, text: &str) -> PyResult<Rules> {
    Rules::parse(text).map_err(|error| {
        let near = error.nearest.map_or(String::new(), |word| format!("did you mean {word}?"));
        usage_error(py, "E203", &format!("there is no protocol `{}`", error.word), &near)
    })
}

/// A product by name, the user's own among them, or a profile's file.
fn find_profile(py: Python<'_>, word: &str) -> PyResult<&'static Profile> {
    Config::discover().resolve_profile(word).map_err(|error| to_py_error(py, &error))
}
