//! Counts replies on CAN that match requests, as evidence for a protocol whose identifiers and checksums
//! are ambiguous.

use std::collections::{BTreeMap, VecDeque};

use polepair_core::explain::{Dissector, RawFrame};

use super::AXES_MAX;
use crate::decoder::DecodedFrame;
use crate::timestamp::Timestamp;

/// Requests that are remembered.
const REQUESTS_MAX: usize = 16;
/// An answer comes within this time, ns.
const ANSWER_MAX_NS: u64 = 200_000_000;
/// Pairs of an axis that cannot be an accident: mapped values that repeat each other with the
/// letters of a command in them, again and again, are none.
pub(super) const PROOF_PAIRS: u64 = 3;

/// Requests and the answers that were found to them.
#[derive(Clone, Debug, Default)]
pub(super) struct Pairs {
    requests: VecDeque<PairCandidate>,
    /// Pairs found.
    pub found: u64,
    axes: BTreeMap<u32, u64>,
}

#[derive(Clone, Copy, Debug)]
struct PairCandidate {
    data: [u8; 8],
    len: u8,
    id: u32,
    extended: bool,
    time: Option<Timestamp>,
}

impl PairCandidate {
    fn raw(&self) -> RawFrame<'_> {
        let bytes = &self.data[..usize::from(self.len)];
        RawFrame { bytes, id: Some(self.id), extended: self.extended }
    }
}

impl Pairs {
    /// Takes a whole frame.
    pub fn observe(&mut self, dissector: &dyn Dissector, event: &DecodedFrame<'_>) {
        let (Some(id), len @ 0..=8) = (event.id, event.bytes.len()) else { return };
        let raw = RawFrame { bytes: event.bytes, id: Some(id), extended: event.extended };
        if dissector.is_request(&raw) {
            if self.requests.len() == REQUESTS_MAX {
                self.requests.pop_front();
            }
            let mut data = [0; 8];
            data[..len].copy_from_slice(event.bytes);
            let (extended, time) = (event.extended, event.time);
            self.requests.push_back(PairCandidate { data, len: len as u8, id, extended, time });
            return;
        }
        debug_assert!(self.requests.len() <= REQUESTS_MAX);
        let Some(at) = self.requests.iter().position(|pair_candidate| {
            answers_in_time(pair_candidate, event.time)
                && dissector.is_answer_to(&raw, &pair_candidate.raw())
        }) else {
            return;
        };
        // One reply counts for one request, else a beacon would prove many.
        self.requests.remove(at);
        if !dissector.is_evident_answer(&raw) {
            return;
        }
        self.found += 1;
        if let Some(axis) = event.explanation.axis
            && (self.axes.len() < AXES_MAX || self.axes.contains_key(&axis))
        {
            *self.axes.entry(axis).or_default() += 1;
        }
    }

    /// The axes that are proven by them.
    pub fn proven_axes(&self) -> impl Iterator<Item = u32> + '_ {
        self.axes.iter().filter(|(_, pairs)| **pairs >= PROOF_PAIRS).map(|(axis, _)| *axis)
    }
}

fn answers_in_time(pair_candidate: &PairCandidate, event_time: Option<Timestamp>) -> bool {
    pair_candidate.time.zip(event_time).is_none_or(|(then, now)| now.since(then) <= ANSWER_MAX_NS)
}
