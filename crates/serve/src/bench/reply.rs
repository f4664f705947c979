//! A reply that may still be pending: awaited, waited for, or polled.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::sync::oneshot::error::TryRecvError;
use tokio::sync::oneshot::{self, Receiver};

use crate::message::GatewayError;

/// Continuation that gets the permission or its refusal. It must not wait.
pub(super) type Continuation = Box<dyn FnOnce(Result<(), GatewayError>) + Send>;

/// Sender of the result of a request.
pub(super) type ReplySender<T> = oneshot::Sender<Result<T, GatewayError>>;

/// Result of a request, available later. Dropping it does not end the request.
#[derive(Debug)]
#[must_use = "the operation continues, but its result is lost"]
pub struct PendingReply<T>(ReplyState<T>);

#[derive(Debug)]
enum ReplyState<T> {
    Ready(Option<Result<T, GatewayError>>),
    Waiting(Receiver<Result<T, GatewayError>>),
}

impl<T> PendingReply<T> {
    /// One that is known already.
    pub(super) fn ready(answer: Result<T, GatewayError>) -> Self {
        Self(ReplyState::Ready(Some(answer)))
    }

    /// One that comes later, if it could be asked for.
    pub(super) fn from_receiver(
        reply: Receiver<Result<T, GatewayError>>,
        result: Result<(), GatewayError>,
    ) -> Self {
        match result {
            Ok(()) => Self(ReplyState::Waiting(reply)),
            Err(refused) => Self::ready(Err(refused)),
        }
    }

    /// Waits for it. Not to be called in an asynchronous task.
    ///
    /// # Errors
    /// As it was refused.
    pub fn wait(self) -> Result<T, GatewayError> {
        match self.0 {
            ReplyState::Ready(answer) => answer.unwrap_or_else(|| Err(closed_error())),
            ReplyState::Waiting(reply) => {
                reply.blocking_recv().unwrap_or_else(|_| Err(closed_error()))
            }
        }
    }

    /// Takes it if it is there.
    pub fn try_recv(&mut self) -> Option<Result<T, GatewayError>> {
        match &mut self.0 {
            ReplyState::Ready(answer) => answer.take(),
            ReplyState::Waiting(reply) => match reply.try_recv() {
                Ok(answer) => Some(answer),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Closed) => Some(Err(closed_error())),
            },
        }
    }
}

impl<T: Unpin> Future for PendingReply<T> {
    type Output = Result<T, GatewayError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        match &mut self.0 {
            ReplyState::Ready(answer) => {
                Poll::Ready(answer.take().unwrap_or_else(|| Err(closed_error())))
            }
            ReplyState::Waiting(reply) => Pin::new(reply)
                .poll(context)
                .map(|result| result.unwrap_or_else(|_| Err(closed_error()))),
        }
    }
}

fn closed_error() -> GatewayError {
    let refused = GatewayError::new("gateway.busy", "the server ended before it was answered");
    GatewayError {
        executed: None,
        ..refused.hint("check the state of the drive before you repeat it")
    }
}
