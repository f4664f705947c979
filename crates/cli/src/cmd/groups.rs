//! Groups of verbs: the sections of `polepair --help`, and the pages of the reference.
//!
//! Every verb is in exactly one group; a test checks that.

use std::fmt::Write as _;

use clap::Command;

/// Verbs that a user needs for one kind of task.
#[derive(Debug)]
pub struct VerbGroup {
    /// Heading in the help, and title of the page.
    pub heading: &'static str,
    /// Names of the verbs, in the order of their listing.
    pub verbs: &'static [&'static str],
}

/// All groups, in the order of their listing.
pub const VERB_GROUPS: [VerbGroup; 6] = [
    VerbGroup {
        heading: "Find and look",
        verbs: &[
            "ports",
            "scan",
            "info",
            "get",
            "watch",
            "record-in-drive",
            "monitor",
            "params",
            "doctor",
            "explain",
        ],
    },
    VerbGroup {
        heading: "Configure",
        verbs: &["set", "config", "eds", "watchdog", "lss", "send", "encode", "program"],
    },
    VerbGroup {
        heading: "Move",
        verbs: &[
            "stop", "enable", "disable", "clear", "spin", "jog", "move", "home", "torque", "paths",
            "stream", "sync", "couple", "uncouple",
        ],
    },
    VerbGroup {
        heading: "Captures",
        verbs: &["record", "decode", "summary", "diff", "convert", "replay", "fleet"],
    },
    VerbGroup {
        heading: "Simulate and serve",
        verbs: &["demo", "sim", "act", "serve", "release", "dismiss", "journal"],
    },
    VerbGroup { heading: "Shell", verbs: &["completions"] },
];

/// Lists the verbs of `command` by group in its help.
pub fn with_grouped_verbs(command: Command) -> Command {
    let header = *command.get_styles().get_header();
    let literal = *command.get_styles().get_literal();
    let mut template = String::from("{about-with-newline}\n{usage-heading} {usage}\n");
    for group in &VERB_GROUPS {
        let _ = write!(template, "\n{header}{}:{header:#}\n", group.heading);
        for verb in group.verbs {
            let about = command.find_subcommand(verb).and_then(Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(template, "  {literal}{verb:<15}{literal:#}  {about}");
        }
    }
    let _ = write!(template, "\n{header}Options:{header:#}\n{{options}}{{after-help}}");
    command.help_template(template)
}
