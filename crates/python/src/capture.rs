//! Captures: every frame explained, as Python objects.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair::config::Config;
use polepair_capture::session::Notice;
use polepair_capture::{Decoder as Inner, Event as Found, Format, ItemValue, Judge, Rules};
use polepair_core::explain::{Addressing, Direction, EncodeError, Via};
use polepair_core::medium::STREAM_UNIT_MAX;
use polepair_core::profile::Profile;
use polepair_core::{drives, proto};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::{PyBytes, PyDict};

use crate::errors::{raised, usage};

/// Bytes of a file that are read at once.
const PIECE: usize = 1 << 18;

/// Explains a capture piece by piece.
#[pyclass(frozen, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Decoder {
    reading: Mutex<Reading>,
    verdicts: Vec<String>,
}

/// How far a capture is read.
#[derive(Debug)]
struct Reading {
    decoder: Inner,
    /// `None` at its end.
    file: Option<File>,
}

/// One frame of a capture, or bytes that are none.
#[pyclass(frozen, get_all, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Event {
    /// Its number in the capture, from 1.
    number: u64,
    /// Nanoseconds since the capture's epoch.
    time_ns: Option<u64>,
    /// On which link.
    link: String,
    /// `tx` from the host, `rx` to it.
    direction: Option<&'static str>,
    /// The protocol that explains it.
    protocol: Option<&'static str>,
    /// Its bytes.
    bytes: Py<PyBytes>,
    /// CAN identifier.
    id: Option<u32>,
    /// A CAN identifier of 29 bits.
    extended: bool,
    /// A CAN remote request.
    remote: bool,
    /// The host's own request, heard back through its adapter.
    echo: bool,
    /// The protocol's word for it.
    kind: String,
    /// The axis, station or module that it concerns.
    axis: Option<u32>,
    /// Its fields by name.
    fields: Py<PyDict>,
    /// The one-line meaning.
    text: String,
    /// What is wrong with it.
    error: Option<String>,
    /// What its conversation tells at this frame: a kind, and its facts by name.
    notices: Vec<(&'static str, Py<PyDict>)>,
}

#[pymethods]
impl Event {
    fn __repr__(&self) -> String {
        let Self { number, link, text, .. } = self;
        let trouble = self.error.as_deref().map_or(String::new(), |error| format!(" ! {error}"));
        format!("<Event {number} {link} {}: {text}{trouble}>", self.protocol.unwrap_or("-"))
    }
}

