//! The binary interface is that of `abi/polepair.xml`: what a program was built with goes on working.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::programs::{is_there, library, root, run};

/// The functions of the header, without comments, as C declares them.
fn declarations() -> Vec<String> {
    let header = std::fs::read_to_string(root().join("crates/ffi/include/polepair.h"));
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

/// A library with the header's functions, whose debug information has their types.
fn library_of_the_header() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("abi");
    std::fs::create_dir_all(&folder).expect("a folder");
    let body = |declaration: &String| format!("{declaration} {{ __builtin_trap(); }}\n");
    let source: String = declarations().iter().map(body).collect();
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
    let name = |declaration: &String| {
        let before = declaration.split_once('(').expect("arguments").0;
        before.rsplit([' ', '*']).next().unwrap_or("").to_owned()
    };
    let declared: BTreeSet<String> = declarations().iter().map(name).collect();
    assert!(declared.len() > 70, "{declared:?}");
    let listed = run(Command::new("nm")
        .args(["-D", "--defined-only"])
        .arg(library().join("libpolepair_ffi.so")));
    let exported = listed.lines().filter_map(|line| line.rsplit(' ').next());
    let exported: BTreeSet<String> =
        exported.filter(|name| name.starts_with("pp_")).map(str::to_owned).collect();
    assert_eq!(declared, exported);
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
