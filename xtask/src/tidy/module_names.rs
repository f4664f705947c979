//! The protocols and families that there are: the folders of the two lists.

use std::path::Path;

/// Module names of protocols and families.
#[derive(Debug, Default)]
pub(crate) struct ModuleNames {
    pub(crate) protocols: Vec<String>,
    pub(crate) families: Vec<String>,
}

impl ModuleNames {
    pub(crate) fn load(root: &Path) -> Self {
        Self {
            protocols: folders(&root.join("crates/core/src/proto")),
            families: folders(&root.join("crates/drives/src")),
        }
    }

    pub(crate) fn all(&self) -> impl Iterator<Item = &str> {
        self.protocols.iter().chain(&self.families).map(String::as_str)
    }
}

fn folders(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.is_dir());
    paths.filter_map(|path| path.file_name()?.to_str().map(str::to_owned)).collect()
}
