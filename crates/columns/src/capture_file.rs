//! A capture as a file: the fingerprint of its content, its earlier states, and whether it changes.

use polepair_core::convert::saturating;
use std::fs::{File, Metadata};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::path_word::escape;

const READ_SIZE: usize = 1 << 18;
/// Magic number of BLF, and the bytes of its header, in which a recorder keeps counts up to date.
const BLF_MAGIC: &[u8] = b"LOGG";
const BLF_HEADER: usize = 144;
/// Magic number of SQLite, whose pages change in place.
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

const NO_PATH: &str = "-";

/// A capture and its content, as it was when it was read.
#[derive(Clone, Debug)]
pub struct CaptureFile {
    path: PathBuf,
    name: String,
    state: FileState,
    content: CaptureContent,
    is_database: bool,
}

/// The content that a capture had.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CaptureContent {
    /// BLAKE3 of all bytes, hexadecimal.
    pub blake3: String,
    /// Number of bytes.
    pub size: u64,
    /// BLAKE3 of the bytes that stay as they are while the file grows, hexadecimal.
    pub body: String,
    /// Path of a database; `-` for other captures, which are known by their content.
    pub path: String,
}

/// Properties of a file that differ once it was written to.
#[derive(Clone, PartialEq, Eq, Debug)]
struct FileState {
    size: u64,
    modified: Option<SystemTime>,
}

impl FileState {
    fn new(found: &Metadata) -> Self {
        Self { size: found.len(), modified: found.modified().ok() }
    }
}

/// Hashes a content in two ways, as it is read.
#[derive(Default)]
struct ContentHasher {
    all: blake3::Hasher,
    body: blake3::Hasher,
    /// Bytes read so far, and those of the header that the body lacks.
    size: u64,
    header: usize,
}

impl ContentHasher {
    fn update(&mut self, bytes: &[u8]) {
        if self.size == 0 && bytes.starts_with(BLF_MAGIC) {
            self.header = BLF_HEADER;
        }
        // The header of a BLF file counts its objects, and changes while the file grows.
        let skipped = self.header.saturating_sub(saturating(self.size));
        self.all.update(bytes);
        self.body.update(&bytes[skipped.min(bytes.len())..]);
        self.size += bytes.len() as u64;
    }

    fn body(&self) -> String {
        self.body.finalize().to_hex().to_string()
    }
}

impl CaptureContent {
    /// The content as a line of a note.
    #[must_use]
    pub fn to_line(&self) -> String {
        let Self { blake3, size, body, path } = self;
        format!("{blake3} {size} {body} {}", escape(path))
    }

    /// Reads such a line; `None` for any other.
    #[must_use]
    pub fn from_line(line: &str) -> Option<Self> {
        let mut words = line.split(' ');
        let blake3 = words.next()?.to_owned();
        let (size, body) = (words.next()?.parse().ok()?, words.next()?.to_owned());
        Some(Self { blake3, size, body, path: unescape(words.next()?) })
    }
}

