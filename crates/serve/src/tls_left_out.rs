//! Replaces encryption in a program that was built without it.

use tokio::net::TcpStream;

use crate::error::SetupError;
use crate::options::ServerOptions;

/// Encryption that nothing can make.
#[derive(Clone, Debug)]
pub enum Acceptor {}

impl Acceptor {
    pub async fn accept(&self, _stream: TcpStream) -> Option<TcpStream> {
        match *self {}
    }
}

#[derive(Debug)]
pub struct ServerTls {
    pub acceptor: Acceptor,
    pub fingerprint: String,
}

/// Refuses to encrypt.
///
/// # Errors
/// `E263`.
pub fn load(_options: &ServerOptions) -> Result<ServerTls, SetupError> {
    Err(SetupError::usage("E263", "this program was built without encryption")
        .hint("a released program has it, and one that is built with the feature `tls`"))
}
