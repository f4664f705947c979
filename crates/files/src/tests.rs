use std::io::Write as _;
use std::path::Path;

use super::*;

fn entries(folder: &Path) -> Vec<String> {
    let found = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        found.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn a_file_keeps_its_content_until_the_new_one_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    std::fs::write(&path, "old").unwrap();
    let mut dropped = AtomicFile::create(&path).unwrap();
    dropped.write_all(b"half").unwrap();
    assert_eq!(entries(folder.path()).len(), 2);
    drop(dropped);
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
    assert_eq!(entries(folder.path()), ["a.csv"]);
    write_atomic(&path, b"new").unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"new");
    assert_eq!(entries(folder.path()), ["a.csv"]);
    assert!(AtomicFile::create(folder.path()).is_err(), "a folder");
    assert!(AtomicFile::create(&folder.path().join("missing/a.csv")).is_err());
}

#[test]
fn long_names_have_a_temporary_name_too() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["n".repeat(255), "ü".repeat(127)] {
        write_atomic(&folder.path().join(&name), b"1").unwrap();
        assert!(entries(folder.path()).contains(&name));
    }
}

#[test]
fn a_sealed_file_holds_no_descriptor_and_appears_when_published() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part");
    let mut sealed = Vec::new();
    for n in 0..1200 {
        let mut file = AtomicFile::create(&path.with_extension(n.to_string())).unwrap();
        file.write_all(b"ro").unwrap();
        file.park().unwrap();
        file.write_all(b"ws").unwrap();
        sealed.push(file.seal().unwrap());
    }
    assert!(!path.with_extension("7").exists());
    sealed.into_iter().for_each(|file| file.publish().unwrap());
    assert_eq!(std::fs::read(path.with_extension("1199")).unwrap(), b"rows");
}

#[test]
fn a_growing_file_overwrites_nothing_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bus.log");
    let add = |existing| create_growing(&path, existing).and_then(|mut file| file.write_all(b"1"));
    add(ExistingFile::Refuse).unwrap();
    assert_eq!(add(ExistingFile::Refuse).unwrap_err().kind(), std::io::ErrorKind::AlreadyExists);
    add(ExistingFile::Append).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"11");
    add(ExistingFile::Replace).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"1");
}

#[cfg(unix)]
mod unix {
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    use super::*;

    fn mode(path: &Path) -> u32 {
        std::fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn links_and_permissions_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("deep")).unwrap();
        symlink("deep/link", at("link")).unwrap();
        symlink("../real", at("deep/link")).unwrap();
        write_atomic(&at("link"), b"1").unwrap();
        std::fs::set_permissions(at("real"), std::fs::Permissions::from_mode(0o640)).unwrap();
        write_atomic(&at("link"), b"2").unwrap();
        assert_eq!(std::fs::read(at("real")).unwrap(), b"2");
        assert_eq!(mode(&at("real")), 0o640);
        assert!(at("link").is_symlink() && at("deep/link").is_symlink());
        write_atomic(&at("secret"), b"3").unwrap();
        std::fs::set_permissions(at("secret"), std::fs::Permissions::from_mode(0o644)).unwrap();
        write_private(&at("secret"), b"3").unwrap();
        assert_eq!(mode(&at("secret")), 0o600);
        symlink("loop", at("loop")).unwrap();
        assert!(write_atomic(&at("loop"), b"4").is_err());
    }

    #[test]
    fn one_file_is_known_by_all_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("a"), "1").unwrap();
        std::fs::write(at("b"), "1").unwrap();
        symlink("a", at("soft")).unwrap();
        std::fs::hard_link(at("a"), at("hard")).unwrap();
        for (other, same) in [("a", true), ("./a", true), ("soft", true), ("hard", true)] {
            assert_eq!(is_same_file(&at("a"), &at(other)), same, "{other}");
        }
        assert!(!is_same_file(&at("a"), &at("b")) && !is_same_file(&at("a"), &at("missing")));
        assert!(!is_same_file(Path::new("/dev/null"), Path::new("/dev/null")));
    }

    #[test]
    fn devices_are_written_directly() {
        let mut file = AtomicFile::create(Path::new("/dev/null")).unwrap();
        file.write_all(b"1").unwrap();
        file.commit().unwrap();
        assert!(create_growing(Path::new("/dev/null"), ExistingFile::Refuse).is_ok());
    }
}
