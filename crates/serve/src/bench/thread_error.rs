//! Threads that cannot be started.

use crate::message::GatewayError;

pub(super) fn thread_error(error: &std::io::Error) -> GatewayError {
    GatewayError::new("gateway.busy", format!("no thread can be started: {error}"))
}
