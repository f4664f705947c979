//! What `polepair decode --format jsonl` prints, read back as what was captured.

use std::borrow::Cow;

use polepair_core::explain::Direction;
use serde::Deserialize;
use serde_json::value::RawValue;

use super::Bad;
use super::lines::Line;
use super::seriallog::hex_run;
use crate::explained::{ERROR_FRAME, REMOTE_REQUEST};
use crate::record::{Data, ErrorFrame, ID_MASK, Record, STANDARD_MAX, Shape, classic};
use crate::stamp::Stamp;

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct Jsonl {
    link: String,
    bytes: Vec<u8>,
}

/// The keys that tell what was captured.
#[derive(Deserialize)]
struct Object<'a> {
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

impl Line for Jsonl {
    fn line<'a>(&'a mut self, line: &'a [u8]) -> Result<Option<Record<'a>>, Bad> {
        if line.trim_ascii().is_empty() {
            return Ok(None);
        }
        let object: Object<'_> = serde_json::from_slice(line)
            .map_err(|_| Bad("it is not an object with time, link, direction, bytes and id"))?;
        let time = object.time.map(|raw| {
            Stamp::parse(raw.get().as_bytes()).ok_or(Bad("the time is not seconds with decimals"))
        });
        let direction = match object.direction.as_deref() {
            None => None,
            Some("tx") => Some(Direction::ToDrive),
            Some("rx") => Some(Direction::ToHost),
            Some(_) => return Err(Bad("the direction is not tx, rx or null")),
        };
        let time = time.transpose()?;
        self.bytes.clear();
        hex_run(object.bytes.as_bytes(), &mut self.bytes)?;
        let shape = object.shape(&self.bytes)?;
        object.link.as_ref().clone_into(&mut self.link);
        let data = shape.map_or(Data::Bytes(&self.bytes), |shape| shape.with(&self.bytes));
        Ok(Some(Record { time, link: &self.link, direction, data, at: 0 }))
    }
}

impl Object<'_> {
    /// The kind of CAN frame; `None` for bytes of a serial line.
    fn shape(&self, bytes: &[u8]) -> Result<Option<Shape>, Bad> {
        let Some(id) = self.id else { return Ok(None) };
        let extended = self.extended.unwrap_or(id > STANDARD_MAX);
        if self.kind.as_deref() == Some(ERROR_FRAME) {
            let data = classic(0, false, false, 8, bytes).data;
            return Ok(Some(Shape::Error(ErrorFrame { class: id & ID_MASK, data })));
        }
        if id > if extended { ID_MASK } else { STANDARD_MAX } {
            return Err(Bad("the identifier is too great"));
        }
        let says = |word: &str| self.text.as_ref().is_some_and(|text| text.starts_with(word));
        let remote = self.remote.is_some() || bytes.is_empty() && says(REMOTE_REQUEST);
        let len = self.remote.map_or(bytes.len(), |wanted| usize::from(wanted.min(8)));
        Ok(Some(match bytes.len() {
            0..=8 => Shape::Frame(classic(id, extended, remote, len as u8, bytes)),
            9..=64 => Shape::Fd { id, extended, flags: 0 },
            _ => return Err(Bad("a CAN frame has at most 64 bytes")),
        }))
    }
}
