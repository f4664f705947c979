//! The binary interface is that of `abi/polepair.xml`: what a program was built with goes on working.

use std::path::PathBuf;
use std::process::Command;

use polepair_test_support::c_program::{is_there, root, run, test_folder};

use crate::programs::LIBRARY;

/// A library with the header's functions, whose debug information has their types.
fn library_of_the_header() -> PathBuf {
    let folder = test_folder("abi");
    let body = |declaration: &String| format!("{declaration} {{ __builtin_trap(); }}\n");
    let source: String = LIBRARY.declarations().iter().map(body).collect();
    std::fs::write(folder.join("header.c"), format!("#include <polepair.h>\n{source}"))
        .expect("written");
    let library = folder.join("libheader.so");
    run(Command::new("gcc")
        .args(["-g", "-shared", "-fPIC", "-I"])
        .arg(root().join("crates/ffi/include"))
        // Its place on this machine is no part of the interface.
        .args(["header.c", "-o", "libheader.so"])
        .current_dir(&folder));
    library
}

#[test]
fn the_library_exports_what_the_header_declares() {
    LIBRARY.check_exports("pp_");
}

#[test]
fn nothing_that_programs_use_has_changed() {
    if !is_there("abidiff") {
        eprintln!("skipped: abidiff is not installed");
        return;
    }
    let (library, recorded) = (library_of_the_header(), root().join("crates/ffi/abi/polepair.xml"));
    if std::env::var_os("POLEPAIR_GOLDEN").is_some_and(|value| value == "write") {
        run(Command::new("abidw")
            .args(["--no-corpus-path", "--no-comp-dir-path", "--no-show-locs", "--out-file"])
            .arg(&recorded)
            .arg(&library));
    }
    // What was added is no change for a program.
    let text = run(Command::new("abidiff").arg("--no-added-syms").arg(recorded).arg(library));
    assert_eq!(text.trim(), "");
}
