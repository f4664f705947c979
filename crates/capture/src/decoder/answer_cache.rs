//! A cache of the explanations of answers, by their requests. An answer that differs from an earlier one in numbers
//! alone needs no explanation of its own.
//!
//! Why: DEC-6.

use std::sync::Arc;

use polepair_core::explain::{Direction, Dissector, RawFrame};

use super::repeat_cache::{RepeatKey, SERIAL_MAX, SLOTS, slot_of};
use super::route::FrameRoute;
use crate::batch::DATA_MAX;
use crate::explanation::{Explanation, RESTATED_MAX};
use crate::record::STANDARD_MAX;

/// Common properties of answers to identical requests.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct AnswerKey {
    request: u128,
    request_len: u8,
    request_id: Option<u32>,
    len: u8,
    id: Option<u32>,
    direction: Option<Direction>,
}

/// Explanations of the last answers, in a hash table.
#[derive(Default)]
pub(super) struct AnswerCache {
    slots: Vec<Option<(AnswerKey, Option<KnownAnswer>)>>,
    /// Protocol of the answers with a CAN identifier of 11 bits.
    dissectors: Vec<Option<&'static dyn Dissector>>,
}

/// An answer whose explanation is known, but for its numbers.
pub(super) struct KnownAnswer {
    pub route: FrameRoute,
    pub explanation: Arc<Explanation>,
    bytes: u128,
    /// A one for each bit that is a number's.
    numbers: u128,
    /// Index of its last template in a batch.
    pub template: u16,
}

impl core::fmt::Debug for AnswerCache {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} of {SLOTS}", self.slots.iter().flatten().count())
    }
}

impl AnswerKey {
    /// The key of an answer; `None` where it or its request is too long, or its identifier has 29 bits.
    pub fn new(
        request: &RawFrame<'_>,
        answer: &RawFrame<'_>,
        direction: Option<Direction>,
    ) -> Option<Self> {
        if answer.extended || request.extended || answer.bytes.len() > RESTATED_MAX {
            return None;
        }
        Some(Self {
            request: joined(request.bytes)?,
            request_len: request.bytes.len() as u8,
            request_id: request.id,
            len: answer.bytes.len() as u8,
            id: answer.id,
            direction,
        })
    }
}

impl RepeatKey for AnswerKey {
    fn slot_index(&self) -> usize {
        let (low, high) = (self.request as u64, (self.request >> 64) as u64);
        slot_of(low ^ high.rotate_left(29) ^ u64::from(self.id.unwrap_or(0)) << 40)
    }
}

impl AnswerCache {
    /// Protocol of the answers with a CAN identifier, if one of them is known.
    pub fn dissector_of(&self, id: u32) -> Option<&'static dyn Dissector> {
        *self.dissectors.get(id as usize)?
    }

    /// Finds an earlier answer that differs from a frame in numbers alone.
    pub fn find(&mut self, key: &AnswerKey, bytes: &[u8]) -> Option<&mut KnownAnswer> {
        let (known, answer) = self.slots.get_mut(key.slot_index())?.as_mut()?;
        let answer = answer.as_mut().filter(|_| known == key)?;
        ((joined(bytes)? ^ answer.bytes) & !answer.numbers == 0).then_some(answer)
    }

    /// Records the explanation of an answer: it is stored from the second one to the same request on.
    pub fn record(
        &mut self,
        key: AnswerKey,
        raw: &RawFrame<'_>,
        route: FrameRoute,
        explanation: &Explanation,
    ) {
        self.slots.resize_with(SLOTS, || None);
        let slot = &mut self.slots[key.slot_index()];
        let Some((_, answer)) = slot.as_mut().filter(|(known, _)| *known == key) else {
            *slot = Some((key, None));
            return;
        };
        let data_start = raw.bytes.len().saturating_sub(DATA_MAX.into());
        let numbers = explanation.number_bytes(raw.bytes);
        // Frames of one template differ in their last bytes.
        let Some(numbers) = numbers.filter(|it| it.trailing_zeros() as usize >= data_start) else {
            return;
        };
        let Some(bytes) = joined(raw.bytes) else { return };
        let mask = (0..RESTATED_MAX).filter(|at| numbers >> at & 1 == 1);
        let numbers = mask.fold(0, |mask, at| mask | 0xFF << (8 * at));
        let explanation = Arc::new(explanation.duplicate());
        *answer = Some(KnownAnswer { route, explanation, bytes, numbers, template: 0 });
        if let Some(id) = raw.id.filter(|id| *id <= STANDARD_MAX) {
            self.dissectors.resize(STANDARD_MAX as usize + 1, None);
            self.dissectors[id as usize] = Some(route.dissector);
        }
    }
}

/// Bytes as a number, the first lowest; `None` for more than 16.
fn joined(bytes: &[u8]) -> Option<u128> {
    let mut all = [0; SERIAL_MAX];
    all.get_mut(..bytes.len())?.copy_from_slice(bytes);
    Some(u128::from_le_bytes(all))
}
