//! Files that appear under their name when they are complete.

use std::fs::{File, OpenOptions, Permissions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile, TempPath};

use crate::unfinished::UnfinishedMark;

/// Links that are followed from the name of a file to the file.
const LINKS_MAX: usize = 40;
/// Bytes of a file's name that its temporary name repeats: both have to fit into the 255 of a file system.
const NAME_MAX: usize = 200;

/// A file that is written beside its place and takes it in [`commit`](Self::commit), in one step.
///
/// A file that was there keeps its content until then, and for ever if this value is dropped; its permissions go over
/// to the new one. A symbolic link stays, and its target is replaced. A path that is no file (a terminal, a pipe,
/// `/dev/null`) is written directly.
#[derive(Debug)]
pub struct AtomicFile(AtomicTarget);

/// Read permission of a new file.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Access {
    /// Permission of the replaced file; for a new file, that of the user's umask.
    AsUmask,
    OwnerOnly,
}

#[derive(Debug)]
enum AtomicTarget {
    Beside(FileBeside),
    Direct(BufWriter<File>),
}

/// A file under a temporary name.
#[derive(Debug)]
struct FileBeside {
    /// `None` while it is parked.
    file: Option<BufWriter<File>>,
    temporary: TempPath,
    place: PathBuf,
    mark: UnfinishedMark,
}

/// A complete file without its name, and without an open descriptor.
#[derive(Debug)]
pub struct SealedFile(Option<FileBeside>);

impl AtomicFile {
    /// Begins a file that others may read as far as the user's umask allows.
    ///
    /// # Errors
    /// Those of the operating system: its folder is missing or cannot be written to, its name is that of a folder.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::create_with(path, Access::AsUmask)
    }

    fn create_with(path: &Path, access: Access) -> io::Result<Self> {
        let place = follow_links(path)?;
        let found = match std::fs::metadata(&place) {
            Ok(found) if found.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Ok(found) if !found.is_file() => {
                let device = OpenOptions::new().write(true).open(&place)?;
                return Ok(Self(AtomicTarget::Direct(BufWriter::new(device))));
            }
            // A file that cannot be written is not replaced either: its owner protected it.
            Ok(found) => {
                OpenOptions::new().write(true).open(&place)?;
                Some(found.permissions())
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        let file = create_beside(&place, access)?;
        if let (Some(permissions), Access::AsUmask) = (found, access) {
            file.as_file().set_permissions(permissions)?;
        }
        let mark = UnfinishedMark::new(file.path());
        let (file, temporary) = file.into_parts();
        let file = Some(BufWriter::new(file));
        Ok(Self(AtomicTarget::Beside(FileBeside { file, temporary, place, mark })))
    }

    /// Closes the file until the next write: a process may have more files under way than descriptors.
    ///
    /// # Errors
    /// Those of the operating system: buffered bytes could not be written.
    pub fn park(&mut self) -> io::Result<()> {
        match &mut self.0 {
            AtomicTarget::Beside(beside) => beside.close().map(drop),
            AtomicTarget::Direct(device) => device.flush(),
        }
    }

    /// Writes the rest to the disk, and gives the file its name.
    ///
    /// # Errors
    /// Those of the operating system; an earlier file is left as it was.
    pub fn commit(self) -> io::Result<()> {
        self.seal()?.publish()
    }

    /// Writes the rest to the disk, and closes the file without giving it its name.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn seal(self) -> io::Result<SealedFile> {
        match self.0 {
            AtomicTarget::Direct(mut device) => {
                device.flush()?;
                Ok(SealedFile(None))
            }
            AtomicTarget::Beside(mut beside) => {
                beside.open()?;
                if let Some(file) = beside.close()? {
                    file.sync_all()?;
                }
                Ok(SealedFile(Some(beside)))
            }
        }
    }
}

