//! Programs in the memory of a drive: text of the drive's language, and software files (`.sw`).
//!
//! ```
//! use polepair::Program;
//! let text = "4000\n649C\n92\n0001\n\n5000\n1234\n";
//! let program = Program::parse_sw("cell.sw", text)?;
//! assert_eq!(program.pieces()[0].words, [0x649C, 0x0092, 0x0001]);
//! assert_eq!(program.pieces()[1].start, 0x5000);
//! assert_eq!(Program::parse_sw("again.sw", &program.to_sw())?, program);
//! # Ok::<(), polepair::Error>(())
//! ```

use crate::toml_file::FileError;
use polepair_core::convert::saturating;
use polepair_core::convert::text_from;
use polepair_core::profile::Profile;
use polepair_core::program::MemoryBlock;
use polepair_core::program::{
    LABELS_MAX, ListingSink, ProgramLabel, ProgramLanguage, SourceError, WORDS_MAX,
};
use std::fmt::Write as _;
use std::path::Path;

/// The largest file that is read, bytes.
const FILE_MAX: u64 = 4 << 20;

/// Words at addresses, with names for some of these.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Program {
    pieces: Vec<MemoryBlock>,
    labels: Vec<(String, u16)>,
}

/// Context for assembling a text.
#[derive(Clone, Copy)]
pub struct AssemblyContext<'a> {
    /// The language.
    pub language: &'a dyn ProgramLanguage,
    /// Names of the drive's variables.
    pub profile: Option<&'static Profile>,
    /// Address of the first word.
    pub origin: u16,
}

impl std::fmt::Debug for AssemblyContext<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = self.profile.map(|profile| profile.name);
        write!(f, "Source({name:?} at {:04X})", self.origin)
    }
}

impl Program {
    /// Words that lie one after the other.
    #[must_use]
    pub fn from_words(start: u16, words: Vec<u16>) -> Self {
        Self { pieces: vec![MemoryBlock { start, words }], labels: Vec::new() }
    }

    /// Reads a file: a software file if it is called `.sw`, else text.
    ///
    /// # Errors
    /// [`FileError`] with file, line, column and reason.
    pub fn read(path: &Path, source: &AssemblyContext<'_>) -> Result<Self, FileError> {
        let file = path.display().to_string();
        let size =
            std::fs::metadata(path).map_err(|e| whole_file_error(e.to_string(), &file))?.len();
        if size > FILE_MAX {
            return Err(whole_file_error(
                format!("larger than {FILE_MAX} bytes: is it a program?"),
                &file,
            ));
        }
        let text = std::fs::read(path).map_err(|e| whole_file_error(e.to_string(), &file))?;
        let text = String::from_utf8_lossy(&text);
        if is_software(path) {
            Self::parse_sw(&file, &text)
        } else {
            Self::assemble(&file, &text, source)
        }
    }

    /// Makes words of a program's text.
    ///
    /// # Errors
    /// [`FileError`] with the line, the column, and what should stand there.
    pub fn assemble(
        file: &str,
        text: &str,
        source: &AssemblyContext<'_>,
    ) -> Result<Self, FileError> {
        let (mut words, mut labels) =
            (vec![0; WORDS_MAX], vec![ProgramLabel::default(); LABELS_MAX]);
        let AssemblyContext { language, profile, origin } = *source;
        let made = language
            .assemble(text, origin, profile, &mut words, &mut labels)
            .map_err(|error| source_error(file, text, &error))?;
        // A file of comments alone is a mistake, and loading it would report success.
        if made.words == 0 {
            return Err(FileError::for_file(file, "there is no instruction in it"));
        }
        words.truncate(made.words);
        let labels = labels[..made.labels].iter().map(|l| (l.name.to_owned(), l.address));
        Ok(Self { labels: labels.collect(), ..Self::from_words(origin, words) })
    }

