//! Values of any length: text, and bytes such as a firmware image or a log.

use super::failure::RequestKind;
use super::{LocalAxis, RunningRequest};
use crate::amount::Value;
use crate::error::Error;
use polepair_core::error::{Failure, Outcome};
use polepair_core::escape::EscapedText;
use polepair_core::profile::{Encoding, ParameterId};
use polepair_core::proto;
use polepair_core::time::Instant;
use std::fmt;
use std::time::Duration;

/// Interval of moving bytes between the caller and the host, whose buffer holds one block.
const PUMP_INTERVAL: Duration = Duration::from_millis(2);
/// The most bytes that are read of one value.
pub const DATA_MAX: usize = 256 << 20;
/// Size of the host's buffer, bytes.
const BUFFER_MAX: usize = 1024;
/// A value of more bytes is written in blocks, which need an answer for each block and not for each
/// segment of seven bytes.
const BLOCK_MIN: usize = 256;

impl LocalAxis {
    /// Reads a parameter of any length: text without its final zeros, or all bytes. `progress` gets the
    /// number of received bytes. With `block`, a block transfer is used if protocol and drive support it,
    /// else segments.
    ///
    /// # Errors
    /// [`Error`] by source, with the code of a refusal.
    pub fn read_data(
        &self,
        id: ParameterId,
        block: bool,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Vec<u8>, Error> {
        // A drive without block transfer refuses its first frame: nothing was transferred, and segments are
        // safe.
        let mut data = match self.read_data_once(id, block, progress) {
            Err(error) if block && self.has_no_blocks(&error) => {
                self.read_data_once(id, false, progress)?
            }
            read => read?,
        };
        if self.parameter(id).is_some_and(|parameter| parameter.encoding == Encoding::Text) {
            let len = data.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
            data.truncate(len);
        }
        Ok(data)
    }

    /// Writes all bytes of a parameter of any length. `progress` gets the number of bytes that the host has accepted. A
    /// long value goes in blocks if the drive has them, otherwise in segments: a drive with neither refuses before the
    /// first byte is sent.
    ///
    /// # Errors
    /// [`Error`] by blame; `E219` for what may move an unarmed axis. After a loss the transfer is not
    /// repeated: the drive may have stored part of it.
    pub fn write_data(
        &self,
        id: ParameterId,
        data: &[u8],
        progress: &mut dyn FnMut(usize),
    ) -> Result<(), Error> {
        let block = data.len() >= BLOCK_MIN;
        match self.write_data_once(id, data, block, progress) {
            Err(error) if block && self.has_no_blocks(&error) => {
                self.write_data_once(id, data, false, progress)
            }
            written => written,
        }
    }

    /// Reads a parameter that holds text, by name or address.
    ///
    /// # Errors
    /// As [`read_data`](Self::read_data).
    pub fn get_text(&self, name: &str) -> Result<String, Error> {
        let data = self.read_data(self.find(name)?, false, &mut |_| {})?;
        Ok(String::from_utf8_lossy(&data).into_owned())
    }

    /// Reads a parameter that holds bytes, by name or address.
    ///
    /// # Errors
    /// As [`read_data`](Self::read_data).
    pub fn get_bytes(&self, name: &str) -> Result<Vec<u8>, Error> {
        self.read_data(self.find(name)?, false, &mut |_| {})
    }

    /// Returns whether the drive refused because it has no block transfer: nothing was transferred then.
    fn has_no_blocks(&self, error: &Error) -> bool {
        let Error::Failed { outcome, .. } = error else { return false };
        let Some(Failure::Refused { code }) = outcome.failure() else { return false };
        proto::find_dissector(self.protocol).is_some_and(|known| known.refuses_blocks(code))
    }

    fn read_data_once(
        &self,
        id: ParameterId,
        block: bool,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Vec<u8>, Error> {
        let mut running = self.start_data_read(id, block, 0)?;
        let ticket = running.pending.ticket();
        let (mut data, mut buffer) = (Vec::new(), [0; BUFFER_MAX]);
        loop {
            let ended = running.wait(PUMP_INTERVAL);
            let count = self.connection.with_axes(|axes, _| axes.poll_bytes(ticket, &mut buffer));
            if let Some(count) = count {
                data.extend_from_slice(&buffer[..count]);
            }
            progress(data.len());
            match ended? {
                // The announced and the received length have to agree.
                Some(count) if usize::try_from(count).is_ok_and(|count| count == data.len()) => {
                    return Ok(data);
                }
                Some(_) => {
                    let outcome = Outcome::NotDone(Failure::Misbehaved);
                    return Err(self.outcome_error(&running.what, RequestKind::Query, outcome));
                }
                None if data.len() > DATA_MAX => {
                    let what = format!("{}: more than {DATA_MAX} bytes came", running.what);
                    return Err(Error::usage("E213", what, "the value does not end"));
                }
                None => {}
            }
        }
    }

    /// Begins to read a parameter of any length. It is aborted after more than `max` bytes; 0 for no limit.
    fn start_data_read(
        &self,
        id: ParameterId,
        block: bool,
        max: u16,
    ) -> Result<RunningRequest, Error> {
        let what = format!("reading `{}`", self.required_parameter(id)?.name);
        let submitted = self.connection.submit_in_turn(Instant::FAR_FUTURE, |axes, now, ticket| {
            axes.read_data(now, ticket, self.index, id, block, max)
        });
        self.running(what, RequestKind::Query, submitted)
    }

    /// Reads a short text; `None` if it does not end after `max` bytes or within the time.
    pub(super) fn read_short_text(
        &self,
        id: ParameterId,
        max: u16,
        within: Duration,
    ) -> Result<Option<String>, Error> {
        let mut running = self.start_data_read(id, false, max)?;
        let ticket = running.pending.ticket();
        let end = self.connection.now() + self.connection.scale_timeout(within);
        let (mut data, mut buffer) = (Vec::new(), [0; BUFFER_MAX]);
        loop {
            let ended = running.wait(PUMP_INTERVAL);
            let count = self.connection.with_axes(|axes, _| axes.poll_bytes(ticket, &mut buffer));
            if let Some(count) = count {
                data.extend_from_slice(&buffer[..count]);
            }
            match ended {
                Ok(Some(_)) => return Ok(Some(String::from_utf8_lossy(&data).into_owned())),
                Ok(None) if self.connection.now() < end => {}
                Ok(None) => return Ok(None),
                Err(Error::Failed { outcome, .. })
                    if outcome.failure() == Some(Failure::Misbehaved) =>
                {
                    return Ok(None);
                }
                Err(error) => return Err(error),
            }
        }
    }

    fn write_data_once(
        &self,
        id: ParameterId,
        data: &[u8],
        block: bool,
        progress: &mut dyn FnMut(usize),
    ) -> Result<(), Error> {
        let what = format!("setting `{}`", self.required_parameter(id)?.name);
        // The size of an SDO download has 32 bits (CiA 301).
        let size = u32::try_from(data.len()).map_err(|_| too_long_error())?;
        let submitted = self.connection.submit_in_turn(Instant::FAR_FUTURE, |axes, now, ticket| {
            axes.write_data(now, ticket, self.index, id, size, block)
        });
        let mut running = self.running(what, RequestKind::Command, submitted)?;
        let ticket = running.pending.ticket();
        let mut sent = 0;
        loop {
            let fed = self.connection.with_axes(|axes, _| axes.feed_bytes(ticket, &data[sent..]));
            if let Some(count) = fed {
                sent += count;
                progress(sent);
            }
            if running.wait(PUMP_INTERVAL)?.is_some() {
                return Ok(());
            }
        }
    }
}

fn too_long_error() -> Error {
    Error::usage("E216", "more bytes than a transfer has", "")
}

/// A value of a parameter, whatever its type.
#[derive(Clone, PartialEq, Debug)]
pub enum ParameterValue {
    /// A number, with its unit.
    Number(Value),
    /// Text.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
}

impl ParameterValue {
    /// The number, where it is one.
    #[must_use]
    pub const fn number(&self) -> Option<&Value> {
        match self {
            Self::Number(value) => Some(value),
            Self::Text(_) | Self::Bytes(_) => None,
        }
    }
}

impl fmt::Display for ParameterValue {
    /// Text with its control characters escaped. Bytes in hexadecimal, as many as there are.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => value.fmt(f),
            Self::Text(text) => EscapedText(text).fmt(f),
            Self::Bytes(bytes) => bytes.iter().enumerate().try_for_each(|(at, byte)| {
                let gap = if at == 0 { "" } else { " " };
                write!(f, "{gap}{byte:02X}")
            }),
        }
    }
}

impl LocalAxis {
    /// Reads a parameter of whatever type. What has no known type is a number where it has at most
    /// eight bytes, else bytes.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn read_any(&self, id: ParameterId) -> Result<ParameterValue, Error> {
        let encoding = self.required_parameter(id)?.encoding;
        if encoding.is_number() {
            match self.read(id) {
                // It has more bytes than a number.
                Err(Error::Failed { outcome, .. })
                    if encoding == Encoding::AnyLength
                        && matches!(outcome.failure(), Some(Failure::NotReady { .. })) => {}
                read => return Ok(ParameterValue::Number(self.value(id, read?)?)),
            }
        }
        let data = self.read_data(id, false, &mut |_| {})?;
        Ok(match encoding {
            Encoding::Text => ParameterValue::Text(String::from_utf8_lossy(&data).into_owned()),
            _ => ParameterValue::Bytes(data),
        })
    }
}
