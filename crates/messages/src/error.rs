//! The error of the gateway.

use std::borrow::Cow;
use std::fmt;

use polepair_core::error::{Exception, Exit};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Why something was not done, for people and for programs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GatewayError {
    /// Stable: the library's (`E401`) or the gateway's own (`gateway.lease`). The page on exit codes
    /// explains all of them.
    #[schema(value_type = String)]
    pub code: Cow<'static, str>,
    /// Description of the error, in a sentence.
    pub message: String,
    /// Remedy to try; may be empty.
    #[serde(default)]
    pub hint: String,
    /// True if a drive executed it; `null` if unknown, or executed in part. The message does not repeat it.
    #[schema(required)]
    pub executed: Option<bool>,
    /// True if the motor was started, or was moving, and cannot be stopped. The message states it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub may_turn: bool,
    /// The server's time, where the time of a command is why it was refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub server_ms: Option<f64>,
}

/// Text for a command that may have been executed.
const IN_DOUBT: &str = "it may have been executed, or a part of it";

impl GatewayError {
    /// Something that the gateway itself does not let through: nothing was sent.
    pub fn new(code: &'static str, message: impl Into<String>) -> Self {
        Self {
            code: code.into(),
            message: message.into(),
            hint: String::new(),
            executed: Some(false),
            may_turn: false,
            server_ms: None,
        }
    }

    /// Adds what to try.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = hint.into();
        self
    }

    /// Description of the error, and whether the request was executed where that is in doubt: one sentence, without a
    /// full stop.
    #[must_use]
    pub fn sentence(&self) -> String {
        match self.executed {
            None => format!("{}; {IN_DOUBT}", self.message),
            Some(_) => self.message.clone(),
        }
    }

    /// The HTTP status that goes with its code.
    #[must_use]
    pub fn status(&self) -> u16 {
        match &*self.code {
            "gateway.request" => 400,
            "gateway.token" => 401,
            "gateway.scope" | "gateway.origin" => 403,
            "gateway.missing" | "E212" | "E205" | "E213" => 404,
            "gateway.method" => 405,
            "gateway.lease" | "gateway.expired" | "gateway.pending" | "gateway.simulated"
            | "gateway.look" => 409,
            "gateway.size" => 413,
            "gateway.host" => 421,
            // A file that is no capture: nothing behind the gateway failed.
            "E510" => 422,
            "gateway.locked" => 423,
            "gateway.limit" => 429,
            "gateway.busy" | "gateway.journal" => 503,
            code => match code.as_bytes() {
                [b'E', b'2', ..] => 422,
                [b'E', b'3', ..] => 503,
                [b'E', b'4', ..] => 504,
                [b'E', b'5', ..] => 502,
                [b'E', ..] => 409,
                _ => 500,
            },
        }
    }

    /// The exit code of its code: the first digit of a number.
    #[must_use]
    pub fn exit(&self) -> Exit {
        match self.code.as_bytes() {
            [b'E', b'1', ..] => Exit::Negative,
            [b'E', b'3', ..] => Exit::Adapter,
            [b'E', b'4', ..] => Exit::NoReply,
            [b'E', b'5', ..] => Exit::Corrupt,
            [b'E', b'6', ..] => Exit::Refused,
            [b'E', b'7', ..] => Exit::Partial,
            [b'E', b'8', ..] => Exit::DriveFault,
            [b'E', b'9', ..] => Exit::Unconfirmed,
            [b'E', ..] => Exit::Usage,
            _ => match self.status() {
                409 | 423 => Exit::Refused,
                429.. => Exit::Adapter,
                _ => Exit::Usage,
            },
        }
    }

    /// Exception that the bindings raise for it.
    #[must_use]
    pub fn exception(&self) -> Exception {
        match self.exit() {
            // Who may not is refused, though the words were right.
            Exit::Usage if matches!(self.status(), 401 | 403) => Exception::Refused,
            Exit::Usage => Exception::Unsupported,
            Exit::NoReply => Exception::NoReply,
            Exit::Corrupt => Exception::ProtocolError,
            Exit::Refused => Exception::Refused,
            Exit::DriveFault => Exception::DriveFault,
            _ => Exception::PolepairError,
        }
    }
}

impl fmt::Display for GatewayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.message, self.code)
    }
}

impl std::error::Error for GatewayError {}

#[cfg(feature = "server")]
impl axum::response::IntoResponse for GatewayError {
    fn into_response(self) -> axum::response::Response {
        use axum::http::StatusCode;
        let status = StatusCode::from_u16(self.status());
        let status = status.unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        (status, axum::Json(ErrorBody { error: self })).into_response()
    }
}

/// A [`GatewayError`] as the body of an answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ErrorBody {
    /// The error.
    pub error: GatewayError,
}