impl CaptureFile {
    /// Reads a file. Its rows are called by `name`, by which it is also found again when it has grown.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn read(path: &Path, name: &str) -> io::Result<Self> {
        let place = path.canonicalize()?.display().to_string();
        Self::read_copy(path, name, place)
    }

    /// Reads the copy of a file that is at `place`, which may be on another machine.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn read_copy(path: &Path, name: &str, place: String) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let state = FileState::new(&file.metadata()?);
        let (mut hasher, mut piece) = (ContentHasher::default(), vec![0; READ_SIZE]);
        let mut is_database = false;
        loop {
            let count = file.read(&mut piece)?;
            if count == 0 {
                break;
            }
            is_database |= hasher.size == 0 && piece[..count].starts_with(SQLITE_MAGIC);
            hasher.update(&piece[..count]);
        }
        let content = CaptureContent {
            blake3: hasher.all.finalize().to_hex().to_string(),
            size: hasher.size,
            body: hasher.body(),
            // The path means nothing to others, and would make two equal data sets differ.
            path: if is_database { place } else { NO_PATH.to_owned() },
        };
        Ok(Self { path: path.to_owned(), name: name.to_owned(), state, content, is_database })
    }

    /// Name of the capture in its rows.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The content that was read.
    #[must_use]
    pub const fn content(&self) -> &CaptureContent {
        &self.content
    }

    /// Returns whether nothing wrote to the file since it was read, by its size and time.
    #[must_use]
    pub fn is_unchanged(&self) -> bool {
        let now = std::fs::metadata(&self.path);
        // Reading went to the end of the file, which was elsewhere if it grew meanwhile.
        now.is_ok_and(|now| FileState::new(&now) == self.state)
            && self.content.size == self.state.size
    }

    /// Earlier contents of which this file is a continuation: it begins with all of their bytes. A database, which
    /// changes in place, is a continuation of the previous content of its path.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn grown_from(&self, earlier: &[CaptureContent]) -> io::Result<Vec<CaptureContent>> {
        let is_other = |other: &&CaptureContent| other.blake3 != self.content.blake3;
        if self.is_database {
            return Ok(earlier
                .iter()
                .filter(is_other)
                .filter(|other| other.path == self.content.path)
                .cloned()
                .collect());
        }
        let mut shorter: Vec<&CaptureContent> = earlier.iter().filter(is_other).collect();
        shorter.retain(|other| other.size > 0 && other.size <= self.content.size);
        // By length, so that one pass over the file checks them all.
        shorter.sort_by_key(|other| other.size);
        let (mut grown, mut hasher) = (Vec::new(), ContentHasher::default());
        let mut file = io::BufReader::with_capacity(READ_SIZE, File::open(&self.path)?);
        let mut piece = vec![0; READ_SIZE];
        for other in shorter {
            while hasher.size < other.size {
                let wanted = (other.size - hasher.size).min(READ_SIZE as u64) as usize;
                file.read_exact(&mut piece[..wanted])?;
                hasher.update(&piece[..wanted]);
            }
            if hasher.body() == other.body {
                grown.push(other.clone());
            }
        }
        Ok(grown)
    }
}

fn unescape(word: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = word.as_bytes();
    while let [first, others @ ..] = rest {
        let code = match (first, others) {
            (b'%', [high, low, ..]) => {
                u8::from_str_radix(&String::from_utf8_lossy(&[*high, *low]), 16).ok()
            }
            _ => None,
        };
        bytes.push(code.unwrap_or(*first));
        rest = if code.is_some() { &others[2..] } else { others };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    fn read(path: &Path) -> CaptureFile {
        CaptureFile::read(path, "a").unwrap()
    }

    #[test]
    fn a_file_has_grown_from_what_it_begins_with() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.log");
        std::fs::write(&path, "one\n").unwrap();
        let first = read(&path);
        std::fs::write(&path, "other\n").unwrap();
        let other = read(&path);
        std::fs::write(&path, "one\ntwo\n").unwrap();
        let second = read(&path);
        assert!(!first.is_unchanged() && second.is_unchanged());
        std::fs::OpenOptions::new().append(true).open(&path).unwrap().write_all(b"3\n").unwrap();
        let third = read(&path);
        let all: Vec<_> = [&second, &other, &first, &third].map(|it| it.content().clone()).into();
        let grown: Vec<_> = third.grown_from(&all).unwrap();
        assert_eq!(grown, [first.content().clone(), second.content().clone()]);
        assert_eq!(first.grown_from(&all).unwrap(), [], "the shorter one");
    }

    #[test]
    fn headers_and_pages_that_change_in_place_are_no_other_capture() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let blf = |count: u8, body: &str| {
            let mut file = b"LOGG".to_vec();
            file.resize(BLF_HEADER, count);
            file.extend(body.bytes());
            std::fs::write(&path, file).unwrap();
            read(&path)
        };
        let (first, second) = (blf(1, "objects"), blf(2, "objects, more"));
        assert_eq!(second.grown_from(&[first.content().clone()]).unwrap().len(), 1);
        assert_eq!(blf(3, "others").grown_from(&[first.content().clone()]).unwrap().len(), 0);
        let database = |path: &Path, page: &str| {
            std::fs::write(path, [SQLITE_MAGIC, page.as_bytes()].concat()).unwrap();
            read(path)
        };
        let (first, second) = (database(&path, "page"), database(&path, "changed"));
        assert_eq!(second.grown_from(&[first.content().clone()]).unwrap().len(), 1);
        let elsewhere = database(&folder.path().join("b"), "third");
        assert_eq!(elsewhere.grown_from(&[first.content().clone()]).unwrap().len(), 0);
    }
}
