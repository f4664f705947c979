//! A list that only grows, up to a limit. Elements do not move, so readers need no lock.
//!
//! Why: GW-8.

use std::ops::Index;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The list.
pub(super) struct AppendOnlyVec<T> {
    slots: Box<[OnceLock<Box<T>>]>,
    count: AtomicUsize,
}

impl<T> AppendOnlyVec<T> {
    /// With room for `most`, and these in it; those beyond are left out.
    pub fn new(max: usize, these: impl IntoIterator<Item = T>) -> Self {
        let places = (0..max).map(|_| OnceLock::new()).collect();
        let grown = Self { slots: places, count: AtomicUsize::new(0) };
        for one in these.into_iter().take(max) {
            grown.push(one);
        }
        grown
    }

    /// Appends an element, and returns its index. `None` without room. One caller at a time.
    pub fn push(&self, one: T) -> Option<usize> {
        let index = self.len();
        self.slots.get(index)?.set(Box::new(one)).ok()?;
        self.count.store(index + 1, Ordering::Release);
        Some(index)
    }

    pub fn len(&self) -> usize {
        self.count.load(Ordering::Acquire)
    }

    pub fn get(&self, index: usize) -> Option<&T> {
        self.slots.get(..self.len())?.get(index)?.get().map(|one| &**one)
    }

    pub fn first(&self) -> Option<&T> {
        self.get(0)
    }

    pub fn iter(&self) -> impl Iterator<Item = &T> + Clone {
        self.slots[..self.len()].iter().filter_map(|one| one.get().map(|one| &**one))
    }
}

impl<T> Index<usize> for AppendOnlyVec<T> {
    type Output = T;

    fn index(&self, position: usize) -> &T {
        self.get(position).expect("places are those of the list")
    }
}

#[cfg(test)]
mod tests {
    use super::AppendOnlyVec;

    #[test]
    fn contents_stay_while_it_grows() {
        let grown = AppendOnlyVec::new(3, ["a", "b"]);
        let first = &grown[0];
        assert_eq!((grown.push("c"), grown.push("d")), (Some(2), None));
        assert!(std::ptr::eq(first, &grown[0]));
        assert_eq!(grown.iter().copied().collect::<Vec<_>>(), ["a", "b", "c"]);
        assert_eq!((grown.len(), grown.get(3)), (3, None));
    }
}
