//! The CSV of python-can: `timestamp,arbitration_id,extended,remote,error,dlc,data`, with data in base 64.
//! Columns are identified by their names.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;

use super::ReadError;
use super::lines::LineFormat;
use crate::record::{CanErrorFrame, CanRecord, ID_MASK, Record, STANDARD_MAX, classic_frame};
use crate::timestamp::Timestamp;

/// Columns that are read.
const NAMES: [&str; 7] =
    ["timestamp", "arbitration_id", "extended", "remote", "error", "dlc", "data"];

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct CsvReader {
    /// Where each of the columns that are read stands, once the first line has told.
    columns: Option<[Option<usize>; NAMES.len()]>,
    bytes: Vec<u8>,
}

impl LineFormat for CsvReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<Option<Record<'a>>, ReadError> {
        let line = std::str::from_utf8(line).map_err(|_| ReadError("the line is not text"))?;
        let line = line.trim_start_matches('\u{FEFF}').trim();
        if line.is_empty() {
            return Ok(None);
        }
        let Some(places) = self.columns else {
            self.columns = Some(parse_header(line)?);
            return Ok(None);
        };
        let mut found = [""; NAMES.len()];
        for (word, index) in found.iter_mut().zip(places) {
            *word = index.and_then(|at| line.split(',').nth(at)).unwrap_or_default().trim();
        }
        let [time, id, extended, remote, error, dlc, data] = found;
        let time = Timestamp::parse(time.as_bytes()).ok_or(ReadError("expected seconds"))?;
        let shape = self.parse_frame(
            id,
            parse_bool(extended),
            parse_bool(remote),
            parse_bool(error),
            dlc,
            data,
        )?;
        let data = shape.with_bytes(&self.bytes);
        Ok(Some(Record { time: Some(time), link: "can0", direction: None, data, offset: 0 }))
    }
}

impl CsvReader {
    fn parse_frame(
        &mut self,
        id: &str,
        extended: bool,
        remote: bool,
        error: bool,
        dlc: &str,
        data: &str,
    ) -> Result<CanRecord, ReadError> {
        let id = id.strip_prefix("0x").unwrap_or(id);
        let id = u32::from_str_radix(id, 16).map_err(|_| ReadError("expected an identifier"))?;
        let dlc = dlc.parse::<u8>().map_err(|_| ReadError("expected a length"))?;
        self.bytes.clear();
        BASE64
            .decode_vec(data, &mut self.bytes)
            .map_err(|_| ReadError("the data is not base 64"))?;
        if error {
            let frame = classic_frame(0, false, false, 8, &self.bytes);
            let class = if id == 0 { CanErrorFrame::BUS_ERROR } else { id & ID_MASK };
            return Ok(CanRecord::Error(CanErrorFrame { class, data: frame.data }));
        }
        if id > if extended { ID_MASK } else { STANDARD_MAX } {
            return Err(ReadError("the identifier is too great"));
        }
        if !remote && self.bytes.len() < usize::from(dlc) {
            return Err(ReadError("it has fewer bytes than its length says"));
        }
        self.bytes.truncate(usize::from(dlc));
        Ok(match dlc {
            0..=8 => CanRecord::Frame(classic_frame(id, extended, remote, dlc, &self.bytes)),
            9..=64 => CanRecord::Fd { id, extended, flags: 0 },
            _ => return Err(ReadError("a CAN FD frame has at most 64 bytes")),
        })
    }
}

fn parse_header(line: &str) -> Result<[Option<usize>; NAMES.len()], ReadError> {
    let locate = |name: &str| line.split(',').position(|word| word.trim() == name);
    let places = NAMES.map(locate);
    match places {
        [Some(_), Some(_), .., Some(_), Some(_)] => Ok(places),
        _ => Err(ReadError("the first line does not name timestamp, arbitration_id, dlc and data")),
    }
}

fn parse_bool(word: &str) -> bool {
    matches!(word, "1" | "True" | "true")
}
