//! Commands that README and docs show must exist.

use std::path::{Path, PathBuf};

/// Verbs that the guides show ahead of the command line having them; each goes from here when its
/// file is there.
const COMING: [&str; 16] = [
    "ports", "scan", "info", "get", "set", "params", "enable", "disable", "stop", "clear", "spin",
    "move", "home", "watch", "sim", "demo",
];

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

/// One file a verb.
fn verbs(root: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(root.join("crates/cli/src/cmd")) else { return Vec::new() };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let stems = paths.filter_map(|path| path.file_stem()?.to_str().map(str::to_owned));
    stems
        .filter(|stem| stem != "mod")
        .chain(["help"].into_iter().chain(COMING).map(str::to_owned))
        .collect()
}

fn targets(root: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(root.join("Makefile")).unwrap_or_default();
    let head = |line: &str| line.split_once(':').map(|(head, _)| head.to_owned());
    let heads =
        text.lines().filter(|line| !line.starts_with(['\t', ' ', '#', '.'])).filter_map(head);
    heads.flat_map(|h| h.split_whitespace().map(str::to_owned).collect::<Vec<_>>()).collect()
}
