//! A set of modules.

/// Modules by their address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Modules([u64; 4]);

impl Modules {
    pub(super) const NONE: Self = Self([0; 4]);

    #[inline]
    pub(super) const fn holds(self, module: u8) -> bool {
        self.0[(module >> 6) as usize] & 1 << (module & 63) != 0
    }

    #[inline]
    pub(super) fn add(&mut self, module: u8) {
        self.0[usize::from(module >> 6)] |= 1 << (module & 63);
    }

    pub(super) fn remove(&mut self, module: u8) {
        self.0[usize::from(module >> 6)] &= !(1 << (module & 63));
    }

    pub(super) fn is_empty(self) -> bool {
        self == Self::NONE
    }
}
