//! A WebSocket as two ends that share nothing: one hears what a viewer says, the other tells it what
//! there is.
//!
//! Split the usual way, both ends would take turns on one lock, and whoever reads a stop would wait
//! for the thread that writes telemetry, which stands back behind all others. So each end has a
//! WebSocket of its own on its half of the connection. What the one that hears would answer by itself
//! goes nowhere: the other end says it.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

use super::MESSAGE_MAX;

/// Bytes that are read at once.
const READ: usize = 8 * 1024;

/// Both ends of a connection.
pub(super) struct Ends {
    pub hears: WebSocketStream<Hears>,
    pub tells: WebSocketStream<Tells>,
}

/// Takes what arrives.
pub(super) struct Hears(Box<dyn AsyncRead + Send + Unpin>);

/// Sends what is told.
pub(super) struct Tells(Box<dyn AsyncWrite + Send + Unpin>);

/// The ends of a connection that was a request until now. Neither waits for the other, but encrypted,
/// where they share the cipher's state. None where it is plain and not what the server listens to: ends
/// that share anything may not be given to threads that stand back.
pub(super) async fn ends(upgraded: Upgraded, encrypts: bool) -> Option<Ends> {
    let config = WebSocketConfig::default()
        .read_buffer_size(READ)
        .max_message_size(Some(MESSAGE_MAX))
        .max_frame_size(Some(MESSAGE_MAX));
    let (hears, tells, came) = match upgraded.downcast::<TokioIo<TcpStream>>() {
        Ok(parts) => {
            // From here on by the threads that this runs on, whoever took the connection.
            let stream = parts.io.into_inner().into_std().and_then(TcpStream::from_std).ok()?;
            let (read, write) = stream.into_split();
            (Hears(Box::new(read)), Tells(Box::new(write)), parts.read_buf.to_vec())
        }
        Err(upgraded) if encrypts => {
            let (read, write) = tokio::io::split(TokioIo::new(upgraded));
            (Hears(Box::new(read)), Tells(Box::new(write)), Vec::new())
        }
        Err(_) => return None,
    };
    let hears = WebSocketStream::from_partially_read(hears, came, Role::Server, Some(config));
    let tells = WebSocketStream::from_raw_socket(tells, Role::Server, Some(config));
    Some(Ends { hears: hears.await, tells: tells.await })
}

impl AsyncRead for Hears {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_read(context, buffer)
    }
}

impl AsyncWrite for Hears {
    fn poll_write(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl AsyncRead for Tells {
    fn poll_read(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        _: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // The other end hears.
        Poll::Pending
    }
}

impl AsyncWrite for Tells {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.0).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(context)
    }
}
