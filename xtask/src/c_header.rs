//! The header of the C interface, from the functions of `crates/ffi` and their comments.

use std::path::{Path, PathBuf};

use crate::codegen::CodegenResult;

const PREAMBLE: &str = "\
/* libpolepair: the C interface of Polepair. Generated from crates/ffi by `cargo xtask codegen`; never edited.
 *
 * Handles: opaque. Each may be used by any thread; calls on one handle from several threads run at the same time.
 *     The error that a handle keeps is that of its last failed call: threads that want their own use handles of
 *     their own (pp_link_axis gives a new one each time).
 * Results: functions return a pp_status; results go through pointers. A failed call leaves them alone.
 * Text: UTF-8 with its length in bytes; PP_NTS as length means that it ends at its first zero byte.
 * Structs: begin with their size, which the caller sets: struct.size = sizeof struct. A program that was built with
 *     an older header gets the fields that it knows.
 * Units: SI (rad, rad/s, N m, A, V, s), unless a function says otherwise.
 * Motion: an axis moves only after pp_axis_arm. pp_link_close stops, disables and disarms what was armed.
 * Forks: a child process is refused (PP_FORKED).
 * Linkage: extern \"C\", cdecl. */";

const NTS: &str = "
/* Length of a text that ends at its first zero byte. */
#define PP_NTS ((size_t)-1)
";

/// The header's path and text. None in a folder without the crate.
pub fn file(root: &Path) -> CodegenResult<Option<(PathBuf, String)>> {
    let crate_folder = root.join("crates/ffi");
    if !crate_folder.is_dir() {
        return Ok(None);
    }
    let mut config = cbindgen::Config {
        language: cbindgen::Language::C,
        header: Some(PREAMBLE.to_owned()),
        include_guard: Some("POLEPAIR_H".to_owned()),
        no_includes: true,
        sys_includes: vec!["stddef.h".to_owned(), "stdint.h".to_owned()],
        after_includes: Some(NTS.to_owned()),
        cpp_compat: true,
        usize_is_size_t: true,
        documentation_style: cbindgen::DocumentationStyle::Doxy,
        style: cbindgen::Style::Both,
        tab_width: 4,
        line_length: 110,
        ..cbindgen::Config::default()
    };
    config.export.exclude = vec!["PP_NTS".to_owned()];
    config.function.sort_by = Some(cbindgen::SortKey::None);
    let built = cbindgen::Builder::new().with_crate(&crate_folder).with_config(config).generate();
    let bindings = built.map_err(|error| format!("crates/ffi: {error}"))?;
    let mut text = Vec::new();
    bindings.write(&mut text);
    let text = String::from_utf8(text).map_err(|error| error.to_string())?;
    Ok(Some((crate_folder.join("include/polepair.h"), plain_comments(&text))))
}

/// Comments without what only rustdoc knows: the heading of safety, and the fences of examples.
fn plain_comments(text: &str) -> String {
    let text =
        text.replace(" * # Safety\n", " * Pointers: ").replace("Pointers:  * ", "Pointers: ");
    let (mut plain, mut is_example) = (String::new(), false);
    for line in text.replace(" * Example:\n *\n", " * Example:\n").lines() {
        match line.trim() {
            "* ```c" => is_example = true,
            "* ```" => is_example = false,
            _ if is_example => plain += &line.replacen(" * ", " *     ", 1),
            _ => plain += line,
        }
        if !line.trim().starts_with("* ```") {
            plain.push('\n');
        }
    }
    plain
}
