//! The lease of an axis, for its lifetime.

use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use polepair_messages::{
    AxisState, CommandArguments, CommandRequest, DEFAULT_TTL_MS, LeaseAction, RawRequest,
};
use tokio::sync::oneshot;
use tokio::sync::oneshot::error::TryRecvError;
use tokio::time::timeout;

use crate::failure::{action_error, outcome_result, server_lost};
use crate::live::{LiveConnection, LiveRequest};
use crate::{Gateway, GatewayError};

/// Message for a command whose end was not received.
const NO_OUTCOME: &str = "a command had no result";

/// The right to command an axis. It is renewed until it is released or dropped; its end stops the
/// motions that were started under it.
#[derive(Debug)]
pub struct Lease {
    live: LiveConnection,
    axis: u16,
    epoch: u64,
}

impl Lease {
    pub(crate) const fn new(live: LiveConnection, axis: u16, epoch: u64) -> Self {
        Self { live, axis, epoch }
    }

    /// The axis.
    #[must_use]
    pub const fn axis(&self) -> u16 {
        self.axis
    }

    /// The epoch that parameter writes must carry.
    #[must_use]
    pub const fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Checks that the lease is still valid.
    ///
    /// # Errors
    /// The reason if not: `gateway.lease`, or `E313` without a server.
    pub fn check(&self) -> Result<(), GatewayError> {
        self.live.cache().check(self.axis, self.epoch)
    }

    /// The connection by which it is renewed.
    #[must_use]
    pub const fn live(&self) -> &LiveConnection {
        &self.live
    }

    /// The last state of the axis from the server; `None` before the first.
    #[must_use]
    pub fn state(&self) -> Option<AxisState> {
        self.live.cache().state(self.axis)
    }

    /// Returns whether the last state of the axis was sent after this lease began. An older state does not show how the
    /// lease ended.
    #[must_use]
    pub fn has_current_state(&self) -> bool {
        self.live.cache().has_state_since(self.axis, self.epoch)
    }

    /// Sends a command, once, and returns without waiting for its result.
    ///
    /// # Errors
    /// `E313` without a server: nothing was sent.
    pub fn start(
        &self,
        verb: &str,
        arguments: CommandArguments,
    ) -> Result<PendingOperation, GatewayError> {
        let command_request = CommandRequest {
            id: new_command_id()?,
            issued_ms: self.live.cache().now_ms(),
            ttl_ms: DEFAULT_TTL_MS,
            epoch: self.epoch,
            verb: verb.to_owned(),
            arguments,
        };
        let (reply_sender, receiver) = oneshot::channel();
        self.live.send_request(LiveRequest::Command {
            axis: self.axis,
            request: command_request,
            reply: reply_sender,
        })?;
        Ok(PendingOperation::new(receiver, self.live.gateway().clone()))
    }

    /// Sends a command and waits for its result.
    ///
    /// # Errors
    /// The error of the drive or the gateway; `E101` without a result after `within`.
    pub fn run(
        &self,
        verb: &str,
        arguments: CommandArguments,
        within: Duration,
    ) -> Result<(), GatewayError> {
        self.start(verb, arguments)?.wait(within)?.ok_or_else(|| {
            let late = GatewayError::new("E101", format!("`{verb}` did not end in time"));
            GatewayError { executed: None, ..late }
        })
    }

    /// Sends a request in the protocol's own text, once, and gives the value that was answered.
    ///
    /// # Errors
    /// The error of the drive or the gateway; `gateway.scope` if the token does not allow it.
    pub fn raw(&self, text: &str) -> Result<i64, GatewayError> {
        let request = RawRequest {
            id: new_command_id()?,
            issued_ms: self.live.cache().now_ms(),
            ttl_ms: DEFAULT_TTL_MS,
            epoch: self.epoch,
            text: text.to_owned(),
        };
        let outcome = self.live.gateway().raw(self.axis, &request)?;
        let value = outcome.value.unwrap_or_default();
        outcome_result(outcome).map(|()| value)
    }

