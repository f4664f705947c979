//! Waiting for a bench in virtual time.

use std::time::Duration;

use polepair_serve::bench::{Bench, Reply};
use polepair_serve::message::{Arguments, CommandOrder, Refused};

/// A step of it.
pub const MS: Duration = Duration::from_millis(1);

/// Waits for an answer.
pub fn heard<T>(bench: &Bench, mut reply: Reply<T>) -> Result<T, Refused> {
    for _ in 0..30_000 {
        if let Some(answer) = reply.take() {
            return answer;
        }
        bench.pass(MS);
    }
    panic!("no answer within thirty seconds of virtual time");
}

/// A command that is said now, with an id of its own.
pub fn order(
    bench: &Bench,
    id: u32,
    epoch: u64,
    verb: &str,
    velocity: Option<f64>,
) -> CommandOrder {
    CommandOrder {
        id: format!("id-{id}"),
        issued_ms: bench.now_ms(),
        ttl_ms: 500.0,
        epoch,
        verb: verb.into(),
        arguments: Arguments { velocity, ..Arguments::default() },
    }
}
