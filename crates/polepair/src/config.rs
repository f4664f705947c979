//! `polepair.toml` and the configuration folder: named links and users' own profiles.
//!
//! ```toml
//! # polepair.toml, found in the working folder, in any folder above it, or in the configuration
//! # folder ($XDG_CONFIG_HOME/polepair, ~/.config/polepair; on Windows %APPDATA%\polepair)
//! name = "machine"                # optional: what all links of the rack below are called together
//!
//! [links]
//! arm = "tmcl+serial:///dev/ttyUSB0:9600#1,2"
//!
//! [[link]]                        # a rack, as in a file for `sim:`
//! name = "cell"
//! connect = "socketcan://can0"    # without it, it is simulated
//! bitrate = 1000000
//!
//! [[link.drive]]
//! name = "x"
//! profile = "tmcm-171"
//! address = 3
//! lead = "5 mm"
//! ```
//! `@arm` is then a connection string, as are `@arm#2`, `@arm?timeout=50` and `@cell#x`. `@machine` is every
//! `[[link]]`. A rack is read at its first use, so its errors do not affect other links.

use crate::error::Error;
use crate::profile::{self, read_text};
use crate::profile_file::load_profile;
use crate::simulate;
use crate::spelling;
use crate::toml_file::{FileError, SourceText};
use crate::url;
use polepair_core::profile::Profile;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Folders above the working folder that are looked into.
const FOLDERS_MAX: usize = 64;
/// The file's name.
pub const FILE: &str = "polepair.toml";

/// Named links and users' profiles.
#[derive(Clone, Debug, Default)]
pub struct Config {
    /// File of the names, if one was found.
    pub file: Option<PathBuf>,
    /// Names and their connection strings, by name.
    pub links: Vec<(String, String)>,
    /// Profiles beyond those that are compiled in.
    pub profiles: Vec<&'static Profile>,
    /// Files with errors. They prevent only what needs them. The caller should report them once.
    pub broken: Vec<FileError>,
    /// Notices on drives that were changed during their identification.
    notices: Arc<Mutex<Vec<String>>>,
}

impl Config {
    /// Takes the notices on drives that were changed during their identification, since the last call. The caller
    /// should report them.
    #[must_use]
    pub fn take_notices(&self) -> Vec<String> {
        std::mem::take(&mut *self.notices.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn add_notice(&self, notice: String) {
        self.notices.lock().unwrap_or_else(PoisonError::into_inner).push(notice);
    }

    /// Searches from the working folder upward, and in the configuration folder. A file with errors is in
    /// [`broken`](Self::broken), and so is one of another user or one that others may write to, which is not read.
    #[must_use]
    pub fn discover() -> Self {
        let here = std::env::current_dir().unwrap_or_default();
        Self::discover_from(&here, folder().as_deref())
    }

    /// The configuration found from `here` upward and in the folder `folder`, as [`discover`](Self::discover).
    #[must_use]
    pub fn discover_from(here: &Path, folder: Option<&Path>) -> Self {
        let above = here.ancestors().take(FOLDERS_MAX).chain(folder);
        let mut config = Self::default();
        let mut found = above.map(|folder| folder.join(FILE)).filter(|file| file.is_file());
        // A file of another user could make `@arm` another motor.
        let file = found.find(|file| match polepair_link::is_trusted_file(file) {
            Ok(true) => true,
            Ok(false) => {
                let reason = "it belongs to another user, or others may write to it: chown and \
                              chmod o-w make it yours";
                config.broken.push(FileError::for_file(file.display().to_string(), reason));
                false
            }
            Err(error) => {
                let file = file.display().to_string();
                config.broken.push(FileError::for_file(file, error.to_string()));
                false
            }
        });
        if let Some(file) = file {
            match Self::read_links(&file) {
                Ok(links) => config.links = links,
                Err(error) => config.broken.push(error),
            }
            config.file = Some(file);
        }
        let own = folder.map(|folder| profile_files(&folder.join("profiles")));
        for file in own.into_iter().flatten() {
            match load_profile(&file) {
                Ok(profile) => config.profiles.push(profile),
                Err(error) => config.broken.push(error),
            }
        }
        config
    }

    /// Reads one `polepair.toml`.
    ///
    /// # Errors
    /// [`Error::File`] with file, line, column and reason.
    pub fn load(file: &Path) -> Result<Self, Error> {
        let links = Self::read_links(file)?;
        Ok(Self { file: Some(file.to_path_buf()), links, ..Self::default() })
    }

    fn read_links(file: &Path) -> Result<Vec<(String, String)>, FileError> {
        parse_links(&file.display().to_string(), &read_text(file)?)
    }

    /// Adds a profile file.
    ///
    /// # Errors
    /// [`Error::File`] with file, line, column and reason.
    pub fn add_profile(&mut self, file: &Path) -> Result<&'static Profile, Error> {
        let profile = load_profile(file)?;
        self.profiles.retain(|other| other.name != profile.name);
        self.profiles.push(profile);
        Ok(profile)
    }

    /// The profile of that name: the user's own go before those that are compiled in.
    #[must_use]
    pub fn profile(&self, name: &str) -> Option<&'static Profile> {
        let own = self.all_profiles().find(|profile| profile.name == name);
        own.or_else(|| profile::find_shipped(name))
    }

