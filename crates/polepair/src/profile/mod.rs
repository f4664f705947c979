//! Profiles from files.
//!
//! A profile describes a drive's parameters, units, limits, faults and plans. Profiles of this repository are
//! compiled in; this module reads further ones from TOML at run time.
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
//! let id = profile.find_parameter("Max-Current").unwrap();
//! assert_eq!(profile.parameter(id).unwrap().index, 0x10);
//!
//! let error = polepair::profile::parse("bad.toml", &text.replace("scale", "scael")).unwrap_err();
//! assert_eq!(error.to_string(), "bad.toml:8:1: unknown key `scael`; did you mean `scale`?");
//! # Ok::<(), polepair::FileError>(())
//! ```

mod bits;
mod blocks;
mod catalogue;
mod digits;
pub(crate) mod draft;
mod memory_map;
mod missing_parameters;
mod motors;
mod plan_text;
mod read;
mod resolve;
mod scale;
mod serial_line;
mod setup;
mod signals;
mod step;
mod stops;
#[cfg(test)]
mod tests;
mod watchdog;

pub use catalogue::{Listed, catalogue, find_shipped, shipped_profiles};
pub use setup::write_setup;

pub(crate) use catalogue::{find_answered, find_listed, find_nearest, listed_for};
pub(crate) use missing_parameters::remove_missing;
pub(crate) use setup::name_from_path;
pub(crate) use step::argument_word;

use crate::error::Error;
use crate::toml_file::{self, FileError, Located};
use crate::{registry, spelling};
use draft::Draft;
use polepair_core::profile::{Parameter, Profile};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Generic profile of a protocol, by the protocol's word in connection strings: `tmcl`, `canopen`, `modbus-rtu`. It
/// serves a drive without a profile.
///
/// ```
/// let tmcl = polepair::profile::generic_profile("tmcl").unwrap();
/// assert!(tmcl.find_parameter("actual position").is_some());
/// ```
#[must_use]
pub fn generic_profile(protocol: &str) -> Option<&'static Profile> {
    registry::protocol_by_word(protocol).map(|found| found.generic)
}

/// Different profiles that one process reads at most: each stays in memory for good.
pub const PROFILES_MAX: usize = 256;

/// The protocol whose motors differ by the places of their registers.
const REGISTER_PROTOCOL: &str = "modbus";

/// Profiles that may extend one another in a row.
const EXTENDS_MAX: usize = 8;

/// The largest profile file, bytes.
const FILE_MAX: u64 = 4 << 20;

/// Reads a profile from text; `file` is its name in complaints. `extends` may name a profile that
/// is compiled in, or a protocol (`tmcl`) for what all its drives have. The same text gives the same `&'static` again.
///
/// # Errors
/// [`FileError`] with line, column and reason; or that [`PROFILES_MAX`] are read already.
pub fn parse(file: &str, text: &str) -> Result<&'static Profile, FileError> {
    read_profile(file, text, None)
}

/// Reads a profile file, or the set-up of a TML drive.
pub(crate) fn load_own_file(path: &Path) -> Result<&'static Profile, FileError> {
    if setup::is_setup(path) {
        return intern_profile(&setup::draft_profile(path)?);
    }
    let text = read_text(path)?;
    let folder = path.parent().map(Path::to_path_buf);
    read_profile(&path.display().to_string(), &text, folder)
}

/// Reads a profile, once for each of its motors where one address has several.
fn read_profile(
    file: &str,
    text: &str,
    folder: Option<PathBuf>,
) -> Result<&'static Profile, FileError> {
    let mut bases = BaseProfiles { folder, motor: 0 };
    let mut draft = bases.read_draft(file, text, 0)?;
    let is_of_objects = draft.protocol == read::OBJECT_PROTOCOL;
    // Elsewhere the motor is a field of each request.
    if is_of_objects || draft.protocol == REGISTER_PROTOCOL {
        let first = format!("{draft:?}");
        for motor in 1..usize::from(draft.motors) {
            bases.motor = motor;
            let mut further = bases.read_draft(file, text, 0)?;
            if format!("{further:?}") == first {
                // The axes of a node may lie at the distance that the standard gives.
                if is_of_objects {
                    break;
                }
                let reason = "`motors` needs a list: `index = [0x2088, 0x2089]` is one for each";
                return Err(draft.location.error(reason));
            }
            (draft.lists_motors, further.lists_motors) = (true, true);
            draft.further_motors.push(intern_profile(&further)?);
        }
    }
    intern_profile(&draft)
}

/// Reads a text file of bounded size.
pub(crate) fn read_text(path: &Path) -> Result<String, FileError> {
    let whole = |reason| FileError::for_file(path.display().to_string(), reason);
    let bytes = toml_file::read_limited(path, FILE_MAX).map_err(whole)?;
    String::from_utf8(bytes).map_err(|_| whole("no text: its bytes are no UTF-8".to_owned()))
}

