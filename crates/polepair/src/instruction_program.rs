//! Programs with one instruction at each address (TMCL): assembler, disassembler and file format.
//!
//! A line holds an instruction (`MVP ABS, 0, 1000`), a constant (`Speed = 500`), a label (`Loop:`, also
//! before an instruction), `#include "FILE"`, or a comment (`// …`, `/* … */`). Fields are numbers (decimal,
//! `$1F` or `0x1F` hexadecimal, `%101` binary), constants, labels, and sums or products of them.
//!
//! Source: the reference and the firmware manuals of Trinamic's modules, chapters "programming techniques"
//! and "command overview". Instructions that the reference does not list are those of the maker's published
//! firmware.
//!
//! ```
//! use polepair::InstructionProgram;
//! let link = polepair::connect_local("sim:tmcm-1140?time=virtual")?;
//! let language = link.axis(1)?.instruction_language()?;
//! let text = "Speed = 500\nLoop: ROR 0, Speed\n JA Loop";
//! let program = InstructionProgram::assemble(language, "turn.tmc", text, None)?;
//! assert_eq!(program.instructions().len(), 2);
//! assert_eq!(program.label("loop"), Some(0));
//! assert_eq!(program.line_of(1).unwrap().number, 3);
//! # Ok::<(), polepair::Error>(())
//! ```

mod source;

use crate::toml_file::FileError;
use polepair_core::program::{INSTRUCTION_BYTES, InstructionBytes, InstructionLanguage};
use polepair_core::proto;
use source::SourceReader;
use std::fmt::Write as _;
use std::path::Path;

/// The largest file that is read, bytes.
const FILE_MAX: u64 = 1 << 20;
/// Files that may include one another.
const INCLUDE_MAX: usize = 16;
/// Bytes of an instruction in a binary file, as the maker's IDE writes it.
const RECORD: usize = INSTRUCTION_BYTES + 1;
/// Column of comments in a listing.
const COMMENT_COLUMN: usize = 36;

/// A program: instructions, with the lines and labels of the text that they were made of.
#[derive(Clone)]
pub struct InstructionProgram {
    language: &'static dyn InstructionLanguage,
    instructions: Vec<InstructionBytes>,
    /// The file of its text, as it was named; empty without one.
    file: String,
    /// The line of each; empty for a program that was read from a drive or a binary file.
    lines: Vec<SourceLine>,
    labels: Vec<(String, u16)>,
}

impl std::fmt::Debug for InstructionProgram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} instructions", self.instructions.len())
    }
}

/// A line of a program's text.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SourceLine {
    /// The file, as it was named.
    pub file: String,
    /// Number of the line, from 1.
    pub number: u32,
    /// Text without surrounding spaces.
    pub text: String,
}

impl InstructionProgram {
    /// Reads a file: instructions of eight bytes if it is called `.bin`, else text.
    ///
    /// # Errors
    /// [`FileError`] with file, line, column and reason.
    pub fn read(
        language: &'static dyn InstructionLanguage,
        path: &Path,
    ) -> Result<Self, FileError> {
        let file = path.display().to_string();
        let bytes = read_file(path).map_err(|reason| FileError::for_file(&file, reason))?;
        if is_binary(path) {
            return Self::from_binary(language, &file, &bytes);
        }
        Self::assemble(language, &file, &String::from_utf8_lossy(&bytes), path.parent())
    }

    /// Makes instructions of a program's text. Files that it includes are looked for in `folder`.
    ///
    /// # Errors
    /// [`FileError`] with file, line, column and reason.
    pub fn assemble(
        language: &'static dyn InstructionLanguage,
        file: &str,
        text: &str,
        folder: Option<&Path>,
    ) -> Result<Self, FileError> {
        let mut source = SourceReader::new(language);
        source.read(file, text, folder, 0)?;
        source.finish(file)
    }

    /// The program of a drive's memory.
    #[must_use]
    pub fn from_instructions(
        language: &'static dyn InstructionLanguage,
        instructions: Vec<InstructionBytes>,
    ) -> Self {
        Self { language, instructions, file: String::new(), lines: Vec::new(), labels: Vec::new() }
    }

    fn from_binary(
        language: &'static dyn InstructionLanguage,
        file: &str,
        bytes: &[u8],
    ) -> Result<Self, FileError> {
        let (records, rest) = bytes.as_chunks::<RECORD>();
        if records.is_empty() || !rest.is_empty() {
            let reason =
                format!("{} bytes: a program has {RECORD} for each instruction", bytes.len());
            return Err(FileError::for_file(file, reason));
        }
        Ok(Self::from_instructions(language, records.iter().map(|[head @ .., _]| *head).collect()))
    }

