//! Scripts rely on the words of the command line: `tests/golden/words.txt` pins them.
//! `POLEPAIR_GOLDEN=write cargo test -p polepair-cli --bin polepair every_word` writes the file anew.

use clap::{Arg, Command};

use super::CommandLine;

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

/// What a user writes for one argument: its options, value names, possible values and default.
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
