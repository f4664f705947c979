//! Encryption, and access by a certificate.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;

use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};

use super::authority::{authority, vouched_by};
use super::site::{Site, folder, options};

/// A certificate with its key, in PEM.
type Shown = (String, String);

/// A client that trusts this site's certificate, and shows one of its own.
fn client(site: &Site, shown: Option<Shown>) -> StreamOwned<ClientConnection, TcpStream> {
    let mut roots = RootCertStore::empty();
    let file = site.folder.join("certificate.pem");
    roots.add(CertificateDer::from_pem_file(file).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots);
    let config = match shown {
        None => config.with_no_client_auth(),
        Some((own, key)) => {
            let own = CertificateDer::from_pem_slice(own.as_bytes()).unwrap();
            let key = PrivateKeyDer::from_pem_slice(key.as_bytes()).unwrap();
            config.with_client_auth_cert(vec![own], key).unwrap()
        }
    };
    let name = ServerName::try_from("localhost").unwrap();
    StreamOwned::new(ClientConnection::new(Arc::new(config), name).unwrap(), site.connect())
}

/// First line of the response to a request with a token; empty without a response.
fn status_line(site: &Site, shown: Option<Shown>) -> String {
    let mut stream = client(site, shown);
    let request = format!(
        "GET /api/v1/bench HTTP/1.1\r\nHost: {}\r\n{}Connection: close\r\n\r\n",
        site.address,
        site.bearer("operator")
    );
    let mut answer = [0; 12];
    let result = stream.write_all(request.as_bytes()).and_then(|()| stream.read_exact(&mut answer));
    result.map(|()| String::from_utf8_lossy(&answer).into_owned()).unwrap_or_default()
}

#[test]
fn t16_only_the_newest_tls_and_the_certificate_that_was_shown() {
    let site = Site::with(polepair_serve::ServerOptions { tls: true, ..options(folder()) });
    let fingerprint = site.server.as_ref().unwrap().fingerprint().unwrap().to_owned();
    assert_eq!(fingerprint.len(), 95);
    let mut old = site.connect();
    old.write_all(&hello_1_2()).unwrap();
    let mut answer = Vec::new();
    old.read_to_end(&mut answer).unwrap();
    assert_eq!(answer[..1], [21], "an alert");
    assert_eq!(answer.last(), Some(&70), "protocol_version");
    let plain = site.get("/api/v1/bench", &site.bearer("operator"));
    assert_eq!(plain.status, 0, "nothing in the clear");
    assert_eq!(status_line(&site, None), "HTTP/1.1 200");
    site.end();
}

#[test]
fn t16_where_clients_show_certificates_a_token_alone_is_not_enough() {
    let folder = folder();
    std::fs::create_dir_all(&folder).unwrap();
    let (ours, others) = (folder.join("ours.pem"), folder.join("others.pem"));
    let (ours, others) = (authority(&ours), authority(&others));
    let clients = Some(folder.join("ours.pem"));
    let site = Site::with(polepair_serve::ServerOptions {
        tls: true,
        client_ca: clients,
        ..options(folder)
    });
    assert_eq!(status_line(&site, Some(vouched_by(&ours))), "HTTP/1.1 200");
    assert_eq!(status_line(&site, Some(vouched_by(&others))), "", "vouched for by somebody else");
    assert_eq!(status_line(&site, None), "", "by nobody");
    site.end();
}

/// The first message of a client that knows TLS 1.2 and nothing newer.
fn hello_1_2() -> Vec<u8> {
    let mut body = vec![3, 3];
    body.extend([7; 32]);
    body.extend([0, 0, 4, 0xC0, 0x2F, 0xC0, 0x2B, 1, 0]);
    let groups = [0, 10, 0, 4, 0, 2, 0, 23];
    let algorithms = [0, 13, 0, 6, 0, 4, 4, 3, 8, 4];
    body.extend(((groups.len() + algorithms.len()) as u16).to_be_bytes());
    body.extend(groups);
    body.extend(algorithms);
    let mut hello = vec![22, 3, 1];
    hello.extend((body.len() as u16 + 4).to_be_bytes());
    hello.extend([1, 0]);
    hello.extend((body.len() as u16).to_be_bytes());
    hello.extend(body);
    hello
}
