//! The page that was compiled into this program, if any.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse as _, Response};

include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Page of a program that was built without the page.
const LEFT_OUT: &str = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Polepair</title>\
<h1>The page was left out</h1><p>This polepair was built without its dashboard. The gateway works: \
REST and WebSocket are at <code>/api/v1</code>, described by <a href=\"/api/v1/openapi.json\">\
openapi.json</a>.</p><p>To have the page: <code>make web</code> where Node is, then build again.</p>";

/// Page for a browser without a login.
const TOKEN_REQUIRED: &str = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Polepair</title>\
<h1>This needs a token</h1><p>Open the URL that <code>polepair serve</code> printed when it started. \
It lets one browser in, once; start the server again for another one.</p>";

/// The file of that path; `None` where there is none.
pub(crate) fn file(path: &str) -> Option<Response> {
    let path = if path == "/" { "/index.html" } else { path };
    let found = FILES.iter().find(|(name, ..)| *name == path);
    if let Some((name, kind, bytes)) = found {
        // Files in `assets` have a hash in their name, so they never change.
        let keep =
            if name.starts_with("/assets/") { "private, max-age=31536000" } else { "no-cache" };
        let heads = [(header::CONTENT_TYPE, *kind), (header::CACHE_CONTROL, keep)];
        return Some((heads, *bytes).into_response());
    }
    (path == "/index.html").then(|| html(StatusCode::OK, LEFT_OUT))
}

/// Response for a browser instead of an error in JSON.
pub(crate) fn token_required_page(status: StatusCode) -> Response {
    html(status, TOKEN_REQUIRED)
}

fn html(status: StatusCode, text: &'static str) -> Response {
    let kind = HeaderValue::from_static("text/html; charset=utf-8");
    (status, [(header::CONTENT_TYPE, kind)], text).into_response()
}
