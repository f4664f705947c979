//! A request that is being executed, on a wire of this program or by a gateway.

use std::task::Waker;
use std::time::Duration;

use super::Reply;
use crate::axis::RunningRequest;
use crate::error::Error;
#[cfg(feature = "remote")]
use crate::interface::remote::RemoteRequest;

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

    /// Waits for the end, at most for this time; `None` if the request continues.
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
