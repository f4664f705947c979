//! The reader of a program's text.

use super::{INCLUDE_MAX, InstructionProgram, SourceLine, read_file};
use crate::spelling;
use crate::toml_file::FileError;
use polepair_core::convert::saturating;
use polepair_core::convert::text_from;
use polepair_core::program::{InstructionBytes, InstructionLanguage};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Text as it is read: constants and labels, and instructions whose fields are not known yet.
pub struct SourceReader {
    language: &'static dyn InstructionLanguage,
    constants: HashMap<String, i64>,
    labels: Vec<(String, u16)>,
    statements: Vec<Statement>,
    open: Vec<PathBuf>,
}

/// An instruction of the text.
struct Statement {
    line: SourceLine,
    /// Position in the line, bytes, with the spaces before it.
    column: usize,
    text: String,
}

impl SourceReader {
    /// A reader of a text in that language.
    pub fn new(language: &'static dyn InstructionLanguage) -> Self {
        Self {
            language,
            constants: HashMap::new(),
            labels: Vec::new(),
            statements: Vec::new(),
            open: Vec::new(),
        }
    }

    pub fn read(
        &mut self,
        file: &str,
        text: &str,
        folder: Option<&Path>,
        depth: usize,
    ) -> Result<(), FileError> {
        let text = without_comments(file, text)?;
        for (number, whole) in (1..).zip(text.lines()) {
            let mut at = whole.len() - whole.trim_start().len();
            if let Some(rest) = whole[at..].trim_end().strip_prefix('#') {
                self.include(rest, folder, depth, &|reason| {
                    located_error(at, reason, number, whole, file)
                })?;
                continue;
            }
            // Labels stand before an instruction, or alone.
            while let Some(colon) = whole[at..].find(':') {
                let name = whole[at..at + colon].trim();
                if !is_name(name) {
                    return Err(located_error(
                        at,
                        format!("`{name}` is not a valid label"),
                        number,
                        whole,
                        file,
                    ));
                }
                if self.label(name).is_some() || self.constants.contains_key(&key(name)) {
                    return Err(located_error(
                        at,
                        format!("`{name}` is already defined"),
                        number,
                        whole,
                        file,
                    ));
                }
                let address = saturating(self.statements.len());
                self.labels.push((name.to_owned(), address));
                at += colon + 1;
                at += whole[at..].len() - whole[at..].trim_start().len();
            }
            let statement = whole[at..].trim_end();
            if statement.is_empty() {
                continue;
            }
            if let Some((name, value)) = statement.split_once('=') {
                let name = name.trim();
                if !is_name(name) {
                    return Err(located_error(
                        at,
                        format!("`{name}` is not a valid constant name"),
                        number,
                        whole,
                        file,
                    ));
                }
                let begin = at + statement.len() - value.len();
                let value = self
                    .evaluate(value)
                    .map_err(|reason| located_error(begin, reason, number, whole, file))?;
                // A file of constants may be included twice.
                let before = self.constants.insert(key(name), value);
                if before.is_some_and(|before| before != value) || self.label(name).is_some() {
                    return Err(located_error(
                        at,
                        format!("`{name}` is already defined"),
                        number,
                        whole,
                        file,
                    ));
                }
                continue;
            }
            let capacity = self.language.capacity();
            if self.statements.len() == capacity {
                return Err(located_error(
                    at,
                    format!("more than {capacity} instructions"),
                    number,
                    whole,
                    file,
                ));
            }
            let line = SourceLine { file: file.to_owned(), number, text: whole.trim().to_owned() };
            self.statements.push(Statement { line, column: at, text: statement.to_owned() });
        }
        Ok(())
    }

    fn include(
        &mut self,
        directive: &str,
        folder: Option<&Path>,
        depth: usize,
        refuse: &dyn Fn(String) -> FileError,
    ) -> Result<(), FileError> {
        let end = directive.find([' ', '\t', '"', '<']).unwrap_or(directive.len());
        let (word, name) = directive.split_at(end);
        let name = name.trim().trim_matches(['"', '<', '>']);
        if !word.eq_ignore_ascii_case("include") || name.is_empty() {
            return Err(refuse(format!("`#{word}`: expected `#include \"FILE\"`")));
        }
        let path = folder.map_or_else(|| PathBuf::from(name), |folder| folder.join(name));
        if depth == INCLUDE_MAX || self.open.contains(&path) {
            return Err(refuse(format!("{name} includes itself")));
        }
        let bytes = read_file(&path).map_err(|reason| refuse(format!("{name}: {reason}")))?;
        self.open.push(path.clone());
        let shown = path.display().to_string();
        self.read(&shown, &String::from_utf8_lossy(&bytes), path.parent(), depth + 1)?;
        self.open.pop();
        Ok(())
    }

