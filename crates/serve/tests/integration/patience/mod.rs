//! Waiting for a bench in virtual time.

use std::time::Duration;

use polepair_serve::bench::{Bench, PendingReply};
use polepair_serve::message::{CommandArguments, CommandRequest, GatewayError};

/// A step of it.
pub const MS: Duration = Duration::from_millis(1);

/// Waits for an answer.
pub fn heard<T>(bench: &Bench, mut reply: PendingReply<T>) -> Result<T, GatewayError> {
    for _ in 0..30_000 {
        if let Some(answer) = reply.try_recv() {
            return answer;
        }
        bench.advance_time(MS);
    }
    panic!("no answer within thirty seconds of virtual time");
}

/// Sends a new command with its own id.
pub fn order(
    bench: &Bench,
    id: u32,
    epoch: u64,
    verb: &str,
    velocity: Option<f64>,
) -> CommandRequest {
    CommandRequest {
        id: format!("id-{id}"),
        issued_ms: bench.now_ms(),
        ttl_ms: 500.0,
        epoch,
        verb: verb.into(),
        arguments: CommandArguments { velocity, ..CommandArguments::default() },
    }
}
