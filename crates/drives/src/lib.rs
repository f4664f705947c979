//! Families of motor drives: the profiles of their products, and how each is simulated. This is the only list of
//! them: code outside names no family.
//!
//! ```
//! use polepair_drives::profiles;
//! assert!(profiles().iter().all(|profile| !profile.parameters.is_empty()));
//! ```
#![no_std]
#![forbid(unsafe_code)]

pub mod bldc;
pub mod cia402;
mod plan_texts;
pub mod stored_paths;
pub mod surroundings;
pub mod syntron_ts;
pub mod technosoft;
pub mod thruster;
pub mod tmcm;
pub mod tmcm17x;
pub mod tmcm_bldc;

pub use syntron_ts::path_model::PathModel;

use polepair_core::explain::Dissector;
use polepair_core::medium::{Can, Stream};
use polepair_core::profile::{Profile, ScaleRule};
use polepair_core::proto;
use polepair_core::station::{Station, Timed};

/// The fragments and plans of a profile as its file has them, where other profiles may change the fragments.
#[must_use]
pub fn plan_text(profile: &str) -> Option<&'static str> {
    plan_texts::PLAN_TEXTS.iter().find(|(name, _)| *name == profile).map(|(_, text)| *text)
}

/// Settings of a simulated drive, as a rack file or a command line gives them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceOptions<'a> {
    /// Address on the wire; the factory's if `None`.
    pub address: Option<u32>,
    /// The protocols of its wires, where a family supports several: one, or one for each wire of a drive that
    /// relays between two.
    pub wires: &'a [&'a str],
    /// Which standard its serial wire follows; the family's usual one if `None`.
    pub standard: Option<proto::SerialStandard>,
    /// True if its serial wire has no byte timing (pty, TCP): frames are separated by length, not by silence.
    pub untimed: bool,
    /// Seed of random values in the drive (sensor noise).
    pub seed: u64,
    /// Options of the family: `variant=position`, `dlc=8`.
    pub extra: &'a [(&'a str, &'a str)],
}

/// A simulated drive: one object, with as many ends as it has connectors.
pub trait SimulatedDevice: Timed + surroundings::SurroundingsControl + Send {
    /// The drive's end of a serial wire.
    fn serial_station(&mut self) -> Option<&mut dyn Station<Stream>> {
        None
    }
    /// The drive's end of a CAN bus.
    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        None
    }
}

/// One family: its products as profiles, and how one is simulated.
pub trait Family {
    /// The word in profiles: `tmcm17x`.
    const NAME: &'static str;
    /// A simulated drive.
    type Device: SimulatedDevice + 'static;
    /// The products, the usual one first.
    fn profiles() -> &'static [&'static Profile];
    /// A drive as from the factory, powered.
    ///
    /// # Errors
    /// The name or value of an option that the family does not know.
    fn create_device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self::Device, &'a str>;
}

/// Takes every family in turn.
pub trait FamilyVisitor {
    /// One family.
    fn visit_family<F: Family>(&mut self);
}

/// Shows every family to `visitor`.
pub fn visit_families(visitor: &mut impl FamilyVisitor) {
    visitor.visit_family::<tmcm17x::Tmcm17x>();
    visitor.visit_family::<tmcm::Tmcm>();
    visitor.visit_family::<tmcm_bldc::BrushlessFamily>();
    visitor.visit_family::<syntron_ts::SyntronTs>();
    visitor.visit_family::<technosoft::Technosoft>();
    visitor.visit_family::<thruster::ThrusterFamily>();
    visitor.visit_family::<cia402::Cia402>();
}

/// Every profile that is compiled in.
#[must_use]
pub fn profiles() -> &'static [&'static Profile] {
    static ALL: [&Profile; 15] = [
        &tmcm17x::profile::TMCM_171,
        &tmcm17x::profile::TMCM_170,
        &tmcm::profile::TMCM_1140,
        &tmcm::profile::TMCM_6110,
        &syntron_ts::profile::SYNTRON_TS,
        &syntron_ts::profile::SYNTRON_DS102,
        &cia402::profile::CIA402,
        &cia402::profile::CIA402_VL,
        &syntron_ts::profile::SYNTRON_TS_CANOPEN,
        &technosoft::profile::TECHNOSOFT_F514L,
        &technosoft::profile::TECHNOSOFT_FA00G,
        &technosoft::profile::TECHNOSOFT_F2XX,
        &thruster::profile::THRUSTER,
        &thruster::profile::THRUSTER_SERVO,
        &thruster::profile::THRUSTER_ACTUATOR,
    ];
    &ALL
}

/// Every rule by which a scale is computed from several parameters.
#[must_use]
pub const fn scale_rules() -> [&'static ScaleRule; 9] {
    [
        &cia402::units::POSITION,
        &cia402::units::VELOCITY,
        &cia402::units::ACCELERATION,
        &tmcm::units::POSITION,
        &tmcm::units::VELOCITY,
        &tmcm::units::ACCELERATION,
        &tmcm::units::VELOCITY_PPS,
        &tmcm::units::ACCELERATION_PPS,
        &tmcm_bldc::units::POSITION,
    ]
}

/// The profile whose names are used for an unknown drive, where a protocol's texts contain names.
#[must_use]
pub fn usual_profile(dissector: &dyn Dissector) -> Option<&'static Profile> {
    let named = dissector.encodes_by_name();
    profiles()
        .iter()
        .filter(|_| named)
        .find(|profile| profile.protocol == dissector.language())
        .copied()
}

/// The profile whose names explain an unknown drive's frames: the first of its protocol. Drives differ, so explanations
/// by it should state that.
#[must_use]
pub fn assumed_profile(dissector: &dyn Dissector) -> Option<&'static Profile> {
    if !dissector.explains_by_name() {
        return None;
    }
    let language = dissector.language();
    profiles().iter().find(|profile| profile.protocol == language).copied()
}
