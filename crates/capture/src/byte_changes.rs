//! Finds the bytes of a frame that changed since the last frame of its kind.

use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::Hasher as _;

use polepair_core::explain::Direction;

use crate::decoder::DecodedFrame;
use crate::explanation::{ExplanationValue, REMOTE_REQUEST};

/// Limit of distinguished kinds of frames; bytes of further ones are not compared.
const KINDS_MAX: usize = 2_000;
/// Fields with the subject of a frame, not its value.
const SUBJECT: [&str; 6] = ["index", "sub", "type", "motor", "start", "variable"];

/// The last frame of each kind: link, identifier, direction, and subject.
#[derive(Clone, Debug, Default)]
pub struct ByteChanges {
    last_bytes: HashMap<u64, Vec<u8>>,
}

impl ByteChanges {
    /// Takes a frame. A bit for each of its first 64 bytes that changed; none for the first of a kind.
    pub fn update(&mut self, event: &DecodedFrame<'_>) -> u64 {
        let mut key = DefaultHasher::new();
        key.write(event.link.as_bytes());
        visit_frame_key(event, &mut |piece| key.write(piece));
        let key = key.finish();
        if let Some(last) = self.last_bytes.get_mut(&key) {
            let mask = changed_mask(last, event.bytes);
            last.clear();
            last.extend_from_slice(event.bytes);
            return mask;
        }
        if self.last_bytes.len() < KINDS_MAX {
            self.last_bytes.insert(key, event.bytes.to_vec());
        }
        0
    }
}

/// Key by which frames of a link are of one kind, piece by piece: identifier, direction, kind, axis, and subject.
/// Pieces in their order sort kinds as a person would.
pub fn visit_frame_key(event: &DecodedFrame<'_>, each: &mut dyn FnMut(&[u8])) {
    let explained = event.explanation;
    let id = event.id.map_or(0, |id| u64::from(event.extended) << 32 | u64::from(id) | 1 << 33);
    each(&id.to_be_bytes());
    each(&[match event.direction {
        None => 0,
        Some(Direction::ToDrive) => 1,
        Some(Direction::ToHost) => 2,
    }]);
    each(&explained.axis.map_or(0, |axis| u64::from(axis) + 1).to_be_bytes());
    each(explained.kind.as_bytes());
    let mut plain = true;
    for item in explained.fields().filter(|item| SUBJECT.contains(&item.name)) {
        plain = false;
        match item.value {
            ExplanationValue::Int(value) => each(&value.to_be_bytes()),
            ExplanationValue::Hex(value, _) => each(&value.to_be_bytes()),
            ExplanationValue::Text(text) => each(text.as_bytes()),
            ExplanationValue::Real(_) | ExplanationValue::Words(_) => {}
        }
    }
    if let Some((about, _)) = explained.text.split_once(" = ").filter(|_| plain) {
        each(about.as_bytes());
    }
}

/// Meaning of a frame, in words.
#[must_use]
pub fn meaning_text<'a>(event: &DecodedFrame<'a>) -> &'a str {
    let explained = event.explanation;
    match (explained.text.as_str(), explained.kind.as_str(), event.protocol) {
        ("", "", _) if event.remote => REMOTE_REQUEST,
        ("", "", None) => "not a frame of any known protocol",
        ("", kind, _) => kind,
        (text, ..) => text,
    }
}

/// A bit for each of the first 64 bytes that has changed.
fn changed_mask(before: &[u8], now: &[u8]) -> u64 {
    let differs = |(at, byte): (usize, &u8)| before.get(at) != Some(byte);
    let bits = now.iter().enumerate().take(64).filter(|found| differs(*found));
    bits.fold(0, |mask, (at, _)| mask | 1 << at)
}
