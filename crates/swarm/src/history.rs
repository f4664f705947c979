//! The history of a world: its times and its hash.

use polepair_core::time::Instant;
use polepair_sim::random::HistoryHash;

/// Seconds.
pub fn seconds(instant: Instant) -> f64 {
    instant.0 as f64 / 1e9
}

/// The hash of a word.
pub fn hash_text(history: &mut HistoryHash, word: &str) {
    history.add_bytes(word.as_bytes());
}
