//! Plain language in help texts, errors and documents.
//!
//! Phrases that readers had to guess are refused, and so are sentences that are too long. The words between
//! backticks are code and are not checked. CONTRIBUTING.md has the rules of style.

use super::read_text;
use std::path::Path;

use clap::Command;
use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// Phrases that are refused, in lower case. Each has a plain equivalent.
const REFUSED: [(&str, &str); 10] = [
    ("stands", "is, is at standstill"),
    ("is told", "receives, is reported"),
    ("was told", "received"),
    ("are told", "receive, are reported"),
    ("owed", "pending"),
    ("nobody", "no client, no drive, no program"),
    ("somebody", "another client, another program"),
    ("what came", "the reply, the received frames"),
    ("said", "reported, sent"),
    ("heard", "received"),
];

/// Longest sentence of a help text or an error, in words.
const WORDS_MAX: usize = 30;

/// Crates whose texts a user reads as errors and notes.
const CRATES: [&str; 5] = ["cli", "polepair", "link", "client", "serve"];

/// Shortest text that is a sentence and not a name, in words.
const SENTENCE_MIN: usize = 2;

pub(crate) fn check(root: &Path) -> Vec<String> {
    let mut broken = Vec::new();
    let mut command = polepair_cli::command();
    command.build();
    check_help(&command, "", &mut broken);
    for file in super::rust_files(root) {
        let path = super::display_path(root, &file);
        let for_users = CRATES.iter().any(|name| path.starts_with(&format!("crates/{name}/src/")));
        if !for_users || path.ends_with("tests.rs") || path.contains("/tests/") {
            continue;
        }
        let text = read_text(&file);
        broken.extend(check_literals(&text).into_iter().map(|what| format!("{path}:{what}")));
    }
    for page in super::docs::doc_pages(root) {
        let path = super::display_path(root, &page);
        let text = read_text(&page);
        broken.extend(check_document(&text).into_iter().map(|what| format!("{path}:{what}")));
    }
    broken
}

fn check_help(command: &Command, path: &str, broken: &mut Vec<String>) {
    let path = format!("{path} {}", command.get_name()).trim().to_owned();
    let own = [command.get_about(), command.get_long_about(), command.get_after_help()];
    let arguments = command.get_arguments().flat_map(|arg| [arg.get_help(), arg.get_long_help()]);
    for text in own.into_iter().chain(arguments).flatten() {
        broken.extend(
            faults(&text.to_string()).into_iter().map(|what| format!("{path} --help: {what}")),
        );
    }
    for subcommand in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
        check_help(subcommand, &path, broken);
    }
}

/// Faults in the string literals of a source; tests and attributes are left out.
fn check_literals(source: &str) -> Vec<String> {
    let mut found = Vec::new();
    if let Ok(tokens) = source.parse::<TokenStream>() {
        visit(tokens, &mut found);
    }
    found
}

fn visit(tokens: TokenStream, found: &mut Vec<String>) {
    let mut tokens = tokens.into_iter().peekable();
    let mut of_test = false;
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Punct(mark) if mark.as_char() == '#' => {
                // An attribute; documentation comments are attributes too, those of modules with `!`.
                if matches!(tokens.peek(), Some(TokenTree::Punct(mark)) if mark.as_char() == '!') {
                    tokens.next();
                }
                if let Some(TokenTree::Group(attribute)) = tokens.peek()
                    && attribute.delimiter() == Delimiter::Bracket
                {
                    of_test |= attribute.to_string().replace(' ', "").contains("cfg(test)");
                    tokens.next();
                }
            }
            TokenTree::Group(group) => {
                let skipped = of_test && group.delimiter() == Delimiter::Brace;
                of_test &= !skipped;
                if !skipped {
                    visit(group.stream(), found);
                }
            }
            TokenTree::Literal(literal) => {
                let line = literal.span().start().line;
                let text = literal.to_string();
                if let Some(text) = text.strip_prefix('"') {
                    let text = text.trim_end_matches('"').replace("\\n", "\n").replace("\\\n", "");
                    if text.split_whitespace().count() >= SENTENCE_MIN {
                        found.extend(
                            faults(&text).into_iter().map(|what| format!("{line}: {what}")),
                        );
                    }
                }
            }
            TokenTree::Punct(mark) if mark.as_char() == ';' => of_test = false,
            _ => {}
        }
    }
}

/// Refused phrases of a document, with their lines. Blocks of code, and code in running text, are left out.
pub(crate) fn check_document(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut in_block = false;
    for (number, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            in_block = !in_block;
        } else if !in_block && !line.starts_with("    ") {
            found.extend(
                refused(&without_targets(line), &REFUSED)
                    .map(|what| format!("{}: {what}", number + 1)),
            );
        }
    }
    found
}

/// A line of a document without the targets of its links.
pub(super) fn without_targets(line: &str) -> String {
    let Some((first, rest)) = line.split_once("](") else { return line.to_owned() };
    let parts = rest.split("](");
    parts.fold(first.to_owned(), |text, part| {
        text + part.split_once(')').map_or("", |(_, rest)| rest)
    })
}

/// Faults of a text for users.
pub(crate) fn faults(text: &str) -> Vec<String> {
    let mut found: Vec<String> = refused(text, &REFUSED).collect();
    for paragraph in text.split("\n\n").filter(|paragraph| !paragraph.contains("\n  ")) {
        for sentence in paragraph.split(['.', ';', ':', '!', '?']).filter(|s| !s.is_empty()) {
            let words = sentence.split_whitespace().count();
            if words > WORDS_MAX {
                found.push(format!(
                    "a sentence of {words} words, at most {WORDS_MAX}: {}",
                    sentence.trim()
                ));
            }
        }
    }
    found
}

/// Phrases of a list in a text, each with its equivalents.
pub(super) fn refused<'a>(
    text: &str,
    phrases: &'a [(&'a str, &'a str)],
) -> impl Iterator<Item = String> + use<'a> {
    let prose: String = text.split('`').step_by(2).collect::<Vec<_>>().join(" ").to_lowercase();
    let words: Vec<&str> = prose
        .split(|c: char| !c.is_alphanumeric() && c != '\'')
        .filter(|w| !w.is_empty())
        .collect();
    let plain = format!(" {} ", words.join(" "));
    phrases
        .iter()
        .filter(move |(phrase, _)| plain.contains(&format!(" {phrase} ")))
        .map(|(phrase, instead)| format!("\"{phrase}\" (write: {instead})"))
}
