//! Names of simulated drives: a protocol, a family, a product.

use crate::config::Config;
use crate::error::Error;
use crate::{profile, profile_file, registry, spelling};
use polepair_core::medium::MediumKind;
use polepair_core::profile::Profile;
use std::path::Path;

/// Returns whether a word of [`rack_of_words`](super::rack_of_words), without addresses, means a drive.
#[must_use]
pub fn is_drive(word: &str) -> bool {
    find_drive(word).is_ok()
}

/// The words that mean a drive: protocols, which mean their first drive, then products.
#[must_use]
pub fn words() -> Vec<String> {
    let listed = profile::catalogue().iter();
    usual_words().into_iter().chain(listed.map(|module| module.name.to_owned())).collect()
}

fn usual_words() -> Vec<String> {
    let protocols = registry::protocols();
    let protocols = protocols.iter().map(registry::ProtocolInfo::unique_word);
    let products = polepair_drives::profiles().iter().map(|profile| profile.name.to_owned());
    protocols.chain(products).collect()
}

/// The product meant by a protocol's, family's or product's word, and the protocol of its wire: its
/// usual one, or after `+can` the one on that medium.
pub(crate) fn find_drive(word: &str) -> Result<(&'static Profile, registry::ProtocolInfo), Error> {
    if let Some(own) = find_own_profile(word)? {
        let protocols = registry::protocols();
        let protocol = protocols.into_iter().find(|protocol| protocol.profile == own.protocol);
        return protocol.map(|protocol| (own, protocol)).ok_or_else(|| {
            Error::usage("E203", format!("`{}` has no protocol with a host", own.name), "")
        });
    }
    let found = match word.split_once('+') {
        None => find_product(word, None),
        Some((name, "serial")) => find_product(name, Some(MediumKind::Serial)),
        Some((name, "can")) => find_product(name, Some(MediumKind::Can)),
        Some(_) => None,
    };
    found.ok_or_else(|| {
        let known = words();
        let near = spelling::suggestion(word, known.iter().map(String::as_str));
        let what = format!("nothing called `{word}` can be simulated{near}");
        let usual = usual_words().join(", ");
        Error::usage("E203", what, format!("it can be {usual}, or another TMCM module"))
    })
}

/// A user's profile that a word means: a file, or one of the configuration folder.
///
/// # Errors
/// [`Error::File`] with line and reason.
pub(crate) fn find_own_profile(word: &str) -> Result<Option<&'static Profile>, Error> {
    let file = Path::new(word);
    if file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
        return Ok(Some(profile_file::load_profile(file)?));
    }
    if find_product(word, None).is_some() {
        return Ok(None);
    }
    // Read where no other drive has that name, so that usual words cost no file.
    Ok(Config::discover().profiles.iter().find(|own| own.name == word).copied())
}

/// Returns whether a profile is a user's: no reply identifies a drive that is simulated by it.
pub(crate) fn is_own_profile(profile: &'static Profile) -> bool {
    let listed = profile::find_shipped(profile.name);
    !listed.is_some_and(|listed| core::ptr::eq(listed, profile))
}

/// The first product of that protocol, family or name, and its first protocol on that medium.
fn find_product(
    name: &str,
    medium: Option<MediumKind>,
) -> Option<(&'static Profile, registry::ProtocolInfo)> {
    let profiles = polepair_drives::profiles();
    let mut names = registry::protocols();
    names.retain(|protocol| medium.is_none_or(|medium| medium == protocol.medium));
    let of_protocol = names.iter().find(|protocol| protocol.name == name).and_then(|protocol| {
        let profile = match protocol.usual_profile {
            Some(name) => shipped_profile(name)?,
            None => profiles.iter().find(|p| p.protocol == protocol.profile)?,
        };
        Some((profile, protocol.clone()))
    });
    of_protocol.or_else(|| {
        let profile = shipped_profile(name)
            .or_else(|| profiles.iter().find(|p| p.family == name).copied())?;
        let protocol = names.iter().find(|protocol| protocol.profile == profile.protocol)?;
        Some((profile, protocol.clone()))
    })
}

fn shipped_profile(name: &str) -> Option<&'static Profile> {
    profile::find_shipped(name)
}