    /// Reads a software file, as the vendor's tools write them: blocks that blank lines part, in each
    /// the address of its first word, then its words, every one a line of at most four hexadecimal
    /// digits ("Setup download and SW file checking", Technosoft's knowledge base; TML_LIB_light).
    /// It has no sum of its own: the drive is asked for the sum of each block.
    ///
    /// # Errors
    /// [`FileError`] with line, column and reason.
    pub fn parse_sw(file: &str, text: &str) -> Result<Self, FileError> {
        let mut pieces: Vec<MemoryBlock> = Vec::new();
        let (mut open, mut total) = (false, 0);
        for (line, digits) in (1..).zip(text.lines().map(str::trim)) {
            let word = match digits {
                "" => {
                    open = false;
                    continue;
                }
                digits => parse_hex_word(digits)
                    .ok_or_else(|| line_error(not_hex_reason(digits), line, file))?,
            };
            match pieces.last_mut().filter(|_| open) {
                Some(piece) => piece.words.push(word),
                None => pieces.push(MemoryBlock { start: word, words: Vec::new() }),
            }
            (open, total) = (true, total + 1);
            if total > WORDS_MAX {
                return Err(line_error(format!("more than {WORDS_MAX} words"), line, file));
            }
        }
        // The whole file, before a word of it is sent.
        check_layout(file, &pieces)?;
        Ok(Self { pieces, labels: Vec::new() })
    }

    /// The text of a software file.
    #[must_use]
    pub fn to_sw(&self) -> String {
        let mut text = String::new();
        for (n, piece) in self.pieces.iter().enumerate() {
            text.push_str(if n == 0 { "" } else { "\n" });
            for word in std::iter::once(&piece.start).chain(&piece.words) {
                // Writing into a String cannot fail.
                let _ = writeln!(text, "{word:04X}");
            }
        }
        text
    }

    /// The text that its words stand for, with their addresses as comments. Of a single piece it
    /// assembles to the same words.
    #[must_use]
    pub fn listing(
        &self,
        language: &dyn ProgramLanguage,
        profile: Option<&'static Profile>,
    ) -> String {
        let mut lines = ListingWriter::default();
        for piece in &self.pieces {
            language.disassemble(piece.start, &piece.words, profile, &mut lines);
        }
        lines.end_line();
        lines.text
    }

    /// Words of the program, in pieces.
    #[must_use]
    pub fn pieces(&self) -> &[MemoryBlock] {
        &self.pieces
    }

    /// Number of words.
    #[must_use]
    pub fn words(&self) -> usize {
        self.pieces.iter().map(|piece| piece.words.len()).sum()
    }

    /// The address of a label, case-insensitive.
    #[must_use]
    pub fn label(&self, name: &str) -> Option<u16> {
        let found = self.labels.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
        found.map(|(_, address)| *address)
    }

    /// The labels of its text.
    pub fn labels(&self) -> impl Iterator<Item = (&str, u16)> {
        self.labels.iter().map(|(name, address)| (name.as_str(), *address))
    }
}

fn line_error(reason: String, line: u32, file: &str) -> FileError {
    FileError { line, column: 1, ..file_error(file, reason) }
}

fn whole_file_error(reason: String, file: &str) -> FileError {
    FileError::for_file(file, reason)
}

/// A listing, an instruction a line.
#[derive(Default)]
struct ListingWriter {
    text: String,
    /// Length of the completed lines.
    line_start: usize,
    /// The comment of a line.
    comment: String,
}

/// Column of comments.
const COMMENT_COLUMN: usize = 32;

impl ListingWriter {
    fn end_line(&mut self) {
        let len = self.text[self.line_start..].chars().count();
        if len > 0 {
            self.text.extend(std::iter::repeat_n(' ', COMMENT_COLUMN.saturating_sub(len)));
            self.text.push_str(&self.comment);
        }
        self.line_start = self.text.len();
    }
}

impl ListingSink for ListingWriter {
    fn instruction(&mut self, address: u16, words: &[u16]) {
        self.end_line();
        let words: String = words.iter().map(|word| format!(" {word:04X}")).collect();
        self.comment = format!(" // {address:04X}:{words}\n");
    }

    fn text(&mut self, piece: &str) {
        self.text.push_str(piece);
    }
}

/// Returns whether a file is a software file, by its name.
#[must_use]
pub fn is_software(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("sw"))
}

fn file_error(file: &str, reason: String) -> FileError {
    FileError::for_file(file, reason)
}

fn parse_hex_word(digits: &str) -> Option<u16> {
    let good = digits.len() <= 4 && digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    good.then(|| u16::from_str_radix(digits, 16).ok()).flatten()
}

fn not_hex_reason(digits: &str) -> String {
    let shown: String = digits.chars().take(20).collect();
    format!("`{shown}` is no word: a line has one of at most four hexadecimal digits, 0000 to FFFF")
}