    /// Releases the lease, and waits for the server's confirmation.
    ///
    /// # Errors
    /// When it was no longer valid, or without a server.
    pub fn release(&self) -> Result<(), GatewayError> {
        self.live.request_lease(self.axis, LeaseAction::Drop, self.epoch).map(drop)
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        // The server stops an axis whose lease ends.
        self.live.release_lease(self.axis, self.epoch);
    }
}

/// Something under way: a command, or what [`Gateway::spawn`] was given. Dropped before its end, it goes
/// on by itself.
#[derive(Debug)]
pub struct PendingOperation<T = ()> {
    receiver: oneshot::Receiver<Result<T, GatewayError>>,
    result: Option<Result<T, GatewayError>>,
    gateway: Gateway,
}

impl<T> PendingOperation<T> {
    pub(crate) const fn new(
        receiver: oneshot::Receiver<Result<T, GatewayError>>,
        gateway: Gateway,
    ) -> Self {
        Self { receiver, result: None, gateway }
    }

    /// True when it has ended; else `waker` is woken once it has.
    pub fn poll_finished(&mut self, waker: &Waker) -> bool {
        let waker = self.gateway.detached_waker(waker);
        self.result.is_some() || self.poll(&mut Context::from_waker(&waker)).is_ready()
    }

    fn poll(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let polled = Pin::new(&mut self.receiver).poll(context);
        polled.map(|result| {
            self.result =
                Some(result.unwrap_or_else(|_| Err(action_error(server_lost(NO_OUTCOME)))));
        })
    }
}

impl<T: Clone> PendingOperation<T> {
    /// Waits for the end, at most for this time; `None` if it continues.
    ///
    /// # Errors
    /// The reason of the failure; [`GatewayError::executed`] is `None` if the execution is unknown.
    pub fn wait(&mut self, within: Duration) -> Result<Option<T>, GatewayError> {
        if self.result.is_none() && within.is_zero() {
            // A waker that is registered for the end is still woken.
            self.result = match self.receiver.try_recv() {
                Ok(result) => Some(result),
                Err(TryRecvError::Empty) => return Ok(None),
                Err(TryRecvError::Closed) => Some(Err(action_error(server_lost(NO_OUTCOME)))),
            };
        }
        if self.result.is_none() {
            let gateway = self.gateway.clone();
            // Both the wait and its deadline are made where the runtime is.
            let waited = async { timeout(within, poll_fn(|context| self.poll(context))).await };
            if gateway.block_on(waited).is_err() {
                return Ok(None);
            }
        }
        self.result.clone().transpose()
    }
}

impl LiveConnection {
    /// Acquires the lease of an axis, if it is free.
    ///
    /// # Errors
    /// `gateway.lease` names the session that holds it.
    pub fn acquire_lease(&self, axis: u16) -> Result<Lease, GatewayError> {
        let epoch = self.request_lease(axis, LeaseAction::Take, 0)?;
        Ok(Lease::new(self.clone(), axis, epoch))
    }
}

/// A new UUID, version 4.
fn new_command_id() -> Result<String, GatewayError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| {
        GatewayError::new("E318", format!("there are no random numbers: {error}"))
    })?;
    // Version 4, variant 2 (RFC 9562, 5.4): the server accepts no other form.
    let bits = u128::from_be_bytes(bytes) & !(0xF << 76) & !(0x3 << 62) | 0x4 << 76 | 0x2 << 62;
    let text = format!("{bits:032x}");
    let [a, b, c, d, e] = [0..8, 8..12, 12..16, 16..20, 20..32].map(|part| &text[part]);
    Ok(format!("{a}-{b}-{c}-{d}-{e}"))
}

#[cfg(test)]
mod tests {
    #[test]
    fn ids_are_uuids_and_never_the_same() {
        let (one, two) = (super::new_command_id().unwrap(), super::new_command_id().unwrap());
        assert_ne!(one, two);
        let parts: Vec<_> = one.split('-').map(str::len).collect();
        assert_eq!(parts, [8, 4, 4, 4, 12]);
        assert!(&one[14..15] == "4" && "89ab".contains(&one[19..20]), "{one}");
    }
}
