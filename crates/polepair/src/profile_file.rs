//! Reads any file that describes a drive as its profile.

use std::path::Path;

use polepair_core::profile::Profile;

use crate::eds;
use crate::profile::{intern_profile, load_own_file};
use crate::toml_file::FileError;

/// Reads a profile file, the set-up of a TML drive (`.t.zip`, or a folder with `variables.cfg`), or the data
/// sheet of a CANopen device (`.eds`, `.dcf`). `extends` may name another
/// file of its folder, or a profile that is compiled in.
///
/// # Errors
/// [`FileError`], also for a file that cannot be read.
pub fn load_profile(path: &Path) -> Result<&'static Profile, FileError> {
    if eds::is_eds_file(path) {
        intern_profile(&eds::draft_profile(path)?)
    } else {
        load_own_file(path)
    }
}
