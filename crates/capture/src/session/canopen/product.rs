//! Identifies the drive of a node by a value in the capture: object 1018h for a data sheet, or a register
//! for a built-in profile.

use std::sync::LazyLock;

use polepair_core::profile::{Identity, IdentityQuery, Profile};
use polepair_core::proto::canopen::explain::meanings;
use polepair_core::proto::canopen::sdo::ObjectIndex;

use crate::session::{ChangeNotice, InternedName, intern};

/// Index of the device type, which shows the capabilities of a device, not its product.
const DEVICE_TYPE: u16 = 0x1000;

/// Drive of one node.
#[derive(Clone, Copy, Debug, Default)]
pub(super) enum NodeProduct {
    /// The product is unknown.
    #[default]
    Unknown,
    /// The product is known.
    Known(&'static Profile),
    /// Another than was stated, in words.
    Other(InternedName),
}

impl NodeProduct {
    /// The profile that has its names, where the link's is `usual`.
    pub const fn naming_profile(self, usual: Option<&'static Profile>) -> Option<&'static Profile> {
        match self {
            Self::Unknown => usual,
            Self::Known(profile) => Some(profile),
            Self::Other(_) => None,
        }
    }

    /// Learns an object's value; returns true if it identifies the drive.
    pub fn learn_value(
        &mut self,
        node: u8,
        object: ObjectIndex,
        raw: i64,
        stated: Option<&'static Profile>,
    ) -> Option<ChangeNotice> {
        if stated.is_none() && !IDENTITY_OBJECTS.contains(&object) {
            return None;
        }
        let (is, to) = self.identify(object, raw, stated)?;
        let from = match *self {
            Self::Unknown => "",
            Self::Known(profile) => profile.title,
            Self::Other(text) => text,
        };
        *self = is;
        (from != to).then_some(ChangeNotice { axis: Some(node.into()), what: "product", from, to })
    }

    /// Product by a value, if it identifies one.
    fn identify(
        self,
        object: ObjectIndex,
        raw: i64,
        stated: Option<&'static Profile>,
    ) -> Option<(Self, InternedName)> {
        let built_in = polepair_drives::profiles().iter().copied();
        let says =
            |profile: &&'static Profile| matches_identity(profile, object, raw) == Some(true);
        if let Some(found) = stated.into_iter().chain(built_in).find(says) {
            return Some((Self::Known(found), found.title));
        }
        let stated =
            stated.filter(|profile| matches_identity(profile, object, raw) == Some(false))?;
        let text = intern(&format!("not {}", stated.title));
        Some((Self::Other(text), text))
    }
}

/// Objects that identify one of the drives. A poll reads others, again and again.
static IDENTITY_OBJECTS: LazyLock<Vec<ObjectIndex>> = LazyLock::new(|| {
    let object_of = |profile: &&'static Profile| {
        let Identity { query: IdentityQuery::Parameter(id), .. } =
            meanings::canopen_profile(Some(profile))?.identity?
        else {
            return None;
        };
        let parameter = profile.parameter(id)?;
        Some(ObjectIndex::new(parameter.index, parameter.space))
    };
    polepair_drives::profiles().iter().filter_map(object_of).collect()
});

/// Compares a value with a product's identity; `None` if it is no part of that.
fn matches_identity(profile: &'static Profile, object: ObjectIndex, raw: i64) -> Option<bool> {
    let Identity { query: IdentityQuery::Parameter(id), mask, equals, .. } =
        meanings::canopen_profile(Some(profile))?.identity?
    else {
        return None;
    };
    let parameter = profile.parameter(id).filter(|parameter| parameter.index != DEVICE_TYPE)?;
    let here = ObjectIndex::new(parameter.index, parameter.space) == object && mask != 0;
    here.then_some(raw & mask == equals)
}
