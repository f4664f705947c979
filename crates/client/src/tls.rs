//! Encryption: TLS 1.3 with one pinned certificate. No other certificate can be trusted.
//!
//! Why: CLIENT-3.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use polepair_messages::certificate_fingerprint;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::AlertDescription as Alert;
use tokio_rustls::rustls::client::ResolvesClientCert;
use tokio_rustls::rustls::client::danger::{
    HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier,
};
use tokio_rustls::rustls::crypto::{CryptoProvider, ring, verify_tls13_signature};
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use tokio_rustls::rustls::sign::CertifiedKey;
use tokio_rustls::rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, Error, SignatureScheme, version,
};

use crate::address::Address;
use crate::failure::unreachable_error;
use crate::secret::{open_private, state_folder, unreadable};
use crate::server_stream::ServerStream;
use crate::{GatewayError, GatewayOptions};

/// The certificate's file in a server's folder.
const CERTIFICATE: &str = "certificate.pem";
/// Certificates of a file.
const CHAIN_MAX: usize = 8;
/// Bytes of a file of certificates or of a key.
const FILE_MAX: u64 = 256 * 1024;

/// TLS settings of a client.
#[derive(Clone)]
pub(crate) struct ClientTls {
    config: Arc<ClientConfig>,
    /// There is a certificate of ours to show.
    has_client_cert: bool,
}

impl ClientTls {
    /// Encrypts a connection to the server at `address`.
    ///
    /// # Errors
    /// `E321` where it has another certificate, `E256` where it wants one of ours, `E315` for an invalid name.
    pub async fn encrypt(
        &self,
        stream: TcpStream,
        address: &Address,
    ) -> Result<Box<dyn ServerStream>, GatewayError> {
        let name = ServerName::try_from(address.host.clone())
            .map_err(|error| unreachable_error(address, &error.to_string()))?;
        let (connector, unmet) = self.connector();
        let encrypted = connector.connect(name, stream).await;
        let encrypted = encrypted.map_err(|error| wrong_server_error(address, &error))?;
        if unmet.was_requested() {
            Err(certificate_error("it wants a certificate of its clients"))
        } else {
            Ok(Box::new(encrypted))
        }
    }

    /// The encryption of one connection, and a flag whether the server requested a missing client
    /// certificate.
    fn connector(&self) -> (TlsConnector, Arc<MissingClientCert>) {
        let unmet = Arc::<MissingClientCert>::default();
        let mut config = Arc::clone(&self.config);
        if !self.has_client_cert {
            Arc::make_mut(&mut config).client_auth_cert_resolver = Arc::clone(&unmet) as _;
        }
        (TlsConnector::from(config), unmet)
    }
}

fn wrong_server_error(address: &Address, error: &std::io::Error) -> GatewayError {
    let what = format!("{} is not the expected server: {error}", address.authority());
    GatewayError::new("E321", what)
        .hint("compare its certificate's SHA-256, which `polepair serve --tls` prints")
}

/// Error for a server that refuses our certificate, if that is why a connection broke.
pub(crate) fn certificate_refusal(
    error: &(dyn std::error::Error + 'static),
) -> Option<GatewayError> {
    let mut cause = Some(error);
    while let Some(error) = cause {
        let inner = error.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref);
        if let Some(Error::AlertReceived(
            Alert::CertificateRequired
            | Alert::UnknownCA
            | Alert::BadCertificate
            | Alert::CertificateUnknown
            | Alert::CertificateExpired
            | Alert::DecryptError,
        )) = inner.and_then(|inner| inner.downcast_ref())
        {
            return Some(certificate_error(&error.to_string()));
        }
        cause = error.source();
    }
    None
}

/// No request has reached the server.
fn certificate_error(why: &str) -> GatewayError {
    GatewayError::new("E256", format!("the server does not let this client in: {why}"))
        .hint("--client-cert with one that its --client-ca signed, and the key in the same file")
}

/// Notes that a certificate was asked for where there is none.
#[derive(Debug, Default)]
pub(crate) struct MissingClientCert(AtomicBool);

