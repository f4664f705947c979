//! Stations with function 16 only: a single register is written as a list of one.

use super::{PendingSend, SerialHost};
use crate::proto::modbus::host_request::{HostRequest, RequestBody, WORDS_MAX};
use crate::proto::modbus::wire::Exception;
use crate::time::Instant;

/// Stations that refused function 06 because they do not have it.
#[derive(Clone, Copy, Debug, Default)]
pub struct MultipleWriters([u64; 4]);

impl MultipleWriters {
    pub fn insert(&mut self, unit: u8) {
        self.0[usize::from(unit >> 6)] |= 1 << (unit & 63);
    }

    fn contains(&self, unit: u8) -> bool {
        self.0[usize::from(unit >> 6)] >> (unit & 63) & 1 == 1
    }

    /// The request as its station takes it.
    pub fn adapt(&self, request: HostRequest) -> HostRequest {
        match request.body {
            RequestBody::WriteRegister { address, value } if self.contains(request.unit) => {
                let mut words = [0; WORDS_MAX];
                words[0] = value;
                let body = RequestBody::WriteRegisters { start: address, count: 1, words };
                HostRequest { body, ..request }
            }
            _ => request,
        }
    }
}

impl SerialHost {
    /// Sends a single write that a station refused as an illegal function once more, as function 16:
    /// a function that a station does not have was not carried out. Returns whether it does.
    #[cold]
    pub(super) fn retry_as_multiple_write(&mut self, now: Instant, exception: Exception) -> bool {
        let Some(current) = &mut self.current else { return false };
        let single = matches!(current.request.body, RequestBody::WriteRegister { .. });
        // The exception proves that nothing was written, so another function for the same register is no
        // repetition.
        if !single || exception != Exception::IllegalFunction || self.outstanding_len > 0 {
            return false;
        }
        self.multiple_writers.insert(current.request.unit);
        current.request = self.multiple_writers.adapt(current.request);
        // Counted anew: the attempts belonged to the other function.
        (current.attempts, current.since) = (1, now);
        self.counters.answered += 1;
        self.sending = Some(PendingSend::Request);
        self.quarantine = false;
        self.deadline = None;
        true
    }
}
