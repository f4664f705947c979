//! The reference of the command line: a page for each group of verbs, made from the grammar itself.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use clap::{Arg, Command};
use polepair_cli::VerbGroup;

const MARK: &str =
    "<!-- Made from the command line's grammar by `cargo xtask codegen`. Do not edit. -->\n";

/// Longest text of a table's cell, in characters.
const CELL_MAX: usize = 200;

/// Names of the pages below `docs/reference/command-line`, and their texts.
pub fn pages() -> BTreeMap<String, String> {
    let mut command = polepair_cli::command();
    command.build();
    polepair_cli::VERB_GROUPS
        .iter()
        .map(|group| (file_name(group), group_page(&command, group)))
        .collect()
}

/// Name of a group's page.
fn file_name(group: &VerbGroup) -> String {
    group.heading.to_lowercase().replace(' ', "-") + ".md"
}

fn group_page(command: &Command, group: &VerbGroup) -> String {
    let mut text = format!("# Command line: {}\n\n{MARK}\n", group.heading.to_lowercase());
    text += "Options of every verb are on the [first page](../command-line.md).\n\n";
    text += "| verb | effect |\n|---|---|\n";
    let verbs: Vec<&Command> =
        group.verbs.iter().filter_map(|v| command.find_subcommand(v)).collect();
    for verb in &verbs {
        let about = help_text(verb.get_about());
        let _ = writeln!(text, "| [`{0}`](#{0}) | {about} |", verb.get_name());
    }
    for verb in verbs {
        text.push('\n');
        write_verb(&mut text, verb, verb.get_name(), "##");
    }
    text.replace("\n\n\n", "\n\n").trim_end().to_owned() + "\n"
}

/// The section of a verb, and those of its subcommands.
fn write_verb(text: &mut String, verb: &Command, path: &str, level: &str) {
    let _ = write!(text, "{level} {path}\n\n");
    let about = help_text(verb.get_long_about().or(verb.get_about()));
    let about = about.trim_end();
    let _ = writeln!(text, "{about}{}\n", if about.ends_with(['.', ':']) { "" } else { "." });
    let subcommands: Vec<&Command> = verb
        .get_subcommands()
        .filter(|sub| sub.get_name() != "help" && !sub.is_hide_set())
        .collect();
    if subcommands.is_empty() {
        let usage = verb.clone().render_usage().to_string();
        let usage = usage.trim_start_matches("Usage: ").to_owned();
        let _ = writeln!(text, "```text\nusage: {usage}\n```\n");
    }
    write_arguments(text, verb);
    write_notes(text, &help_text(verb.get_after_help()));
    for sub in subcommands {
        write_verb(text, sub, &format!("{path} {}", sub.get_name()), "###");
    }
}

fn write_arguments(text: &mut String, verb: &Command) {
    let arguments: Vec<&Arg> = verb.get_arguments().filter(is_own_argument).collect();
    if arguments.is_empty() {
        return;
    }
    *text += "| argument | effect |\n|---|---|\n";
    for argument in arguments {
        let _ = writeln!(text, "| `{}` | {} |", written(argument), cell(&effect(argument)));
    }
    text.push('\n');
    for argument in verb.get_arguments().filter(is_own_argument) {
        // The first paragraph is in the table.
        let long = help_text(argument.get_long_help());
        if let Some((_, more)) = long.split_once("\n\n") {
            let name = argument.get_long().unwrap_or_default();
            let _ = writeln!(text, "`--{name}`: {more}\n");
        }
    }
}

fn is_own_argument(arg: &&Arg) -> bool {
    !arg.is_global_set() && !arg.is_hide_set() && arg.get_id() != "help"
}

/// An argument as a user writes it.
fn written(argument: &Arg) -> String {
    let names = argument.get_value_names().unwrap_or_default();
    let values: Vec<String> = names.iter().map(|name| format!("<{name}>")).collect();
    let values = values.join(" ").replace('|', "\\|");
    let takes = argument.get_action().takes_values();
    let mut words = Vec::new();
    words.extend(argument.get_short().map(|short| format!("-{short}")));
    words.extend(argument.get_long().map(|long| format!("--{long}")));
    let option = words.join(", ");
    match (option.is_empty(), takes) {
        (true, _) => values,
        (false, true) => format!("{option} {values}"),
        (false, false) => option,
    }
}

fn effect(argument: &Arg) -> String {
    let help = help_text(argument.get_help());
    let mut effect = help.replace('|', "\\|").replace('<', "&lt;").replace('\n', " ");
    let possible = argument.get_possible_values();
    let shown: Vec<String> =
        possible.iter().map(|value| format!("`{}`", value.get_name())).collect();
    if argument.get_action().takes_values() && !shown.is_empty() {
        let _ = write!(effect, ": {}", shown.join(", "));
    }
    let defaults: Vec<String> = argument
        .get_default_values()
        .iter()
        .map(|value| format!("`{}`", value.to_string_lossy()))
        .collect();
    if argument.get_action().takes_values() && !defaults.is_empty() {
        let _ = write!(effect, " [default: {}]", defaults.join(", "));
    }
    effect
}

fn cell(text: &str) -> &str {
    assert!(text.chars().count() <= CELL_MAX, "a cell above {CELL_MAX} characters: {text}");
    text
}

/// Notes below the options: paragraphs, and commands as a block.
fn write_notes(text: &mut String, notes: &str) {
    for paragraph in notes.split("\n\n").filter(|paragraph| !paragraph.trim().is_empty()) {
        let (plain, indented): (Vec<&str>, Vec<&str>) =
            paragraph.lines().partition(|line| !line.starts_with("  "));
        let heading = plain.join("\n");
        if !heading.is_empty() {
            let _ = writeln!(text, "{heading}\n");
        }
        if !indented.is_empty() {
            let lines: Vec<String> = indented.iter().map(|line| example(line)).collect();
            let _ = writeln!(text, "```console\n{}\n```\n", lines.join("\n").trim_end());
        }
    }
}

/// An example as a shell takes it: text behind a command becomes a comment.
fn example(line: &str) -> String {
    let line = line.strip_prefix("  ").unwrap_or(line);
    match line.split_once("   ") {
        Some((command, comment)) if command.starts_with("polepair ") => {
            let comment = comment.trim_start().trim_start_matches("# ");
            format!("{command}   # {comment}")
        }
        _ => line.to_owned(),
    }
}

/// A text of the help; empty where there is none.
fn help_text(text: Option<&clap::builder::StyledStr>) -> String {
    text.map(ToString::to_string).unwrap_or_default()
}
