//! Errors of a server that is lost, refuses, or sends no reply of ours.

use polepair_messages::{CommandOutcome, OutcomeKind};

use crate::GatewayError;
use crate::address::Address;

/// Error for an address without a server.
pub(crate) fn unreachable_error(address: &Address, why: &str) -> GatewayError {
    GatewayError::new("E315", format!("{} cannot be reached: {why}", address.authority()))
}

/// The server went away: the request may have been executed.
pub(crate) fn server_lost(why: &str) -> GatewayError {
    GatewayError {
        executed: None,
        ..GatewayError::new("E313", format!("the server went away: {why}"))
    }
}

/// Error of an action: motors are not stopped until the server is back.
pub(crate) fn action_error(refused: GatewayError) -> GatewayError {
    if refused.code == "E313" && refused.executed.is_none() && refused.hint.is_empty() {
        refused.hint(
            "moving motors may still turn: cut their supply, or stop them directly with `polepair \
             stop URL`",
        )
    } else {
        refused
    }
}

/// Error of a read, which moves nothing.
pub(crate) fn query_error(refused: GatewayError) -> GatewayError {
    GatewayError { executed: Some(false), ..refused }
}

/// Error for a reply that no gateway sends.
pub(crate) fn invalid_response(why: &str) -> GatewayError {
    GatewayError {
        executed: None,
        ..GatewayError::new("E501", format!("that is not a reply of a polepair server: {why}"))
    }
    .hint("check that it is `polepair serve` of this version")
}

/// The result of a command.
pub(crate) fn outcome_result(outcome: CommandOutcome) -> Result<(), GatewayError> {
    match (outcome.outcome, outcome.error) {
        (_, Some(error)) => Err(error),
        (OutcomeKind::Done, None) => Ok(()),
        (OutcomeKind::NotDone, None) => Err(GatewayError::new("E601", "it was not executed")),
        (OutcomeKind::Unknown, None) => Err(GatewayError {
            executed: None,
            ..GatewayError::new("E401", "it may have been executed")
        }),
    }
}
