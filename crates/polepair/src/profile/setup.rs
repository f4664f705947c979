//! Set-ups of TML drives: archives, `NAME.t.zip`, or folders with the same files. `variables.cfg` lists the
//! memory of the drive's firmware, with user variables.
//!
//! Texts, units, faults and steps come from the compiled-in profile with the most similar memory. Names
//! that the archive lacks are not offered. `setup.cfg` has the values of the set-up table; its format is
//! not documented, so it is not read.

use super::draft::Draft;
use super::memory_map;
use super::read::MEMORY_PROTOCOL;
use crate::spelling::fold;
use crate::toml_file::{FileError, FileLocation, read_limited};
use polepair_core::profile::Profile;
use std::collections::HashSet;
use std::io::{Cursor, Read, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

/// The file with the memory's names.
const VARIABLES: &str = "variables.cfg";
/// The largest archive, bytes.
const ARCHIVE_MAX: u64 = 4 << 20;
/// Files in an archive.
const FILES_MAX: usize = 256;
/// The longest list of variables, bytes unpacked.
const VARIABLES_MAX: u64 = 1 << 20;

/// Returns whether a path is an archive, by its name, or a folder.
pub(super) fn is_setup(path: &Path) -> bool {
    path.is_dir() || path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("zip"))
}

/// Reads an archive or a folder.
pub(super) fn draft_profile(path: &Path) -> Result<Draft, FileError> {
    let file = path.display().to_string();
    let text = read_variables(path).map_err(|reason| FileError::for_file(&file, reason))?;
    let location = FileLocation::built_in(&format!("{file}: {VARIABLES}"));
    let entries =
        memory_map::parse_entries(&text, false).map_err(|reason| location.error(reason))?;
    let base = most_similar_profile(&entries).ok_or_else(|| {
        location.error(
            "no variable has the address that the TML profiles define: is this the set-up \
             of a TML drive?",
        )
    })?;
    let mut draft = Draft::from_profile(base);
    draft.name = name_from_path(path);
    draft.title = format!("{} with the set-up of {}", base.title, draft.name);
    draft.location = location.clone();
    memory_map::apply_entries(&mut draft, entries, &location);
    Ok(draft)
}

