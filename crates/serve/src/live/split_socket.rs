//! A WebSocket split into a reading and a writing end without shared state.
//!
//! With a normal split, both ends share one lock, and a stop would wait for the low-priority thread that
//! writes telemetry. Therefore each end has its own WebSocket on its half of the connection. Automatic
//! replies of the reading end are sent by the writing end.
//!
//! Why: GW-20.

use polepair_core::convert::saturating;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

use super::MESSAGE_MAX;

/// Bytes that are read at once.
const READ: usize = 8 * 1024;
/// Limit of frames of one message. More close the connection: no other limit counts them, and an empty frame costs its
/// sender next to nothing.
const FRAMES_MAX: u32 = 128;

/// Both ends of a connection.
pub(super) struct SplitSocket {
    pub reader: WebSocketStream<SocketReader>,
    pub writer: WebSocketStream<SocketWriter>,
}

/// Takes what arrives.
pub(super) struct SocketReader {
    from: Box<dyn AsyncRead + Send + Unpin>,
    frame_counter: FrameCounter,
}

impl SocketReader {
    fn new(from: impl AsyncRead + Send + Unpin + 'static) -> Self {
        Self { from: Box::new(from), frame_counter: FrameCounter::default() }
    }
}

/// Counts the frames of a message.
#[derive(Default)]
struct FrameCounter {
    head: [u8; 14],
    /// Bytes of the head so far.
    header_len: usize,
    /// Bytes behind it that are not its own.
    payload_left: usize,
    count: u32,
}

impl FrameCounter {
    /// Counts the frames of received bytes. False if a message has too many.
    fn count_frames(&mut self, mut bytes: &[u8]) -> bool {
        while let Some((byte, rest)) = bytes.split_first() {
            if self.payload_left > 0 {
                let count = self.payload_left.min(bytes.len());
                (self.payload_left, bytes) = (self.payload_left - count, &bytes[count..]);
                continue;
            }
            self.head[self.header_len] = *byte;
            (self.header_len, bytes) = (self.header_len + 1, rest);
            let Some(length) = self.payload_len() else { continue };
            (self.header_len, self.payload_left) = (0, length);
            let (last, of_control) = (self.head[0] & 0x80 != 0, self.head[0] & 8 != 0);
            if last && !of_control {
                self.count = 0;
            } else if !of_control {
                self.count += 1;
            }
            if self.count >= FRAMES_MAX {
                return false;
            }
        }
        true
    }

    /// Length of the payload behind the head, once that is whole (RFC 6455, 5.2).
    fn payload_len(&self) -> Option<usize> {
        let (head, short) = (&self.head[..self.header_len], self.head.get(1)? & 0x7F);
        let wide = match short {
            126 => 2,
            127 => 8,
            _ => 0,
        };
        let mask = usize::from(self.head[1] >> 7) * 4;
        if head.len() < 2 || head.len() < 2 + wide + mask {
            return None;
        }
        let long = head[2..2 + wide].iter().fold(0, |long, byte| long << 8 | u64::from(*byte));
        let length = if wide == 0 { u64::from(short) } else { long };
        Some(saturating(length))
    }
}

/// Sender of messages.
pub(super) struct SocketWriter(Box<dyn AsyncWrite + Send + Unpin>);

/// The ends of a connection that was a request until now. Neither waits for the other, but encrypted,
/// where they share the cipher's state. None where it is plain and not what the server listens to: ends
/// that share anything may not be given to threads that stand back.
pub(super) async fn split(upgraded: Upgraded, encrypts: bool) -> Option<SplitSocket> {
    let config = WebSocketConfig::default()
        .read_buffer_size(READ)
        .max_message_size(Some(MESSAGE_MAX))
        .max_frame_size(Some(MESSAGE_MAX));
    let (mut socket_reader, socket_writer, came) = match upgraded.downcast::<TokioIo<TcpStream>>() {
        Ok(parts) => {
            // From here on the socket is polled by the threads of this runtime, not by those that accepted it.
            let stream = parts.io.into_inner().into_std().and_then(TcpStream::from_std).ok()?;
            let (read, write) = stream.into_split();
            (SocketReader::new(read), SocketWriter(Box::new(write)), parts.read_buf.to_vec())
        }
        Err(upgraded) if encrypts => {
            let (read, write) = tokio::io::split(TokioIo::new(upgraded));
            (SocketReader::new(read), SocketWriter(Box::new(write)), Vec::new())
        }
        Err(_) => return None,
    };
    if !socket_reader.frame_counter.count_frames(&came) {
        return None;
    }
    let reading =
        WebSocketStream::from_partially_read(socket_reader, came, Role::Server, Some(config));
    let writing = WebSocketStream::from_raw_socket(socket_writer, Role::Server, Some(config));
    Some(SplitSocket { reader: reading.await, writer: writing.await })
}

impl AsyncRead for SocketReader {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = ready!(Pin::new(&mut self.from).poll_read(context, buffer));
        let few = self.frame_counter.count_frames(&buffer.filled()[before..]);
        Poll::Ready(if few { read } else { Err(io::ErrorKind::InvalidData.into()) })
    }
}

impl AsyncWrite for SocketReader {
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

impl AsyncRead for SocketWriter {
    fn poll_read(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        _: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // The other end receives.
        Poll::Pending
    }
}

impl AsyncWrite for SocketWriter {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A masked frame of `length` bytes, none of which looks like a head's end.
    fn frame(first: u8, length: usize) -> Vec<u8> {
        let mut frame = vec![first];
        match length {
            0..126 => frame.push(0x80 | length as u8),
            126..0x1_0000 => frame.extend([0xFE, (length >> 8) as u8, length as u8]),
            _ => {
                frame.push(0xFF);
                frame.extend((length as u64).to_be_bytes());
            }
        }
        frame.extend([1, 2, 3, 4]);
        frame.extend(std::iter::repeat_n(0x01, length));
        frame
    }

    #[test]
    fn frames_of_a_message_are_counted_however_they_are_cut() {
        let max = FRAMES_MAX as usize - 1;
        let message = |pieces: usize| {
            let lengths = [0, 1, 125, 126, 300, 70_000].into_iter().cycle();
            let mut bytes: Vec<u8> = lengths.take(pieces).flat_map(|n| frame(0, n)).collect();
            // A ping between counts as a message, elsewhere.
            bytes.extend(frame(0x89, 5));
            bytes.extend(frame(0x80, 200));
            bytes
        };
        for cut in [1, 7, 1000, usize::MAX] {
            let all = |bytes: &[u8]| {
                let mut frames = FrameCounter::default();
                bytes.chunks(cut).all(|piece| frames.count_frames(piece))
            };
            assert!(all(&[message(max), message(max), message(0)].concat()), "{cut}");
            assert!(!all(&[message(3), message(max + 1)].concat()), "{cut}");
        }
    }
}
