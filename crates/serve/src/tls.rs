//! Encryption: TLS 1.3 only, with the server's own certificate or that of the user.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::{CryptoProvider, ring};
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::server::danger::ClientCertVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig, version};
use tokio_rustls::server::TlsStream;

use crate::error::SetupError;
use crate::message::certificate_fingerprint;
use crate::options::{HostName, ServerOptions};
use crate::token::{require_private, write_private_file};

/// The certificate's file in the server's folder.
const CERTIFICATE: &str = "certificate.pem";
/// File name of the private key.
const KEY: &str = "key.pem";
/// Certificates of a file.
const CHAIN_MAX: usize = 8;

/// Encrypts a connection.
#[derive(Clone)]
pub struct Acceptor(TlsAcceptor);

impl Acceptor {
    /// The connection once it is encrypted; `None` where the client did not agree.
    pub async fn accept(&self, stream: TcpStream) -> Option<TlsStream<TcpStream>> {
        self.0.accept(stream).await.ok()
    }
}

/// TLS settings of a server, with the certificate's fingerprint for people.
pub struct ServerTls {
    /// Takes connections.
    pub acceptor: Acceptor,
    /// SHA-256 of the certificate, as browsers show it: `AB:CD:…`.
    pub fingerprint: String,
}

impl std::fmt::Debug for ServerTls {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tls").field("fingerprint", &self.fingerprint).finish_non_exhaustive()
    }
}

/// Takes `certificate.pem` and `key.pem` of the server's folder; makes them on the first run.
///
/// # Errors
/// They cannot be read, others may read the key, or they do not belong together.
pub fn load(options: &ServerOptions) -> Result<ServerTls, SetupError> {
    let (certificate, key) = (options.folder.join(CERTIFICATE), options.folder.join(KEY));
    if !certificate.exists() && !key.exists() {
        make(options, &certificate, &key)?;
    }
    let file = File::open(&key).map_err(|error| SetupError::file(&key, "read", &error))?;
    require_private(&key, &file)?;
    let chain = certificates(&certificate).map_err(with_renewal_hint)?;
    debug_assert!(!chain.is_empty(), "a file without a certificate is refused");
    let fingerprint = certificate_fingerprint(&chain[0]);
    let secret = PrivateKeyDer::from_pem_file(&key)
        .map_err(|error| with_renewal_hint(invalid_file(&key, &error)))?;
    let provider = Arc::new(ring::default_provider());
    let config = ServerConfig::builder_with_provider(Arc::clone(&provider))
        .with_protocol_versions(&[&version::TLS13])
        .map_err(|error| invalid_file(&certificate, &error))?;
    let config = match &options.client_ca {
        Some(path) => config.with_client_cert_verifier(client_cert_verifier(path, provider)?),
        None => config.with_no_client_auth(),
    };
    let config = config.with_single_cert(chain, secret);
    let config = config.map_err(|error| with_renewal_hint(invalid_file(&certificate, &error)))?;
    Ok(ServerTls { acceptor: Acceptor(TlsAcceptor::from(Arc::new(config))), fingerprint })
}

fn with_renewal_hint(refusal: SetupError) -> SetupError {
    refusal.hint("remove both files to get new ones")
}

/// Verifier of client certificates by the CA certificates of a file.
fn client_cert_verifier(
    path: &Path,
    provider: Arc<CryptoProvider>,
) -> Result<Arc<dyn ClientCertVerifier>, SetupError> {
    let mut roots = RootCertStore::empty();
    for certificate in certificates(path)? {
        roots.add(certificate).map_err(|error| invalid_file(path, &error))?;
    }
    WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider)
        .build()
        .map_err(|error| invalid_file(path, &error))
}

/// The certificates of a file, at least one.
fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, SetupError> {
    let all = CertificateDer::pem_file_iter(path)
        .and_then(|all| all.take(CHAIN_MAX + 1).collect::<Result<Vec<_>, _>>())
        .map_err(|error| invalid_file(path, &error))?;
    match all.len() {
        0 => Err(invalid_file(path, &"it holds no certificate")),
        1..=CHAIN_MAX => Ok(all),
        _ => Err(invalid_file(path, &format!("it holds more than {CHAIN_MAX} certificates"))),
    }
}

fn invalid_file(path: &Path, error: &dyn std::fmt::Display) -> SetupError {
    SetupError::usage("E230", format!("{}: {error}", path.display()))
}

fn make(options: &ServerOptions, certificate: &Path, key: &Path) -> Result<(), SetupError> {
    let mut names = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
    let address = options.bind.ip();
    if !address.is_unspecified() && !address.is_loopback() {
        names.push(address.to_string());
    }
    let stated = options.host_names.iter().filter_map(|name| HostName::parse(name));
    names.extend(stated.map(|name| name.host.to_owned()));
    let made = rcgen::generate_simple_self_signed(names).map_err(|error| {
        SetupError::adapter("E318", "no certificate can be made").why(error.to_string())
    })?;
    write_private_file(key, made.signing_key.serialize_pem().as_bytes())?;
    polepair_files::write_atomic(certificate, made.cert.pem().as_bytes())
        .map_err(|error| SetupError::file(certificate, "write", &error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_certificate_is_made_once_and_kept_private() {
        let folder = std::env::temp_dir().join(format!("polepair-tls-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let options = ServerOptions::in_folder(folder.clone());
        let first = load(&options).unwrap();
        assert_eq!(first.fingerprint.len(), 32 * 3 - 1);
        assert_eq!(load(&options).unwrap().fingerprint, first.fingerprint);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let key = folder.join(KEY);
            assert_eq!(std::fs::metadata(&key).unwrap().permissions().mode() & 0o777, 0o600);
            std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o640)).unwrap();
            assert_eq!(load(&options).unwrap_err().code, "E305");
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
