//! The profile that a connection string selects, and the user files that may be ignored.

use super::Connector;
use crate::error::Error;
use crate::profile::Listed;
use crate::registry::ProtocolInfo;
use crate::spelling;
use crate::toml_file::FileError;
use crate::url::{LinkTarget, Url};
use polepair_core::medium::Parity;
use polepair_core::profile::Profile;
use std::path::Path;
use std::sync::PoisonError;

impl Connector {
    /// For stops: a broken or unknown profile, set-up or data sheet is [ignored](Self::ignored_files), and
    /// the drive is identified by its replies. An axis that is named twice counts once.
    #[must_use]
    pub fn for_stop(mut self) -> Self {
        self.is_for_stop = true;
        self
    }

    /// Ignored files: those of the configuration, and those of the connection string. An unknown profile is
    /// listed by its name.
    #[must_use]
    pub fn ignored_files(&self) -> Vec<FileError> {
        let more = self.ignored_files.lock().unwrap_or_else(PoisonError::into_inner);
        self.config.broken.iter().chain(more.iter()).cloned().collect()
    }

    /// Peculiarities of the data sheets (EDS, DCF) that were read, and entries of them that are left out.
    #[must_use]
    pub fn sheet_warnings(&self) -> Vec<FileError> {
        self.sheet_warnings.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn keep_sheet_warnings(&self, file: &Path) {
        let mut kept = self.sheet_warnings.lock().unwrap_or_else(PoisonError::into_inner);
        for warning in crate::eds::sheet_warnings(file) {
            if !kept.contains(&warning) {
                kept.push(warning);
            }
        }
    }

    /// The profile that a connection string chooses: by name, or a drive's set-up archive.
    pub(crate) fn chosen_profile(
        &self,
        url: &Url,
        protocol: &ProtocolInfo,
    ) -> Result<Option<&'static Profile>, Error> {
        let error = match self.read_chosen_profile(url, protocol) {
            Err(Error::File(error)) if self.is_for_stop => error,
            Err(Error::Usage { what, .. }) if self.is_for_stop => {
                let keys = ["setup", "eds", "profile"].into_iter();
                let stated = keys.filter_map(|key| Some(format!("{key}={}", url.key(key)?)));
                FileError::for_file(stated.collect::<Vec<_>>().join("&"), what)
            }
            chosen => return chosen,
        };
        let mut over = self.ignored_files.lock().unwrap_or_else(PoisonError::into_inner);
        if !over.contains(&error) {
            over.push(error);
        }
        Ok(None)
    }

    /// The string with what the chosen profile states of the serial line, where the string states nothing.
    pub(super) fn with_factory_line(&self, url: &Url, protocol: &ProtocolInfo) -> Url {
        let mut url = url.clone();
        // A wrong profile is reported by who reads it for its parameters.
        let chosen = self.read_chosen_profile(&url, protocol).ok().flatten();
        let Some(line) = chosen.and_then(|profile| profile.line) else { return url };
        let LinkTarget::Serial { baud, .. } = &mut url.target else { return url };
        baud.get_or_insert(line.baud);
        let parity = match line.parity {
            Parity::None => "none",
            Parity::Even => "even",
            Parity::Odd => "odd",
        };
        let states = [
            ("parity", parity.to_owned()),
            ("stop", line.stop_bits.to_string()),
            ("bits", line.data_bits.to_string()),
        ];
        for (key, value) in states {
            if url.key(key).is_none() {
                url.keys.push((key.to_owned(), value));
            }
        }
        url
    }

    fn read_chosen_profile(
        &self,
        url: &Url,
        protocol: &ProtocolInfo,
    ) -> Result<Option<&'static Profile>, Error> {
        if let Some((key, file)) =
            ["setup", "eds"].iter().find_map(|key| Some((key, url.key(key)?)))
        {
            let profile = crate::profile_file::load_profile(Path::new(file))?;
            self.keep_sheet_warnings(Path::new(file));
            if profile.protocol == protocol.profile {
                return Ok(Some(profile));
            }
            let what = format!("{file} is not of a {} drive", protocol.name);
            let hint = format!("choose another file, or remove {key}=");
            return Err(Error::usage("E213", what, hint));
        }
        url.key("profile").map(|name| self.named_profile(name, protocol)).transpose()
    }

    fn named_profile(
        &self,
        name: &str,
        protocol: &ProtocolInfo,
    ) -> Result<&'static Profile, Error> {
        let speaks = |p: &&'static Profile| p.protocol == protocol.profile;
        let mut fitting = self.config.all_profiles().filter(speaks);
        let generic = protocol.generic;
        let found = fitting.find(|p| p.name == name || p.family == name);
        let found = found.or((name == generic.name).then_some(generic));
        let listed = crate::profile::listed_for(protocol.profile);
        if let Some(profile) =
            found.or_else(|| catalogue_entry(name, listed).map(|module| module.profile()))
        {
            return Ok(profile);
        }
        if let Some(error) = self.config.broken_profile(name) {
            return Err(error.clone().into());
        }
        let known: Vec<&str> = self.config.all_profiles().filter(speaks).map(|p| p.name).collect();
        let names = known.iter().copied().chain(listed.iter().map(|module| module.name));
        let near = spelling::suggestion(name, names);
        let what = format!("no profile `{name}` of {}{near}", protocol.name);
        let more = match listed.len() {
            0 => String::new(),
            count => format!(", and {count} more that `polepair params` lists"),
        };
        Err(Error::usage("E213", what, format!("known are {}{more}", known.join(", "))))
    }
}

fn catalogue_entry<'l>(name: &str, listed: &'l [Listed]) -> Option<&'l Listed> {
    listed.iter().find(|module| module.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry;

    /// The keys of a link, once a profile has added what it states of the line.
    fn keys(string: &str) -> Vec<(String, String)> {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/oriental-az.toml");
        let connector = Connector::default().with_profile(Path::new(file)).unwrap();
        let url: Url = string.parse().unwrap();
        let protocol = registry::protocol_by_word("modbus-rtu").unwrap();
        let url = connector.with_factory_line(&url, &protocol);
        let LinkTarget::Serial { baud, .. } = url.target else { panic!("a serial port") };
        let mut keys = url.keys;
        keys.push(("baud".into(), baud.map_or_else(String::new, |baud| baud.to_string())));
        keys.retain(|(key, _)| key != "profile");
        keys
    }

    #[test]
    fn the_string_goes_before_the_line_of_a_profile() {
        let pair = |key: &str, value: &str| (key.to_owned(), value.to_owned());
        let factory =
            [pair("parity", "even"), pair("stop", "1"), pair("bits", "8"), pair("baud", "115200")];
        assert_eq!(keys("modbus-rtu+serial:///dev/ttyUSB0?profile=oriental-az#1"), factory);
        let stated =
            "modbus-rtu+serial:///dev/ttyUSB0:9600?parity=none&stop=2&profile=oriental-az#1";
        let own =
            [pair("parity", "none"), pair("stop", "2"), pair("bits", "8"), pair("baud", "9600")];
        assert_eq!(keys(stated), own);
        // Without a profile nothing is known of the line.
        assert_eq!(keys("modbus-rtu+serial:///dev/ttyUSB0#1"), [pair("baud", "")]);
    }
}