impl FileBeside {
    fn open(&mut self) -> io::Result<&mut BufWriter<File>> {
        let file = match self.file.take() {
            Some(file) => file,
            None => BufWriter::new(OpenOptions::new().append(true).open(&self.temporary)?),
        };
        Ok(self.file.insert(file))
    }

    fn close(&mut self) -> io::Result<Option<File>> {
        let Some(file) = self.file.take() else { return Ok(None) };
        file.into_inner().map(Some).map_err(io::IntoInnerError::into_error)
    }
}

impl SealedFile {
    /// Gives the file its name.
    ///
    /// # Errors
    /// Those of the operating system; an earlier file is left as it was.
    pub fn publish(self) -> io::Result<()> {
        let Some(FileBeside { temporary, place, mark, .. }) = self.0 else { return Ok(()) };
        temporary.persist(&place).map_err(|refused| refused.error)?;
        drop(mark);
        sync_folder(&place);
        Ok(())
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.0 {
            AtomicTarget::Beside(beside) => beside.open()?.write(bytes),
            AtomicTarget::Direct(device) => device.write(bytes),
        }
    }

    /// Writes the buffered bytes to a device. A file is not read before it is complete.
    fn flush(&mut self) -> io::Result<()> {
        match &mut self.0 {
            AtomicTarget::Beside(_) => Ok(()),
            AtomicTarget::Direct(device) => device.flush(),
        }
    }
}

/// Writes a whole file, as [`AtomicFile`] does.
///
/// # Errors
/// Those of the operating system; an earlier file is left as it was.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes)?;
    file.commit()
}

/// Writes a whole file that only its owner can read, also if others could read the previous one.
///
/// # Errors
/// As [`write_atomic`].
pub fn write_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = AtomicFile::create_with(path, Access::OwnerOnly)?;
    file.write_all(bytes)?;
    file.commit()
}

/// The file that a path leads to, which need not exist.
fn follow_links(path: &Path) -> io::Result<PathBuf> {
    let mut place = path.to_owned();
    for _ in 0..LINKS_MAX {
        match std::fs::read_link(&place) {
            Ok(next) => place = place.parent().unwrap_or(Path::new("")).join(next),
            // It is no link, or nothing.
            Err(_) => return Ok(place),
        }
    }
    Err(io::Error::other("too many symbolic links"))
}

/// A new file in the folder of another, hidden until it takes its place.
fn create_beside(place: &Path, access: Access) -> io::Result<NamedTempFile> {
    let name = place.file_name().ok_or(io::ErrorKind::InvalidFilename)?.to_string_lossy();
    let shown = &name[..(0..=NAME_MAX.min(name.len()))
        .rev()
        .find(|end| name.is_char_boundary(*end))
        .unwrap_or(0)];
    let folder = match place.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let (prefix, mut builder) = (format!(".{shown}."), Builder::new());
    builder.prefix(&prefix).suffix(".part");
    if let Some(permissions) = permissions_of(access) {
        builder.permissions(permissions);
    }
    // The name in the error is the temporary one, which means nothing to a user.
    builder.tempfile_in(folder).map_err(|error| match error.raw_os_error() {
        Some(code) => io::Error::from_raw_os_error(code),
        None => error.kind().into(),
    })
}

#[cfg(unix)]
fn permissions_of(access: Access) -> Option<Permissions> {
    let mode = match access {
        Access::AsUmask => 0o666,
        Access::OwnerOnly => 0o600,
    };
    Some(std::os::unix::fs::PermissionsExt::from_mode(mode))
}

/// Files inherit the rights of their folder.
#[cfg(not(unix))]
fn permissions_of(_access: Access) -> Option<Permissions> {
    None
}

/// Has the new name survive a loss of power, where folders can be synced. The file itself is whole without it.
fn sync_folder(place: &Path) {
    if cfg!(unix)
        && let Some(folder) = place.parent().filter(|folder| !folder.as_os_str().is_empty())
        && let Ok(folder) = File::open(folder)
    {
        let _ = folder.sync_all();
    }
}
