//! Modules that are known from their maker's library. A profile is read at its first use.
//!
//! The files are in `profiles/trinamic`. `cargo xtask pytrinamic` makes them.

use super::parse;
use polepair_core::profile::Profile;

/// A module of the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Listed {
    /// The profile's name: `tmcm-1160`.
    pub name: &'static str,
    /// Reply of the drives to the identification request of their protocol, shifted as in the profile's
    /// `identify`.
    pub product: u32,
    text: &'static str,
}

/// The protocol of all of them.
const PROTOCOL: &str = "tmcl";

macro_rules! modules {
    ($($number:literal)*) => {
        &[$(Listed {
            name: concat!("tmcm-", $number),
            product: $number,
            text: include_str!(concat!("../../profiles/trinamic/tmcm-", $number, ".toml")),
        }),*]
    };
}

static MODULES: &[Listed] = modules![
    343 351 1021 1110 1111 1141 1160 1161 1180 1210 1211 1230 1231 1240 1241 1260 1270 1276 1278 1290 1311
    1316 1321 1370 1378 1617 1630 1633 1636 1637 1638 1640 1670 1690 2611 3110 3212 3216 3312 3351 6212 6214
];

/// Modules that have a profile beside those of [`polepair_drives::profiles`].
///
/// ```
/// let module = polepair::profile::catalogue().iter().find(|module| module.name == "tmcm-1160").unwrap();
/// assert_eq!(module.profile().motors, 1);
/// ```
#[must_use]
pub fn catalogue() -> &'static [Listed] {
    MODULES
}

impl Listed {
    /// Profile of the module.
    ///
    /// # Panics
    /// Where the file that was compiled in is wrong, which a test rules out.
    #[must_use]
    pub fn profile(&self) -> &'static Profile {
        parse(&format!("{}.toml", self.name), self.text).expect("a profile that was compiled in")
    }

    pub(crate) fn text(&self) -> &'static str {
        self.text
    }
}

/// The profile of that name that comes with this library.
///
/// ```
/// assert_eq!(polepair::profile::find_shipped("tmcm-1640").unwrap().title, "Trinamic TMCM-1640");
/// ```
#[must_use]
pub fn find_shipped(name: &str) -> Option<&'static Profile> {
    let built_in = polepair_drives::profiles().iter().find(|profile| profile.name == name);
    built_in.copied().or_else(|| find_listed(name).map(Listed::profile))
}

/// Every profile that comes with this library: those that are compiled in, then the catalogue's.
pub fn shipped_profiles() -> impl Iterator<Item = &'static Profile> {
    polepair_drives::profiles().iter().copied().chain(MODULES.iter().map(Listed::profile))
}

/// The module of that name.
pub(crate) fn find_listed(name: &str) -> Option<&'static Listed> {
    MODULES.iter().find(|module| module.name == name)
}

/// The module with the reply `raw` to the identification request of a protocol.
pub(crate) fn find_answered(protocol: &str, raw: i64) -> Option<&'static Listed> {
    let product = u32::try_from(raw).ok()? >> 16;
    MODULES.iter().find(|module| protocol == PROTOCOL && module.product == product)
}

/// Name of the profile of the module whose number is nearest to that of such a reply, among those of the same hundred:
/// modules of a series have most parameters in common.
pub(crate) fn find_nearest(protocol: &str, raw: i64) -> Option<&'static str> {
    let product = u32::try_from(raw).ok()? >> 16;
    let written = polepair_drives::profiles().iter().filter_map(|profile| {
        let number = profile.name.strip_prefix("tmcm-")?.parse().ok()?;
        Some((number, profile.name))
    });
    let listed = MODULES.iter().map(|module| (module.product, module.name));
    let alike = written.chain(listed).filter(|(number, _)| number / 100 == product / 100);
    let nearest = alike.min_by_key(|(number, _)| number.abs_diff(product));
    nearest.filter(|_| protocol == PROTOCOL).map(|(_, name)| name)
}

/// The modules that speak a protocol.
pub(crate) fn listed_for(protocol: &str) -> &'static [Listed] {
    if protocol == PROTOCOL { MODULES } else { &[] }
}

#[cfg(test)]
mod tests {
    use super::{MODULES, PROTOCOL};
    use polepair_core::profile::Certainty;
    use std::collections::BTreeSet;

    #[test]
    fn every_listed_module_has_its_profile() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/profiles/trinamic");
        let files: BTreeSet<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        let listed = MODULES.iter().map(|module| format!("{}.toml", module.name)).collect();
        assert_eq!(files, listed);
        for module in MODULES {
            let profile = module.profile();
            let identity = profile.identity.unwrap();
            assert_eq!((profile.name, profile.protocol), (module.name, PROTOCOL));
            assert_eq!(identity.equals, i64::from(module.product) << 16, "{}", module.name);
            assert!(profile.find_parameter("actual position").is_some(), "{}", module.name);
            let sure = |p: &&polepair_core::profile::Parameter| {
                p.space == 0 && p.certainty == Certainty::Documented
            };
            assert_eq!(
                profile.parameters.iter().find(sure).map(|p| p.name),
                None,
                "{}",
                module.name
            );
        }
    }
}
