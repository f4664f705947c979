//! Parses request bodies and arguments, with errors as texts.

use axum::body::Bytes;
use axum::extract::{FromRequest, Request};
use axum::http::StatusCode;
use serde::de::DeserializeOwned;

use crate::message::GatewayError;

/// A body in JSON.
pub(crate) struct JsonBody<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for JsonBody<T> {
    type Rejection = GatewayError;

    async fn from_request(request: Request, _: &S) -> Result<Self, GatewayError> {
        parse_json(&read_body(request).await?).map(Self)
    }
}

/// Parses a body in JSON.
pub(super) fn parse_json<T: DeserializeOwned>(body: &[u8]) -> Result<T, GatewayError> {
    serde_json::from_slice(body)
        .map_err(|error| GatewayError::new("gateway.request", format!("the body: {error}")))
}

/// A body as it is, whole.
pub(super) async fn read_body(request: Request) -> Result<Bytes, GatewayError> {
    Bytes::from_request(request, &()).await.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => GatewayError::new("gateway.size", "the body is too large"),
        _ => GatewayError::new("gateway.request", "the body is incomplete"),
    })
}

/// A number in a path.
pub(crate) fn parse_index(text: &str) -> Result<u16, GatewayError> {
    text.parse().map_err(|_| number_error(text))
}

fn number_error(text: &str) -> GatewayError {
    GatewayError::new("gateway.missing", format!("{text:?} is not a number"))
}
