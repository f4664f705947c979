//! REST requests, each with one reply.

use std::sync::Mutex;
use std::time::Duration;

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::Bytes;
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST};
use hyper::{Method, Request};
use hyper_util::rt::TokioIo;
use polepair_link::clock;
use polepair_messages::ErrorBody;
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::time::timeout;

use crate::GatewayError;
use crate::dialer::{Dialer, connection_error};
use crate::failure::{action_error, invalid_response, query_error, server_lost};

/// Time limit of a reply: a request may need many reads of a drive.
const ANSWER_MAX: Duration = Duration::from_secs(30);
/// Time limit of a list: no drive is read for it.
const LIST_MAX: Duration = Duration::from_secs(5);
/// Time limit of the reply to a stop: the server replies within 10 s.
const STOP_MAX: Duration = Duration::from_secs(12);
/// Bytes of an answer.
const BODY_MAX: usize = 16 << 20;
/// A connection that was quiet for longer may be about to be closed, and is not used again.
const QUIET_MAX: Duration = Duration::from_secs(2);

type HttpSender = SendRequest<Full<Bytes>>;

/// Asks by REST.
#[derive(Debug)]
pub(crate) struct RestClient {
    dialer: Dialer,
    /// The last connection, for the next request.
    idle_sender: Mutex<Option<(HttpSender, polepair_core::time::Instant)>>,
}

impl RestClient {
    pub fn new(dialer: Dialer) -> Self {
        Self { dialer, idle_sender: Mutex::new(None) }
    }

    /// Reads something.
    pub async fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, GatewayError> {
        self.request(Method::GET, path, Bytes::new(), ANSWER_MAX).await
    }

    /// Reads a list that the server has without asking drives.
    pub async fn list<T: DeserializeOwned>(&self, path: &str) -> Result<T, GatewayError> {
        self.request(Method::GET, path, Bytes::new(), clock::scale_timeout(LIST_MAX)).await
    }

    /// Sends a request that changes something. It is sent once, whatever its result.
    pub async fn post<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, GatewayError> {
        self.request(Method::POST, path, to_json(body)?, ANSWER_MAX).await
    }

    /// [`post`](Self::post) with a short time limit, for a stop.
    pub async fn stop<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, GatewayError> {
        self.request(Method::POST, path, to_json(body)?, STOP_MAX).await
    }

    /// Ends something.
    pub async fn delete<T: DeserializeOwned>(&self, path: &str) -> Result<T, GatewayError> {
        self.request(Method::DELETE, path, Bytes::from_static(b"{}"), ANSWER_MAX).await
    }

    async fn request<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &str,
        body: Bytes,
        within: Duration,
    ) -> Result<T, GatewayError> {
        let changes = method != Method::GET;
        let result = timeout(within, self.send(method, path, body)).await;
        let answer = result.unwrap_or_else(|_| Err(late_error(within)));
        let answer =
            answer.map_err(
                |refused| if changes { action_error(refused) } else { query_error(refused) },
            )?;
        serde_json::from_slice(&answer).map_err(|error| invalid_response(&error.to_string()))
    }

    async fn send(&self, method: Method, path: &str, body: Bytes) -> Result<Bytes, GatewayError> {
        let mut sender = self.open_sender().await?;
        let request = Request::builder()
            .method(method)
            .uri(path)
            .header(HOST, self.dialer.address.authority())
            .header(AUTHORIZATION, self.dialer.secret.bearer())
            .header(CONTENT_TYPE, "application/json")
            .header("x-polepair", "1")
            .body(Full::new(body))
            .map_err(|error| {
                GatewayError::new("E256", format!("{path} cannot be asked: {error}"))
            })?;
        let answer =
            sender.send_request(request).await.map_err(|error| connection_error(&error))?;
        let good = answer.status().is_success();
        let body = Limited::new(answer.into_body(), BODY_MAX).collect().await;
        let body = body.map_err(|error| server_lost(&error.to_string()))?.to_bytes();
        if good {
            // After an error the connection may hold the rest of a reply.
            self.store_sender(sender);
            return Ok(body);
        }
        let result = serde_json::from_slice::<ErrorBody>(&body);
        Err(result.map_or_else(|error| invalid_response(&error.to_string()), |body| body.error))
    }

    async fn open_sender(&self) -> Result<HttpSender, GatewayError> {
        let stored = self.idle_sender.lock().ok().and_then(|mut stored| stored.take());
        let fresh =
            // The server closes idle connections, and a request on a closing one is lost without a trace.
            stored.filter(|(_, at)| clock::now().since(*at) < clock::scale_timeout(QUIET_MAX));
        if let Some((mut sender, _)) = fresh
            && sender.ready().await.is_ok()
        {
            return Ok(sender);
        }
        let stream = self.dialer.dial().await?;
        let shaken = handshake(TokioIo::new(stream)).await;
        let (sender, connection) = shaken.map_err(|error| connection_error(&error))?;
        // The reason of the end goes to the callers of requests.
        tokio::spawn(async move { connection.await.ok() });
        Ok(sender)
    }

    fn store_sender(&self, sender: HttpSender) {
        if let Ok(mut stored) = self.idle_sender.lock() {
            *stored = Some((sender, clock::now()));
        }
    }
}

fn late_error(within: Duration) -> GatewayError {
    server_lost(&format!("it did not answer within {} s", within.as_secs()))
}

fn to_json(body: &impl Serialize) -> Result<Bytes, GatewayError> {
    serde_json::to_vec(body).map(Bytes::from).map_err(|error| invalid_response(&error.to_string()))
}
