//! Interned names of signals and operations: each is stored once.

use std::collections::BTreeSet;
use std::sync::Mutex;

/// A word that stays for as long as the program runs.
pub type InternedName = &'static str;

/// Words that are kept beside those that the program has; a capture with more of them is hostile.
const NAMES_MAX: usize = 1 << 16;
/// Name for further ones.
const OVERFLOW_NAME: InternedName = "(more names than can be kept)";

static NAMES: Mutex<BTreeSet<InternedName>> = Mutex::new(BTreeSet::new());

/// Keeps a word.
#[must_use]
pub fn intern(word: &str) -> InternedName {
    let mut names = NAMES.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some(stored) = names.get(word) {
        return stored;
    }
    if names.len() == NAMES_MAX {
        return OVERFLOW_NAME;
    }
    let stored: InternedName = String::from(word).leak();
    names.insert(stored);
    stored
}

#[cfg(test)]
mod tests {
    use super::intern;

    #[test]
    fn a_word_is_kept_once() {
        let (one, other) = (intern("0x2000:3"), intern(&format!("0x{:04X}:3", 0x2000)));
        assert!(core::ptr::eq(one, other));
    }
}
