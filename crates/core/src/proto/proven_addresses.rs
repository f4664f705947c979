//! Addresses without pending replies of an earlier program. An address is proven by replies to random
//! probes; before that, the host accepts no other reply from it.
//!
//! Why: REQ-7.

/// Addresses that are proven, and the generator that draws probes for the others.
#[derive(Clone, Debug)]
pub(super) struct ProvenAddresses {
    addresses: [u64; 4],
    /// State of the generator; `None` where no program was there before, so that all are proven.
    random_state: Option<u32>,
}

impl ProvenAddresses {
    /// `doubt` is what the draws begin with.
    pub(super) fn new(doubt: Option<u32>) -> Self {
        Self {
            addresses: if doubt.is_some() { [0; 4] } else { [u64::MAX; 4] },
            // Zero would draw itself for ever.
            random_state: doubt.map(|seed| seed.wrapping_mul(0x9E37_79B9) | 1),
        }
    }

    #[inline]
    pub(super) const fn contains(&self, address: u8) -> bool {
        self.addresses[(address >> 6) as usize] & 1 << (address & 63) != 0
    }

    pub(super) fn insert(&mut self, address: u8) {
        self.addresses[usize::from(address >> 6)] |= 1 << (address & 63);
    }

    /// Nothing is known of it any more, where a program may have been there before.
    pub(super) fn remove(&mut self, address: u8) {
        if self.random_state.is_some() {
            self.addresses[usize::from(address >> 6)] &= !(1 << (address & 63));
        }
    }

    /// A number below `count`, at random (xorshift).
    pub(super) fn random_below(&mut self, count: usize) -> usize {
        let mut draw = self.random_state.unwrap_or(1);
        draw ^= draw << 13;
        draw ^= draw >> 17;
        draw ^= draw << 5;
        self.random_state = self.random_state.map(|_| draw);
        draw as usize % count.max(1)
    }
}
