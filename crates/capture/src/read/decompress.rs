//! Decompresses captures as a stream.

use std::io::Write as _;

use super::{ReadError, blf};
use crate::format::{CaptureFormat, Compression};

/// Packed bytes that are unpacked at once: what a hostile file makes of them stays bounded.
const PIECE_GZIP: usize = 1 << 12;
/// Input piece for Zstandard, whose compression can be higher.
const PIECE_ZSTD: usize = 1 << 8;
/// Memory that a Zstandard file may demand, as a power of two.
#[cfg(feature = "zstd")]
const WINDOW_LOG_MAX: u32 = 27;

/// Content of a compressed capture, or the bytes themselves of another one. Bytes behind a damaged place are left out,
/// as a [`CaptureReader`](super::CaptureReader) does. `None` if it holds more than `max` bytes: a few kilobytes can
/// hold gigabytes. Compressed parts within the capture (the containers of a BLF file) stay so, and count with their
/// unpacked size.
///
/// A capture that is compressed twice holds nothing that a `Reader` reads, and the result is empty: a reader would
/// unpack it once more, without a bound.
#[must_use]
pub fn unpack_bounded(bytes: Vec<u8>, max: usize) -> Option<Vec<u8>> {
    let fits = |plain: &Vec<u8>| plain.len() as u64 + nested_size(plain) <= max as u64;
    let Some(packing) = Compression::detect(&bytes) else {
        return Some(bytes).filter(fits);
    };
    let mut plain = Vec::new();
    unpack_into(&mut plain, packing, &bytes, max);
    // Packed twice is a bomb until shown otherwise.
    if Compression::detect(&plain).is_some() {
        plain.clear();
    }
    Some(plain).filter(fits)
}

/// Number of bytes more there are in a plain capture once all of it is unpacked.
fn nested_size(plain: &[u8]) -> u64 {
    match plain.get(..Compression::HEAD).and_then(|head| CaptureFormat::detect(head, false)) {
        Some(CaptureFormat::Blf) => blf::unpacked_size(plain),
        _ => 0,
    }
}

/// Unpacks until the end, or one byte beyond `most`.
fn unpack_into(plain: &mut Vec<u8>, packing: Compression, bytes: &[u8], max: usize) {
    let mut unpack = Decompressor::new(packing);
    let mut keep = |part: &[u8]| {
        // One byte more than allowed is kept, as the sign that it is too much.
        let capacity = max.saturating_add(1).saturating_sub(plain.len());
        plain.extend_from_slice(&part[..part.len().min(capacity)]);
        capacity > part.len()
    };
    for piece in bytes.chunks(PIECE_ZSTD) {
        let mut goes_on = true;
        unpack.feed(piece, &mut |part| goes_on = keep(part));
        if !goes_on {
            return;
        }
    }
    // A file that is cut off ends there.
    let _ = unpack.finish(&mut |part| {
        keep(part);
    });
}

/// An unpacker, and whether it has met its end.
pub(super) struct Decompressor {
    engine: DecompressionEngine,
    /// Reason why nothing more can be unpacked.
    error: Option<ReadError>,
}

enum DecompressionEngine {
    Gzip(Box<flate2::write::MultiGzDecoder<Vec<u8>>>),
    #[cfg(feature = "zstd")]
    Zstd(zstd::stream::write::Decoder<'static, Vec<u8>>),
    /// The decompressor could not be set up.
    None,
}

impl core::fmt::Debug for Decompressor {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Unpack").field("broken", &self.error).finish_non_exhaustive()
    }
}

impl Decompressor {
    pub(super) fn new(packing: Compression) -> Self {
        let engine = match packing {
            Compression::Gzip => {
                DecompressionEngine::Gzip(Box::new(flate2::write::MultiGzDecoder::new(Vec::new())))
            }
            Compression::Zstd => zstd_engine(),
        };
        Self { engine, error: None }
    }

