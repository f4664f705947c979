//! What comes with a request, and what is wrong with it in words.

use axum::body::Bytes;
use axum::extract::{FromRequest, Request};
use axum::http::StatusCode;
use serde::de::DeserializeOwned;

use crate::message::Refused;

/// A body in JSON.
pub(crate) struct Input<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Input<T> {
    type Rejection = Refused;

    async fn from_request(request: Request, _: &S) -> Result<Self, Refused> {
        serde_json::from_slice(&body(request).await?)
            .map(Self)
            .map_err(|error| Refused::new("gateway.request", format!("the body: {error}")))
    }
}

/// A body as it is, whole.
pub(super) async fn body(request: Request) -> Result<Bytes, Refused> {
    Bytes::from_request(request, &()).await.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Refused::new("gateway.size", "more than this takes"),
        _ => Refused::new("gateway.request", "the body broke off"),
    })
}

/// A number in a path.
pub(crate) fn number(text: &str) -> Result<u16, Refused> {
    let wrong = || Refused::new("gateway.missing", format!("{text:?} is no number of anything"));
    text.parse().map_err(|_| wrong())
}
