//! A set of nodes.

use crate::proto::canopen::NODE_MAX;

/// A set of nodes, a bit each. Two words rather than one of twice the length, in which no bit is
/// found or set by a single instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct NodeSet([u64; 2]);

const _: () = assert!(NODE_MAX < 128, "a node is a bit");

impl NodeSet {
    /// None.
    pub const EMPTY: Self = Self([0; 2]);

    #[inline]
    pub const fn insert(&mut self, node: u8) {
        debug_assert!(node <= NODE_MAX);
        self.0[(node >> 6 & 1) as usize] |= 1 << (node & 63);
    }

    #[inline]
    pub const fn remove(&mut self, node: u8) {
        self.0[(node >> 6 & 1) as usize] &= !(1 << (node & 63));
    }

    #[inline]
    pub const fn contains(&self, node: u8) -> bool {
        self.0[(node >> 6 & 1) as usize] >> (node & 63) & 1 != 0
    }

    /// The lowest of them.
    #[inline]
    pub const fn first(&self) -> Option<u8> {
        match self.0 {
            [0, 0] => None,
            [0, upper] => Some(64 + upper.trailing_zeros() as u8),
            [lower, _] => Some(lower.trailing_zeros() as u8),
        }
    }

    /// All that are in either.
    pub const fn union(self, other: Self) -> Self {
        Self([self.0[0] | other.0[0], self.0[1] | other.0[1]])
    }

    /// All that are not in the other.
    #[inline]
    pub const fn difference(self, other: Self) -> Self {
        Self([self.0[0] & !other.0[0], self.0[1] & !other.0[1]])
    }

    /// The lowest first.
    pub fn iter(mut self) -> impl Iterator<Item = u8> {
        core::iter::from_fn(move || self.first().inspect(|node| self.remove(*node)))
    }
}
