//! Words that stay: what names a signal or an operation is kept once, however often it is told.

use std::collections::BTreeSet;
use std::sync::Mutex;

/// A word that stays for as long as the program runs.
pub type Name = &'static str;

/// Words that are kept beside those that the program has; a capture with more of them is hostile.
const NAMES_MAX: usize = 1 << 16;
/// What further ones are called.
const BEYOND: Name = "(more names than can be kept)";

static NAMES: Mutex<BTreeSet<Name>> = Mutex::new(BTreeSet::new());

/// Keeps a word.
#[must_use]
pub fn name(word: &str) -> Name {
    let mut names = NAMES.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some(kept) = names.get(word) {
        return kept;
    }
    if names.len() == NAMES_MAX {
        return BEYOND;
    }
    let kept: Name = String::from(word).leak();
    names.insert(kept);
    kept
}

#[cfg(test)]
mod tests {
    use super::name;

    #[test]
    fn a_word_is_kept_once() {
        let (one, other) = (name("0x2000:3"), name(&format!("0x{:04X}:3", 0x2000)));
        assert!(core::ptr::eq(one, other));
    }
}