/// Checks that the blocks have words, end within memory, and do not overlap.
fn check_layout(file: &str, pieces: &[MemoryBlock]) -> Result<(), FileError> {
    if pieces.is_empty() {
        return Err(file_error(file, "there is no block in it".to_owned()));
    }
    for (n, piece) in pieces.iter().enumerate() {
        let start = piece.start;
        if piece.words.is_empty() {
            return Err(file_error(file, format!("the block at {start:04X} has no words")));
        }
        if block_end(piece) > WORDS_MAX {
            return Err(file_error(file, format!("the block at {start:04X} goes beyond FFFF")));
        }
        if let Some(other) = pieces[..n].iter().find(|other| {
            usize::from(other.start) < block_end(piece) && usize::from(start) < block_end(other)
        }) {
            let other = other.start;
            return Err(file_error(
                file,
                format!("the blocks at {other:04X} and {start:04X} overlap"),
            ));
        }
    }
    Ok(())
}

fn block_end(piece: &MemoryBlock) -> usize {
    usize::from(piece.start) + piece.words.len()
}

/// A complaint about a place in a text.
fn source_error(file: &str, text: &str, error: &SourceError) -> FileError {
    let SourceError { line, at, expected } = *error;
    let source = text.lines().nth(line as usize - 1).unwrap_or("");
    let before = source.get(..at).unwrap_or(source);
    let column = saturating(before.chars().count() + 1);
    let found: String = text_from(source, at).trim().chars().take(24).collect();
    let reason = match found.as_str() {
        "" => format!("expected {expected}"),
        found => format!("`{found}`: expected {expected}"),
    };
    FileError { line, column, ..file_error(file, reason) }
}

#[cfg(test)]
mod tests {
    use super::{AssemblyContext, Program};
    use polepair_core::program::ProgramLanguage;
    use polepair_core::proto;

    fn language() -> &'static dyn ProgramLanguage {
        proto::find_dissector("tml").and_then(|dissector| dissector.program_language()).unwrap()
    }

    fn source(origin: u16) -> AssemblyContext<'static> {
        let profile = polepair_drives::profiles().iter().find(|p| p.protocol == "tml");
        AssemblyContext { language: language(), profile: profile.copied(), origin }
    }

    #[test]
    fn software_files_are_refused_with_line_and_reason() {
        let reason = |text: &str| Program::parse_sw("a.sw", text).unwrap_err().to_string();
        assert!(reason("4000\n12\nxyz\n").starts_with("a.sw:3:1: `xyz` is no word"));
        assert!(reason("4000\n12345\n").starts_with("a.sw:2:1: "), "five digits");
        assert!(reason("4000\n+12\n").starts_with("a.sw:2:1: "), "no signs");
        assert_eq!(reason("\n\n"), "a.sw: there is no block in it");
        assert_eq!(reason("4000\n1\n\n5000\n"), "a.sw: the block at 5000 has no words");
        assert_eq!(reason("FFFF\n1\n2\n"), "a.sw: the block at FFFF goes beyond FFFF");
        let overlap = "4000\n1\n2\n\n3FFF\n1\n2\n";
        assert_eq!(reason(overlap), "a.sw: the blocks at 4000 and 3FFF overlap");
        let dos = Program::parse_sw("a.sw", "\r\n4000\r\n1\r\n\r\n\r\n5000\r\n2\r\n").unwrap();
        assert_eq!((dos.pieces().len(), dos.words()), (2, 2));
    }

    #[test]
    fn text_becomes_words_and_words_text() {
        let text = "main: CPOS = 4000; CALL wait\n GOTO main // for ever\nwait: !MC; WAIT!; RET\n";
        let program = Program::assemble("a.tml", text, &source(0x8270)).unwrap();
        assert_eq!(program.label("WAIT"), Some(0x8277));
        assert_eq!(program.labels().count(), 2);
        let listed = program.listing(language(), source(0).profile);
        assert!(listed.contains("CPOS = 4000"), "{listed}");
        assert!(listed.lines().next().unwrap().ends_with("// 8270: 249E 0FA0 0000"), "{listed}");
        let again = Program::assemble("b.tml", &listed, &source(0x8270)).unwrap();
        assert_eq!(again.pieces(), program.pieces());
        let bad = Program::assemble("a.tml", "NOP\n  GOTO é", &source(0x8270)).unwrap_err();
        assert_eq!((bad.line, bad.column), (2, 8), "{bad}");
    }
}
