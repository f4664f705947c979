//! The bytes to and from a server.

use tokio::io::{AsyncRead, AsyncWrite};

/// Stream of bytes to and from the server, encrypted or not.
pub(crate) trait ServerStream: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> ServerStream for T {}
