//! A capture that is still being written: pieces as they come, without waiting for the end.

use std::io::Read;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

/// Pieces read ahead of their use.
const AHEAD_MAX: usize = 16;
const PIECE: usize = 1 << 16;

/// What came.
#[derive(Debug)]
pub enum Next {
    /// Some bytes.
    Piece(Vec<u8>),
    /// Nothing for the time allowed; more may come.
    Pause,
    /// No more will come, and why if that is an error.
    End(Option<std::io::Error>),
}

/// Reads a source on a thread of its own, which ends with the source.
#[derive(Debug)]
pub struct Follow {
    pieces: Receiver<std::io::Result<Vec<u8>>>,
}

impl Follow {
    /// Begins to read.
    pub fn new(mut source: impl Read + Send + 'static) -> Self {
        let (sender, pieces) = sync_channel(AHEAD_MAX);
        std::thread::spawn(move || {
            let mut buffer = vec![0; PIECE];
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
        Self { pieces }
    }

    /// Waits for the next piece, for ever if `patience` is `None`.
    pub fn next(&self, patience: Option<Duration>) -> Next {
        let next = match patience {
            Some(patience) => self.pieces.recv_timeout(patience),
            None => self.pieces.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match next {
            Ok(Ok(piece)) => Next::Piece(piece),
            Ok(Err(error)) => Next::End(Some(error)),
            Err(RecvTimeoutError::Timeout) => Next::Pause,
            Err(RecvTimeoutError::Disconnected) => Next::End(None),
        }
    }
}
