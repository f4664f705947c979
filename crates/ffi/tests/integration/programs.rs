//! The programs in `examples/c` and those of other languages do what they say, on simulated drives, as far as
//! their compilers are there.

use std::path::{Path, PathBuf};
use std::process::Command;

const COMPILERS: [&str; 2] = ["gcc", "clang"];
const STRICT: [&str; 5] = ["-O1", "-Wall", "-Wextra", "-pedantic", "-Werror"];

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The folder of `libpolepair_ffi.so`, which cargo has built for this test: that of the test itself.
pub fn library() -> PathBuf {
    let test = std::env::current_exe().expect("this test");
    test.parent().expect("its folder").to_owned()
}

pub fn is_there(program: &str) -> bool {
    // The Pascal compiler knows no --version.
    let asked = if program == "fpc" { "-iV" } else { "--version" };
    Command::new(program).arg(asked).output().is_ok_and(|ran| ran.status.success())
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

pub fn run(command: &mut Command) -> String {
    let ran = command.output().expect("the program starts");
    let (text, failed) =
        (String::from_utf8_lossy(&ran.stdout), String::from_utf8_lossy(&ran.stderr));
    assert!(ran.status.success(), "{command:?}: {:?}\n{text}{failed}", ran.status);
    text.into_owned()
}

/// A folder with the library under the name by which it is installed.
fn installed_library() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c/lib");
    std::fs::create_dir_all(&folder).expect("a folder");
    let link = folder.join("libpolepair.so");
    // Tests at the same time make the same link.
    let _ = std::os::unix::fs::symlink(library().join("libpolepair_ffi.so"), link);
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
            Command::new(build(compiler, &source, &["-std=c11"]))
        });
    }
}

#[test]
fn examples_in_cpp_print_what_those_of_rust_print() {
    for compiler in ["g++", "clang++"] {
        try_examples("C++", &[compiler], |name| {
            let source = root().join("examples/cpp").join(name).with_extension("cpp");
            Command::new(build(compiler, &source, &["-std=c++17"]))
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
fn the_rules_of_the_interface_hold() {
    let source = root().join("crates/ffi/tests/integration/rules.c");
    for compiler in COMPILERS.into_iter().filter(|compiler| is_there(compiler)) {
        let program = build(compiler, &source, &["-std=c11"]);
        assert_eq!(run(&mut Command::new(program)), "rules hold\n");
    }
}

#[test]
fn valgrind_finds_nothing() {
    if !is_there("valgrind") {
        eprintln!("skipped: valgrind is not installed");
        return;
    }
    let program =
        build("gcc", &root().join("crates/ffi/tests/integration/rules.c"), &["-std=c11", "-g"]);
    let text = run(Command::new("valgrind")
        .args(["--quiet", "--error-exitcode=9", "--leak-check=full"])
        .args(["--errors-for-leak-kinds=definite"])
        .arg(program)
        .arg("quick"));
    assert_eq!(text, "rules hold\n");
}

/// The header as it is generated: `cargo xtask codegen` writes it.
#[test]
fn the_headers_are_c_and_cpp() {
    let header = root().join("crates/ffi/include/polepair.h");
    for (compiler, language) in [("gcc", "c"), ("g++", "c++"), ("clang", "c"), ("clang++", "c++")] {
        if is_there(compiler) {
            let mut command = Command::new(compiler);
            command.args(["-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only", "-x"]);
            run(command.arg(language).arg(&header));
        }
    }
}
