//! The programs in `examples/c` and those of other languages work, on simulated drives, if
//! their compilers are installed.

use std::path::PathBuf;
use std::process::Command;

use polepair_test_support::c_program::{
    CLibrary, COMPILERS, is_there, library_folder, root, run, run_under_valgrind, test_folder,
};

pub const LIBRARY: CLibrary =
    CLibrary { package: "ffi", header: "polepair.h", name: "polepair_ffi" };

/// A folder with the library under the name by which it is installed.
fn installed_library() -> PathBuf {
    let folder = test_folder("c/lib");
    let link = folder.join("libpolepair.so");
    // Tests at the same time make the same link.
    let _ = std::os::unix::fs::symlink(library_folder().join("libpolepair_ffi.so"), link);
    folder
}

/// `move_and_home` as `MoveAndHome`.
fn camel_case(name: &str) -> String {
    let word = |word: &str| word[..1].to_uppercase() + &word[1..];
    name.split('_').map(word).collect()
}

/// Runs every example of a language, whose command a function makes of the example's name.
fn try_examples(language: &str, tools: &[&str], command: impl Fn(&str) -> Command) {
    if let Some(missing) = tools.iter().find(|tool| !is_there(tool)) {
        eprintln!("skipped: {language}, because {missing} is not installed");
        return;
    }
    let expected = std::fs::read_to_string(root().join("examples/expected.txt")).expect("outputs");
    for line in expected.lines() {
        let (name, parts) = line.split_once(": ").expect("a name");
        let text = run(command(name).env("LD_LIBRARY_PATH", installed_library()));
        let mut rest = &*text;
        for part in parts.split(" | ") {
            let at = rest.find(part);
            let missing = || panic!("{language}: {name} does not print {part:?}:\n{text}");
            rest = &rest[at.unwrap_or_else(missing) + part.len()..];
        }
    }
}

#[test]
fn examples_in_c_print_what_those_of_rust_print() {
    assert!(is_there("gcc"), "there is no C compiler");
    for compiler in COMPILERS {
        try_examples("C", &[compiler], |name| {
            let source = root().join("examples/c").join(name).with_extension("c");
            Command::new(LIBRARY.build(compiler, &source, &["-std=c11"]))
        });
    }
}

#[test]
fn examples_in_cpp_print_what_those_of_rust_print() {
    for compiler in ["g++", "clang++"] {
        try_examples("C++", &[compiler], |name| {
            let source = root().join("examples/cpp").join(name).with_extension("cpp");
            Command::new(LIBRARY.build(compiler, &source, &["-std=c++17"]))
        });
    }
}

#[test]
fn examples_in_c_sharp_print_what_those_of_rust_print() {
    try_examples("C#", &["mcs", "mono"], |name| {
        let name = camel_case(name);
        let program = installed_library().with_file_name(format!("{name}.exe"));
        run(Command::new("mcs")
            .args(["-warn:4", "-warnaserror"])
            .arg(format!("-out:{}", program.display()))
            .arg(root().join("bindings/csharp/Polepair.cs"))
            .arg(root().join("examples/csharp").join(name).with_extension("cs")));
        let mut mono = Command::new("mono");
        mono.arg(program);
        mono
    });
}

#[test]
fn examples_in_pascal_print_what_those_of_rust_print() {
    let folder = installed_library().with_file_name("pascal");
    std::fs::create_dir_all(&folder).expect("a folder");
    try_examples("Pascal", &["fpc"], |name| {
        run(Command::new("fpc")
            .arg("-v0ew")
            .arg(format!("-Fu{}", root().join("bindings/pascal").display()))
            .arg(format!("-Fl{}", installed_library().display()))
            .arg(format!("-FE{}", folder.display()))
            .arg(root().join("examples/pascal").join(name).with_extension("pas")));
        Command::new(folder.join(name))
    });
}

#[test]
fn examples_with_ctypes_print_what_those_of_rust_print() {
    try_examples("ctypes", &["python3"], |name| {
        let mut python = Command::new("python3");
        python
            .arg(root().join("examples/ctypes").join(name).with_extension("py"))
            .env("PYTHONPATH", root().join("bindings/ctypes"))
            .env("PYTHONDONTWRITEBYTECODE", "1");
        python
    });
}

#[test]
fn examples_in_octave_print_what_those_of_rust_print() {
    let folder = installed_library().with_file_name("octave");
    std::fs::create_dir_all(&folder).expect("a folder");
    if is_there("mkoctfile") && is_there("octave") {
        run(Command::new("mkoctfile")
            .arg("--mex")
            .arg(format!("-I{}", LIBRARY.include().display()))
            .arg(root().join("bindings/octave/polepair.c"))
            .arg("-o")
            .arg(folder.join("polepair.mex"))
            .arg(format!("-L{}", installed_library().display()))
            .arg("-lpolepair")
            .current_dir(&folder));
    }
    try_examples("Octave", &["octave", "mkoctfile"], |name| {
        let mut octave = Command::new("octave");
        octave
            .args(["--no-gui", "--quiet", "--no-init-file", "--path"])
            .arg(&folder)
            .arg(root().join("examples/octave").join(name).with_extension("m"));
        octave
    });
}

#[test]
fn the_rules_of_the_interface_hold() {
    let source = root().join("crates/ffi/tests/integration/rules.c");
    for compiler in COMPILERS.into_iter().filter(|compiler| is_there(compiler)) {
        let program = LIBRARY.build(compiler, &source, &["-std=c11"]);
        assert_eq!(run(&mut Command::new(program)), "rules hold\n");
    }
}

#[test]
fn valgrind_finds_nothing() {
    if !is_there("valgrind") {
        eprintln!("skipped: valgrind is not installed");
        return;
    }
    let source = root().join("crates/ffi/tests/integration/rules.c");
    let program = LIBRARY.build("gcc", &source, &["-std=c11", "-g"]);
    assert_eq!(run_under_valgrind(&program, &["20"]), "rules hold\n");
}

/// The header as it is generated: `cargo xtask codegen` writes it.
#[test]
fn the_headers_are_c_and_cpp() {
    LIBRARY.check_header();
}

/// The first program of `docs/guides/c.md` compiles without warnings, runs, and checks each status.
#[test]
fn the_guides_first_program_runs() {
    let guide = std::fs::read_to_string(root().join("docs/guides/c.md")).expect("a guide");
    let (_, after) = guide.split_once("```c\n").expect("a program");
    let (program, _) = after.split_once("```\n").expect("its end");
    let source = test_folder("c/guide").join("guide.c");
    std::fs::write(&source, program).expect("written");
    for compiler in COMPILERS.into_iter().filter(|compiler| is_there(compiler)) {
        let built = LIBRARY.build(compiler, &source, &["-std=c11"]);
        let text = run(Command::new(built).env("LD_LIBRARY_PATH", installed_library()));
        let speed = text.trim().strip_suffix(" rad/s").and_then(|text| text.parse::<f64>().ok());
        assert!(speed.is_some_and(|speed| (5.5..7.0).contains(&speed)), "{compiler}: {text}");
    }
    for line in program.lines().filter(|line| line.contains("pp_") && line.contains('(')) {
        // A call whose status is dropped begins its line.
        let dropped = line.trim_start().starts_with("pp_") && line.trim_end().ends_with(';');
        assert!(!dropped || line.contains("pp_axis_close(") || line.contains(" = "), "{line}");
    }
}
