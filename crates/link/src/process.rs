//! Limits and privacy settings of this process and its threads.

/// Raises this process' limit of open files and sockets to the system's maximum, and returns it; `None`
/// where the system does not report it.
#[cfg(unix)]
#[must_use]
pub fn raise_file_limit() -> Option<u64> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit { current: limit.maximum, ..limit };
    // macOS takes none that is not bounded: what was allowed stays so.
    match setrlimit(Resource::Nofile, raised) {
        Ok(()) => raised.current,
        Err(_) => limit.current,
    }
}

/// Raises the limit of open files, where the system has one.
#[cfg(not(unix))]
#[must_use]
pub const fn raise_file_limit() -> Option<u64> {
    None
}

/// Lowers the priority of the present thread below all others: for threads that only display. Does nothing
/// except on Linux, where priorities are per thread.
pub fn lower_priority() {
    #[cfg(target_os = "linux")]
    {
        const NICE: i32 = 10;
        // Without permission it keeps the ordinary priority.
        let _ = rustix::process::nice(NICE);
    }
}

/// Returns whether only its owner can read or write an open file that holds a token or a key. True where files have no
/// such modes.
///
/// # Errors
/// When the system does not report the file's mode.
#[cfg_attr(not(unix), allow(clippy::missing_const_for_fn, reason = "it asks on Unix"))]
pub fn is_private_file(file: &std::fs::File) -> std::io::Result<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        Ok(file.metadata()?.permissions().mode() & 0o077 == 0)
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        Ok(true)
    }
}

/// Returns whether only this user and the system's administrator could have written a file: it is owned by one of them,
/// and others have no right to write. True where files have no owners.
///
/// # Errors
/// When the system does not report it.
#[cfg_attr(not(unix), allow(clippy::missing_const_for_fn, reason = "it asks on Unix"))]
pub fn is_trusted_file(path: &std::path::Path) -> std::io::Result<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        const OTHERS_WRITE: u32 = 0o002;
        let found = std::fs::metadata(path)?;
        let is_own = found.uid() == 0 || found.uid() == rustix::process::geteuid().as_raw();
        Ok(is_own && found.mode() & OTHERS_WRITE == 0)
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        Ok(true)
    }
}
