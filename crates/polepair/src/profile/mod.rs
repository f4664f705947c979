//! Profiles from files: drives as data, written by people.
//!
//! A profile names a drive's parameters, units, limits, faults and plans. Those that are shipped are
//! compiled in; this module reads more of them, from the same TOML, at run time.
//!
//! ```
//! let text = r#"
//! name = "my-drive"
//! protocol = "modbus"
//! [[parameter]]
//! name = "max current"
//! index = 0x10
//! unit = "A"
//! scale = 0.1
//! max = 250
//! "#;
//! let profile = polepair::profile::parse("my-drive.toml", text)?;
//! let id = profile.find("Max-Current").unwrap();
//! assert_eq!(profile.parameter(id).unwrap().index, 0x10);
//!
//! let error = polepair::profile::parse("bad.toml", &text.replace("scale", "scael")).unwrap_err();
//! assert_eq!(error.to_string(), "bad.toml:8:1: unknown key `scael`; did you mean `scale`?");
//! # Ok::<(), polepair::FileError>(())
//! ```

pub(crate) mod draft;
mod map;
mod missing;
mod read;
mod resolve;
mod setup;
mod step;
mod stops;
#[cfg(test)]
mod tests;

pub use setup::write_setup;

pub(crate) use missing::without_missing;
pub(crate) use read::encoding_range;
pub(crate) use setup::name_of;

use crate::file::{self, FileError, Found};
use crate::words;
use draft::Draft;
use polepair_core::profile::Profile;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Different profiles that one process reads at most: each stays in memory for good.
pub const PROFILES_MAX: usize = 256;

/// Profiles that may extend one another in a row.
const EXTENDS_MAX: usize = 8;

/// The largest profile file, bytes.
const FILE_MAX: u64 = 4 << 20;

/// Reads a profile from text; `file` is its name in complaints. `extends` may name a profile that
/// is compiled in. The same text gives the same `&'static` again.
///
/// # Errors
/// [`FileError`] with line, column and reason; or that [`PROFILES_MAX`] are read already.
pub fn parse(file: &str, text: &str) -> Result<&'static Profile, FileError> {
    kept(&Shelf { folder: None }.draft(file, text, 0)?)
}

/// Reads a profile file, the set-up archive of a TML drive (`.t.zip`), or the data sheet of a CANopen
/// device (`.eds`, `.dcf`). `extends` may name another
/// file of its folder, or a profile that is compiled in.
///
/// # Errors
/// [`FileError`], also for a file that cannot be read.
pub fn load(path: &Path) -> Result<&'static Profile, FileError> {
    if setup::is_archive(path) {
        return kept(&setup::draft(path)?);
    }
    if crate::eds::is_sheet(path) {
        return kept(&crate::eds::draft(path)?);
    }
    let text = text_of(path)?;
    let folder = path.parent().map(Path::to_path_buf);
    kept(&Shelf { folder }.draft(&path.display().to_string(), &text, 0)?)
}

/// Reads a text file of bounded size.
pub(crate) fn text_of(path: &Path) -> Result<String, FileError> {
    let whole = |reason| FileError::whole(path.display().to_string(), reason);
    let bytes = file::bytes_of(path, FILE_MAX).map_err(whole)?;
    String::from_utf8(bytes).map_err(|_| whole("no text: its bytes are no UTF-8".to_owned()))
}

/// Leaks a draft once per content.
fn kept(draft: &Draft) -> Result<&'static Profile, FileError> {
    static KEPT: Mutex<Option<HashMap<String, &'static Profile>>> = Mutex::new(None);
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let kept = kept.get_or_insert_with(HashMap::new);
    // The draft's own words are its content; places are part of it, which only costs a repetition
    // when the same profile stands in two files.
    let content = format!("{draft:?}");
    if let Some(profile) = kept.get(&content) {
        return Ok(profile);
    }
    if kept.len() >= PROFILES_MAX {
        return Err(draft.place.error(format!("more than {PROFILES_MAX} profiles in one process")));
    }
    let profile = resolve::profile(draft)?;
    kept.insert(content, profile);
    Ok(profile)
}

/// Where the profile that another extends is looked for.
struct Shelf {
    folder: Option<PathBuf>,
}

impl Shelf {
    fn draft(&self, file: &str, text: &str, depth: usize) -> Result<Draft, FileError> {
        read::draft(file, text, &mut |name| self.base(name, depth + 1))
    }

    fn base(&self, name: &Found<String>, depth: usize) -> Result<Draft, FileError> {
        if depth > EXTENDS_MAX {
            let reason = format!("more than {EXTENDS_MAX} profiles extend one another");
            return Err(name.place.error(reason));
        }
        if let Some(path) = self.file_of(&name.value) {
            return self.draft(&path.display().to_string(), &text_of(&path)?, depth);
        }
        let known = polepair_core::drives::profiles();
        if let Some(profile) = known.iter().find(|profile| profile.name == name.value) {
            return Ok(Draft::of(profile));
        }
        let hint = words::hint(&name.value, known.iter().map(|profile| profile.name));
        Err(name.place.error(format!("no profile `{}` to extend{hint}", name.value)))
    }

    fn file_of(&self, name: &str) -> Option<PathBuf> {
        let plain = !name.contains(['/', '\\']) && !name.starts_with('.');
        let path = self.folder.as_ref()?.join(format!("{name}.toml"));
        (plain && path.is_file()).then_some(path)
    }
}
