//! The description of the REST interface, in OpenAPI's form.

use utoipa::OpenApi;

use super::{axis, bench, capture, entry, look, motion, record};
use crate::message::{ClientMessage, ServerMessage};

/// What is described.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "Polepair gateway",
        description = "Drives behind one door. Every request needs a token (`Authorization: Bearer`, \
            or the page's cookie); what is no GET also needs `Content-Type: application/json` (a \
            capture: `application/octet-stream`) and `X-Polepair: 1`. `GET /api/v1/live` is a \
            WebSocket (sub-protocol `polepair.v1`); its texts are `ClientMessage` and `ServerMessage`."
    ),
    paths(
        bench::show,
        bench::act,
        bench::pace,
        look::show,
        look::begin,
        look::break_off,
        look::take_in,
        axis::show,
        axis::signals,
        axis::parameters,
        axis::parameter,
        axis::write,
        axis::watchdog,
        axis::set_watchdog,
        motion::take,
        motion::renew,
        motion::give_back,
        motion::command,
        motion::raw,
        motion::stop,
        motion::dismiss,
        motion::dismiss_absent,
        motion::release,
        capture::open,
        capture::page,
        capture::frame,
        record::journal,
        record::openapi,
        record::metrics,
        entry::login,
        entry::prove,
        crate::live::upgrade
    ),
    components(schemas(ClientMessage, ServerMessage))
)]
struct Description;

/// The description, as it is committed and served.
#[must_use]
pub fn description() -> String {
    // Made of what this program holds, it can always be written down.
    Description::openapi().to_pretty_json().unwrap_or_default() + "\n"
}
