//! Reads the output of `polepair decode --format jsonl` as records.

use std::borrow::Cow;

use polepair_core::explain::Direction;
use serde::Deserialize;
use serde_json::value::RawValue;

use super::ReadError;
use super::lines::{LineFormat, ParsedLine};
use super::words::parse_hex;
use crate::explanation::{ERROR_FRAME, REMOTE_REQUEST};
use crate::record::{
    CanErrorFrame, CanRecord, ID_MASK, Record, RecordData, STANDARD_MAX, classic_frame,
};
use crate::timestamp::Timestamp;

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct JsonlReader {
    link: String,
    bytes: Vec<u8>,
}

/// Keys of the captured frame.
#[derive(Deserialize)]
struct JsonlFrame<'a> {
    #[serde(borrow)]
    time: Option<&'a RawValue>,
    #[serde(borrow)]
    link: Cow<'a, str>,
    #[serde(borrow)]
    direction: Option<Cow<'a, str>>,
    #[serde(borrow)]
    bytes: Cow<'a, str>,
    id: Option<u32>,
    extended: Option<bool>,
    /// Bytes that a remote request asks for.
    remote: Option<u8>,
    #[serde(borrow)]
    kind: Option<Cow<'a, str>>,
    #[serde(borrow)]
    text: Option<Cow<'a, str>>,
}

impl LineFormat for JsonlReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        if line.trim_ascii().is_empty() {
            return Ok(ParsedLine::Nothing);
        }
        let object: JsonlFrame<'_> = serde_json::from_slice(line).map_err(|_| {
            ReadError("it is not an object with time, link, direction, bytes and id")
        })?;
        let time = object.time.map(|raw| {
            Timestamp::parse(raw.get().as_bytes())
                .ok_or(ReadError("the time is not seconds with decimals"))
        });
        let direction = match object.direction.as_deref() {
            None => None,
            Some("tx") => Some(Direction::ToDrive),
            Some("rx") => Some(Direction::ToHost),
            Some(_) => return Err(ReadError("the direction is not tx, rx or null")),
        };
        let time = time.transpose()?;
        self.bytes.clear();
        parse_hex(object.bytes.as_bytes(), &mut self.bytes)?;
        let shape = object.can_record(&self.bytes)?;
        object.link.as_ref().clone_into(&mut self.link);
        let data =
            shape.map_or(RecordData::Bytes(&self.bytes), |shape| shape.with_bytes(&self.bytes));
        Ok(ParsedLine::Record(Record { time, link: &self.link, direction, data, offset: 0 }))
    }
}

impl JsonlFrame<'_> {
    /// The kind of CAN frame; `None` for bytes of a serial line.
    fn can_record(&self, bytes: &[u8]) -> Result<Option<CanRecord>, ReadError> {
        let Some(id) = self.id else { return Ok(None) };
        let extended = self.extended.unwrap_or(id > STANDARD_MAX);
        if self.kind.as_deref() == Some(ERROR_FRAME) {
            let data = classic_frame(0, false, false, 8, bytes).data;
            return Ok(Some(CanRecord::Error(CanErrorFrame { class: id & ID_MASK, data })));
        }
        if id > if extended { ID_MASK } else { STANDARD_MAX } {
            return Err(ReadError("the identifier is too great"));
        }
        let remote = self.remote.is_some() || bytes.is_empty() && self.begins_with(REMOTE_REQUEST);
        let len = self.remote.map_or(bytes.len(), |wanted| usize::from(wanted.min(8)));
        Ok(Some(match bytes.len() {
            0..=8 => CanRecord::Frame(classic_frame(id, extended, remote, len as u8, bytes)),
            9..=64 => CanRecord::Fd { id, extended, flags: 0 },
            _ => return Err(ReadError("a CAN frame has at most 64 bytes")),
        }))
    }

    fn begins_with(&self, word: &str) -> bool {
        self.text.as_ref().is_some_and(|text| text.starts_with(word))
    }
}