/// The text of `variables.cfg`; bytes that are no UTF-8 can only stand in comments.
fn read_variables(path: &Path) -> Result<String, String> {
    if path.is_dir() {
        let bytes = read_limited(&path.join(VARIABLES), VARIABLES_MAX)?;
        return Ok(String::from_utf8_lossy(&bytes).into_owned());
    }
    let file = Cursor::new(read_limited(path, ARCHIVE_MAX)?);
    let mut archive = ZipArchive::new(file).map_err(|e| format!("no archive: {e}"))?;
    // EasyMotion Studio writes a handful.
    if archive.len() > FILES_MAX {
        return Err(format!("more than {FILES_MAX} files in it"));
    }
    let names = archive.file_names().filter_map(Result::ok).map(std::borrow::Cow::into_owned);
    let known = names.into_iter().find(|name| file_part(name) == VARIABLES);
    let known = known.ok_or_else(|| format!("no {VARIABLES} in it"))?;
    let packed = archive.by_name(&known).map_err(|e| format!("{known}: {e}"))?;
    let mut bytes = Vec::new();
    // The archive's own statement of the size is not trusted.
    let read = packed.take(VARIABLES_MAX + 1).read_to_end(&mut bytes);
    read.map_err(|e| format!("{known}: {e}"))?;
    if bytes.len() as u64 > VARIABLES_MAX {
        return Err(format!("{known}: longer than {VARIABLES_MAX} bytes"));
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn file_part(name: &str) -> String {
    name.rsplit(['/', '\\']).next().unwrap_or("").to_ascii_lowercase()
}

/// The shipped profile that has most names at the same addresses.
fn most_similar_profile(entries: &[memory_map::MapEntry<'_>]) -> Option<&'static Profile> {
    let places: HashSet<(String, u16)> =
        entries.iter().map(|entry| (fold(entry.name), entry.address)).collect();
    let common = |profile: &&&'static Profile| {
        profile.parameters.iter().filter(|p| places.contains(&(fold(p.symbol), p.index))).count()
    };
    let memories = polepair_drives::profiles().iter().filter(|p| p.protocol == MEMORY_PROTOCOL);
    // Of equals the first: maps share most of their names.
    let best = memories.rev().max_by_key(common).copied()?;
    (common(&&best) > 0).then_some(best)
}

/// `My drive.t.zip` → `my-drive`.
pub(crate) fn name_from_path(path: &Path) -> String {
    let stem = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let stem = stem.trim_end_matches(".zip").trim_end_matches(".t");
    let stem = stem.trim_end_matches(".eds").trim_end_matches(".dcf");
    let name: String = stem.chars().map(|c| if is_name_char(c) { c } else { '-' }).collect();
    if name.is_empty() { "setup".to_owned() } else { name }
}

fn is_name_char(c: char) -> bool {
    c.is_ascii_lowercase() || c.is_ascii_digit() || "-_.".contains(c)
}

/// Writes the memory of a profile as a set-up archive, which [`load_profile`](crate::load_profile) reads again.
///
/// # Errors
/// [`FileError`] for a profile that is no memory, and for a file that cannot be written.
pub fn write_setup(profile: &Profile, path: &Path) -> Result<(), FileError> {
    let file = path.display().to_string();
    if profile.protocol != MEMORY_PROTOCOL {
        let reason = format!("`{}` has no memory map: only TML drives have set-ups", profile.name);
        return Err(FileError::for_file(file, reason));
    }
    pack_archive(profile, path).map_err(|e| FileError::for_file(file, e.to_string()))
}

fn pack_archive(profile: &Profile, path: &Path) -> zip::result::ZipResult<()> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    archive.start_file(VARIABLES, SimpleFileOptions::default())?;
    writeln!(archive, "# {}", profile.title)?;
    for p in profile.parameters {
        writeln!(archive, "{} {} @0x{:04X}", memory_map::type_word(p.encoding), p.symbol, p.index)?;
    }
    // Made in memory first: an archive that is cut off would hide the older one.
    Ok(polepair_files::write_atomic(path, archive.finish()?.get_ref())?)
}

#[cfg(test)]
mod tests {
    use super::{ARCHIVE_MAX, name_from_path, write_setup};
    use crate::profile::load_own_file as load;
    use polepair_drives::profiles;
    use std::io::Write;
    use std::path::{Path, PathBuf};
    use zip::write::SimpleFileOptions;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("polepair-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn archive(path: &Path, file: &str, text: &[u8]) {
        let mut zip = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
        zip.start_file(file, SimpleFileOptions::default()).unwrap();
        zip.write_all(text).unwrap();
        zip.finish().unwrap();
    }

    #[test]
    fn what_is_written_is_read_again() {
        let folder = folder("setup");
        for profile in profiles().iter().filter(|p| p.protocol == "tml") {
            let path = folder.join("My Drive.t.zip");
            write_setup(profile, &path).unwrap();
            let read = load(&path).unwrap();
            assert_eq!((read.name, read.protocol), ("my-drive", "tml"));
            assert_eq!(read.parameters.len(), profile.parameters.len());
            for (a, b) in read.parameters.iter().zip(profile.parameters) {
                assert_eq!((a.symbol, a.index, a.encoding), (b.symbol, b.index, b.encoding));
                assert_eq!((a.name, a.about), (b.name, b.about));
            }
            assert_eq!(read.signals.len(), profile.signals.len());
            assert_eq!(read.plans.len(), profile.plans.len());
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn an_archive_brings_its_own_variables_and_drops_what_it_lacks() {
        let folder = folder("setup-own");
        let path = folder.join("cell.t.zip");
        let text = b"# caf\xE9\r\nLONG APOS @0x0228 [rot]\r\nINT my_counter @0x03B0\r\n\
                     UINT SRL @0x090E\r\nCHAR odd @0x1\r\nLONG APOS @0x0300\r\n";
        archive(&path, "Setup/Variables.cfg", text);
        let profile = load(&path).unwrap();
        let symbols: Vec<_> = profile.parameters.iter().map(|p| (p.symbol, p.index)).collect();
        assert_eq!(symbols, [("APOS", 0x228), ("my_counter", 0x3B0), ("SRL", 0x90E)]);
        assert!(profile.signal(polepair_core::profile::Signal::Position).is_some());
        assert!(profile.signal(polepair_core::profile::Signal::Fault).is_none());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_variable_called_as_a_described_one_is_no_second_parameter() {
        let folder = folder("setup-clash");
        let path = folder.join("cell.t.zip");
        let text = b"# Configuration variables\nINT POSERR @0x022A\nLONG APOS @0x0228\n\
                     INT Position_Error @0x022A\nINT ACTUAL_POSITION @0x03B0\n";
        archive(&path, "variables.cfg", text);
        let profile = load(&path).unwrap();
        let names: Vec<_> = profile.parameters.iter().map(|p| (p.name, p.index)).collect();
        assert_eq!(
            names,
            [
                ("actual position", 0x228),
                ("position error", 0x22A),
                ("ACTUAL_POSITION@0x03B0", 0x3B0)
            ]
        );
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn hostile_archives_are_refused_with_a_reason() {
        let folder = folder("setup-bad");
        let path = folder.join("x.t.zip");
        let reason = || load(&path).unwrap_err().reason;
        std::fs::write(&path, b"PK\x03\x04 and nothing else").unwrap();
        assert!(reason().contains("no archive"), "{}", reason());
        archive(&path, "setup.cfg", b"");
        assert_eq!(reason(), "no variables.cfg in it");
        archive(&path, "variables.cfg", b"INT NOBODY @0x0001");
        assert!(reason().contains("is this the set-up of a TML drive"), "{}", reason());
        archive(&path, "variables.cfg", &vec![b'\n'; (1 << 20) + 1]);
        assert!(reason().contains("longer than"), "a small archive with much in it: {}", reason());
        std::fs::File::create(&path).unwrap().set_len(ARCHIVE_MAX + 1).unwrap();
        assert!(reason().contains("larger than"), "{}", reason());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn names_of_files_become_names_of_profiles() {
        assert_eq!(name_from_path(Path::new("/a/Axis 7.T.ZIP")), "axis-7");
        assert_eq!(name_from_path(Path::new(".zip")), "setup");
    }
}
