//! Compressed captures, unpacked as they come.

use std::io::Write as _;

use super::Bad;
use crate::format::Packing;

/// Packed bytes that are unpacked at once: what a hostile file makes of them stays bounded.
const PIECE_GZIP: usize = 1 << 12;
/// The same for Zstandard, which can say more with fewer bytes.
const PIECE_ZSTD: usize = 1 << 8;
/// Memory that a Zstandard file may demand, as a power of two.
const WINDOW_LOG_MAX: u32 = 27;

/// What a compressed capture holds, and the bytes themselves where it is not compressed. What follows
/// a damaged place is left out, as a [`Reader`](super::Reader) leaves it out. `None` where it holds more
/// than `most` bytes: a few kilobytes can hold gigabytes.
#[must_use]
pub fn unpacked(bytes: Vec<u8>, most: usize) -> Option<Vec<u8>> {
    let Some(packing) = Packing::of_head(&bytes) else {
        return Some(bytes).filter(|bytes| bytes.len() <= most);
    };
    let (mut unpack, mut plain) = (Unpack::new(packing), Vec::new());
    for piece in bytes.chunks(PIECE_GZIP) {
        unpack.feed(piece, &mut |part| plain.extend_from_slice(part));
        if plain.len() > most {
            return None;
        }
    }
    // What is cut off ends there.
    let _ = unpack.finish(&mut |part| plain.extend_from_slice(part));
    (plain.len() <= most).then_some(plain)
}

/// An unpacker, and whether it has met its end.
pub(super) struct Unpack {
    engine: Engine,
    /// Why nothing more can be unpacked.
    broken: Option<Bad>,
}

enum Engine {
    Gzip(Box<flate2::write::MultiGzDecoder<Vec<u8>>>),
    Zstd(zstd::stream::write::Decoder<'static, Vec<u8>>),
    /// It could not be set up.
    None,
}

impl core::fmt::Debug for Unpack {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Unpack").field("broken", &self.broken).finish_non_exhaustive()
    }
}

impl Unpack {
    pub(super) fn new(packing: Packing) -> Self {
        let engine = match packing {
            Packing::Gzip => Engine::Gzip(Box::new(flate2::write::MultiGzDecoder::new(Vec::new()))),
            Packing::Zstd => zstd(),
        };
        Self { engine, broken: None }
    }

    /// Takes packed bytes and gives what they hold.
    pub(super) fn feed(&mut self, piece: &[u8], out: &mut dyn FnMut(&[u8])) {
        let size = match self.engine {
            Engine::Gzip(_) => PIECE_GZIP,
            _ => PIECE_ZSTD,
        };
        for part in piece.chunks(size) {
            if self.broken.is_none() && self.engine.take(part).is_err() {
                self.broken = Some(Bad("the compressed bytes are damaged; the rest is lost"));
            }
            self.engine.give(out);
        }
    }

    /// Ends the file.
    pub(super) fn finish(&mut self, out: &mut dyn FnMut(&[u8])) -> Result<(), Bad> {
        let whole = self.engine.end();
        self.engine.give(out);
        match self.broken {
            Some(reason) => Err(reason),
            None => whole.map_err(|_| Bad("the compressed file is cut off")),
        }
    }
}

fn zstd() -> Engine {
    let decoder = zstd::stream::write::Decoder::new(Vec::new()).and_then(|mut decoder| {
        decoder.window_log_max(WINDOW_LOG_MAX)?;
        Ok(decoder)
    });
    decoder.map_or(Engine::None, Engine::Zstd)
}

impl Engine {
    fn take(&mut self, part: &[u8]) -> std::io::Result<()> {
        match self {
            Self::Gzip(decoder) => decoder.write_all(part),
            Self::Zstd(decoder) => decoder.write_all(part),
            Self::None => Err(std::io::ErrorKind::Unsupported.into()),
        }
    }

    fn end(&mut self) -> std::io::Result<()> {
        match self {
            Self::Gzip(decoder) => decoder.try_finish(),
            Self::Zstd(decoder) => decoder.flush(),
            Self::None => Err(std::io::ErrorKind::Unsupported.into()),
        }
    }

    fn give(&mut self, out: &mut dyn FnMut(&[u8])) {
        let ready = match self {
            Self::Gzip(decoder) => decoder.get_mut(),
            Self::Zstd(decoder) => decoder.get_mut(),
            Self::None => return,
        };
        if !ready.is_empty() {
            out(ready);
            ready.clear();
        }
    }
}
