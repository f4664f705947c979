//! Ids of decisions that code and documents cite must exist, each once.

use std::collections::BTreeSet;
use std::path::Path;

use super::{display_path, docs, read_text, rust_files};

/// Every id that is cited and not decided, and every one that is decided twice.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let (mut ids, mut broken) = (BTreeSet::new(), Vec::new());
    let pages = docs::doc_pages(root);
    for file in pages.iter().filter(|file| file.starts_with(root.join("docs/decisions"))) {
        let text = read_text(file);
        for id in text.lines().filter_map(|line| line.strip_prefix("## ")) {
            if is_id(id) && !ids.insert(id.to_owned()) {
                broken.push(format!("{}: {id} is decided twice", display_path(root, file)));
            }
        }
    }
    for file in pages.into_iter().chain(rust_files(root)) {
        let text = read_text(&file);
        let missing = undecided_ids(&text, &ids).into_iter();
        broken.extend(
            missing.map(|id| format!("{}: nobody decided {id}", display_path(root, &file))),
        );
    }
    broken
}

/// Words that look like an id of a known subject and are not in `ids`.
pub(crate) fn undecided_ids(text: &str, ids: &BTreeSet<String>) -> BTreeSet<String> {
    let subjects: BTreeSet<String> = ids.iter().filter_map(|id| decision_subject(id)).collect();
    let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '-');
    let cited = words.filter(|word| {
        is_id(word) && decision_subject(word).is_some_and(|s| subjects.contains(&s))
    });
    cited.filter(|word| !ids.contains(*word)).map(str::to_owned).collect()
}

fn decision_subject(id: &str) -> Option<String> {
    id.split_once('-').map(|(subject, _)| subject.to_owned())
}

/// `STOP-12`.
fn is_id(word: &str) -> bool {
    word.split_once('-').is_some_and(|(subject, number)| {
        let upper = subject.len() > 1 && subject.bytes().all(|byte| byte.is_ascii_uppercase());
        upper && !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}