    /// Unpacks bytes.
    pub(super) fn feed(&mut self, piece: &[u8], out: &mut dyn FnMut(&[u8])) {
        let size = match self.engine {
            DecompressionEngine::Gzip(_) => PIECE_GZIP,
            _ => PIECE_ZSTD,
        };
        for part in piece.chunks(size) {
            // After damage nothing further is decoded: what follows cannot be aligned again.
            if self.error.is_none()
                && let Err(error) = self.engine.decompress(part)
            {
                self.error = Some(match error.kind() {
                    std::io::ErrorKind::Unsupported => NOT_DECOMPRESSED,
                    _ => ReadError("the compressed bytes are damaged; the rest is lost"),
                });
            }
            self.engine.drain(out);
        }
    }

    /// Ends the file.
    pub(super) fn finish(&mut self, out: &mut dyn FnMut(&[u8])) -> Result<(), ReadError> {
        let whole = self.engine.finish();
        self.engine.drain(out);
        match self.error {
            Some(reason) => Err(reason),
            None => whole.map_err(|_| ReadError("the compressed file is cut off")),
        }
    }
}

/// The decompressor could not be set up, or is not there.
const NOT_DECOMPRESSED: ReadError = ReadError(if cfg!(feature = "zstd") {
    "there is not enough memory to decompress it"
} else {
    "this program was built without Zstandard (feature `zstd`)"
});

#[cfg(not(feature = "zstd"))]
fn zstd_engine() -> DecompressionEngine {
    DecompressionEngine::None
}

#[cfg(feature = "zstd")]
fn zstd_engine() -> DecompressionEngine {
    let decoder = zstd::stream::write::Decoder::new(Vec::new()).and_then(|mut decoder| {
        decoder.window_log_max(WINDOW_LOG_MAX)?;
        Ok(decoder)
    });
    decoder.map_or(DecompressionEngine::None, DecompressionEngine::Zstd)
}

impl DecompressionEngine {
    fn decompress(&mut self, part: &[u8]) -> std::io::Result<()> {
        match self {
            Self::Gzip(decoder) => decoder.write_all(part),
            #[cfg(feature = "zstd")]
            Self::Zstd(decoder) => decoder.write_all(part),
            Self::None => Err(std::io::ErrorKind::Unsupported.into()),
        }
    }

    fn finish(&mut self) -> std::io::Result<()> {
        match self {
            Self::Gzip(decoder) => decoder.try_finish(),
            #[cfg(feature = "zstd")]
            Self::Zstd(decoder) => decoder.flush(),
            Self::None => Err(std::io::ErrorKind::Unsupported.into()),
        }
    }

    fn drain(&mut self, out: &mut dyn FnMut(&[u8])) {
        let ready = match self {
            Self::Gzip(decoder) => decoder.get_mut(),
            #[cfg(feature = "zstd")]
            Self::Zstd(decoder) => decoder.get_mut(),
            Self::None => return,
        };
        if !ready.is_empty() {
            out(ready);
            ready.clear();
        }
    }
}

#[cfg(all(test, feature = "zstd"))]
mod tests {
    use super::*;

    /// Blocks of 128 KiB in four bytes each, as Zstandard's format describes them.
    fn bomb(blocks: usize) -> Vec<u8> {
        let mut bytes = vec![0x28, 0xB5, 0x2F, 0xFD, 0, 0x38];
        (0..blocks).for_each(|_| bytes.extend([0x02, 0x00, 0x10, b'\n']));
        bytes.extend([0x01, 0x00, 0x00]);
        bytes
    }

    #[test]
    fn nothing_is_kept_beyond_the_bound() {
        assert_eq!(unpack_bounded(bomb(8), 1 << 20).map(|plain| plain.len()), Some(1 << 20));
        assert_eq!(unpack_bounded(bomb(8), (1 << 20) - 1), None);
        let mut plain = Vec::new();
        unpack_into(&mut plain, Compression::Zstd, &bomb(1000), 1 << 20);
        assert_eq!(plain.len(), (1 << 20) + 1);
        assert!(plain.capacity() < 1 << 22, "{}", plain.capacity());
    }
}