    /// The bytes of a binary file: those of each instruction, and a zero.
    #[must_use]
    pub fn to_binary(&self) -> Vec<u8> {
        self.instructions.iter().flat_map(|bytes| bytes.iter().copied().chain([0])).collect()
    }

    /// The instructions, from address 0 on.
    #[must_use]
    pub fn instructions(&self) -> &[InstructionBytes] {
        &self.instructions
    }

    /// The address of a label; letter case does not matter.
    #[must_use]
    pub fn label(&self, name: &str) -> Option<u16> {
        let found = self.labels.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
        found.map(|(_, address)| *address)
    }

    /// The labels, in the order of their addresses.
    pub fn labels(&self) -> impl Iterator<Item = (&str, u16)> {
        self.labels.iter().map(|(name, address)| (name.as_str(), *address))
    }

    /// The line that an instruction was made of.
    #[must_use]
    pub fn line_of(&self, address: u16) -> Option<&SourceLine> {
        self.lines.get(usize::from(address))
    }

    /// The first instruction at a line of the program's own file, or behind it; files that it includes do
    /// not count.
    #[must_use]
    pub fn address_of_line(&self, number: u32) -> Option<u16> {
        let at =
            self.lines.iter().position(|line| line.file == self.file && line.number >= number)?;
        u16::try_from(at).ok()
    }

    /// An instruction as text: `MVP ABS, 0, 1000`; jumps name labels.
    #[must_use]
    pub fn instruction_text(&self, address: u16) -> Option<String> {
        let instruction = *self.instructions.get(usize::from(address))?;
        let mut pieces: Vec<String> = Vec::new();
        self.language.write(instruction, &mut |piece| pieces.push(piece.to_owned()));
        if let Some(target) = self.language.role(instruction).target
            && let Some((name, _)) = self.labels.iter().find(|(_, at)| *at == target)
            && let Some(last) = pieces.last_mut()
        {
            name.clone_into(last);
        }
        Some(pieces.concat())
    }

    /// The program with a label at each jump target: `L12` if the text has none.
    #[must_use]
    pub fn with_labels(&self) -> Self {
        let mut named = self.clone();
        for instruction in &self.instructions {
            let Some(target) = self.language.role(*instruction).target else { continue };
            let known = named.labels.iter().any(|(_, at)| *at == target);
            if !known && usize::from(target) < self.instructions.len() {
                named.labels.push((format!("L{target}"), target));
            }
        }
        named.labels.sort_by_key(|(_, at)| *at);
        named
    }

    /// The text that the instructions stand for, with addresses as comments. It assembles to the same
    /// instructions.
    #[must_use]
    pub fn listing(&self) -> String {
        let named = self.with_labels();
        let mut text = String::new();
        for (address, instruction) in (0..).zip(&self.instructions) {
            for (name, _) in named.labels.iter().filter(|(_, at)| *at == address) {
                let _ = writeln!(text, "{name}:");
            }
            let line = format!(
                "    {}",
                named.instruction_text(address).expect("an address of the program")
            );
            let [opcode, kind, motor, value @ ..] = *instruction;
            let value = u32::from_be_bytes(value);
            let _ = writeln!(
                text,
                "{line:<COMMENT_COLUMN$}// {address:4}: {opcode:02X} {kind:02X} {motor:02X} \
                 {value:08X}"
            );
        }
        text
    }
}

/// The language of a file, by its name: `moves.tmc`. A file that holds bytes is the first language's.
#[must_use]
pub fn language_of(path: &Path) -> Option<&'static dyn InstructionLanguage> {
    let mut languages = proto::dissectors().iter().filter_map(|known| known.instruction_language());
    languages.find(|language| has_extension(language.extension(), path) || is_binary(path))
}

fn has_extension(extension: &str, path: &Path) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// Returns whether a file holds instructions as bytes, by its name.
#[must_use]
pub fn is_binary(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("bin"))
}

