//! Replaces encryption in a program that was built without it.

use tokio::net::TcpStream;

use crate::address::Address;
use crate::server_stream::ServerStream;
use crate::{GatewayError, GatewayOptions};

/// Encryption that nothing can make.
#[derive(Clone)]
pub(crate) enum ClientTls {}

impl ClientTls {
    pub async fn encrypt(
        &self,
        _stream: TcpStream,
        _address: &Address,
    ) -> Result<Box<dyn ServerStream>, GatewayError> {
        match *self {}
    }
}

pub(crate) fn certificate_refusal(
    _error: &(dyn std::error::Error + 'static),
) -> Option<GatewayError> {
    None
}

/// Refuses a server with encryption.
///
/// # Errors
/// `E263`.
pub(crate) fn load_tls(_options: &GatewayOptions) -> Result<ClientTls, GatewayError> {
    Err(GatewayError::new("E263", "this program was built without encryption")
        .hint("a released program has it, and one that is built with the feature `tls`"))
}
