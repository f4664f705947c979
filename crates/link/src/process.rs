//! Limits and privacy settings of this process and its threads.

/// Lets this process open as many files and sockets as the system lets it, and tells how many that
/// are; `None` where that is not told.
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

/// As on Unix, where it is told.
#[cfg(not(unix))]
#[must_use]
pub const fn raise_file_limit() -> Option<u64> {
    None
}

/// Lets the present thread stand back behind all others when processors are short: for what only
/// shows. Elsewhere than on Linux a whole process would, so nothing is done.
pub fn lower_priority() {
    #[cfg(target_os = "linux")]
    {
        const NICE: i32 = 10;
        // Where that is not let, it is as important as any other.
        let _ = rustix::process::nice(NICE);
    }
}

/// Whether nobody but its owner may read or write an open file: what a token or a key lies in. Where
/// files have no such modes, it is taken for so.
///
/// # Errors
/// When the system does not tell.
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
