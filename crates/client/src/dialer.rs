//! A connection to the server, encrypted or not.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::{BodyExt as _, Empty, Limited};
use hyper::Request;
use hyper::body::Bytes;
use hyper::client::conn::http1::handshake;
use hyper::header::HOST;
use hyper_util::rt::TokioIo;
use polepair_link::clock;
use polepair_messages::{PROOF_BYTES, Proof, token_proof};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::GatewayError;
use crate::address::Address;
use crate::failure::{server_lost, unreachable_error};
use crate::secret::{Secret, VARIABLE};
use crate::server_stream::ServerStream;
use crate::tls::{self, ClientTls};

/// Time limit of a connection attempt. An unreachable host would otherwise keep a command for minutes.
const CONNECT_MAX: Duration = Duration::from_secs(5);

/// Bytes of the answer by which a server proves to be our own.
const PROOF_MAX: usize = 4096;

/// The server's address and the credentials for it.
#[derive(Clone)]
pub(crate) struct Dialer {
    pub address: Arc<Address>,
    pub secret: Secret,
    pub tls: Option<ClientTls>,
}

impl std::fmt::Debug for Dialer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wire").field("address", &self.address).finish_non_exhaustive()
    }
}

impl Dialer {
    /// Connects.
    ///
    /// # Errors
    /// `E314`, `E315` if no server listens; `E321` if another server does; `E256` if the server demands a client
    /// certificate and none is set, or if it has none of our tokens and would be sent our own.
    pub async fn dial(&self) -> Result<Box<dyn ServerStream>, GatewayError> {
        let dialled = async {
            let (stream, there) = self.connect().await?;
            match self.secret.token_to_prove() {
                Some(token) => self.verify_server(stream, there, token).await,
                None => Ok(stream),
            }
        };
        timeout(clock::scale_timeout(CONNECT_MAX), dialled).await.map_err(|_| self.late_error())?
    }

    fn late_error(&self) -> GatewayError {
        self.unreachable("no answer within 5 s")
    }

    /// The connection, once the server at its other end has proved to have our token.
    async fn verify_server(
        &self,
        stream: Box<dyn ServerStream>,
        there: SocketAddr,
        token: &[u8; PROOF_BYTES],
    ) -> Result<Box<dyn ServerStream>, GatewayError> {
        // New for each connection: an answer that was overheard proves nothing later.
        let mut challenge = [0; PROOF_BYTES];
        getrandom::fill(&mut challenge).map_err(|error| {
            GatewayError::new("E318", format!("there is no randomness: {error}"))
        })?;
        let digits: String = challenge.iter().map(|byte| format!("{byte:02x}")).collect();
        let request = Request::get(format!("/api/v1/proof/{digits}"))
            .header(HOST, self.address.authority())
            .body(Empty::<Bytes>::new())
            .map_err(|error| GatewayError::new("E256", format!("nothing can be asked: {error}")))?;
        let shaken = handshake(TokioIo::new(stream)).await;
        let (mut sender, connection) = shaken.map_err(|error| unsent(connection_error(&error)))?;
        let after = tokio::spawn(connection.without_shutdown());
        let answer =
            sender.send_request(request).await.map_err(|error| unsent(connection_error(&error)))?;
        let body = Limited::new(answer.into_body(), PROOF_MAX).collect().await;
        let body = body.map_err(|error| unsent(server_lost(&error.to_string())))?.to_bytes();
        // The connection hands its stream back once its sender is gone; the session goes on in the same one.
        drop(sender);
        let result = serde_json::from_slice::<Proof>(&body).map(|report| report.proof);
        if !result.is_ok_and(|output| output == token_proof(token, &challenge, there)) {
            return Err(self.unproven());
        }
        match after.await {
            Ok(Ok(parts)) if parts.read_buf.is_empty() => Ok(parts.io.into_inner()),
            _ => Err(unsent(server_lost("it hung up"))),
        }
    }

    fn unproven(&self) -> GatewayError {
        let what = format!("{} is not this account's own server", self.address.authority());
        GatewayError::new("E256", what).hint(format!(
            "--token-file or {VARIABLE} with a token of that server: your own server's token is \
             sent only to a server that proves to have it"
        ))
    }

    async fn connect(&self) -> Result<(Box<dyn ServerStream>, SocketAddr), GatewayError> {
        let Address { host, port, .. } = &*self.address;
        let stream = TcpStream::connect((host.as_str(), *port)).await;
        let stream = stream.map_err(|error| match error.kind() {
            std::io::ErrorKind::ConnectionRefused => self.not_listening_error(),
            _ => self.unreachable(&error.to_string()),
        })?;
        // Without this option the socket is slower, no worse.
        let _ = stream.set_nodelay(true);
        let there = stream.peer_addr().map_err(|error| self.unreachable(&error.to_string()))?;
        match &self.tls {
            Some(tls) => Ok((tls.encrypt(stream, &self.address).await?, there)),
            None => Ok((Box::new(stream), there)),
        }
    }

    fn not_listening_error(&self) -> GatewayError {
        GatewayError::new("E314", format!("no server is listening on {}", self.address.authority()))
            .hint("start one: polepair serve URL; it prints its address")
    }

    fn unreachable(&self, why: &str) -> GatewayError {
        unreachable_error(&self.address, why)
    }
}

/// Nothing that may move something has been sent yet.
fn unsent(refused: GatewayError) -> GatewayError {
    GatewayError { executed: Some(false), ..refused }
}

/// Error of a broken connection: the server refused our certificate, or it went away.
pub(crate) fn connection_error(error: &(dyn std::error::Error + 'static)) -> GatewayError {
    tls::certificate_refusal(error).unwrap_or_else(|| server_lost(&error.to_string()))
}
