//! Programs in C and C++ that use the library as programs for TML_LIB do.

use std::path::PathBuf;
use std::process::Command;

use polepair::profile::{find_shipped, write_setup};
use polepair_test_support::c_program::{
    CLibrary, COMPILERS, is_there, root, run, run_under_valgrind, test_folder,
};

const LIBRARY: CLibrary = CLibrary { package: "tml-compat", header: "TML_lib.h", name: "TML_lib" };

fn source(name: &str) -> PathBuf {
    root().join("crates/tml-compat/tests/integration").join(name)
}

/// A set-up archive with the variables of a drive, in a folder of its own.
fn setup(test: &str) -> (PathBuf, PathBuf) {
    let folder = test_folder(test);
    let archive = folder.join("setup.t.zip");
    let profile = find_shipped("technosoft-f514l").expect("the profile");
    write_setup(profile, &archive).expect("an archive");
    (archive, folder)
}

#[test]
fn every_function_does_what_its_name_says() {
    assert!(is_there("gcc"), "there is no C compiler");
    for compiler in COMPILERS.into_iter().filter(|compiler| is_there(compiler)) {
        let program = LIBRARY.build(compiler, &source("functions.c"), &["-std=c11"]);
        let (archive, folder) = setup(&format!("tml-{compiler}"));
        let text = run(Command::new(program).arg(archive).arg(folder));
        assert_eq!(text, "functions work\n");
    }
}

#[test]
fn programs_in_cpp_compile_and_move() {
    for compiler in ["g++", "clang++"].into_iter().filter(|compiler| is_there(compiler)) {
        let program = LIBRARY.build(compiler, &source("move.cpp"), &["-std=c++17"]);
        let (archive, _) = setup(&format!("tml-{compiler}"));
        assert_eq!(run(Command::new(program).arg(archive)), "at 1500\n");
    }
}

#[test]
fn a_folder_with_variables_is_a_setup() {
    let (archive, folder) = setup("tml-folder");
    let program = LIBRARY.build("g++", &source("move.cpp"), &["-std=c++17", "-g"]);
    run(Command::new("python3").args(["-m", "zipfile", "-e"]).arg(archive).arg(&folder));
    assert_eq!(run(Command::new(program).arg(folder)), "at 1500\n");
}

#[test]
fn valgrind_finds_nothing() {
    if !is_there("valgrind") {
        eprintln!("skipped: valgrind is not installed");
        return;
    }
    let program = LIBRARY.build("g++", &source("move.cpp"), &["-std=c++17", "-O0"]);
    let (archive, _) = setup("tml-valgrind");
    let archive = archive.to_string_lossy().into_owned();
    assert_eq!(run_under_valgrind(&program, &[&archive]), "at 1500\n");
}

#[test]
fn the_header_and_the_library_have_the_same_functions() {
    LIBRARY.check_header();
    LIBRARY.check_exports("TS_");
}