    /// The profile that a word means: that of a name, or a file.
    ///
    /// # Errors
    /// [`Error::File`] with file, line, column and reason.
    pub fn resolve_profile(&self, word: &str) -> Result<&'static Profile, Error> {
        match (self.profile(word), self.broken_profile(word)) {
            (Some(known), _) => Ok(known),
            (None, Some(error)) => Err(error.clone().into()),
            (None, None) => Ok(load_profile(word.as_ref())?),
        }
    }

    /// Returns whether a file was found and is wrong.
    pub(crate) fn is_broken(&self, file: &Path) -> bool {
        self.broken.iter().any(|error| Path::new(&error.file) == file)
    }

    /// Error of the user's own profile of that name.
    pub(crate) fn broken_profile(&self, name: &str) -> Option<&FileError> {
        self.broken.iter().find(|error| {
            let file = Path::new(&error.file);
            file.file_stem().is_some_and(|stem| stem == name) && self.file.as_deref() != Some(file)
        })
    }

    /// Every profile but those of the [catalogue](profile::catalogue), the user's own first.
    pub fn all_profiles(&self) -> impl Iterator<Item = &'static Profile> {
        self.profiles.iter().chain(polepair_drives::profiles()).copied()
    }

    /// Expands `@` names to connection strings. Other texts are returned unchanged.
    ///
    /// # Errors
    /// [`Error::Usage`] `E211` for an unknown name; [`Error::File`] if the file that may have it has
    /// errors.
    pub fn expand(&self, text: &str) -> Result<String, Error> {
        let Some(named) = text.strip_prefix('@') else { return Ok(text.to_owned()) };
        let (name, more) = named.split_at(named.find(['?', '#']).unwrap_or(named.len()));
        let known = self.links.iter().find(|(other, _)| other == name);
        let Some((_, url)) = known else {
            let file = self.file.as_deref();
            let broken = self.broken.iter().find(|it| file == Some(Path::new(&it.file)));
            if let Some(error) = broken {
                return Err(error.clone().into());
            }
            let names = self.links.iter().map(|(name, _)| name.as_str());
            let near = spelling::suggestion(name, names);
            let location = self.file.as_ref().map_or_else(
                || format!("no {FILE} was found"),
                |file| format!("{} does not have it", file.display()),
            );
            let what = format!("no link is called `@{name}`{near}");
            let hint = format!(
                "{location}; write `{name} = \"…\"` below [links], or a [[link]] of that name"
            );
            return Err(Error::usage("E211", what, hint));
        };
        Ok(merge_url(url, more))
    }
}

/// The named string with the keys and axes of `more` in place of its own.
fn merge_url(url: &str, more: &str) -> String {
    let (rest, axes) = url.split_once('#').map_or((url, None), |(a, b)| (a, Some(b)));
    let (head, keys) = rest.split_once('?').map_or((rest, ""), |(a, b)| (a, b));
    let (new_keys, new_axes) = more.split_once('#').map_or((more, None), |(a, b)| (a, Some(b)));
    let new_keys = new_keys.trim_start_matches('?');
    let replaced: Vec<String> = new_keys.split('&').map(pair_name).collect();
    let stored = keys.split('&').filter(|pair| !replaced.contains(&pair_name(pair)));
    let all: Vec<&str> =
        stored.chain(new_keys.split('&')).filter(|pair| !pair.is_empty()).collect();
    let mut out = head.to_owned();
    if !all.is_empty() {
        out.push('?');
        out.push_str(&all.join("&"));
    }
    if let Some(axes) = new_axes.or(axes) {
        out.push('#');
        out.push_str(axes);
    }
    out
}

fn pair_name(pair: &str) -> String {
    pair.split_once('=').map_or(pair, |(name, _)| name).to_owned()
}

/// Every name of a file with its connection string.
fn parse_links(file: &str, text: &str) -> Result<Vec<(String, String)>, FileError> {
    SourceText::new(file, text).parse(&simulate::FILE_KEYS, |node| {
        let mut links: Vec<(String, String)> = Vec::new();
        if let Some(table) = node.table("links", &[])? {
            for key in table.keys() {
                links.push((key.value.to_owned(), table.required_text(key.value)?.value));
            }
        }
        let whole = node.text("name")?.map(|name| (name, None));
        let racks = node.tables("link", &[])?;
        let racks: Vec<_> = racks.iter().map(|rack| rack.text("name")).collect::<Result<_, _>>()?;
        let racks = racks.into_iter().flatten().map(|name| (name.clone(), Some(name.value)));
        for (name, link) in whole.into_iter().chain(racks) {
            if links.iter().any(|(other, _)| *other == name.value) {
                let reason = format!("`{}` is already used as another name", name.value);
                return Err(name.location.error(reason));
            }
            links.push((name.value, url::rack_url(file, link.as_deref())));
        }
        Ok(links)
    })
}

/// The configuration folder.
#[must_use]
pub fn folder() -> Option<PathBuf> {
    let base = if cfg!(windows) {
        env_path("APPDATA")
    } else {
        env_path("XDG_CONFIG_HOME").or_else(|| env_path("HOME").map(|home| home.join(".config")))
    };
    base.map(|base| base.join("polepair"))
}

fn env_path(name: &str) -> Option<PathBuf> {
    std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from)
}

/// The profiles of a folder, by name.
fn profile_files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|file| file.extension().is_some_and(|e| e == "toml"));
    files.sort();
    files.truncate(profile::PROFILES_MAX);
    files
}