/// Leaks a draft once per content.
pub(crate) fn intern_profile(draft: &Draft) -> Result<&'static Profile, FileError> {
    static PROFILE_CACHE: Mutex<Option<HashMap<String, &'static Profile>>> = Mutex::new(None);
    let mut stored = PROFILE_CACHE.lock().unwrap_or_else(PoisonError::into_inner);
    let stored = stored.get_or_insert_with(HashMap::new);
    // The draft's own words are its content; locations are part of it, which only costs a repetition if two files have
    // the same profile.
    let content = format!("{draft:?}");
    if let Some(profile) = stored.get(&content) {
        return Ok(profile);
    }
    if stored.len() >= PROFILES_MAX {
        return Err(draft
            .location
            .error(format!("more than {PROFILES_MAX} profiles in one process")));
    }
    let profile = resolve::resolve_profile(draft)?;
    stored.insert(content, profile);
    Ok(profile)
}

/// Search path of the profile that another extends.
struct BaseProfiles {
    folder: Option<PathBuf>,
    /// The motor whose profile is read, counted from 0.
    motor: usize,
}

impl BaseProfiles {
    fn read_draft(&self, file: &str, text: &str, depth: usize) -> Result<Draft, FileError> {
        read::read_draft(file, text, self.motor, &mut |name| self.find_base(name, depth + 1))
    }

    fn find_base(&self, name: &Located<String>, depth: usize) -> Result<Draft, FileError> {
        if depth > EXTENDS_MAX {
            let reason = format!("more than {EXTENDS_MAX} profiles extend one another");
            return Err(name.location.error(reason));
        }
        if let Some(path) = self.base_file(&name.value) {
            return self.read_draft(&path.display().to_string(), &read_text(&path)?, depth);
        }
        let known = polepair_drives::profiles();
        if let Some(profile) = known.iter().find(|profile| profile.name == name.value) {
            let mut draft = Draft::from_profile(profile);
            plan_text::add_plan_texts(&mut draft, self.motor)?;
            return Ok(draft);
        }
        if let Some(module) = find_listed(&name.value) {
            return self.read_draft(&format!("{}.toml", module.name), module.text(), depth);
        }
        if let Some(generic) = generic_profile(&name.value) {
            return Ok(Draft::from_profile(generic));
        }
        let names = known.iter().map(|profile| profile.name);
        let names = names.chain(catalogue().iter().map(|module| module.name));
        let hint = spelling::suggestion(&name.value, names);
        Err(name.location.error(format!("no profile `{}` to extend{hint}", name.value)))
    }

    fn base_file(&self, name: &str) -> Option<PathBuf> {
        let plain = !name.contains(['/', '\\']) && !name.starts_with('.');
        let path = self.folder.as_ref()?.join(format!("{name}.toml"));
        (plain && path.is_file()).then_some(path)
    }
}

/// A profile with another number of full steps a turn than its rules assume.
///
/// # Errors
/// [`Error::Usage`] `E210`: invalid number, no stepper motor, or a drive that reports its steps itself.
pub(crate) fn profile_with_steps(
    profile: &'static Profile,
    steps: u64,
) -> Result<&'static Profile, Error> {
    type Known = HashMap<(&'static str, usize, u64), &'static Profile>;
    static KNOWN: Mutex<Option<Known>> = Mutex::new(None);
    if !(4..=10_000).contains(&steps) {
        let what = format!("`steps={steps}` is no number of full steps");
        return Err(profile_error(what, "200 and 400 are usual; at most 10000"));
    }
    let Some((assumed, object)) = profile.parameters.iter().find_map(full_steps_rule) else {
        let what =
            format!("`steps={steps}`: {} has no stepper motor that it is for", profile.title);
        return Err(profile_error(what, "leave it out"));
    };
    if let Some(own) = profile.find_object(object).and_then(|id| profile.parameter(id)) {
        let what = format!("`steps={steps}`: {} has a setting for it", profile.title);
        return Err(profile_error(what, &format!("set `{}` ({})", own.name, own.symbol)));
    }
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let key = (profile.name, std::ptr::from_ref(profile) as usize, steps);
    Ok(known.get_or_insert_default().entry(key).or_insert_with(|| {
        let mut parameters = profile.parameters.to_vec();
        for parameter in
            parameters.iter_mut().filter(|parameter| full_steps_rule(parameter).is_some())
        {
            parameter.scale.factor *= assumed / steps as f64;
        }
        let parameters = parameters.leak();
        Box::leak(Box::new(Profile { parameters, ..profile.clone() }))
    }))
}

fn full_steps_rule(parameter: &Parameter) -> Option<(f64, (u16, u8))> {
    parameter.scale.rule.and_then(|rule| rule.full_steps)
}

fn profile_error(what: String, hint: &str) -> Error {
    Error::usage("E210", what, hint.to_owned())
}
