//! A connection to the server, encrypted or not.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::rustls;
use tokio_rustls::rustls::AlertDescription as Alert;
use tokio_rustls::rustls::pki_types::ServerName;

use crate::Refused;
use crate::address::Address;
use crate::rest::lost;
use crate::secret::Secret;
use crate::tls::Tls;

/// How long connecting may take.
const CONNECT_MAX: Duration = Duration::from_secs(5);

/// Either end of what bytes go through.
pub(crate) trait Stream: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Stream for T {}

/// Where the server is, and what lets us in.
#[derive(Clone)]
pub(crate) struct Wire {
    pub address: Arc<Address>,
    pub secret: Secret,
    pub tls: Option<Tls>,
}

impl std::fmt::Debug for Wire {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wire").field("address", &self.address).finish_non_exhaustive()
    }
}

impl Wire {
    /// Connects.
    ///
    /// # Errors
    /// `E314`, `E315` where nobody listens, `E321` where somebody else does, `E256` where a certificate
    /// of ours is wanted and there is none.
    pub async fn dial(&self) -> Result<Box<dyn Stream>, Refused> {
        let late = || self.unreachable("no answer within 5 s");
        timeout(CONNECT_MAX, self.connect()).await.map_err(|_| late())?
    }

    async fn connect(&self) -> Result<Box<dyn Stream>, Refused> {
        let Address { host, port, .. } = &*self.address;
        let stream = TcpStream::connect((host.as_str(), *port)).await;
        let stream = stream.map_err(|error| match error.kind() {
            std::io::ErrorKind::ConnectionRefused => self.nobody(),
            _ => self.unreachable(&error.to_string()),
        })?;
        // A socket that cannot be told so is slower, no worse.
        let _ = stream.set_nodelay(true);
        let Some(tls) = &self.tls else { return Ok(Box::new(stream)) };
        let name = ServerName::try_from(host.clone())
            .map_err(|error| self.unreachable(&error.to_string()))?;
        let (connector, unmet) = tls.connector();
        let encrypted = connector.connect(name, stream).await;
        let encrypted = encrypted.map_err(|error| self.stranger(&error))?;
        match unmet.noted() {
            true => Err(unvouched("it wants a certificate of its clients")),
            false => Ok(Box::new(encrypted)),
        }
    }

    fn nobody(&self) -> Refused {
        Refused::new("E314", format!("no server listens on {}", self.address.authority()))
            .hint("start one: polepair serve URL; it prints where it listens")
    }

    fn unreachable(&self, why: &str) -> Refused {
        Refused::new("E315", format!("{} cannot be reached: {why}", self.address.authority()))
    }

    fn stranger(&self, error: &std::io::Error) -> Refused {
        let what = format!("{} is not the server that is meant: {error}", self.address.authority());
        Refused::new("E321", what)
            .hint("compare its certificate's SHA-256, which `polepair serve --tls` prints")
    }
}

/// What broke a connection: that the server takes no certificate of ours, else that it went away.
pub(crate) fn broken(error: &(dyn std::error::Error + 'static)) -> Refused {
    let mut cause = Some(error);
    while let Some(error) = cause {
        let inner = error.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref);
        if let Some(rustls::Error::AlertReceived(
            Alert::CertificateRequired
            | Alert::UnknownCA
            | Alert::BadCertificate
            | Alert::CertificateUnknown
            | Alert::CertificateExpired
            | Alert::DecryptError,
        )) = inner.and_then(|inner| inner.downcast_ref())
        {
            return unvouched(&error.to_string());
        }
        cause = error.source();
    }
    lost(&error.to_string())
}

/// Nothing that was said has got as far as the server.
fn unvouched(why: &str) -> Refused {
    Refused::new("E256", format!("the server does not let this client in: {why}"))
        .hint("--client-cert with one that its --client-ca signed, and the key in the same file")
}
