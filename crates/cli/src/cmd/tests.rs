//! Scripts rely on the words of the command line: `tests/golden/words.txt` pins them.
//! `POLEPAIR_GOLDEN=write cargo test -p polepair-cli --lib every_word` writes the file anew.

use clap::{Arg, Command};

use super::CommandLine;
use super::groups::VERB_GROUPS;

/// One line for a command, one for each of its arguments, then its subcommands.
fn describe(command: &Command, path: &str, lines: &mut Vec<String>) {
    let path = format!("{path} {}", command.get_name()).trim().to_owned();
    lines.push(path.clone());
    for argument in command.get_arguments() {
        lines.push(format!("{path}: {}", words(argument)));
    }
    for subcommand in command.get_subcommands() {
        describe(subcommand, &path, lines);
    }
}

/// Words that a user types for one argument: its options, value names, possible values and default.
fn words(argument: &Arg) -> String {
    let mut words = Vec::new();
    words.extend(argument.get_short().map(|short| format!("-{short}")));
    words.extend(argument.get_long().map(|long| format!("--{long}")));
    words.extend(argument.get_all_aliases().unwrap_or_default().iter().map(|a| format!("--{a}")));
    if argument.get_action().takes_values() {
        let names = argument.get_value_names().unwrap_or_default();
        words.extend(names.iter().map(|name| format!("<{name}>")));
        let possible = argument.get_possible_values();
        words.extend(possible.iter().map(|value| format!("={}", value.get_name())));
        let defaults = argument.get_default_values().iter();
        words.extend(defaults.map(|value| format!("default {}", value.to_string_lossy())));
    }
    if argument.is_required_set() {
        words.push("required".into());
    }
    words.join(" ")
}

#[test]
fn every_verb_is_in_one_group() {
    let command = CommandLine::grammar();
    let mut verbs: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
    let mut grouped: Vec<&str> =
        VERB_GROUPS.iter().flat_map(|group| group.verbs).copied().collect();
    verbs.sort_unstable();
    grouped.sort_unstable();
    assert_eq!(grouped, verbs);
}

#[test]
fn every_word_of_the_command_line_is_pinned() {
    let mut command = <CommandLine as clap::CommandFactory>::command();
    command.build();
    let mut lines = Vec::new();
    describe(&command, "", &mut lines);
    let text = lines.join("\n") + "\n";
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/words.txt");
    if std::env::var_os("POLEPAIR_GOLDEN").is_some() {
        std::fs::write(path, &text).expect("the golden file");
    }
    let golden = std::fs::read_to_string(path).expect("the golden file");
    let changed: Vec<&str> = golden
        .lines()
        .filter(|line| !lines.iter().any(|l| l == line))
        .chain(lines.iter().map(String::as_str).filter(|line| !golden.lines().any(|l| l == *line)))
        .collect();
    assert!(golden == text, "the command line differs from {path}: {changed:#?}");
}

/// Commands that the program's own texts name: hints that are a command as a whole, and commands in
/// backticks. Each with its file.
fn commands_in_sources() -> Vec<(String, String)> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let mut found = Vec::new();
    let mut folders: Vec<std::path::PathBuf> = ["cli/src", "polepair/src", "serve/src", "link/src"]
        .map(|folder| std::path::Path::new(root).join(folder))
        .into();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).expect("a source");
                let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                found.extend(commands_in(&text).into_iter().map(|command| (file.clone(), command)));
            }
        }
    }
    found
}

/// The commands in the string literals of a source; a backslash at a line's end joins lines.
fn commands_in(source: &str) -> Vec<String> {
    let code: String = source
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .flat_map(|line| [line, "\n"])
        .collect();
    let mut commands = Vec::new();
    for literal in code.split('"').skip(1).step_by(2) {
        let joined: Vec<&str> = literal.split("\\\n").map(str::trim_start).collect();
        let text = joined.concat();
        // Examples of help texts have a test of their own.
        if text.contains('\n') || text.contains("Example") {
            continue;
        }
        let quoted = text.split('`').skip(1).step_by(2);
        let whole = std::iter::once(text.as_str()).filter(|text| text.starts_with("polepair "));
        let all = quoted.chain(whole).filter(|command| command.starts_with("polepair "));
        commands.extend(all.map(str::to_owned));
    }
    commands
}

/// The words of a command, where what is filled in is some word.
fn command_words(command: &str) -> Vec<String> {
    let (mut words, mut filled, mut quoted) = (vec![String::new()], 0, false);
    for c in command.chars() {
        let word = words.last_mut().expect("one");
        match c {
            '{' => filled += 1,
            '}' => {
                filled -= 1;
                word.push('1');
            }
            '\'' => quoted = !quoted,
            ' ' if filled == 0 && !quoted => words.push(String::new()),
            c if filled == 0 => word.push(c),
            _ => {}
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

#[test]
fn commands_that_texts_name_can_be_typed() {
    let commands = commands_in_sources();
    assert!(commands.len() > 40, "{}", commands.len());
    let mut wrong = Vec::new();
    for (file, command) in commands {
        // `polepair stop` alone names the verb, `polepair demo: …` is a title.
        let verb = command.split_whitespace().nth(1).unwrap_or_default();
        if command.split_whitespace().count() <= 2 || verb.ends_with(':') {
            continue;
        }
        let grammar = <CommandLine as clap::CommandFactory>::command();
        let parsed = grammar.try_get_matches_from(command_words(&command));
        if let Err(error) = parsed
            && error.kind() != clap::error::ErrorKind::DisplayHelp
        {
            let why = error.to_string();
            wrong.push(format!("{file}: {command}: {}", why.lines().next().unwrap_or("")));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
