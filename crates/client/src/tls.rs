//! Encryption: TLS 1.3, to the one certificate that is pinned. There is no way to trust any other, and
//! none to trust all.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::client::danger::{
    HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier,
};
use tokio_rustls::rustls::crypto::{CryptoProvider, ring, verify_tls13_signature};
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use tokio_rustls::rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, Error, SignatureScheme, version,
};

use crate::Refused;
use crate::secret::state_folder;

/// The certificate's file in a server's folder.
const CERTIFICATE: &str = "certificate.pem";

/// What encrypts, for a certificate: a PEM file, or its fingerprint (SHA-256, `AB:CD:…` as the server
/// prints it); without either, that of this account's own server.
///
/// # Errors
/// `E256` where there is none, `E301` to `E303` for its file.
pub(crate) fn connector(certificate: Option<&str>) -> Result<TlsConnector, Refused> {
    let pinned = match certificate {
        Some(text) => match digits(text) {
            Some(fingerprint) => fingerprint,
            None => of_file(Path::new(text))?,
        },
        None => of_file(&own().ok_or_else(none)?)?,
    };
    let provider = Arc::new(ring::default_provider());
    let verifier = Arc::new(Pinned { fingerprint: pinned, provider: Arc::clone(&provider) });
    let config = ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&version::TLS13])
        .map_err(|error| Refused::new("E318", format!("nothing can be encrypted: {error}")))?
        .dangerous()
        .with_custom_certificate_verifier(verifier)
        .with_no_client_auth();
    Ok(TlsConnector::from(Arc::new(config)))
}

fn own() -> Option<PathBuf> {
    state_folder().map(|folder| folder.join(CERTIFICATE)).filter(|file| file.exists())
}

fn none() -> Refused {
    Refused::new("E256", "it is not known which certificate the server has").hint(
        "--certificate with its certificate.pem, or with the SHA-256 that `polepair serve` printed",
    )
}

fn of_file(path: &Path) -> Result<String, Refused> {
    let bytes = std::fs::read(path).map_err(|error| crate::secret::unreadable(path, &error))?;
    let wrong = |error| Refused::new("E256", format!("{}: {error}", path.display()));
    CertificateDer::from_pem_slice(&bytes).map(|it| fingerprint(&it)).map_err(wrong)
}

/// The 64 digits of a fingerprint; `None` for what is none.
fn digits(text: &str) -> Option<String> {
    let plain: String = text.chars().filter(|c| *c != ':').collect();
    let is = plain.len() == 64 && plain.bytes().all(|c| c.is_ascii_hexdigit());
    is.then(|| plain.to_ascii_uppercase())
}

fn fingerprint(certificate: &CertificateDer<'_>) -> String {
    let suite = ring::cipher_suite::TLS13_AES_128_GCM_SHA256.tls13();
    let hash = suite.map(|suite| suite.common.hash_provider.hash(certificate));
    let bytes = hash.iter().flat_map(|hash| hash.as_ref().iter());
    bytes.map(|byte| format!("{byte:02X}")).collect()
}

/// Takes one certificate and no other, whatever name it is for and whoever signed it.
#[derive(Debug)]
struct Pinned {
    fingerprint: String,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        if fingerprint(end_entity) == self.fingerprint {
            return Ok(ServerCertVerified::assertion());
        }
        Err(Error::InvalidCertificate(CertificateError::ApplicationVerificationFailure))
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _cert: &CertificateDer<'_>,
        _dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Err(Error::General("TLS 1.3 alone".to_owned()))
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, cert, dss, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fingerprint_is_told_from_a_file() {
        let printed = ["ab"; 32].join(":");
        assert_eq!(digits(&printed), Some("AB".repeat(32)));
        assert_eq!(digits("certificate.pem"), None);
        assert_eq!(connector(Some("/nowhere/it.pem")).err().unwrap().code, "E301");
    }
}
