//! The origin of decoded tables.

/// Provenance of a decode, with all that repeats it; kept in the metadata of every file.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Provenance {
    /// The capture's file name.
    pub file: String,
    /// BLAKE3 of its bytes, hexadecimal.
    pub blake3: String,
    /// Protocols that were stated or found, as `--as` takes them.
    pub rules: String,
    /// The drive whose names were stated; empty for usual ones.
    pub profile: String,
}

/// The version of the decoder that wrote a file.
pub const DECODER: &str = env!("CARGO_PKG_VERSION");

impl Provenance {
    /// Keys and values of the metadata.
    #[must_use]
    pub fn pairs(&self) -> [(&'static str, &str); 5] {
        [
            ("polepair.decoder", DECODER),
            ("polepair.source.file", &self.file),
            ("polepair.source.blake3", &self.blake3),
            ("polepair.rules", &self.rules),
            ("polepair.profile", &self.profile),
        ]
    }
}
