//! Commands that README and docs show must exist, and every error's code must be explained.

use super::read_text;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Every command in a code block of the documentation that no program knows.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let verbs = command_verbs(root);
    let targets = make_targets(root);
    let mut broken = Vec::new();
    for file in doc_pages(root) {
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let shown = file.strip_prefix(root).unwrap_or(&file).display().to_string();
        for (line, what) in unknown_commands(&text, &verbs, &targets) {
            broken.push(format!("{shown}:{line}: {what}"));
        }
    }
    broken.extend(check_codes(root));
    broken.extend(check_tests(root));
    broken
}

/// Tests that the tables of protocol pages name, and that there are not.
fn check_tests(root: &Path) -> Vec<String> {
    let known: BTreeSet<String> = super::rust_files(root)
        .iter()
        .filter_map(|file| std::fs::read_to_string(file).ok())
        .flat_map(|text| {
            let names = text.split("#[test]").skip(1).filter_map(|rest| {
                let name = rest.split_once("fn ")?.1.split('(').next()?;
                Some(name.to_owned())
            });
            names.collect::<Vec<_>>()
        })
        .collect();
    let mut broken = Vec::new();
    for file in doc_pages(root).into_iter().filter(|file| file.starts_with(root.join(PROTOCOLS))) {
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let shown = file.strip_prefix(root).unwrap_or(&file).display().to_string();
        for (line, name) in named_tests(&text) {
            if !known.contains(&name) {
                broken.push(format!("{shown}:{line}: no test is called `{name}`"));
            }
        }
    }
    broken
}

/// Pages whose tables name tests.
const PROTOCOLS: &str = "docs/protocols";

/// Line numbers and names in the last column of tables whose head ends with `test`.
pub(crate) fn named_tests(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut inside = false;
    for (number, line) in (1..).zip(text.lines()) {
        inside = line.starts_with('|') && (inside || line.ends_with("| test |"));
        let Some(cell) = line.trim_end_matches('|').rsplit('|').next().filter(|_| inside) else {
            continue;
        };
        found.extend(cell.split('`').skip(1).step_by(2).map(|name| (number, name.to_owned())));
    }
    found
}

/// Codes of errors that the code gives and the page on exit codes does not explain.
fn check_codes(root: &Path) -> Vec<String> {
    let page = read_text(root.join(CODES));
    let explained = explained_codes(&page);
    let mut broken = Vec::new();
    for file in super::rust_files(root) {
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let shown = file.strip_prefix(root).unwrap_or(&file).display();
        let given = text.split('"').filter_map(parse_code).filter(|code| !explained.contains(code));
        broken.extend(given.map(|code| format!("{shown}: {CODES} does not explain E{code}")));
    }
    broken
}

/// The page that explains the codes of errors.
const CODES: &str = "docs/reference/exit-codes.md";

/// The codes that a page names, by `E101` or by the ends of a range.
pub(crate) fn explained_codes(page: &str) -> BTreeSet<u16> {
    let words: Vec<&str> = page.split('`').collect();
    let ranges = words.windows(3).filter(|three| three[1] == " to ");
    let ranges = ranges.filter_map(|three| Some(parse_code(three[0])?..=parse_code(three[2])?));
    words.iter().filter_map(|word| parse_code(word)).chain(ranges.flatten()).collect()
}

/// The number of `E101`.
fn parse_code(word: &str) -> Option<u16> {
    let digits = word.strip_prefix('E').filter(|digits| digits.len() == 3)?;
    digits.parse().ok()
}

/// Line numbers and complaints for the commands in code blocks.
pub(crate) fn unknown_commands(
    text: &str,
    verbs: &[String],
    targets: &[String],
) -> Vec<(usize, String)> {
    let mut broken = Vec::new();
    let mut inside = false;
    for (n, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            inside = !inside;
            continue;
        }
        let mut words = line.trim_start().trim_start_matches("$ ").split_whitespace();
        let (program, word) = (words.next(), words.next());
        let (Some(program), Some(word), true) = (program, word, inside) else { continue };
        let plain = word.chars().all(|c| c.is_ascii_lowercase() || c == '-') && word.len() > 1;
        let known = match program {
            "polepair" => verbs,
            "make" => targets,
            _ => continue,
        };
        if plain && !word.starts_with('-') && !known.iter().any(|verb| verb == word) {
            broken.push((n + 1, format!("`{program} {word}` does not exist")));
        }
    }
    broken
}

pub(super) fn doc_pages(root: &Path) -> Vec<PathBuf> {
    let mut pages = vec![root.join("README.md"), root.join("CONTRIBUTING.md")];
    let mut folders = vec![root.join("docs")];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else { continue };
        for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                pages.push(path);
            }
        }
    }
    pages.sort();
    pages
}

/// The variants of the command line's enum of verbs, as they are typed.
fn command_verbs(root: &Path) -> Vec<String> {
    let text = read_text(root.join("crates/cli/src/cmd/mod.rs"));
    let items = syn::parse_file(&text).expect("the compiler has parsed it").items;
    let verbs = items.iter().find_map(|item| match item {
        syn::Item::Enum(item) if item.ident == "CommandVerb" => Some(item),
        _ => None,
    });
    let names = verbs.into_iter().flat_map(|verbs| &verbs.variants);
    names.map(|variant| kebab_case(&variant.ident.to_string())).collect()
}

/// A variant as it is typed: `RecordInDrive` is `record-in-drive`.
fn kebab_case(name: &str) -> String {
    let mut typed = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !typed.is_empty() {
            typed.push('-');
        }
        typed.extend(letter.to_lowercase());
    }
    typed
}

fn make_targets(root: &Path) -> Vec<String> {
    let text = read_text(root.join("Makefile"));
    let heads =
        text.lines().filter(|line| !line.starts_with(['\t', ' ', '#', '.'])).filter_map(line_head);
    heads.flat_map(|h| h.split_whitespace().map(str::to_owned).collect::<Vec<_>>()).collect()
}

fn line_head(line: &str) -> Option<String> {
    line.split_once(':').map(|(head, _)| head.to_owned())
}
