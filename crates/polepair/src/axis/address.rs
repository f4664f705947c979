//! Finds a parameter by its name, or by its number in the protocol's notation.

use super::LocalAxis;
use crate::amount::Amount;
use crate::error::Error;
use crate::profile::generic_profile;
use crate::spelling;
use polepair_core::convert::text_from;
use polepair_core::error::Unsupported;
use polepair_core::explain::{Dissector, TextError};
use polepair_core::profile::{
    Encoding, Parameter, ParameterAddress, ParameterId, Profile, Scale, encoding_word,
};
use polepair_core::proto;
use polepair_core::units::Unit;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Parameters by number that one process describes at most: each stays in memory for good.
const DESCRIBED_MAX: usize = 65_536;

/// The descriptions made so far, by the profile that they were looked up in.
static DESCRIBED: Mutex<Option<HashMap<(usize, ParameterAddress), &'static Parameter>>> =
    Mutex::new(None);

impl LocalAxis {
    /// The parameter of that name or symbol, or at that address.
    ///
    /// Names ignore case, spaces, hyphens and underscores. An address is a number in the protocol's own notation, with
    /// or without a type: `0x2030:1:u16` (CANopen), `R 51` (Modbus), `AP 6` (TMCL), `@0x0228:i32` (TML), `SP 12`
    /// (thruster); see `docs/reference/addresses.md`.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` with the nearest name, or for an address that the protocol cannot
    /// have.
    pub fn find(&self, name: &str) -> Result<ParameterId, Error> {
        if let Some(id) = self.profile.find_parameter(name) {
            return Ok(id);
        }
        if let Some(id) = self.find_address(name)? {
            return Ok(id);
        }
        let names = self.profile.parameters.iter().flat_map(|p| [p.name, p.symbol]);
        let near = spelling::suggestion(name, names);
        let what = format!("{} has no parameter `{name}`{near}", self.profile.name);
        let example = self.address_example();
        let mut hint = format!("`polepair params {}` lists them", self.profile.name);
        if !example.is_empty() {
            hint += &format!("; `{example}` is an example of a number");
        }
        if let Some(address) = self.manual_address(name) {
            hint = format!(
                "if a manual has {name}, it is `{address}` here: the digit of the table and the 1 that it counts \
                 from are not sent"
            );
        }
        Err(Error::usage("E213", what, hint))
    }

    /// Interprets an amount as [`AxisParameters`](crate::interface::AxisParameters) does for a written name.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for an id that the drive does not have.
    pub fn amount_for_name(
        &self,
        name: &str,
        id: ParameterId,
        amount: Amount,
    ) -> Result<Amount, Error> {
        let parameter = self.required_parameter(id)?;
        Ok(amount.for_written_name(name, parameter.name, parameter.symbol))
    }

    /// The parameter at an address; `None` where the text has not the form of one. Nothing is asked.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` for an address that the protocol cannot have.
    pub fn find_address(&self, text: &str) -> Result<Option<ParameterId>, Error> {
        let Some(dissector) = self.dissector() else { return Ok(None) };
        let address = match dissector.parse_address(text) {
            None => return Ok(None),
            Some(Ok(address)) => address,
            Some(Err(TextError { expected, at })) => {
                let rest = text_from(text, at);
                let what = format!("`{text}` is no address: expected {expected} at `{rest}`");
                let hint = format!("an address is written `{}`", dissector.address_example());
                return Err(Error::usage("E213", what, hint));
            }
        };
        if let Some(id) = self.profile.find_object((address.index, address.space)) {
            let known = self.profile.parameter(id).map(|parameter| parameter.encoding);
            if address.encoding.is_none_or(|encoding| Some(encoding) == known) {
                return Ok(Some(id));
            }
        }
        self.add_address(dissector, &address).map(Some)
    }

    /// The parameter at an address that the profile does not name; `None` where there are too many.
    pub(crate) fn find_unnamed(&self, address: &ParameterAddress) -> Option<ParameterId> {
        self.add_address(self.dissector()?, address).ok()
    }

    fn add_address(
        &self,
        dissector: &dyn Dissector,
        address: &ParameterAddress,
    ) -> Result<ParameterId, Error> {
        let parameter = describe(self.profile, dissector, address)?;
        let added = self.connection.with_axes(|axes, _| axes.add_parameter(self.index, parameter));
        let too_many =
            || Error::usage("E213", "too many parameters by number", "open the link again");
        added.ok_or_else(too_many)
    }

