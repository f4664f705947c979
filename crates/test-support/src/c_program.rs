//! Programs in C that use a library of this workspace.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Compilers of C, as far as they are there.
pub const COMPILERS: [&str; 2] = ["gcc", "clang"];
/// Every warning is an error.
const STRICT: [&str; 5] = ["-O1", "-Wall", "-Wextra", "-pedantic", "-Werror"];

const LIBRARY_PATH: &str = "LD_LIBRARY_PATH";

const TIMEOUT_SCALE_VARIABLE: &str = "POLEPAIR_TIMEOUT_SCALE";
/// The factor on time-outs of a program: the machine may be busy with other tests.
const TIMEOUT_SCALE: &str = "10";
/// Time-out scale of a program under valgrind, which runs it about 50 times slower.
const VALGRIND_TIMEOUT_SCALE: &str = "100";

/// A library with its header.
#[derive(Clone, Copy, Debug)]
pub struct CLibrary {
    /// Folder of its package in `crates`.
    pub package: &'static str,
    /// Header, in the package's folder `include`.
    pub header: &'static str,
    /// The name for the linker: `TML_lib`.
    pub name: &'static str,
}

/// The folder of the workspace.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The folder of the libraries that cargo has built for this test: that of the test itself.
///
/// # Panics
/// Without a test program.
#[must_use]
pub fn library_folder() -> PathBuf {
    let test = std::env::current_exe().expect("this test");
    test.parent().expect("its folder").to_owned()
}

/// A folder of a test, made anew for it.
///
/// # Panics
/// If it cannot be made.
#[must_use]
pub fn test_folder(name: &str) -> PathBuf {
    let folder = library_folder().join("../tmp").join(name);
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// Returns whether a program is installed.
#[must_use]
pub fn is_there(program: &str) -> bool {
    // The Pascal compiler knows no --version.
    let asked = if program == "fpc" { "-iV" } else { "--version" };
    Command::new(program).arg(asked).output().is_ok_and(|ran| ran.status.success())
}

/// Runs a program to its end, and returns what it printed.
///
/// # Panics
/// If it fails.
pub fn run(command: &mut Command) -> String {
    // Cargo's own value would come before the folder that the program was linked with.
    if command.get_envs().all(|(name, _)| name != LIBRARY_PATH) {
        command.env_remove(LIBRARY_PATH);
    }
    if command.get_envs().all(|(name, _)| name != TIMEOUT_SCALE_VARIABLE) {
        command.env(TIMEOUT_SCALE_VARIABLE, TIMEOUT_SCALE);
    }
    let ran = command.output().expect("the program starts");
    let (text, failed) =
        (String::from_utf8_lossy(&ran.stdout), String::from_utf8_lossy(&ran.stderr));
    assert!(ran.status.success(), "{command:?}: {:?}\n{text}{failed}", ran.status);
    text.into_owned()
}

impl CLibrary {
    /// The folder of its header.
    #[must_use]
    pub fn include(&self) -> PathBuf {
        root().join("crates").join(self.package).join("include")
    }

    /// Builds a program without a warning, and returns its path.
    ///
    /// # Panics
    /// If the compiler prints anything.
    #[must_use]
    pub fn build(&self, compiler: &str, source: &Path, options: &[&str]) -> PathBuf {
        let name = source.file_stem().expect("a name").to_string_lossy().into_owned();
        // Tests that run at the same time do not overwrite each other's.
        let program = test_folder("c").join(format!("{name}-{compiler}{}", options.concat()));
        let built = Command::new(compiler)
            .args(STRICT)
            .args(options)
            .arg("-I")
            .arg(self.include())
            .arg(source)
            .arg("-o")
            .arg(&program)
            .arg("-L")
            .arg(library_folder())
            .args([&format!("-l{}", self.name), "-lm", "-lpthread"])
            .arg(format!("-Wl,-rpath,{}", library_folder().display()))
            .output()
            .expect("the compiler starts");
        let said = String::from_utf8_lossy(&built.stderr);
        assert!(built.status.success() && said.is_empty(), "{compiler} {name}: {said}");
        program
    }

    /// The functions of the header, without comments, as C declares them.
    ///
    /// # Panics
    /// Without a header.
    #[must_use]
    pub fn declarations(&self) -> Vec<String> {
        let header = std::fs::read_to_string(self.include().join(self.header));
        let mut text = header.expect("the header");
        while let Some((before, rest)) = text.split_once("/*") {
            let behind = rest.split_once("*/").expect("the end of a comment").1;
            text = before.to_owned() + behind;
        }
        let functions = text.split_once("extern \"C\" {").expect("its functions").1;
        let functions = functions.split_once("#ifdef __cplusplus").expect("their end").0;
        let lines: Vec<&str> = functions.lines().filter(|line| !line.starts_with('#')).collect();
        let functions = lines.join("\n");
        let all = functions.split(';').map(str::trim);
        all.filter(|declaration| declaration.contains('(')).map(str::to_owned).collect()
    }

    /// Asserts that the library has the functions of its header and no others that begin so.
    ///
    /// # Panics
    /// If it has others.
    pub fn check_exports(&self, prefix: &str) {
        let name = |declaration: &String| {
            let before = declaration.split_once('(').expect("arguments").0;
            before.rsplit([' ', '*']).next().unwrap_or("").to_owned()
        };
        let declared: BTreeSet<String> = self.declarations().iter().map(name).collect();
        assert!(declared.len() > 70, "{declared:?}");
        let library = library_folder().join(format!("lib{}.so", self.name));
        let listed = run(Command::new("nm").args(["-D", "--defined-only"]).arg(library));
        let exported = listed.lines().filter_map(|line| line.rsplit(' ').next());
        let exported: BTreeSet<String> =
            exported.filter(|name| name.starts_with(prefix)).map(str::to_owned).collect();
        assert_eq!(declared, exported);
    }

    /// Asserts that the header is C and C++ without a warning.
    ///
    /// # Panics
    /// If a compiler prints anything.
    pub fn check_header(&self) {
        let header = self.include().join(self.header);
        for (compiler, language) in
            [("gcc", "c"), ("g++", "c++"), ("clang", "c"), ("clang++", "c++")]
        {
            if is_there(compiler) {
                let mut command = Command::new(compiler);
                command.args(["-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only", "-x"]);
                run(command.arg(language).arg(&header));
            }
        }
    }
}

/// Runs a program under valgrind, which must find nothing, and returns what it printed.
///
/// # Panics
/// If valgrind finds something.
#[must_use]
pub fn run_under_valgrind(program: &Path, arguments: &[&str]) -> String {
    run(Command::new("valgrind")
        .env(TIMEOUT_SCALE_VARIABLE, VALGRIND_TIMEOUT_SCALE)
        .args(["--quiet", "--error-exitcode=9", "--leak-check=full"])
        .args(["--errors-for-leak-kinds=definite"])
        .arg(program)
        .args(arguments))
}