    fn label(&self, name: &str) -> Option<u16> {
        self.labels.iter().find(|(known, _)| known.eq_ignore_ascii_case(name)).map(|(_, at)| *at)
    }

    /// All labels are known: the instructions.
    pub fn finish(self, file: &str) -> Result<InstructionProgram, FileError> {
        let mut program = InstructionProgram::from_instructions(self.language, Vec::new());
        for statement in &self.statements {
            program.instructions.push(self.instruction(statement)?);
        }
        if program.instructions.is_empty() {
            return Err(FileError::for_file(file, "there is no instruction in it"));
        }
        program.lines = self.statements.into_iter().map(|statement| statement.line).collect();
        program.labels = self.labels;
        file.clone_into(&mut program.file);
        Ok(program)
    }

    fn instruction(&self, statement: &Statement) -> Result<InstructionBytes, FileError> {
        let Statement { line, column, text } = statement;
        let name = text.split_once([' ', '\t', ',']).map_or(&**text, |(name, _)| name);
        let shape = self.language.fields(name).ok_or_else(|| {
            let words = (0..).map_while(|n| self.language.mnemonic(n));
            column_error(
                0,
                format!("no instruction `{name}`{}", spelling::suggestion(name, words)),
                column,
                &line.file,
                line.number,
            )
        })?;
        let (mut rewritten, mut places) = (name.to_owned(), Vec::new());
        let fields = &text[name.len()..];
        let mut at = name.len();
        for (n, piece) in fields.split(',').enumerate().filter(|_| !fields.trim().is_empty()) {
            let word = piece.trim();
            let begin = at + piece.len() - piece.trim_start().len();
            at += piece.len() + 1;
            rewritten.push_str(if n == 0 { " " } else { ", " });
            places.push((rewritten.len(), begin));
            if n == 0 && shape.words.iter().any(|(_, known)| known.eq_ignore_ascii_case(word)) {
                rewritten.push_str(word);
                continue;
            }
            let value = self
                .evaluate(word)
                .map_err(|reason| column_error(begin, reason, column, &line.file, line.number))?;
            let _ = write!(rewritten, "{value}");
        }
        let bytes = self.language.parse(&rewritten).map_err(|error| {
            let place = places.iter().rev().find(|(new, _)| *new <= error.at);
            let begin = place.map_or(text.len(), |(_, begin)| *begin);
            let found = text_from(text, begin);
            let reason = match found.split_once(',').map_or(found, |(field, _)| field).trim() {
                "" => format!("expected {}", error.expected),
                found => format!("`{found}`: expected {}", error.expected),
            };
            column_error(begin, reason, column, &line.file, line.number)
        })?;
        if places.len() < shape.count {
            return Err(column_error(
                text.len(),
                format!("{name} has {} fields", shape.count),
                column,
                &line.file,
                line.number,
            ));
        }
        Ok(bytes)
    }

    /// A sum of products of numbers and names.
    fn evaluate(&self, text: &str) -> Result<i64, String> {
        let mut rest = text.trim();
        let value = self.sum(&mut rest)?;
        match rest.trim() {
            "" => Ok(value),
            more => Err(format!("`{more}`: expected the end of the number")),
        }
    }

    fn sum(&self, rest: &mut &str) -> Result<i64, String> {
        let mut value = self.product(rest)?;
        loop {
            let (operator, behind) = next_character(rest);
            let Some(sign @ ('+' | '-')) = operator else { return Ok(value) };
            *rest = behind;
            let other = self.product(rest)?;
            value = if sign == '+' { value.checked_add(other) } else { value.checked_sub(other) }
                .ok_or("the number is too large")?;
        }
    }

    fn product(&self, rest: &mut &str) -> Result<i64, String> {
        let mut value = self.operand(rest)?;
        loop {
            let (operator, behind) = next_character(rest);
            let Some(operator @ ('*' | '/')) = operator else { return Ok(value) };
            *rest = behind;
            let other = self.operand(rest)?;
            value =
                if operator == '*' { value.checked_mul(other) } else { value.checked_div(other) }
                    .ok_or("the number is too large, or divided by zero")?;
        }
    }

