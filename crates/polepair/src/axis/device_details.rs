//! Device information that a drive reports: name, versions, motors.

use super::LocalAxis;
use crate::error::Error;
use crate::profile::{find_shipped, generic_profile};
use crate::url::AxisNumber;
use std::borrow::Cow;
use std::time::Duration;

use polepair_core::error::{Failure, Outcome};
use polepair_core::explain::{DeviceFact, FactQuery};
use polepair_core::profile::Encoding;

/// An item of a drive's device information.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DeviceDetail {
    /// Name of the detail: `device name`, `firmware`.
    pub name: Cow<'static, str>,
    /// Value of the detail.
    pub text: String,
}

/// Characters of a fact at most.
const FACT_MAX: usize = 240;
/// Time limit of reading one detail.
const FACT_TIME: Duration = Duration::from_secs(1);
/// A text of a drive that sends more and more of it.
const ENDLESS: &str = "(the text does not end)";

impl LocalAxis {
    /// Reads the device information by the protocol's functions: name and versions of a CANopen device
    /// (1008h to 100Ah, 1018h); number, firmware and motors of a TMCL module; firmware of a TML drive;
    /// device identification (function 43/14) of a Modbus device without a built-in profile. Refused items
    /// are skipped, and a silent drive is not read further. Only reads are sent.
    ///
    /// # Errors
    /// [`Error::Link`] and [`Error::Interrupted`].
    pub fn device_details(&self) -> Result<Vec<DeviceDetail>, Error> {
        let facts = self.dissector().map_or(&[][..], |dissector| dissector.device_facts());
        let mut details = Vec::new();
        if AxisNumber(self.number).is_group() {
            return Ok(details);
        }
        let generic = generic_profile(self.protocol);
        let is_known = generic.is_none_or(|generic| !std::ptr::eq(generic, self.profile));
        let shipped = find_shipped(self.profile.name);
        let is_shipped = shipped.is_some_and(|known| std::ptr::eq(known, self.profile));
        for fact in facts {
            // A profile has what a product has: a question for more would be refused.
            let is_in_profile = match fact.query {
                FactQuery::Count(..) => is_known,
                FactQuery::Characters(_) => is_shipped,
                FactQuery::Address(_) | FactQuery::Text(_) => false,
            };
            if is_in_profile {
                continue;
            }
            match self.read_fact(fact) {
                Ok(text) if text.is_empty() => {}
                Ok(text) => details.push(DeviceDetail { name: fact.name.into(), text }),
                Err(error @ (Error::Link(_) | Error::Interrupted { .. })) => return Err(error),
                Err(error) if is_answer(&error) => {}
                Err(_) => break,
            }
        }
        Ok(details)
    }

    fn read_fact(&self, fact: &DeviceFact) -> Result<String, Error> {
        let dissector = self.dissector();
        match fact.query {
            FactQuery::Address(address) => {
                let id = self.find(address)?;
                if self.required_parameter(id)?.encoding != Encoding::Text {
                    return Ok(self.read_any(id)?.to_string());
                }
                let Some(text) = self.read_short_text(id, FACT_MAX as u16, FACT_TIME)? else {
                    return Ok(ENDLESS.to_owned());
                };
                // Spaces and zeros fill texts of a fixed length.
                Ok(text.trim_matches(['\0', ' ']).to_owned())
            }
            FactQuery::Text(request) => {
                let raw = self.raw(request)?;
                let mut text = String::new();
                if let Some(dissector) = dissector {
                    dissector.write_fact(fact.name, raw, &mut text);
                }
                Ok(text)
            }
            FactQuery::Characters(request) => {
                let mut text = Vec::new();
                for part in 0.. {
                    let [len, characters @ ..] =
                        self.raw(&format!("{request} {part}"))?.to_be_bytes();
                    let len = usize::from(len).min(characters.len());
                    text.extend_from_slice(&characters[..len]);
                    if len < characters.len() || text.len() > FACT_MAX {
                        break;
                    }
                }
                Ok(String::from_utf8_lossy(&text).trim_matches(['\0', ' ']).to_owned())
            }
            FactQuery::Count(first, rest) => {
                self.read(self.find(first)?)?;
                let mut count = 1;
                for address in rest {
                    match self.read(self.find(address)?) {
                        Ok(_) => count += 1,
                        Err(error) if is_answer(&error) => break,
                        Err(error) => return Err(error),
                    }
                }
                Ok(if count > rest.len() { 1 } else { count }.to_string())
            }
        }
    }
}

/// Returns whether the drive answered, if only with a refusal.
fn is_answer(error: &Error) -> bool {
    match error {
        Error::Failed { outcome: Outcome::NotDone(failure), .. } => {
            matches!(failure, Failure::Refused { .. } | Failure::NotReady { .. })
        }
        Error::Unsupported { .. } | Error::Usage { .. } => true,
        _ => false,
    }
}

/// The details in a line: `TMCM-6110, firmware 1.48, 6 motors`.
#[must_use]
pub fn summarize_details(details: &[DeviceDetail]) -> String {
    let is_module = details.iter().any(|detail| detail.name == "module");
    let shown = details.iter().filter_map(|detail| match &*detail.name {
        "module" => Some(detail.text.clone() + &version_suffix(details)),
        "device name" | "vendor" | "product name" | "product code" => Some(detail.text.clone()),
        "hardware version" => Some(format!("hardware {}", detail.text)),
        "software version" => Some(format!("software {}", detail.text)),
        "revision" => Some(format!("revision {}", detail.text)),
        "firmware" if is_module => None,
        "firmware" => Some(format!("firmware {}", detail.text)),
        "motors" if detail.text == "1" => None,
        "motors" => Some(format!("{} motors", detail.text)),
        _ => None,
    });
    shown.collect::<Vec<_>>().join(", ")
}

/// ` V1.48`, as the maker writes the firmware of a module behind its name.
fn version_suffix(details: &[DeviceDetail]) -> String {
    let firmware = details.iter().find(|detail| detail.name == "firmware");
    firmware.map_or_else(String::new, |firmware| format!(" V{}", firmware.text))
}
