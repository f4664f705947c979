//! Captures that somebody has as a file: taken in, and shown page by page.

use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::QueryRejection;
use axum::extract::{FromRequest as _, Path, Query, Request, State};
use axum::http::StatusCode;
use serde::Deserialize;
use tokio::task::spawn_blocking;

use super::{Answer, Shared};
use crate::message::{CaptureOpened, CapturePage, ErrorBody, Refused};

/// Frames of a page where nobody says.
const COUNT: usize = 500;

/// What the file is called.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Named {
    name: String,
}

/// Which frames.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Which {
    from: Option<u64>,
    count: Option<usize>,
    filter: Option<String>,
}

/// Open a capture
///
/// The body is the file, of any format that `polepair decode` reads, up to 64 MiB
/// (`Content-Type: application/octet-stream`). The server keeps the last four.
#[utoipa::path(post, path = "/api/v1/captures", tag = "capture", params(("name" = String, Query)),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"), responses(
    (status = 200, body = CaptureOpened),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn open(
    State(gate): State<Shared>,
    named: Result<Query<Named>, QueryRejection>,
    request: Request,
) -> Answer<CaptureOpened> {
    let Query(Named { name }) = named.map_err(|error| unclear(&error))?;
    // Before it is read: it may be long.
    let busy = |_| Refused::new("gateway.busy", "others open captures").hint("try again soon");
    let place = gate.uploads.try_acquire().map_err(busy)?;
    let read = Bytes::from_request(request, &gate).await;
    let bytes = read.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Refused::new("gateway.size", "more than this takes")
            .hint("`polepair summary` takes a capture of any length"),
        _ => Refused::new("gateway.request", "the file broke off"),
    })?;
    let bench = gate.bench.clone();
    let opened = spawn_blocking(move || bench.open_capture(&name, bytes.into())).await;
    drop(place);
    opened.map_err(|error| Refused::new("gateway.busy", error.to_string()))?.map(Json)
}

/// Some frames of a capture
///
/// Those from that number on which a filter of the analyser's language wants, at most 1,000.
#[utoipa::path(get, path = "/api/v1/captures/{id}", tag = "capture",
    params(("id" = String, Path), ("from" = Option<u64>, Query), ("count" = Option<usize>, Query),
        ("filter" = Option<String>, Query)), responses(
    (status = 200, body = CapturePage),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn page(
    State(gate): State<Shared>,
    Path(id): Path<String>,
    which: Result<Query<Which>, QueryRejection>,
) -> Answer<CapturePage> {
    let Query(Which { from, count, filter }) = which.map_err(|error| unclear(&error))?;
    let (from, count, bench) = (from.unwrap_or(0), count.unwrap_or(COUNT), gate.bench.clone());
    let read = spawn_blocking(move || bench.capture_page(&id, from, count, filter.as_deref()));
    read.await.map_err(|error| Refused::new("gateway.busy", error.to_string()))?.map(Json)
}

fn unclear(error: &QueryRejection) -> Refused {
    Refused::new("gateway.request", error.body_text())
}
