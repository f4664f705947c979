//! Patterns with `*` for any text, case-insensitive.

/// A pattern: `SDO*`, `*/Actual/Position`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Glob(String);

impl Glob {
    /// A pattern.
    #[must_use]
    pub fn new(pattern: &str) -> Self {
        Self(pattern.to_owned())
    }

    /// Returns whether all of a word fits.
    #[must_use]
    pub fn matches(&self, word: &str) -> bool {
        glob_matches(self.0.as_bytes(), word.len(), |at| word.as_bytes()[at])
    }

    /// Returns whether a signal fits, by its name or as `AXIS/NAME`.
    #[must_use]
    pub fn matches_signal(&self, axis: u32, name: &str) -> bool {
        let mut head = [0; 11];
        let head = axis_prefix(axis, &mut head);
        let whole = |at: usize| match head.get(at) {
            Some(byte) => *byte,
            None => name.as_bytes()[at - head.len()],
        };
        self.matches(name) || glob_matches(self.0.as_bytes(), head.len() + name.len(), whole)
    }
}

/// `2/` for an axis.
fn axis_prefix(axis: u32, buffer: &mut [u8; 11]) -> &[u8] {
    let (mut at, mut rest) = (buffer.len() - 1, axis);
    buffer[at] = b'/';
    loop {
        at -= 1;
        buffer[at] = b'0' + (rest % 10) as u8;
        rest /= 10;
        if rest == 0 {
            return &buffer[at..];
        }
    }
}

/// Goes through the word once; after a mismatch it goes on behind the last `*`.
fn glob_matches(pattern: &[u8], len: usize, byte: impl Fn(usize) -> u8) -> bool {
    let (mut p, mut at, mut star) = (0, 0, None);
    while at < len {
        match pattern.get(p) {
            Some(b'*') => {
                star = Some((p, at));
                p += 1;
            }
            Some(c) if c.eq_ignore_ascii_case(&byte(at)) => {
                p += 1;
                at += 1;
            }
            _ => {
                let Some((back, from)) = star else { return false };
                star = Some((back, from + 1));
                p = back + 1;
                at = from + 1;
            }
        }
    }
    pattern[p..].iter().all(|c| *c == b'*')
}

/// Returns whether a text has a part, letter case ignored.
pub(super) fn contains_ignore_case(text: &str, part: &str) -> bool {
    let part = part.as_bytes();
    part.is_empty()
        || text.as_bytes().windows(part.len()).any(|window| window.eq_ignore_ascii_case(part))
}
