//! The OpenAPI description of the REST interface.

use utoipa::openapi::path::{Operation, ParameterBuilder, ParameterIn};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{KnownFormat, ObjectBuilder, RefOr, Required, Schema, SchemaFormat, Type};
use utoipa::{Modify, OpenApi};

use super::{ApiRoute, ROUTES, axis, bench, capture, diagnostics, login, motion, scan, search};
use crate::access::AccessRule;
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
    components(schemas(ClientMessage, ServerMessage)),
    modifiers(&RouteTableDetails)
)]
struct ApiDoc;

/// Name of the scheme by which clients show who they are.
const TOKEN_SCHEME: &str = "token";

/// Adds what the route table and the guard ask of every request, so that no handler can forget it.
struct RouteTableDetails;

impl Modify for RouteTableDetails {
    fn modify(&self, description: &mut utoipa::openapi::OpenApi) {
        let bearer = HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some("A token of the file that `polepair serve` names as it starts."));
        let components = description.components.get_or_insert_default();
        components.add_security_scheme(TOKEN_SCHEME, SecurityScheme::Http(bearer.build()));
        for (path, item) in &mut description.paths.paths {
            let methods =
                [("GET", &mut item.get), ("POST", &mut item.post), ("DELETE", &mut item.delete)];
            for (method, operation) in methods {
                let of_route = |route: &&ApiRoute| route.path == path && route.method == method;
                if let (Some(operation), Some(route)) = (operation, ROUTES.iter().find(of_route)) {
                    complete(operation, route);
                }
            }
        }
    }
}

/// Adds who may call an operation, the header of changes, the form of a file, and words for its responses.
fn complete(operation: &mut Operation, route: &ApiRoute) {
    operation.security = Some(match route.access {
        AccessRule::Public => vec![SecurityRequirement::default()],
        AccessRule::AnyOf(scopes) => scopes
            .iter()
            .map(|scope| SecurityRequirement::new(TOKEN_SCHEME, [scope.as_str()]))
            .collect(),
    });
    if route.method != "GET" {
        let header = ParameterBuilder::new()
            .name("X-Polepair")
            .parameter_in(ParameterIn::Header)
            .required(Required::True)
            .description(Some("1, which no form and no page of another site can send"))
            .schema(Some(ObjectBuilder::new().schema_type(Type::String).default(Some("1".into()))));
        operation.parameters.get_or_insert_default().push(RefOr::T(header.build()));
    }
    if route.accepts_file
        && let Some(RefOr::T(body)) = &mut operation.request_body
    {
        let file = ObjectBuilder::new()
            .schema_type(Type::String)
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)))
            .build();
        for content in body.content.values_mut() {
            if let RefOr::T(content) = content {
                content.schema = Some(RefOr::T(Schema::Object(file.clone())));
            }
        }
    }
    for (status, response) in &mut operation.responses.responses {
        if let RefOr::T(response) = response
            && response.description.is_empty()
        {
            let words = if status == "default" { "Refused, with the reason" } else { "Done" };
            response.description = words.to_owned();
        }
    }
}

/// The description, as it is committed and served.
#[must_use]
pub fn openapi_json() -> String {
    ApiDoc::openapi().to_pretty_json().expect("a description of strings and numbers") + "\n"
}
