//! Tests from outside are one program a crate: a file that it does not name runs nothing, and another program is linked
//! anew, so it states its reason.

use std::path::{Path, PathBuf};

/// The folder of that program, in `tests`.
const INTEGRATION: &str = "integration";
/// First words of a program of its own, followed by the reason.
const OWN_PROGRAM: &str = "//! A program of its own: ";

/// Every test file that no program has, and every program without a reason.
pub(crate) fn check(root: &Path) -> Vec<String> {
    let mut broken = Vec::new();
    for file in super::rust_files(root) {
        let path = super::display_path(root, &file);
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let parts: Vec<&str> = path.split('/').collect();
        if let ["crates", _, "tests", rest @ ..] = parts.as_slice() {
            broken.extend(check_test_file(Path::new(&path), rest, &text, |file: &Path| {
                std::fs::read_to_string(root.join(file)).ok()
            }));
        }
    }
    broken
}

/// Faults of one file; `rest` is its path below `tests`.
pub(crate) fn check_test_file(
    path: &Path,
    rest: &[&str],
    text: &str,
    read: impl Fn(&Path) -> Option<String>,
) -> Option<String> {
    match rest {
        [INTEGRATION, "main.rs"] => None,
        [_] | [_, "main.rs"] => {
            let says = text.lines().any(|line| line.starts_with(OWN_PROGRAM));
            (!says).then(|| {
                format!("{}: belongs into {INTEGRATION}/, or says `{OWN_PROGRAM}`", path.display())
            })
        }
        _ => {
            let (name, parents) = module_of(path)?;
            let line = format!("mod {name};");
            let reported =
                parents.iter().filter_map(|parent| read(parent)).any(|text| has_line(&text, &line));
            (!reported).then(|| format!("{}: no program has it: `{line}`", path.display()))
        }
    }
}

fn has_line(text: &str, line: &str) -> bool {
    text.lines().any(|l| l.trim_start_matches("pub ") == line)
}

/// A file's module, and the files that may declare it.
fn module_of(path: &Path) -> Option<(String, Vec<PathBuf>)> {
    let mut module = path.with_extension("");
    if module.ends_with("mod") {
        module.pop();
    }
    let (name, folder) = (module.file_name()?.to_str()?.to_owned(), module.parent()?);
    let parents = vec![folder.join("main.rs"), folder.join("mod.rs"), folder.with_extension("rs")];
    Some((name, parents))
}
