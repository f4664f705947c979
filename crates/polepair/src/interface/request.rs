//! A request that is being executed, on a wire of this program or by a gateway.

use std::task::Waker;
use std::time::Duration;

use super::ReadValue;
use super::reading::not_a_number;
use crate::amount::Amount;
use crate::axis::RunningRequest;
use crate::error::Error;
#[cfg(feature = "remote")]
use crate::remote::RemoteRequest;

/// A value to be written.
#[derive(Clone, PartialEq, Debug)]
pub enum WriteValue {
    /// A number in the parameter's unit, text with a unit, or a word.
    Amount(Amount),
    /// The drive's own number.
    Raw(i64),
}

/// The reply to a request.
#[derive(Clone, PartialEq, Debug)]
pub enum Reply {
    /// The last raw value that was read; 0 for a request without a value.
    Raw(i64),
    /// A parameter as a gateway read it.
    Reading(ReadValue),
}

impl Reply {
    /// The raw value of the reply; `name` is for the error.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` if the parameter holds text or bytes.
    pub fn raw(&self, name: &str) -> Result<i64, Error> {
        match self {
            Self::Raw(raw) => Ok(*raw),
            Self::Reading(reading) => reading.raw.ok_or_else(|| not_a_number(name)),
        }
    }
}

/// A request that is being executed. Dropped before its end, it continues.
#[derive(Debug)]
#[must_use = "wait for it, or drop it to continue in the background"]
pub struct AxisRequest(RequestBackend);

#[derive(Debug)]
enum RequestBackend {
    Local(RunningRequest),
    #[cfg(feature = "remote")]
    Remote(RemoteRequest),
}

impl From<RunningRequest> for AxisRequest {
    fn from(request: RunningRequest) -> Self {
        Self(RequestBackend::Local(request))
    }
}

#[cfg(feature = "remote")]
impl From<RemoteRequest> for AxisRequest {
    fn from(request: RemoteRequest) -> Self {
        Self(RequestBackend::Remote(request))
    }
}

impl AxisRequest {
    /// Waits for the end.
    ///
    /// # Errors
    /// [`Error`] by source; [`Error::Interrupted`] after an interruption, and the request continues.
    pub fn finish(&mut self) -> Result<Reply, Error> {
        match &mut self.0 {
            RequestBackend::Local(request) => request.finish().map(Reply::Raw),
            #[cfg(feature = "remote")]
            RequestBackend::Remote(request) => request.finish(),
        }
    }

    /// Waits for the end, at most so long; `None` if the request continues.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn wait(&mut self, at_most: Duration) -> Result<Option<Reply>, Error> {
        match &mut self.0 {
            RequestBackend::Local(request) => Ok(request.wait(at_most)?.map(Reply::Raw)),
            #[cfg(feature = "remote")]
            RequestBackend::Remote(request) => request.wait(at_most),
        }
    }

    /// True if it has ended; else `waker` is woken when it ends.
    pub fn poll_or_wake(&mut self, waker: &Waker) -> bool {
        match &mut self.0 {
            RequestBackend::Local(request) => request.poll_or_wake(waker),
            #[cfg(feature = "remote")]
            RequestBackend::Remote(request) => request.poll_or_wake(waker),
        }
    }
}
