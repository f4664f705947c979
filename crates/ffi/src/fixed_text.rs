//! Texts in arrays of a fixed size.

use std::ffi::c_char;

/// Copies as much of a text as fits, cut between two characters, with a zero byte behind it.
pub fn copy_text(text: &str, out: &mut [c_char]) {
    let room = out.len().saturating_sub(1);
    let mut length = text.len().min(room);
    while !text.is_char_boundary(length) {
        length -= 1;
    }
    for (to, from) in out.iter_mut().zip(&text.as_bytes()[..length]) {
        *to = *from as c_char;
    }
    if let Some(end) = out.get_mut(length) {
        *end = 0;
    }
}
