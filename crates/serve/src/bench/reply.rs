//! An answer that may still be on its way: to be awaited, waited for, or looked for.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::sync::oneshot::Receiver;
use tokio::sync::oneshot::error::TryRecvError;

use crate::message::Refused;

/// What comes of something that was asked. Dropped, it goes on by itself.
#[derive(Debug)]
#[must_use = "it goes on by itself, but nobody hears what came of it"]
pub struct Reply<T>(Told<T>);

#[derive(Debug)]
enum Told<T> {
    Ready(Option<Result<T, Refused>>),
    Later(Receiver<Result<T, Refused>>),
}

impl<T> Reply<T> {
    /// One that is known already.
    pub(super) fn ready(answer: Result<T, Refused>) -> Self {
        Self(Told::Ready(Some(answer)))
    }

    /// One that comes later, if it could be asked for.
    pub(super) fn of(told: Receiver<Result<T, Refused>>, asked: Result<(), Refused>) -> Self {
        match asked {
            Ok(()) => Self(Told::Later(told)),
            Err(refused) => Self::ready(Err(refused)),
        }
    }

    /// Waits for it. Not to be called in an asynchronous task.
    ///
    /// # Errors
    /// As it was refused.
    pub fn wait(self) -> Result<T, Refused> {
        match self.0 {
            Told::Ready(answer) => answer.unwrap_or_else(|| Err(closed())),
            Told::Later(told) => told.blocking_recv().unwrap_or_else(|_| Err(closed())),
        }
    }

    /// Takes it if it is there.
    pub fn take(&mut self) -> Option<Result<T, Refused>> {
        match &mut self.0 {
            Told::Ready(answer) => answer.take(),
            Told::Later(told) => match told.try_recv() {
                Ok(answer) => Some(answer),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Closed) => Some(Err(closed())),
            },
        }
    }
}

impl<T: Unpin> Future for Reply<T> {
    type Output = Result<T, Refused>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        match &mut self.0 {
            Told::Ready(answer) => Poll::Ready(answer.take().unwrap_or_else(|| Err(closed()))),
            Told::Later(told) => {
                Pin::new(told).poll(context).map(|told| told.unwrap_or_else(|_| Err(closed())))
            }
        }
    }
}

fn closed() -> Refused {
    let refused = Refused::new("gateway.busy", "the server ended before it was answered");
    Refused { executed: None, ..refused.hint("see what the drive does before it is said again") }
}
