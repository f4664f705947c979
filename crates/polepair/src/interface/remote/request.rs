//! A request to a gateway that is being executed.

use std::task::Waker;
use std::time::Duration;

use polepair_client::message::ParameterReading as Reading;
use polepair_client::{GatewayError, PendingOperation};

use super::convert::parameter_reading;
use crate::error::Error;
use crate::interface::Reply;

/// Length of one of the waits of [`RemoteRequest::finish`].
const WAIT_SLICE: Duration = Duration::from_secs(60);

/// A request to a gateway. Dropped before its end, it continues.
#[derive(Debug)]
pub struct RemoteRequest(Operation);

#[derive(Debug)]
enum Operation {
    Command(PendingOperation),
    Number(PendingOperation<i64>),
    Read(PendingOperation<Reading>),
}

impl RemoteRequest {
    pub(super) const fn command(pending: PendingOperation) -> Self {
        Self(Operation::Command(pending))
    }

    pub(super) const fn number(pending: PendingOperation<i64>) -> Self {
        Self(Operation::Number(pending))
    }

    pub(super) const fn read(pending: PendingOperation<Reading>) -> Self {
        Self(Operation::Read(pending))
    }

    /// Waits for the end. The client ends each request when the gateway is gone.
    pub(crate) fn finish(&mut self) -> Result<Reply, Error> {
        loop {
            if let Some(reply) = self.wait(WAIT_SLICE)? {
                return Ok(reply);
            }
        }
    }

    /// Waits for the end, at most for this time.
    pub(crate) fn wait(&mut self, at_most: Duration) -> Result<Option<Reply>, Error> {
        self.wait_reply(at_most).map_err(Error::from)
    }

    fn wait_reply(&mut self, at_most: Duration) -> Result<Option<Reply>, GatewayError> {
        Ok(match &mut self.0 {
            Operation::Command(pending) => pending.wait(at_most)?.map(|()| Reply::Raw(0)),
            Operation::Number(pending) => pending.wait(at_most)?.map(Reply::Raw),
            Operation::Read(pending) => {
                pending.wait(at_most)?.map(|read| Reply::Reading(parameter_reading(read)))
            }
        })
    }

    /// True if it has ended; else `waker` is woken when it ends.
    pub(crate) fn poll_or_wake(&mut self, waker: &Waker) -> bool {
        match &mut self.0 {
            Operation::Command(pending) => pending.poll_finished(waker),
            Operation::Number(pending) => pending.poll_finished(waker),
            Operation::Read(pending) => pending.poll_finished(waker),
        }
    }
}