    fn operand(&self, rest: &mut &str) -> Result<i64, String> {
        let (first, behind) = next_character(rest);
        match first {
            Some('-') => {
                *rest = behind;
                return self
                    .operand(rest)?
                    .checked_neg()
                    .ok_or_else(|| "the number is too large".into());
            }
            Some('(') => {
                *rest = behind;
                let value = self.sum(rest)?;
                let (Some(')'), behind) = next_character(rest) else {
                    return Err("a `)` is missing".into());
                };
                *rest = behind;
                return Ok(value);
            }
            _ => {}
        }
        let text = rest.trim_start();
        let end = text.char_indices().find(|(at, c)| {
            !(c.is_ascii_alphanumeric() || *c == '_' || (*at == 0 && "$%".contains(*c)))
        });
        let (word, behind) = text.split_at(end.map_or(text.len(), |(at, _)| at));
        *rest = behind;
        let binary = word.strip_prefix('%').map(|digits| i64::from_str_radix(digits, 2).ok());
        let number = binary.unwrap_or_else(|| parse_number(word));
        let named =
            || self.constants.get(&key(word)).copied().or_else(|| self.label(word).map(i64::from));
        number.or_else(named).ok_or_else(|| match word {
            "" if text.is_empty() => "expected a number or a name".to_owned(),
            "" => format!("`{text}`: expected a number or a name"),
            word => {
                let names = self.labels.iter().map(|(name, _)| name.as_str());
                let names = names.chain(self.constants.keys().map(String::as_str));
                format!("no constant or label `{word}`{}", spelling::suggestion(word, names))
            }
        })
    }
}

fn column_error(
    at: usize,
    reason: String,
    column: &usize,
    line_file: &str,
    line_number: u32,
) -> FileError {
    FileError {
        line: line_number,
        column: saturating(column + at + 1),
        ..FileError::for_file(line_file, reason)
    }
}

fn located_error(at: usize, reason: String, number: u32, whole: &str, file: &str) -> FileError {
    located(file, number, whole, at, reason)
}

/// A decimal or hexadecimal number.
fn parse_number(word: &str) -> Option<i64> {
    let hex = word.strip_prefix('$').or(word.strip_prefix("0x")).or(word.strip_prefix("0X"));
    match hex {
        Some(digits) => i64::from_str_radix(digits, 16).ok(),
        None => word.parse().ok(),
    }
}

/// Key by which names are compared.
fn key(name: &str) -> String {
    name.to_ascii_lowercase()
}

fn is_name(name: &str) -> bool {
    let mut characters = name.chars();
    characters.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
        && characters.all(|c| c.is_ascii_alphanumeric() || c == '_')
}

fn next_character(text: &str) -> (Option<char>, &str) {
    let text = text.trim_start();
    let first = text.chars().next();
    (first, &text[first.map_or(0, char::len_utf8)..])
}

/// The text with its comments as spaces: lines and columns stay.
fn without_comments(file: &str, text: &str) -> Result<String, FileError> {
    let mut out = String::with_capacity(text.len());
    let (mut block, mut line) = (None, 1);
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        line += u32::from(c == '\n');
        if block.is_some() && rest.starts_with("*/") {
            block = None;
            out.push_str("  ");
            rest = &rest[2..];
            continue;
        }
        if block.is_none() && rest.starts_with("/*") {
            block = Some(line);
            out.push_str("  ");
            rest = &rest[2..];
            continue;
        }
        if block.is_none() && rest.starts_with("//") {
            let end = rest.find('\n').unwrap_or(rest.len());
            rest = &rest[end..];
            continue;
        }
        let hidden = block.is_some() && c != '\n';
        out.push(if hidden { ' ' } else { c });
        rest = &rest[c.len_utf8()..];
    }
    match block {
        None => Ok(out),
        Some(line) => {
            let reason = "a comment that begins here has no `*/`".to_owned();
            Err(FileError { line, ..FileError::for_file(file, reason) })
        }
    }
}

fn located(file: &str, line: u32, text: &str, at: usize, reason: String) -> FileError {
    let column = saturating(text[..at].chars().count() + 1);
    FileError { line, column, ..FileError::for_file(file, reason) }
}
