//! Options that name the profile of a drive.

use std::path::{Path, PathBuf};
use std::sync::Once;

use clap::Args;
use polepair::url::shell_word;
use polepair::{Connector, Error, FileError};
use polepair_core::profile::Profile;

use crate::outcome;
use crate::problem::Result;
use crate::terminal::print_warning;

/// The connector with the user's configuration.
///
/// A configuration file with errors gives one warning and is ignored: it must not prevent a stop.
pub fn discover_connector() -> Connector {
    static WARNED: Once = Once::new();
    let connector = Connector::discover();
    WARNED.call_once(|| connector.config.broken.iter().for_each(warn_ignored_file));
    connector
}

/// Warns that a file with errors is ignored.
pub fn warn_ignored_file(error: &FileError) {
    print_warning(&format!("warning: {error}; it is ignored"));
}

/// Option --profile.
#[derive(Args, Debug)]
pub struct ProfileFile {
    /// Profile of the drive: a TOML file, or the set-up archive of a TML drive (.t.zip)
    #[arg(long = "profile", value_name = "FILE")]
    file: Option<PathBuf>,
}

impl ProfileFile {
    /// Connector with the profile.
    pub fn connector(&self) -> Result<Connector> {
        let connector = discover_connector();
        outcome::count_frames_of(&connector);
        match &self.file {
            Some(file) => connector.with_profile(file).map_err(outcome::to_problem),
            None => Ok(connector),
        }
    }

    /// Connector for stops: a wrong profile is reported and ignored.
    pub fn connector_to_stop(&self) -> Connector {
        let mut connector = discover_connector().for_stop();
        outcome::count_frames_of(&connector);
        match self.file.as_deref().map(|file| connector.config.add_profile(file)) {
            Some(Err(Error::File(error))) => warn_ignored_file(&error),
            Some(Err(error)) => print_warning(&format!("warning: {error}")),
            Some(Ok(_)) | None => {}
        }
        connector
    }

    /// Arguments that give it to another verb, behind a URL; empty without one.
    pub fn as_arguments(&self) -> String {
        let Some(file) = &self.file else { return String::new() };
        format!(" --profile {}", shell_word(&file.display().to_string()))
    }

    /// The file, if there is one.
    pub fn path(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// Returns whether there is one.
    pub fn is_given(&self) -> bool {
        self.file.is_some()
    }

    /// Every profile that is known, the user's own first.
    pub fn known_profiles(&self) -> Result<Vec<&'static Profile>> {
        let catalogue = polepair::profile::catalogue().iter().map(|module| module.profile());
        Ok(self.connector()?.config.all_profiles().chain(catalogue).collect())
    }
}

/// Option --profile of commands without a link.
#[derive(Args, Debug)]
pub struct NamingArgs {
    /// Drive whose parameter and fault names are used: a name, a TOML file, or a CANopen data sheet (EDS,
    /// DCF)
    #[arg(long = "profile", value_name = "NAME|FILE")]
    drive: Option<String>,
}

impl NamingArgs {
    /// The word that names the drive; empty if there is none.
    pub fn word(&self) -> &str {
        self.drive.as_deref().unwrap_or_default()
    }

    /// The drive's profile, if one is named.
    pub fn profile(&self) -> Result<Option<&'static Profile>> {
        let Some(word) = &self.drive else { return Ok(None) };
        discover_connector().config.resolve_profile(word).map(Some).map_err(outcome::to_problem)
    }
}
