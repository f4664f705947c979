//! Error messages that the user reads.

use crate::run;

use run::{polepair, polepair_with};

fn error(arguments: &[&str]) -> (String, i32) {
    let ran = polepair(arguments);
    (ran.err, ran.code)
}

#[test]
fn no_such_file() {
    let (text, code) = error(&["decode", "/no/such/file"]);
    assert_eq!(text, "error[E301]: cannot read /no/such/file.\n  There is no such file.\n");
    assert_eq!(code, 3);
}

#[test]
fn no_such_protocol() {
    let (text, code) = error(&["encode", "tmlc", "MST 0"]);
    assert!(
        text.starts_with("error[E203]: \"tmlc\" is not a protocol that polepair knows.\n"),
        "{text}"
    );
    assert!(text.ends_with("  try: tmcl (the nearest)\n"), "{text}");
    assert_eq!(code, 2);
}

#[test]
fn text_of_no_protocol_is_pointed_at() {
    let (text, code) = error(&["encode", "tmcl", "GAP foo, 0"]);
    let expected = "error[E241]: this is not tmcl.\n  GAP foo, 0\n      ^ expected ";
    assert!(text.starts_with(expected), "{text}");
    assert_eq!(code, 2);
}

#[test]
fn an_unknown_code() {
    let (text, code) = error(&["explain", "tmcl", "0x80000"]);
    assert!(text.starts_with("error[E110]: \"0x80000\" is unknown in tmcl.\n"), "{text}");
    assert_eq!(code, 1);
}

#[test]
fn not_a_capture() {
    let ran = polepair_with(&["decode", "-", "--as", "tmcl"], "hello\nworld\n");
    assert!(
        ran.err.contains("skipped lines of text: 2")
            && ran.err.contains("error[E510]: this is not a capture."),
        "{}",
        ran.err
    );
    assert_eq!(ran.code, 5);
}

#[test]
fn help_and_version_are_data() {
    for arguments in [&["--help"][..], &["--version"], &["decode", "--help"]] {
        let ran = polepair(arguments);
        assert_eq!((ran.code, ran.err.as_str()), (0, ""), "{arguments:?}");
        assert!(ran.out.contains("polepair"), "{}", ran.out);
    }
    assert_eq!(polepair(&[]).code, 2);
    assert_eq!(polepair(&["fly"]).code, 2);
}
