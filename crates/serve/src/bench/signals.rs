//! Reads signals on the request worker, so motion does not wait.

use polepair::LocalAxis;
use polepair_core::profile::Signal;
use tokio::sync::oneshot;

use super::Bench;
use super::reply::PendingReply;
use super::state::signal_value;
use crate::message::{GatewayError, SignalValue};

impl Bench {
    /// Reads signals of an axis now, by their words, in this order; each parameter that they come
    /// from is asked for once.
    pub fn read_signals(&self, axis: u16, words: &[&str]) -> PendingReply<Vec<SignalValue>> {
        let (reply_sender, reply) = oneshot::channel();
        let known = words.iter().map(|word| parse_signal(word)).collect::<Result<Vec<_>, _>>();
        let result = known.and_then(|signals| {
            let (link, index) = self.find_axis(axis)?;
            let axis = link.wire.axes[index].1.clone();
            link.request_worker
                .submit_query(reply_sender, move || read_axis_signals(&axis, &signals));
            Ok(())
        });
        PendingReply::from_receiver(reply, result)
    }
}

fn parse_signal(word: &str) -> Result<Signal, GatewayError> {
    let found = Signal::from_name(word);
    found.ok_or_else(|| {
        let all: Vec<_> = Signal::ALL.iter().map(|signal| signal.name()).collect();
        GatewayError::new("E213", format!("there is no signal `{word}`"))
            .hint(format!("signals are {}", all.join(", ")))
    })
}

fn read_axis_signals(
    axis: &LocalAxis,
    signals: &[Signal],
) -> Result<Vec<SignalValue>, GatewayError> {
    axis.signals(signals)?;
    let (state, now) = (axis.state(), axis.connection().now());
    let sources = signals.iter().filter_map(|signal| axis.profile().signal(*signal));
    let values = sources.filter_map(|source| signal_value(axis, &state, source, now));
    Ok(values.collect())
}
