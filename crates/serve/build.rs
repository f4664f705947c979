//! Embeds the page that `make web` built, if it is there.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Files of the page.
const FILES_MAX: usize = 256;

fn main() {
    let here = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").expect("Cargo sets it"));
    let page = here.join("page");
    // A path that does not exist counts as changed at every build: then the crate's folder is watched.
    let watched = if page.exists() { &page } else { &here };
    println!("cargo::rerun-if-changed={}", watched.display());
    println!("cargo::rerun-if-changed=build.rs");
    let mut files = Vec::new();
    collect(&page, &page, &mut files);
    files.sort();
    assert!(files.len() <= FILES_MAX, "the page has {} files", files.len());
    let mut text =
        String::from("/// Path, type, content.\nstatic FILES: &[(&str, &str, &[u8])] = &[\n");
    for (name, path) in &files {
        // Writing into a String cannot fail.
        let _ = writeln!(text, "({name:?}, {:?}, include_bytes!({path:?})),", kind(path));
    }
    text.push_str("];\n");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("Cargo sets it"));
    std::fs::write(out.join("page.rs"), text).expect("the build's own folder can be written");
}

fn collect(top: &Path, folder: &Path, files: &mut Vec<(String, PathBuf)>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            collect(top, &path, files);
        } else if let (Ok(name), Ok(whole)) = (path.strip_prefix(top), path.canonicalize()) {
            files.push((format!("/{}", name.to_string_lossy().replace('\\', "/")), whole));
        }
    }
}

fn kind(path: &Path) -> &'static str {
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("ico") => "image/x-icon",
        Some("json" | "webmanifest") => "application/json",
        Some("woff2") => "font/woff2",
        _ => "application/octet-stream",
    }
}
