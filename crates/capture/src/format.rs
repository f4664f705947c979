//! File formats of captures, detected by their first bytes.

use std::path::Path;

/// A form of capture file.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum CaptureFormat {
    /// candump's log and screen output, serial logs, data alone: a line each.
    Text,
    /// pcap, by tcpdump, with CAN frames of Linux (link type 227) or serial bytes (147).
    Pcap,
    /// pcapng, by Wireshark and dumpcap; the same link types.
    Pcapng,
    /// ASC, by Vector's tools.
    Asc,
    /// TRC, by PEAK's tools, versions 1.0 to 2.1.
    Trc,
    /// BLF, by Vector's tools.
    Blf,
    /// CSV, by python-can, SavvyCAN or Saleae Logic.
    Csv,
    /// The text log of BUSMASTER.
    Busmaster,
    /// CRTD, by the Open Vehicle Monitoring System.
    Crtd,
    /// The SQLite database of python-can.
    Sqlite,
    /// Output of `polepair decode --format jsonl`.
    Jsonl,
}

/// Every format with its word and its usual endings.
const ALL: [(CaptureFormat, &str, &[&str]); 11] = [
    (CaptureFormat::Text, "log", &["log", "txt", "candump"]),
    (CaptureFormat::Pcap, "pcap", &["pcap", "cap"]),
    (CaptureFormat::Pcapng, "pcapng", &["pcapng", "ntar"]),
    (CaptureFormat::Asc, "asc", &["asc"]),
    (CaptureFormat::Trc, "trc", &["trc"]),
    (CaptureFormat::Blf, "blf", &["blf"]),
    (CaptureFormat::Csv, "csv", &["csv"]),
    (CaptureFormat::Busmaster, "busmaster", &["busmaster"]),
    (CaptureFormat::Crtd, "crtd", &["crtd"]),
    (CaptureFormat::Sqlite, "sqlite", &["sqlite", "sqlite3", "db"]),
    (CaptureFormat::Jsonl, "jsonl", &["jsonl", "ndjson"]),
];

/// Bytes that are read to detect a format.
pub(crate) const HEAD_MAX: usize = 4096;

impl CaptureFormat {
    /// Name of the format.
    #[must_use]
    pub fn name(self) -> &'static str {
        ALL.iter().find(|(format, ..)| *format == self).map_or("log", |(_, name, _)| name)
    }

    /// Every word, for error texts and help.
    pub fn names() -> impl Iterator<Item = &'static str> {
        ALL.iter().map(|(_, name, _)| *name)
    }

    /// The format of that word.
    #[must_use]
    pub fn from_name(word: &str) -> Option<Self> {
        ALL.iter().find(|(_, name, _)| *name == word).map(|(format, ..)| *format)
    }

    /// Format by a file's name, compressed or not: `bus.asc.gz`.
    #[must_use]
    pub fn from_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        let name = Compression::ENDINGS.iter().find_map(|(_, end)| name.strip_suffix(end));
        let name = name.map_or_else(|| path.to_path_buf(), Into::into);
        let end = name.extension()?.to_str()?.to_ascii_lowercase();
        ALL.iter().find(|(_, _, ends)| ends.contains(&end.as_str())).map(|(format, ..)| *format)
    }
}

impl std::fmt::Display for CaptureFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A kind of file that is recognised and not read.
#[derive(PartialEq, Eq, Debug)]
pub struct UnsupportedFile {
    /// The kind of file, with its article.
    pub name: &'static str,
    /// Hint on another way to its frames.
    pub hint: &'static str,
    /// Bytes that it begins with.
    magic: &'static [u8],
}

/// First bytes of unsupported files, which are public, and long enough to be no chance.
const UNSUPPORTED: [UnsupportedFile; 8] = [
    UnsupportedFile {
        name: "an MDF file (MF4)",
        hint: "`pip install asammdf`, then `python -m can.logconvert FILE.mf4 FILE.log`",
        magic: b"MDF     ",
    },
    UnsupportedFile {
        name: "an unfinished MDF file (MF4)",
        hint: "finalise it with the logger's tool, then `python -m can.logconvert FILE.mf4 FILE.log`",
        magic: b"UnFinMF ",
    },
    UnsupportedFile {
        name: "a zip archive",
        hint: "unpack it; export the decoded bytes of a sigrok (.sr) or Saleae (.sal) session as CSV",
        magic: b"PK\x03\x04",
    },
    UnsupportedFile { name: "a 7z archive", hint: "unpack it", magic: b"7z\xBC\xAF\x27\x1C" },
    UnsupportedFile { name: "an xz file", hint: "unpack it with `xz -d`", magic: b"\xFD7zXZ\0" },
    UnsupportedFile { name: "a bzip2 file", hint: "unpack it with `bunzip2`", magic: b"BZh" },
    UnsupportedFile {
        name: "an HDF5 file",
        hint: "export it as CSV or ASC",
        magic: b"\x89HDF\r\n",
    },
    UnsupportedFile {
        name: "a log of Microchip's CAN BUS Analyzer",
        hint: "SavvyCAN reads it: save it from there as GVRET CSV",
        magic: b"Microchip Technology Inc.",
    },
];

impl UnsupportedFile {
    /// The kind of file with these first bytes. Text logs may have comments in front.
    pub(crate) fn detect(head: &[u8]) -> Option<&'static Self> {
        let text = head.trim_ascii_start();
        let text =
            &text[text.iter().take_while(|c| matches!(c, b'/' | b'-' | b'\r' | b'\n')).count()..];
        UNSUPPORTED.iter().find(|file| head.starts_with(file.magic) || text.starts_with(file.magic))
    }
}

/// Compression of a file.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Compression {
    /// gzip.
    Gzip,
    /// Zstandard.
    Zstd,
}

impl Compression {
    const ENDINGS: [(Self, &'static str); 2] = [(Self::Gzip, ".gz"), (Self::Zstd, ".zst")];

    /// Compression by a file's name.
    #[must_use]
    pub fn from_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        Self::ENDINGS.iter().find(|(_, end)| name.ends_with(end)).map(|(packing, _)| *packing)
    }

    /// Bytes that identify it.
    pub(crate) const HEAD: usize = 4;

    /// The compression that begins so.
    pub(crate) fn detect(head: &[u8]) -> Option<Self> {
        match head {
            [0x1F, 0x8B, ..] => Some(Self::Gzip),
            // A Zstandard frame, or one of those that may be skipped.
            [0x28, 0xB5, 0x2F, 0xFD, ..] | [0x50..=0x5F, 0x2A, 0x4D, 0x18, ..] => Some(Self::Zstd),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{CaptureFormat, Compression};
    use std::path::Path;

    #[test]
    fn names_and_endings() {
        for name in CaptureFormat::names() {
            assert_eq!(CaptureFormat::from_name(name).map(CaptureFormat::name), Some(name));
            assert_eq!(
                CaptureFormat::from_path(Path::new(&format!("a.{name}.gz"))),
                CaptureFormat::from_name(name)
            );
        }
        assert_eq!(CaptureFormat::from_path(Path::new("BUS.ASC")), Some(CaptureFormat::Asc));
        assert_eq!(CaptureFormat::from_path(Path::new("bus")), None);
        assert_eq!(Compression::from_path(Path::new("a.log.zst")), Some(Compression::Zstd));
    }
}
