//! A set of modules.

/// Modules by their address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ModuleSet([u64; 4]);

impl ModuleSet {
    pub(super) const NONE: Self = Self([0; 4]);

    #[inline]
    pub(super) const fn contains(self, module: u8) -> bool {
        self.0[(module >> 6) as usize] & 1 << (module & 63) != 0
    }

    #[inline]
    pub(super) fn insert(&mut self, module: u8) {
        self.0[usize::from(module >> 6)] |= 1 << (module & 63);
    }

    pub(super) fn remove(&mut self, module: u8) {
        self.0[usize::from(module >> 6)] &= !(1 << (module & 63));
    }

    pub(super) fn is_empty(self) -> bool {
        self == Self::NONE
    }
}
