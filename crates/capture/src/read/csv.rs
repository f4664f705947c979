//! CSV as python-can writes it: `timestamp,arbitration_id,extended,remote,error,dlc,data`, the data
//! in base 64. Columns are known by their names.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;

use super::Bad;
use super::lines::Line;
use crate::record::{ErrorFrame, ID_MASK, Record, STANDARD_MAX, Shape, classic};
use crate::stamp::Stamp;

/// Columns that are read.
const NAMES: [&str; 7] =
    ["timestamp", "arbitration_id", "extended", "remote", "error", "dlc", "data"];

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct Csv {
    /// Where each of the columns that are read stands, once the first line has told.
    places: Option<[Option<usize>; NAMES.len()]>,
    bytes: Vec<u8>,
}

impl Line for Csv {
    fn line<'a>(&'a mut self, line: &'a [u8]) -> Result<Option<Record<'a>>, Bad> {
        let line = std::str::from_utf8(line).map_err(|_| Bad("the line is not text"))?;
        let line = line.trim_start_matches('\u{FEFF}').trim();
        if line.is_empty() {
            return Ok(None);
        }
        let Some(places) = self.places else {
            self.places = Some(header(line)?);
            return Ok(None);
        };
        let mut found = [""; NAMES.len()];
        for (word, place) in found.iter_mut().zip(places) {
            *word = place.and_then(|at| line.split(',').nth(at)).unwrap_or_default().trim();
        }
        let [time, id, extended, remote, error, dlc, data] = found;
        let time = Stamp::parse(time.as_bytes()).ok_or(Bad("expected seconds"))?;
        let shape = self.shape(id, truth(extended), truth(remote), truth(error), dlc, data)?;
        let data = shape.with(&self.bytes);
        Ok(Some(Record { time: Some(time), link: "can0", direction: None, data, at: 0 }))
    }
}

impl Csv {
    fn shape(
        &mut self,
        id: &str,
        extended: bool,
        remote: bool,
        error: bool,
        dlc: &str,
        data: &str,
    ) -> Result<Shape, Bad> {
        let id = id.strip_prefix("0x").unwrap_or(id);
        let id = u32::from_str_radix(id, 16).map_err(|_| Bad("expected an identifier"))?;
        let dlc = dlc.parse::<u8>().map_err(|_| Bad("expected a length"))?;
        self.bytes.clear();
        BASE64.decode_vec(data, &mut self.bytes).map_err(|_| Bad("the data is not base 64"))?;
        if error {
            let frame = classic(0, false, false, 8, &self.bytes);
            let class = if id == 0 { ErrorFrame::BUS_ERROR } else { id & ID_MASK };
            return Ok(Shape::Error(ErrorFrame { class, data: frame.data }));
        }
        if id > if extended { ID_MASK } else { STANDARD_MAX } {
            return Err(Bad("the identifier is too great"));
        }
        if !remote && self.bytes.len() < usize::from(dlc) {
            return Err(Bad("it has fewer bytes than its length says"));
        }
        self.bytes.truncate(usize::from(dlc));
        Ok(match dlc {
            0..=8 => Shape::Frame(classic(id, extended, remote, dlc, &self.bytes)),
            9..=64 => Shape::Fd { id, extended, flags: 0 },
            _ => return Err(Bad("a CAN FD frame has at most 64 bytes")),
        })
    }
}

fn header(line: &str) -> Result<[Option<usize>; NAMES.len()], Bad> {
    let place = |name: &str| line.split(',').position(|word| word.trim() == name);
    let places = NAMES.map(place);
    match places {
        [Some(_), Some(_), .., Some(_), Some(_)] => Ok(places),
        _ => Err(Bad("the first line does not name timestamp, arbitration_id, dlc and data")),
    }
}

fn truth(word: &str) -> bool {
    matches!(word, "1" | "True" | "true")
}
