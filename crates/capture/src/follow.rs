//! Reads a capture that is still being written, without waiting for its end.

use std::io::Read;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

/// Pieces read ahead of their use.
const AHEAD_MAX: usize = 16;
const CHUNK_BYTES: usize = 1 << 16;

/// Event of a followed capture.
#[derive(Debug)]
pub enum FollowEvent {
    /// Some bytes.
    Piece(Vec<u8>),
    /// Nothing for the time allowed; more may come.
    Timeout,
    /// No more will come, and why if that is an error.
    End(Option<std::io::Error>),
}

/// Reads a source on a thread of its own, which ends with the source.
#[derive(Debug)]
pub struct FollowReader {
    receiver: Receiver<std::io::Result<Vec<u8>>>,
}

impl FollowReader {
    /// Begins to read.
    pub fn new(mut source: impl Read + Send + 'static) -> Self {
        let (sender, receiver) = sync_channel(AHEAD_MAX);
        std::thread::spawn(move || {
            let mut buffer = vec![0; CHUNK_BYTES];
            loop {
                let piece = match source.read(&mut buffer) {
                    Ok(0) => return,
                    Ok(count) => Ok(buffer[..count].to_vec()),
                    Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                    Err(error) => Err(error),
                };
                let failed = piece.is_err();
                if sender.send(piece).is_err() || failed {
                    return;
                }
            }
        });
        Self { receiver }
    }

    /// Waits for the next piece, for ever if `patience` is `None`.
    pub fn next_event(&self, patience: Option<Duration>) -> FollowEvent {
        let next = match patience {
            Some(patience) => self.receiver.recv_timeout(patience),
            None => self.receiver.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match next {
            Ok(Ok(piece)) => FollowEvent::Piece(piece),
            Ok(Err(error)) => FollowEvent::End(Some(error)),
            Err(RecvTimeoutError::Timeout) => FollowEvent::Timeout,
            Err(RecvTimeoutError::Disconnected) => FollowEvent::End(None),
        }
    }
}