impl MissingClientCert {
    /// Returns whether a certificate was requested.
    pub fn was_requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl ResolvesClientCert for MissingClientCert {
    fn resolve(&self, _: &[&[u8]], _: &[SignatureScheme]) -> Option<Arc<CertifiedKey>> {
        self.0.store(true, Ordering::Relaxed);
        None
    }

    fn has_certs(&self) -> bool {
        false
    }
}

/// TLS settings for the server's certificate: a PEM file, or its fingerprint (SHA-256, `AB:CD:…` as the server prints
/// it); without either, the certificate of this account's own server. Presents our own certificate if there is one.
///
/// # Errors
/// `E256` where there is none, or one and its key do not belong together; `E301` to `E305` for files.
pub(crate) fn load_tls(options: &GatewayOptions) -> Result<ClientTls, GatewayError> {
    let pinned = match options.certificate.as_deref() {
        Some(text) => match parse_fingerprint(text) {
            Some(fingerprint) => fingerprint,
            None => file_fingerprint(Path::new(text))?,
        },
        None => file_fingerprint(&own_certificate_path().ok_or_else(no_certificate_error)?)?,
    };
    let provider = Arc::new(ring::default_provider());
    let verifier =
        Arc::new(PinnedVerifier { fingerprint: pinned, provider: Arc::clone(&provider) });
    let config = ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&version::TLS13])
        .map_err(|error| GatewayError::new("E318", format!("nothing can be encrypted: {error}")))?
        .dangerous()
        .with_custom_certificate_verifier(verifier);
    let config = match &options.client_cert {
        None => config.with_no_client_auth(),
        Some(path) => {
            let (chain, key) =
                read_client_cert(path, options.client_key.as_deref().unwrap_or(path))?;
            let shown = config.with_client_auth_cert(chain, key);
            shown.map_err(|error| {
                invalid_file(path, &error).hint("is that key the certificate's?")
            })?
        }
    };
    Ok(ClientTls { config: Arc::new(config), has_client_cert: options.client_cert.is_some() })
}

fn own_certificate_path() -> Option<PathBuf> {
    state_folder().map(|folder| folder.join(CERTIFICATE)).filter(|file| file.exists())
}

fn no_certificate_error() -> GatewayError {
    GatewayError::new("E256", "the certificate of the server is unknown").hint(
        "--certificate with its certificate.pem, or with the SHA-256 that `polepair serve` printed",
    )
}

fn file_fingerprint(path: &Path) -> Result<String, GatewayError> {
    let bytes = std::fs::read(path).map_err(|error| unreadable(path, &error))?;
    let found = CertificateDer::from_pem_slice(&bytes);
    found
        .map(|it| without_colons(&certificate_fingerprint(&it)))
        .map_err(|error| invalid_file(path, &error))
}

/// The client certificate with intermediate certificates, and its key, in PEM. The key's file must not be
/// readable by others.
fn read_client_cert(
    certificate: &Path,
    key: &Path,
) -> Result<(Vec<CertificateDer<'static>>, PrivateKeyDer<'static>), GatewayError> {
    let file = File::open(certificate).map_err(|error| unreadable(certificate, &error))?;
    let chain = CertificateDer::pem_slice_iter(&read(file, certificate)?)
        .take(CHAIN_MAX + 1)
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| invalid_file(certificate, &error))?;
    if chain.is_empty() || chain.len() > CHAIN_MAX {
        let what = format!("it holds {} certificates, not 1 to {CHAIN_MAX}", chain.len());
        return Err(invalid_file(certificate, &what));
    }
    let secret = PrivateKeyDer::from_pem_slice(&read(open_private(key)?, key)?);
    let secret =
        secret.map_err(|error| invalid_file(key, &error).hint("--client-key names its file"))?;
    Ok((chain, secret))
}

fn read(file: File, path: &Path) -> Result<Vec<u8>, GatewayError> {
    let mut bytes = Vec::new();
    let read = file.take(FILE_MAX).read_to_end(&mut bytes);
    read.map(|_| bytes).map_err(|error| unreadable(path, &error))
}

fn invalid_file(path: &Path, error: &dyn std::fmt::Display) -> GatewayError {
    GatewayError::new("E256", format!("{}: {error}", path.display()))
}

/// Parses the 64 digits of a fingerprint; `None` if it is not valid.
fn parse_fingerprint(text: &str) -> Option<String> {
    let plain = without_colons(text);
    let is = plain.len() == 64 && plain.bytes().all(|c| c.is_ascii_hexdigit());
    is.then(|| plain.to_ascii_uppercase())
}

fn without_colons(text: &str) -> String {
    text.chars().filter(|c| *c != ':').collect()
}

/// Accepts one certificate, whatever its name and issuer, and no other.
#[derive(Debug)]
struct PinnedVerifier {
    fingerprint: String,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for PinnedVerifier {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        // The exact certificate and not its name: a server of a test bench has no name that an authority would
        // sign.
        if without_colons(&certificate_fingerprint(end_entity)) == self.fingerprint {
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
    fn a_fingerprint_is_distinguished_from_a_file() {
        let printed = ["ab"; 32].join(":");
        assert_eq!(parse_fingerprint(&printed), Some("AB".repeat(32)));
        assert_eq!(parse_fingerprint("certificate.pem"), None);
        let certificate = Some("/nowhere/it.pem".to_owned());
        let options = GatewayOptions { certificate, ..GatewayOptions::default() };
        assert_eq!(load_tls(&options).err().unwrap().code, "E301");
    }
}
