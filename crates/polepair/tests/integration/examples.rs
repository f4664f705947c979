//! The programs in `examples/rust` work on simulated drives.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Lines that a program has at most: it is meant to be read at a glance.
const LINES_MAX: usize = 60;

/// Expected output of each program, in order: those of Python print the same.
fn programs() -> Vec<(String, Vec<String>)> {
    let expected = std::fs::read_to_string(root().join("examples/expected.txt"));
    let program = |line: &str| {
        let (name, parts) = line.split_once(": ")?;
        Some((name.to_owned(), parts.split(" | ").map(str::to_owned).collect()))
    };
    expected.expect("what programs print").lines().filter_map(program).collect()
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[test]
fn every_program_runs() {
    assert_eq!(programs().len(), 6);
    let output = built();
    for (name, expected) in programs() {
        let ran = Command::new(executable(&output, &name)).output().expect("the program starts");
        let text = String::from_utf8_lossy(&ran.stdout);
        let failed = String::from_utf8_lossy(&ran.stderr);
        assert!(ran.status.success(), "{name}: {text}{failed}");
        let mut rest = &*text;
        for part in expected {
            let at = rest.find(&part);
            let at = at.unwrap_or_else(|| panic!("{name} does not print {part:?}:\n{text}"));
            rest = &rest[at + part.len()..];
        }
    }
}

#[test]
fn the_picture_of_a_step_is_what_the_program_draws() {
    let program = executable(&built(), "velocity_step");
    let ran = Command::new(program).arg("--svg").output().expect("the program starts");
    let drawn = String::from_utf8_lossy(&ran.stdout);
    let recorded = std::fs::read_to_string(root().join("docs/images/velocity-step.svg"));
    assert!(
        recorded.expect("the picture") == drawn,
        "docs/concepts/physics.md says how to draw it anew"
    );
}

/// Builds them, and returns cargo's output. The whole workspace's, as tests are: this package alone would have
/// other features, and everything below it would be built anew. The same would happen with the environment of a
/// test: build scripts of `ring` run again whenever that changes.
fn built() -> String {
    let mut cargo = Command::new(env!("CARGO"));
    for (name, _) in std::env::vars_os() {
        let shown = name.to_string_lossy();
        if shown.starts_with("CARGO_PKG_") || shown.starts_with("CARGO_MANIFEST_") {
            cargo.env_remove(&name);
        }
    }
    let built = cargo
        .args(["build", "--quiet", "--locked", "--workspace", "--examples"])
        .args(["--message-format", "json"])
        .current_dir(root())
        .output()
        .expect("cargo starts");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    String::from_utf8_lossy(&built.stdout).into_owned()
}

/// Path of a program, by cargo's output.
fn executable(output: &str, name: &str) -> PathBuf {
    let mut paths =
        output.split("\"executable\":\"").skip(1).filter_map(|part| part.split('"').next());
    let stem = |path: &&str| Path::new(path).file_stem().is_some_and(|stem| stem == name);
    let path = paths.find(stem).unwrap_or_else(|| panic!("cargo built no {name}"));
    PathBuf::from(path.replace("\\\\", "\\"))
}

#[test]
fn every_program_is_short() {
    for (name, _) in programs() {
        let path = root().join(format!("examples/rust/{name}.rs"));
        let text = std::fs::read_to_string(&path).expect("an example");
        assert!(text.lines().count() < LINES_MAX, "{name} is too long");
        assert!(text.starts_with("//! "), "{name} does not say what it does");
    }
}
