//! Rule 17: a comment is understood without the code.
//!
//! A doc comment begins with a noun or a verb: a first word such as "What" or "Its" needs the code to be understood.
//! Words that a reader had to guess are refused in all comments, also of tests.

use super::language;

/// First words of a doc comment that are refused.
const OPENERS: [&str; 17] = [
    "What", "Who", "Whom", "Whose", "Where", "Whether", "How", "So", "As", "Its", "It", "Of",
    "Those", "That", "By", "Under", "In",
];

/// Words and phrases that are refused, in lower case, each with plain ones.
const REFUSED: [(&str, &str); 24] = [
    ("said", "sent, reported, stated"),
    ("says", "states, reports"),
    ("say", "state, report"),
    ("told", "reported, notified"),
    ("tells", "reports, shows, distinguishes"),
    ("tell", "report, show, distinguish"),
    ("nobody", "no client, no drive, no thread"),
    ("somebody", "another client, another program"),
    ("whoever", "the caller, the client"),
    ("heard", "received"),
    ("hears", "receives"),
    ("owed", "pending, outstanding"),
    ("owes", "has a pending stop, has an outstanding reply"),
    ("stands", "is, is at standstill"),
    ("stood", "was, was at standstill"),
    ("so many", "a number, the parameter's name"),
    ("so far as", "as far as"),
    ("speaks", "uses, has the protocol"),
    ("spoken of", "described"),
    ("takes part", "is connected, is active"),
    ("is let", "is allowed"),
    ("are let", "are allowed"),
    ("what came", "the reply, the received frames"),
    ("by whomever", "by any client"),
];

/// Files whose comments are not checked: generated ones, and those that list the refused words.
fn is_left_out(path: &str, text: &str) -> bool {
    path.starts_with("xtask/src/tidy/") || text.starts_with("//! Generated")
}

/// Faults of the comments of a file, with their lines.
pub(crate) fn check_comments(path: &str, text: &str) -> Vec<String> {
    let mut found = Vec::new();
    if is_left_out(path, text) {
        return found;
    }
    let (mut begins, mut in_code) = (true, false);
    for (n, line) in text.lines().map(str::trim).enumerate() {
        let Some(comment) = line.strip_prefix("//") else {
            begins = true;
            continue;
        };
        let doc = comment.strip_prefix(['/', '!']);
        let body = doc.unwrap_or(comment).trim();
        if body.starts_with("```") {
            in_code = !in_code;
        } else if !in_code {
            let opener = first_word(body).filter(|_| doc.is_some() && begins);
            found.extend(opener.map(|word| format!("{path}:{}: begins with \"{word}\"", n + 1)));
            found.extend(
                language::refused(&language::without_targets(body), &REFUSED)
                    .map(|fault| format!("{path}:{}: {fault}", n + 1)),
            );
        }
        begins = doc.is_none() || body.is_empty();
    }
    found
}

/// The refused first word of a doc comment, if it has one.
fn first_word(body: &str) -> Option<&'static str> {
    let word = body.split(|c: char| !c.is_alphanumeric()).next()?;
    let the_same = body.starts_with("The same ").then_some("The same");
    OPENERS.into_iter().find(|opener| *opener == word).or(the_same)
}
