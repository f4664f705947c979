//! The examples in the documentation work: blocks of commands are run, other `polepair` lines are checked against the
//! command line's grammar, links lead somewhere.

#[cfg(unix)]
mod pages;

use crate::run;

use std::path::{Path, PathBuf};

struct Block {
    /// Language of the block, as written after the fence.
    mark: String,
    line: usize,
    text: String,
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the repository")
}

fn pages() -> Vec<PathBuf> {
    let mut pages: Vec<PathBuf> = Vec::new();
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path)
            } else if path.extension().is_some_and(|e| e == "md") {
                pages.push(path)
            }
        }
    }
    let top = std::fs::read_dir(root()).expect("the repository").flatten();
    pages.extend(top.map(|e| e.path()).filter(|p| p.extension().is_some_and(|e| e == "md")));
    pages.sort();
    pages
}

fn text(page: &Path) -> String {
    std::fs::read_to_string(page).expect("a page")
}

fn blocks(page: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut open = false;
    for (n, line) in page.lines().enumerate() {
        if let Some(mark) = line.strip_prefix("```") {
            open = !open;
            if open {
                blocks.push(Block { mark: mark.trim().into(), line: n + 1, text: String::new() });
            }
        } else if let (true, Some(block)) = (open, blocks.last_mut()) {
            block.text += line;
            block.text.push('\n');
        }
    }
    assert!(!open, "a block that does not end");
    blocks
}

/// A line's words as a shell takes them, up to what is no longer this command's.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in line.chars() {
        match (quote, c) {
            (Some(q), c) if q == c => quote = None,
            (Some(_), c) => word.get_or_insert_default().push(c),
            (None, '"' | '\'') => {
                word.get_or_insert_default();
                quote = Some(c);
            }
            (None, '#') if word.is_none() => break,
            (None, '|' | '>' | '&' | ';') => break,
            (None, ' ') => words.extend(word.take()),
            (None, c) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

/// `polepair` commands that a page shows, wherever: in blocks and in running text.
fn shown(page: &str) -> Vec<String> {
    let (mut commands, mut open) = (Vec::new(), false);
    for line in page.lines() {
        if line.starts_with("```") {
            open = !open;
            continue;
        }
        let bare = line.trim_start().trim_start_matches("$ ");
        let block = open || line.starts_with("    ");
        if block && bare.starts_with("polepair ") && !bare.starts_with("polepair  ") {
            commands.push(bare.to_owned());
        }
        if !block {
            let quoted = line.split('`').skip(1).step_by(2);
            commands.extend(quoted.filter(|q| q.starts_with("polepair ")).map(str::to_owned));
        }
    }
    commands
}

#[test]
fn every_command_shown_is_of_the_grammar() {
    let (mut checked, mut wrong) = (0, String::new());
    for page in pages() {
        for command in shown(&text(&page)) {
            let all = words(&command);
            let rest: Vec<&str> = all[1..].iter().map(String::as_str).collect();
            let cut = rest.iter().position(|w| *w == "--").unwrap_or(rest.len());
            // Asked for help, clap still refuses verbs and options that do not exist.
            let help: Vec<&str> = rest[..cut].iter().copied().chain(["--help"]).collect();
            let ran = run::polepair(&help);
            checked += 1;
            if ran.code != 0 {
                wrong += &format!("{}: {command}\n{}\n", page.display(), ran.err);
            }
            let is_url = |w: &&&str| w.contains("://") || w.starts_with("sim:");
            // A server's address has another form.
            let is_server = |w: &&&str| polepair::interface::is_gateway(w);
            // A bucket's address is none of a link.
            if rest.first() == Some(&"fleet") {
                continue;
            }
            for url in rest.iter().filter(is_url).filter(|w| !is_server(w)) {
                // What a scan alone takes: several protocols of one bus.
                let several = url.split('+').next().is_some_and(|words| words.contains(','));
                let placeholder = url.contains('…') || several;
                if let (false, Err(e)) = (placeholder, url.parse::<polepair::url::Url>()) {
                    wrong += &format!("{}: {url}: {e}\n", page.display());
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
    assert!(checked > 30, "only {checked} commands were found");
}

#[test]
fn links_between_pages_lead_somewhere() {
    let (mut checked, mut wrong) = (0, String::new());
    for page in pages() {
        for link in links(&text(&page)) {
            let (file, part) = link.split_once('#').unwrap_or((&link, ""));
            let folder = page.parent().expect("a folder");
            let target = if file.is_empty() { page.clone() } else { folder.join(file) };
            checked += 1;
            let there = target.exists()
                && (part.is_empty() || headings(&target).contains(&part.to_owned()));
            if !there {
                wrong += &format!("{}: {link}\n", page.display());
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
    assert!(checked > 50, "only {checked} links were found");
}

/// Targets of links and pictures that are not on other machines.
fn links(page: &str) -> Vec<String> {
    let targets = page.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let near = |link: &&str| !link.contains("://") && !link.contains(' ') && !link.is_empty();
    targets.filter(near).map(str::to_owned).collect()
}

/// Headings as links name them.
fn headings(page: &Path) -> Vec<String> {
    let plain = |line: &str| -> String {
        let stored = line.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        stored.collect::<String>().trim().to_lowercase().replace(' ', "-")
    };
    text(page)
        .lines()
        .filter(|l| l.starts_with('#'))
        .map(|l| plain(l.trim_start_matches('#')))
        .collect()
}