#[pymethods]
impl Decoder {
    /// Opens a capture. Without rules the whole file is weighed first.
    #[new]
    #[pyo3(signature = (path, rules=None, profile=None, format=None))]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        rules: Option<&str>,
        profile: Option<&str>,
        format: Option<&str>,
    ) -> PyResult<Self> {
        let format = format.map(|word| known_format(py, word)).transpose()?;
        let profile = profile.map(|word| known_profile(py, word)).transpose()?;
        let rules = rules.map(|text| known_rules(py, text)).transpose()?;
        py.detach(|| Self::of(&path, rules, profile, format))
            .map_err(|error| PyOSError::new_err(format!("{}: {error}", path.display())))
    }

    /// What each link speaks, and how sure that is; empty where rules said so.
    #[getter]
    fn verdicts(&self) -> Vec<String> {
        self.verdicts.clone()
    }

    /// Places that could not be read.
    #[getter]
    fn damage(&self, py: Python<'_>) -> Vec<String> {
        let reading = self.lock(py);
        reading.decoder.tally().damage.iter().map(ToString::to_string).collect()
    }

    /// The next frames; empty at the end.
    fn read(&self, py: Python<'_>) -> PyResult<Vec<Event>> {
        let mut reading = self.lock(py);
        let Reading { decoder, file } = &mut *reading;
        let mut events = Vec::new();
        let mut buffer = vec![0; PIECE];
        while let Some(open) = file.as_mut().filter(|_| events.is_empty()) {
            let count = py.detach(|| open.read(&mut buffer))?;
            let mut failed = None;
            let mut keep = |found: &Found<'_>| match Event::new(py, found) {
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

impl Decoder {
    fn of(
        path: &Path,
        rules: Option<Rules>,
        profile: Option<&'static Profile>,
        format: Option<Format>,
    ) -> std::io::Result<Self> {
        let (verdicts, inner) = match rules {
            Some(rules) => (Vec::new(), Inner::new(rules).with_format(format)),
            None => {
                let mut judge = Judge::of_format(format);
                let (mut file, mut buffer) = (File::open(path)?, vec![0; PIECE]);
                loop {
                    match file.read(&mut buffer)? {
                        0 => break judge.decide(),
                        count => judge.feed(&buffer[..count]),
                    }
                }
            }
        };
        let verdicts = verdicts.iter().map(ToString::to_string).collect();
        let decoder = inner.with_profile(profile);
        let reading = Reading { decoder, file: Some(File::open(path)?) };
        Ok(Self { reading: Mutex::new(reading), verdicts })
    }

    /// Other threads go on while this one waits for its turn.
    fn lock<'a>(&'a self, py: Python<'a>) -> MutexGuard<'a, Reading> {
        self.reading.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }
}

impl Event {
    fn new(py: Python<'_>, found: &Found<'_>) -> PyResult<Self> {
        let fields = PyDict::new(py);
        for item in found.explained.items() {
            match item.value {
                ItemValue::Int(value) => fields.set_item(item.name, value)?,
                ItemValue::Hex(value, _) => fields.set_item(item.name, value)?,
                ItemValue::Real(value) => fields.set_item(item.name, value)?,
                ItemValue::Text(value) => fields.set_item(item.name, value)?,
                ItemValue::Words(words) => {
                    let (pairs, _) = words.as_chunks::<2>();
                    let words: Vec<u16> = pairs.iter().copied().map(u16::from_be_bytes).collect();
                    fields.set_item(item.name, words)?;
                }
            }
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
            kind: found.explained.kind.clone(),
            axis: found.explained.axis,
            fields: fields.unbind(),
            text: found.explained.text.clone(),
            error: found.wrong.map(|wrong| wrong.to_string()),
            notices: found.notices.iter().map(|told| notice(py, told)).collect::<PyResult<_>>()?,
        })
    }
}

/// A notice as its kind and its facts.
fn notice(py: Python<'_>, told: &Notice) -> PyResult<(&'static str, Py<PyDict>)> {
    let facts = PyDict::new(py);
    let kind = match told {
        Notice::Signal(signal) => {
            facts.set_item("axis", signal.axis)?;
            facts.set_item("name", signal.name)?;
            facts.set_item("value", signal.value)?;
            facts.set_item("exact", signal.exact)?;
            facts.set_item("unit", signal.unit)?;
            facts.set_item("quality", signal.quality as u8)?;
            "signal"
        }
        Notice::Exchange(exchange) => {
            facts.set_item("axis", exchange.axis)?;
            facts.set_item("op", exchange.op)?;
            facts.set_item("asked", exchange.asked.0)?;
            facts.set_item("answered", exchange.answered.map(|(number, _)| number))?;
            facts.set_item("latency_ns", exchange.latency())?;
            facts.set_item("outcome", exchange.outcome.word())?;
            facts.set_item("retries", exchange.retries)?;
            "exchange"
        }
        Notice::Change(change) => {
            facts.set_item("axis", change.axis)?;
            facts.set_item("what", change.what)?;
            facts.set_item("from", change.from)?;
            facts.set_item("to", change.to)?;
            "change"
        }
        Notice::Fault(fault) => {
            facts.set_item("axis", fault.axis)?;
            facts.set_item("code", fault.code)?;
            facts.set_item("text", fault.text)?;
            facts.set_item("cause", fault.cause)?;
            facts.set_item("remedy", fault.remedy)?;
            facts.set_item("gone", fault.gone)?;
            "fault"
        }
        Notice::Odd(odd) => {
            facts.set_item("axis", odd.axis)?;
            facts.set_item("kind", odd.kind.word())?;
            facts.set_item("text", &odd.text)?;
            "odd"
        }
    };
    Ok((kind, facts.unbind()))
}

fn known_format(py: Python<'_>, word: &str) -> PyResult<Format> {
    Format::named(word).ok_or_else(|| {
        let known: Vec<_> = Format::names().collect();
        usage(py, "E248", &format!("there is no format `{word}`"), &known.join(", "))
    })
}

fn known_rules(py: Python<'_>, text: &str) -> PyResult<Rules> {
    Rules::parse(text).map_err(|error| {
        let near = error.nearest.map_or(String::new(), |word| format!("did you mean {word}?"));
        usage(py, "E203", &format!("there is no protocol `{}`", error.word), &near)
    })
}

/// A product by name, the user's own among them, or a profile's file.
fn known_profile(py: Python<'_>, word: &str) -> PyResult<&'static Profile> {
    let named = Config::discover().and_then(|config| config.profile_of(word));
    named.map_err(|error| raised(py, &error))
}

/// The bytes of a text in a protocol's own language: bytes, and CAN identifier with its width.
#[pyfunction]
#[pyo3(signature = (protocol, text, axis=None, host=None, via=None))]
pub fn encode<'py>(
    py: Python<'py>,
    protocol: &str,
    text: &str,
    axis: Option<u32>,
    host: Option<u32>,
    via: Option<&str>,
) -> PyResult<(Bound<'py, PyBytes>, Option<u32>, bool)> {
    let dissectors = proto::dissectors();
    let found = dissectors.iter().find(|known| known.name() == protocol);
    let dissector = *found.ok_or_else(|| {
        let known: Vec<_> = dissectors.iter().map(|known| known.name()).collect();
        let what = format!("there is no protocol `{protocol}`");
        usage(py, "E203", &what, &format!("protocols are {}", known.join(", ")))
    })?;
    let via = match via {
        None => Via::Usual,
        Some("serial") => Via::Serial,
        Some("rs485") => Via::Rs485,
        Some("can") => Via::Can,
        Some(_) => return Err(PyValueError::new_err("via is serial, rs485 or can")),
    };
    let profile = drives::usual(dissector);
    let addressing = Addressing { axis, groups: false, host, profile, via };
    let mut out = [0; STREAM_UNIT_MAX];
    match dissector.encode(text, &addressing, &mut out) {
        Ok(made) => Ok((PyBytes::new(py, &out[..made.len]), made.id, made.extended)),
        Err(EncodeError::Forbidden(why)) => {
            Err(usage(py, "E222", &format!("`{text}` cannot be sent so: {why}"), ""))
        }
        Err(EncodeError::Text(error)) => {
            let what =
                format!("`{text}` is not {}: expected {}", dissector.language(), error.expected);
            Err(usage(py, "E241", &what, &format!("at character {}", error.at + 1)))
        }
    }
}
