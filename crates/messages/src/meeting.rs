//! How server and client find and know each other.

use rustls::crypto::ring::cipher_suite::TLS13_AES_128_GCM_SHA256;

/// Where a server listens unless told otherwise.
pub const PORT: u16 = 7365;
/// The WebSocket's sub-protocol.
pub const PROTOCOL: &str = "polepair.v1";

/// SHA-256 of a certificate in DER, as a server prints it, browsers show it and clients compare it:
/// `AB:CD:…`.
#[must_use]
pub fn fingerprint(certificate: &[u8]) -> String {
    let suite = TLS13_AES_128_GCM_SHA256.tls13();
    let hash = suite.map(|suite| suite.common.hash_provider.hash(certificate));
    let bytes = hash.iter().flat_map(|hash| hash.as_ref().iter());
    bytes.map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(":")
}
