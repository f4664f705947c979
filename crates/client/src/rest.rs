//! Requests: one question, one answer.

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

use crate::Refused;
use crate::wire::{Wire, broken};

/// How long an answer may take: a drive may have to be asked many things.
const ANSWER_MAX: Duration = Duration::from_secs(30);
/// How long the list of what there is may take: no drive is asked for it.
const LIST_MAX: Duration = Duration::from_secs(5);
/// How long a stop's answer may take: the server's comes within 10 s.
const STOP_MAX: Duration = Duration::from_secs(12);
/// Bytes of an answer.
const BODY_MAX: usize = 16 << 20;
/// A connection that was quiet for longer may be about to be closed, and is not used again.
const QUIET_MAX: Duration = Duration::from_secs(2);

type Sender = SendRequest<Full<Bytes>>;

/// Asks by REST.
#[derive(Debug)]
pub(crate) struct Rest {
    wire: Wire,
    /// What was asked through last, for the next question.
    kept: Mutex<Option<(Sender, polepair_core::time::Instant)>>,
}

impl Rest {
    pub fn new(wire: Wire) -> Self {
        Self { wire, kept: Mutex::new(None) }
    }

    /// Reads something.
    pub async fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, Refused> {
        self.ask(Method::GET, path, Bytes::new(), ANSWER_MAX).await
    }

    /// Reads what the server knows by itself.
    pub async fn list<T: DeserializeOwned>(&self, path: &str) -> Result<T, Refused> {
        self.ask(Method::GET, path, Bytes::new(), LIST_MAX).await
    }

    /// Has something done. It is sent once, whatever becomes of it.
    pub async fn post<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, Refused> {
        self.ask(Method::POST, path, bytes_of(body)?, ANSWER_MAX).await
    }

    /// The same of a stop: whoever says it learns soon that nothing is known of it.
    pub async fn stop<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, Refused> {
        self.ask(Method::POST, path, bytes_of(body)?, STOP_MAX).await
    }

    /// Ends something.
    pub async fn delete<T: DeserializeOwned>(&self, path: &str) -> Result<T, Refused> {
        self.ask(Method::DELETE, path, Bytes::from_static(b"{}"), ANSWER_MAX).await
    }

    async fn ask<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &str,
        body: Bytes,
        within: Duration,
    ) -> Result<T, Refused> {
        let changes = method != Method::GET;
        let asked = timeout(within, self.answer(method, path, body)).await;
        let late = || lost(&format!("it did not answer within {} s", within.as_secs()));
        let answer = asked.unwrap_or_else(|_| Err(late()));
        let answer = answer.map_err(|refused| match changes {
            true => deed(refused),
            false => question(refused),
        })?;
        serde_json::from_slice(&answer).map_err(|error| nonsense(&error.to_string()))
    }

    async fn answer(&self, method: Method, path: &str, body: Bytes) -> Result<Bytes, Refused> {
        let mut sender = self.sender().await?;
        let request = Request::builder()
            .method(method)
            .uri(path)
            .header(HOST, self.wire.address.authority())
            .header(AUTHORIZATION, self.wire.secret.bearer())
            .header(CONTENT_TYPE, "application/json")
            .header("x-polepair", "1")
            .body(Full::new(body))
            .map_err(|error| Refused::new("E256", format!("{path} cannot be asked: {error}")))?;
        let answer = sender.send_request(request).await.map_err(|error| broken(&error))?;
        let good = answer.status().is_success();
        let body = Limited::new(answer.into_body(), BODY_MAX).collect().await;
        let body = body.map_err(|error| lost(&error.to_string()))?.to_bytes();
        if good {
            self.keep(sender);
            return Ok(body);
        }
        let told = serde_json::from_slice::<ErrorBody>(&body);
        Err(told.map_or_else(|error| nonsense(&error.to_string()), |body| body.error))
    }

    async fn sender(&self) -> Result<Sender, Refused> {
        let kept = self.kept.lock().ok().and_then(|mut kept| kept.take());
        let fresh = kept.filter(|(_, at)| clock::now().since(*at) < QUIET_MAX);
        if let Some((mut sender, _)) = fresh
            && sender.ready().await.is_ok()
        {
            return Ok(sender);
        }
        let stream = self.wire.dial().await?;
        let shaken = handshake(TokioIo::new(stream)).await;
        let (sender, connection) = shaken.map_err(|error| broken(&error))?;
        // What ends it is told to whoever asks through it.
        tokio::spawn(async move { connection.await.ok() });
        Ok(sender)
    }

    fn keep(&self, sender: Sender) {
        if let Ok(mut kept) = self.kept.lock() {
            *kept = Some((sender, clock::now()));
        }
    }
}

fn bytes_of(body: &impl Serialize) -> Result<Bytes, Refused> {
    serde_json::to_vec(body).map(Bytes::from).map_err(|error| nonsense(&error.to_string()))
}

/// The server went away: what it was asked to do it may have done.
pub(crate) fn lost(why: &str) -> Refused {
    Refused { executed: None, ..Refused::new("E313", format!("the server went away: {why}")) }
}

/// The same for who had something done: what moves is stopped by nobody until the server is back.
pub(crate) fn deed(refused: Refused) -> Refused {
    match refused.code == "E313" && refused.executed.is_none() && refused.hint.is_empty() {
        true => refused.hint(
            "what moved may still turn: cut its supply, or stop it directly on its own link, \
             `polepair stop URL`",
        ),
        false => refused,
    }
}

/// The same for who only asked: a question moves nothing.
pub(crate) fn question(refused: Refused) -> Refused {
    Refused { executed: Some(false), ..refused }
}

/// What answers does not speak as a gateway does.
pub(crate) fn nonsense(why: &str) -> Refused {
    Refused {
        executed: None,
        ..Refused::new("E501", format!("that is no gateway's answer: {why}"))
    }
    .hint("is that polepair serve, of this version?")
}
