//! The programs in `examples/c` do what they say, on simulated drives, built by the C compilers that are there.

use std::path::{Path, PathBuf};
use std::process::Command;

const COMPILERS: [&str; 2] = ["gcc", "clang"];
const STRICT: [&str; 6] = ["-std=c11", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The folder of `libpolepair_ffi.so`, which cargo has built for this test: that of the test itself.
fn library() -> PathBuf {
    let test = std::env::current_exe().expect("this test");
    test.parent().expect("its folder").to_owned()
}

fn is_there(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|ran| ran.status.success())
}

/// Builds a program, and returns its path.
fn build(compiler: &str, source: &Path, options: &[&str]) -> PathBuf {
    let name = source.file_stem().expect("a name").to_string_lossy().into_owned();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c");
    std::fs::create_dir_all(&folder).expect("a folder");
    // Tests that run at the same time do not overwrite each other's.
    let program = folder.join(format!("{name}-{compiler}{}", options.concat()));
    let library = library();
    let built = Command::new(compiler)
        .args(STRICT)
        .args(options)
        .arg("-I")
        .arg(root().join("crates/ffi/include"))
        .arg(source)
        .arg("-o")
        .arg(&program)
        .arg("-L")
        .arg(&library)
        .args(["-lpolepair_ffi", "-lm", "-lpthread"])
        .arg(format!("-Wl,-rpath,{}", library.display()))
        .output()
        .expect("the compiler starts");
    let said = String::from_utf8_lossy(&built.stderr);
    assert!(built.status.success() && said.is_empty(), "{compiler} {name}: {said}");
    program
}

fn run(command: &mut Command) -> String {
    let ran = command.output().expect("the program starts");
    let (text, failed) =
        (String::from_utf8_lossy(&ran.stdout), String::from_utf8_lossy(&ran.stderr));
    assert!(ran.status.success(), "{command:?}: {:?}\n{text}{failed}", ran.status);
    text.into_owned()
}

#[test]
fn every_example_prints_what_those_of_rust_print() {
    let expected = std::fs::read_to_string(root().join("examples/expected.txt")).expect("outputs");
    for compiler in COMPILERS.into_iter().filter(|compiler| is_there(compiler)) {
        for line in expected.lines() {
            let (name, parts) = line.split_once(": ").expect("a name");
            let source = root().join("examples/c").join(name).with_extension("c");
            let text = run(&mut Command::new(build(compiler, &source, &[])));
            let mut rest = &*text;
            for part in parts.split(" | ") {
                let at = rest.find(part);
                let at = at.unwrap_or_else(|| panic!("{name} does not print {part:?}:\n{text}"));
                rest = &rest[at + part.len()..];
            }
        }
    }
    assert!(is_there("gcc"), "there is no C compiler");
}

#[test]
fn the_rules_of_the_interface_hold() {
    let source = root().join("crates/ffi/tests/integration/rules.c");
    for compiler in COMPILERS.into_iter().filter(|compiler| is_there(compiler)) {
        assert_eq!(run(&mut Command::new(build(compiler, &source, &[]))), "rules hold\n");
    }
}

#[test]
fn valgrind_finds_nothing() {
    if !is_there("valgrind") {
        eprintln!("skipped: valgrind is not installed");
        return;
    }
    let program = build("gcc", &root().join("crates/ffi/tests/integration/rules.c"), &["-g"]);
    let text = run(Command::new("valgrind")
        .args(["--quiet", "--error-exitcode=9", "--leak-check=full"])
        .args(["--errors-for-leak-kinds=definite"])
        .arg(program)
        .arg("quick"));
    assert_eq!(text, "rules hold\n");
}

/// The header as it is generated: `cargo xtask codegen` writes it.
#[test]
fn the_header_is_c_and_cpp() {
    let header = root().join("crates/ffi/include/polepair.h");
    for (compiler, language) in [("gcc", "c"), ("g++", "c++"), ("clang", "c"), ("clang++", "c++")] {
        if is_there(compiler) {
            let mut command = Command::new(compiler);
            command.args(["-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only", "-x"]);
            run(command.arg(language).arg(&header));
        }
    }
}
