//! A connection to the server, encrypted or not.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;

use crate::Refused;
use crate::address::Address;
use crate::secret::Secret;

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
    pub tls: Option<TlsConnector>,
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
    /// `E314`, `E315` where nobody listens, `E321` where somebody else does.
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
        let encrypted = tls.connect(name, stream).await.map_err(|error| self.stranger(&error))?;
        Ok(Box::new(encrypted))
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
