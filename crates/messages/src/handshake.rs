//! Versions and identities that server and client exchange first.

use std::net::SocketAddr;

#[cfg(feature = "tls")]
use rustls::crypto::ring::cipher_suite::TLS13_AES_128_GCM_SHA256;

/// Bytes of a challenge, of a token, and of the reply to a challenge.
pub const PROOF_BYTES: usize = 32;

/// Default port of a server.
pub const PORT: u16 = 7365;
/// The WebSocket's sub-protocol.
pub const WEBSOCKET_PROTOCOL: &str = "polepair.v1";

/// SHA-256 of a certificate in DER, as a server prints it, browsers show it and clients compare it:
/// `AB:CD:…`.
#[cfg(feature = "tls")]
#[must_use]
pub fn certificate_fingerprint(certificate: &[u8]) -> String {
    let suite = TLS13_AES_128_GCM_SHA256.tls13();
    let hash = suite.map(|suite| suite.common.hash_provider.hash(certificate));
    let bytes = hash.iter().flat_map(|hash| hash.as_ref().iter());
    bytes.map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(":")
}

/// The reply of a server with a token to a challenge on a connection that ends at `address`: 64 hexadecimal
/// digits, BLAKE3 keyed with the token. It reveals nothing of the token. A program that forwards the
/// challenge gets a reply for the server's address, not for its own.
#[must_use]
pub fn token_proof(
    token: &[u8; PROOF_BYTES],
    challenge: &[u8; PROOF_BYTES],
    address: SocketAddr,
) -> String {
    let mut hash = blake3::Hasher::new_keyed(token);
    hash.update(b"polepair proof 1\n").update(challenge);
    let address = SocketAddr::new(address.ip().to_canonical(), address.port());
    hash.update(address.to_string().as_bytes());
    hash.finalize().to_hex().to_string()
}

/// Bytes of 64 hexadecimal digits, as tokens and challenges are written.
#[must_use]
pub fn parse_hex(text: &str) -> Option<[u8; PROOF_BYTES]> {
    let text = text.as_bytes();
    let mut bytes = [0; PROOF_BYTES];
    if text.len() != 2 * PROOF_BYTES {
        return None;
    }
    for (at, byte) in bytes.iter_mut().enumerate() {
        *byte = (hex_digit(2 * at, text)? << 4 | hex_digit(2 * at + 1, text)?) as u8;
    }
    Some(bytes)
}

fn hex_digit(at: usize, text: &[u8]) -> Option<u32> {
    char::from(text[at]).to_digit(16)
}
