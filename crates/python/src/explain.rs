//! Explains one frame or code.

use polepair::faults;
use polepair_capture::{Explanation, RecordData, read_first_record};
use polepair_core::explain::{Context, Direction, Dissector};
use polepair_core::profile::Profile;
use polepair_core::proto;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::capture::item_value;
use crate::errors::usage_error;
use crate::fault::{FaultTuple, fault_tuple};

/// First byte, byte after the last, name, value, meaning.
type PartTuple<'py> = (u16, u16, &'static str, Bound<'py, PyAny>, &'static str);

/// Bytes, kind, axis, text, violated rule, parts.
type ExplanationTuple<'py> =
    (Bound<'py, PyBytes>, String, Option<u32>, String, Option<String>, Vec<PartTuple<'py>>);

/// Meaning of a code in a protocol, and the products' faults.
type CodeTuple = (Option<&'static str>, Vec<(&'static str, FaultTuple)>);

/// A frame as a caller has it: bytes with a CAN identifier, or a line of a capture.
#[derive(FromPyObject, Debug)]
pub enum FrameInput {
    /// Bytes, identifier, whether that has 29 bits, whether it is a remote request.
    Bytes(Vec<u8>, Option<u32>, bool, bool),
    /// `01 01 00 …` or `001#0100…`.
    #[pyo3(transparent)]
    Line(String),
}

/// Meaning of every byte of a frame in a protocol, or in that of a product.
#[pyfunction]
#[pyo3(signature = (subject, frame, to_drive=None))]
pub fn explain<'py>(
    py: Python<'py>,
    subject: &str,
    frame: FrameInput,
    to_drive: Option<bool>,
) -> PyResult<ExplanationTuple<'py>> {
    let (dissector, profile) = find_subject(py, subject)?;
    let (bytes, id, extended, remote) = match frame {
        FrameInput::Bytes(bytes, id, extended, remote) => (bytes, id, extended, remote),
        FrameInput::Line(text) => parse_frame(py, &text)?,
    };
    let direction = to_drive.map(|to| if to { Direction::ToDrive } else { Direction::ToHost });
    let profile = profile.or_else(|| polepair_drives::usual_profile(dissector));
    let context = Context { direction, profile, id, extended, remote, ..Context::default() };
    let mut explained = Explanation::default();
    dissector.explain(&bytes, &context, &mut explained);
    let parts = explained.fields().map(|item| {
        Ok((item.start, item.end, item.name, item_value(py, item.value)?, item.meaning))
    });
    let parts = parts.collect::<PyResult<_>>()?;
    let Explanation { kind, axis, text, error, .. } = explained;
    let wrong = error.map(|error| error.to_string());
    Ok((PyBytes::new(py, &bytes), kind, axis, text, wrong, parts))
}

/// Meaning of a number as a status, an exception, an abort code; and as faults of the products.
#[pyfunction]
pub fn explain_code(py: Python<'_>, subject: &str, code: u32) -> PyResult<CodeTuple> {
    let (dissector, profile) = find_subject(py, subject)?;
    let mut speakers: Vec<&'static Profile> = match profile {
        Some(profile) => vec![profile],
        None => polepair_drives::profiles()
            .iter()
            .filter(|p| dissector.language() == p.protocol)
            .copied()
            .collect(),
    };
    speakers.dedup_by_key(|profile| profile.family);
    let found = speakers.iter().flat_map(|profile| {
        faults(profile, code).into_iter().map(|found| (profile.name, fault_tuple(found.into())))
    });
    Ok((dissector.code_meaning(code), found.collect()))
}

/// A protocol by its word, or a product and the first wire of its protocol.
fn find_subject(
    py: Python<'_>,
    subject: &str,
) -> PyResult<(&'static dyn Dissector, Option<&'static Profile>)> {
    if let Some(dissector) = proto::find_dissector(subject) {
        return Ok((dissector, None));
    }
    let product =
        polepair_drives::profiles().iter().find(|p| p.name == subject || p.family == subject);
    let product = product.copied().or_else(|| polepair::profile::find_shipped(subject));
    let speaks = |p: &&'static Profile| {
        let mut all = proto::dissectors().iter().copied();
        all.find(|dissector| dissector.language() == p.protocol)
    };
    let dissector = product.as_ref().and_then(speaks);
    dissector.map(|dissector| (dissector, product)).ok_or_else(|| {
        let all: Vec<_> = proto::dissectors().iter().map(|known| known.name()).collect();
        let what = format!("there is no protocol or product `{subject}`");
        usage_error(py, "E203", &what, &format!("protocols are {}", all.join(", ")))
    })
}

/// A frame as text: its bytes, identifier, width, and whether it is a remote request.
fn parse_frame(py: Python<'_>, text: &str) -> PyResult<(Vec<u8>, Option<u32>, bool, bool)> {
    let frame = read_first_record(text, |record| match &record.data {
        RecordData::Bytes(bytes) => Some((bytes.to_vec(), None, false, false)),
        RecordData::Frame(f) => Some((f.bytes().to_vec(), Some(f.id), f.extended, f.remote)),
        _ => None,
    });
    match frame.flatten() {
        Some(frame) => Ok(frame),
        _ => {
            let what = format!("`{text}` is no frame");
            Err(usage_error(py, "E241", &what, "a frame is `01 01 00 5E` or, on CAN, `30B#5443`"))
        }
    }
}