    /// A parameter's number as its protocol writes it, as an example; empty where it has none.
    #[must_use]
    pub fn address_example(&self) -> &'static str {
        self.dissector().map_or("", |dissector| dissector.address_example())
    }

    /// The address that a manual of another maker means by a number, in our notation.
    fn manual_address(&self, text: &str) -> Option<String> {
        let dissector = self.dissector()?;
        let address = dissector.manual_address(text)?;
        let mut written = String::new();
        dissector.write_address(&address, &mut written);
        Some(written)
    }

    /// A parameter of the profile, or one that was found by its number.
    #[must_use]
    pub fn parameter(&self, id: ParameterId) -> Option<&'static Parameter> {
        let known = self.profile.parameter(id);
        known.or_else(|| self.connection.with_axes(|axes, _| axes.parameter(self.index, id)))
    }

    pub(crate) fn required_parameter(&self, id: ParameterId) -> Result<&'static Parameter, Error> {
        self.parameter(id)
            .ok_or_else(|| self.unsupported_error("reading", Unsupported::NoSuchParameter))
    }

    pub(super) fn dissector(&self) -> Option<&'static dyn Dissector> {
        proto::find_dissector(self.protocol)
    }
}

/// The description of an address, always the same one.
fn describe(
    profile: &'static Profile,
    dissector: &dyn Dissector,
    address: &ParameterAddress,
) -> Result<&'static Parameter, Error> {
    let key = (std::ptr::from_ref(profile).addr(), *address);
    let mut described = DESCRIBED.lock().unwrap_or_else(PoisonError::into_inner);
    let described = described.get_or_insert_default();
    if let Some(known) = described.get(&key) {
        return Ok(known);
    }
    if described.len() >= DESCRIBED_MAX {
        let what = "this process has described too many parameters by number";
        return Err(Error::usage("E213", what, "start it again"));
    }
    let parameter = Box::leak(Box::new(new_description(profile, dissector, address)));
    described.insert(key, parameter);
    Ok(parameter)
}

/// Description of an address: from the drive's profile, from a standard's, or from the protocol.
fn new_description(
    profile: &'static Profile,
    dissector: &dyn Dissector,
    address: &ParameterAddress,
) -> Parameter {
    let shipped = || polepair_drives::profiles().iter().copied();
    let generic = generic_profile(dissector.name());
    let standards = dissector
        .standard_profiles()
        .iter()
        .filter_map(|name| shipped().chain(generic).find(|profile| profile.name == *name));
    let keys = [Some((address.index, address.space)), address.like];
    let tables = std::iter::once(profile).chain(standards);
    let found = tables.flat_map(|table| keys.into_iter().flatten().map(move |key| (table, key)));
    let found = found.into_iter().find_map(|(table, key)| {
        Some((table.parameter(table.find_object(key)?)?, key == (address.index, address.space)))
    });
    let plain = match found {
        Some((known, _)) => unscaled(known, address),
        None => dissector.describe_address(address),
    };
    let mut text = String::new();
    dissector.write_address(address, &mut text);
    let symbol: &'static str = text.clone().leak();
    // What is read as another type than the table has is not what the table names.
    let typed = address.encoding.filter(|encoding| match found {
        Some((known, _)) => known.encoding != *encoding,
        None => true,
    });
    let name = match (found, typed) {
        (Some((known, true)), None) => known.name,
        (_, Some(encoding)) => {
            text.push_str(&type_suffix(encoding));
            text.leak()
        }
        (_, None) => symbol,
    };
    Parameter { name, symbol, ..plain }
}

/// A description from a table, at this address and with this type. Its scale stays where it depends on
/// nothing else.
fn unscaled(known: &Parameter, address: &ParameterAddress) -> Parameter {
    let ParameterAddress { index, space, .. } = *address;
    let placed = Parameter { index, space, ..*known };
    let retyped = address.encoding.filter(|encoding| *encoding != known.encoding);
    match retyped {
        Some(encoding) => Parameter {
            access: known.access,
            moves: known.moves,
            persistence: known.persistence,
            about: known.about,
            section: known.section,
            ..address.describe(encoding)
        },
        None if known.scale.is_constant() => placed,
        None => Parameter { scale: Scale::ONE, unit: Unit::None, ..placed },
    }
}

/// The suffix of an address for a type.
fn type_suffix(encoding: Encoding) -> String {
    let (base, order) = match encoding {
        Encoding::U32LowFirst => (Encoding::U32, ":le"),
        Encoding::I32LowFirst => (Encoding::I32, ":le"),
        Encoding::U48LowFirst => (Encoding::U48, ":le"),
        Encoding::I48LowFirst => (Encoding::I48, ":le"),
        Encoding::U64LowFirst => (Encoding::U64, ":le"),
        Encoding::I64LowFirst => (Encoding::I64, ":le"),
        Encoding::F32LowFirst => (Encoding::F32, ":le"),
        Encoding::F64LowFirst => (Encoding::F64, ":le"),
        other => (other, ""),
    };
    encoding_word(base).map_or_else(String::new, |word| format!(":{word}{order}"))
}