fn read_file(path: &Path) -> Result<Vec<u8>, String> {
    let size = std::fs::metadata(path).map_err(|error| error.to_string())?.len();
    if size > FILE_MAX {
        return Err(format!("larger than {FILE_MAX} bytes: is it a program?"));
    }
    std::fs::read(path).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::InstructionProgram;
    use polepair_core::program::InstructionLanguage;
    use std::path::Path;

    const TEXT: &str = "\
// Turns back and forth.
#include \"constants.tmc\"
Here = 0
/* two
   lines */
        SAP 4, 0, Speed     // speed of moves
Loop:   MVP ABS, 0, Here + 2 * (There - 1)
        WAIT POS, 0, 0
        CSUB Blink
        JC ZE, Loop
        CALCV ADD, 1, -$10
        CALCVA LOAD, 2
        JA Loop
Blink:
        SIO 0, 2, %1
        WAIT TICKS, 0, 50
        RSUB
";

    fn language() -> &'static dyn InstructionLanguage {
        super::language_of(Path::new("a.tmc")).unwrap()
    }

    fn assemble(text: &str) -> Result<InstructionProgram, String> {
        let made = InstructionProgram::assemble(language(), "a.tmc", text, None);
        made.map_err(|error| error.to_string())
    }

    fn folder() -> std::path::PathBuf {
        let folder = std::env::temp_dir().join(format!("polepair-tmc-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_program_of_the_ide_becomes_instructions_and_text_again() {
        let folder = folder();
        std::fs::write(folder.join("constants.tmc"), "Speed = $1F4\nThere=51\n").unwrap();
        let program =
            InstructionProgram::assemble(language(), "a.tmc", TEXT, Some(&folder)).unwrap();
        let texts: Vec<_> = (0..11).filter_map(|at| program.instruction_text(at)).collect();
        assert_eq!(
            texts,
            [
                "SAP 4, 0, 500",
                "MVP ABS, 0, 100",
                "WAIT POS, 0, 0",
                "CSUB Blink",
                "JC ZE, Loop",
                "CALCV ADD, 1, -16",
                "CALCVA LOAD, 2",
                "JA Loop",
                "SIO 0, 2, 1",
                "WAIT TICKS, 0, 50",
                "RSUB",
            ]
        );
        assert_eq!((program.label("LOOP"), program.label("blink")), (Some(1), Some(8)));
        assert_eq!(program.line_of(1).unwrap().number, 7);
        assert_eq!(program.address_of_line(14), Some(8), "the line of the label");
        let again = assemble(&program.listing()).unwrap();
        assert_eq!(again.instructions(), program.instructions());
        // A line is one of the program's own file, whichever instruction is first.
        std::fs::write(folder.join("first.tmc"), "CLE ALL\nCLE ALL\nCLE ALL\n").unwrap();
        let text = "#include \"first.tmc\"\nSTOP\n";
        let included =
            InstructionProgram::assemble(language(), "a.tmc", text, Some(&folder)).unwrap();
        assert_eq!(included.address_of_line(2), Some(3));
        let path = folder.join("a.bin");
        std::fs::write(&path, program.to_binary()).unwrap();
        assert_eq!(
            InstructionProgram::read(language(), &path).unwrap().instructions(),
            program.instructions()
        );
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_wrong_text_is_reported_by_its_place() {
        for (text, told) in [
            (
                "MVP ABS, 0, 1\nMPV ABS, 0, 1",
                "a.tmc:2:1: no instruction `MPV`; did you mean `MVP`?",
            ),
            ("GET VERSION", "a.tmc:1:1: no instruction `GET`"),
            ("Loop: JA Lop", "a.tmc:1:10: no constant or label `Lop`; did you mean `Loop`?"),
            ("SAP 4, 0", "a.tmc:1:9: SAP has 3 fields"),
            ("SAP 300, 0, 1", "a.tmc:1:5: `300`: expected a type or parameter number, 0 to 255"),
            ("ROR 0, 3000000000", "a.tmc:1:8: `3000000000`: expected a value"),
            ("WAIT SOON, 0, 1", "a.tmc:1:6: no constant or label `SOON`"),
            ("A: STOP\na: STOP", "a.tmc:2:1: `a` is already defined"),
            ("A = 1\nA = 2", "a.tmc:2:1: `A` is already defined"),
            ("A = 1 / 0", "a.tmc:1:4: the number is too large, or divided by zero"),
            ("STOP /* \n", "a.tmc:1:0"),
            ("#include \"not-there.tmc\"", "a.tmc:1:1: not-there.tmc: "),
            ("#define A 1", "a.tmc:1:1: `#define`: expected `#include \"FILE\"`"),
            ("// nothing", "a.tmc: there is no instruction in it"),
            ("STOP, 1, 2, 3, 4", "a.tmc:1:"),
        ] {
            let error = assemble(text).unwrap_err();
            assert!(error.starts_with(told), "{text}: {error}");
        }
    }

    #[test]
    fn every_instruction_of_the_language_is_written_and_read() {
        for opcode in 1..128 {
            for rest in [[0; 6], [1, 2, 0xFF, 0xFF, 0xFF, 0xFD], [200, 5, 0, 1, 0x11, 0x70]] {
                let [kind, motor, a, b, c, d] = rest;
                let instruction = [opcode, kind, motor, a, b, c, d];
                let program = InstructionProgram::from_instructions(language(), vec![instruction]);
                let listing = program.listing();
                // A number without a name is written, and is no instruction.
                let named = !listing.trim_start().starts_with(|c: char| c.is_ascii_digit());
                match assemble(&listing) {
                    Ok(again) => {
                        assert_eq!(again.instructions(), program.instructions(), "{listing}")
                    }
                    Err(error) => assert!(!named, "{listing}{error}"),
                }
            }
        }
    }
}
