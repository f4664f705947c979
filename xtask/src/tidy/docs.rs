//! Commands that README and docs show must exist.

use std::path::{Path, PathBuf};

/// Every command in a code block of the documentation that no program knows.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let verbs = verbs(root);
    let targets = targets(root);
    let mut broken = Vec::new();
    for file in pages(root) {
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let shown = file.strip_prefix(root).unwrap_or(&file).display().to_string();
        for (line, what) in unknown(&text, &verbs, &targets) {
            broken.push(format!("{shown}:{line}: {what}"));
        }
    }
    broken
}

/// Line numbers and complaints for the commands in code blocks.
pub(crate) fn unknown(text: &str, verbs: &[String], targets: &[String]) -> Vec<(usize, String)> {
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

fn pages(root: &Path) -> Vec<PathBuf> {
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
fn verbs(root: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(root.join("crates/cli/src/cmd/mod.rs")).unwrap_or_default();
    let items = syn::parse_file(&text).map(|file| file.items).unwrap_or_default();
    let verbs = items.iter().find_map(|item| match item {
        syn::Item::Enum(item) if item.ident == "Verb" => Some(item),
        _ => None,
    });
    let names = verbs.into_iter().flat_map(|verbs| &verbs.variants);
    names.map(|variant| variant.ident.to_string().to_lowercase()).collect()
}

fn targets(root: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(root.join("Makefile")).unwrap_or_default();
    let head = |line: &str| line.split_once(':').map(|(head, _)| head.to_owned());
    let heads =
        text.lines().filter(|line| !line.starts_with(['\t', ' ', '#', '.'])).filter_map(head);
    heads.flat_map(|h| h.split_whitespace().map(str::to_owned).collect::<Vec<_>>()).collect()
}
