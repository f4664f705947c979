//! The OpenAPI description of the REST interface.

use utoipa::OpenApi;

use super::{axis, bench, capture, diagnostics, login, motion, scan, search};
use crate::message::{ClientMessage, ServerMessage};

/// Description of the interface.
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
        bench::apply_action,
        bench::set_time_scale,
        search::show,
        search::start,
        search::cancel,
        scan::show,
        scan::start,
        scan::cancel,
        scan::add_drives,
        axis::show,
        axis::signals,
        axis::parameters,
        axis::parameter,
        axis::device,
        axis::paths,
        axis::plan_paths,
        axis::program,
        axis::program_state,
        axis::write,
        axis::watchdog,
        axis::set_watchdog,
        motion::acquire_lease,
        motion::renew_lease,
        motion::release_lease,
        motion::command,
        motion::record_in_drive,
        motion::raw,
        motion::stop,
        motion::dismiss,
        motion::dismiss_absent,
        motion::release,
        capture::open,
        capture::page,
        capture::frame,
        diagnostics::journal,
        diagnostics::openapi,
        diagnostics::metrics,
        login::login,
        login::prove,
        crate::live::upgrade
    ),
    components(schemas(ClientMessage, ServerMessage))
)]
struct ApiDoc;

/// The description, as it is committed and served.
#[must_use]
pub fn openapi_json() -> String {
    ApiDoc::openapi().to_pretty_json().expect("a description of strings and numbers") + "\n"
}
