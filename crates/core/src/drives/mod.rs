//! The drive families. This is the one list of them: nothing outside names one.

pub mod bench;
pub mod syntron_ts;
pub mod tmcm17x;

use crate::medium::Stream;
use crate::profile::Profile;
use crate::station::Station;

/// Settings of a simulated drive, as a rack file or a command line gives them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceOptions<'a> {
    /// Address on the wire; the factory's if `None`.
    pub address: Option<u32>,
    /// The protocol word of the wire, where a family speaks several: `modbus-rtu`, `modbus-ascii`.
    pub wire: &'a str,
    /// The wire has no byte timing (pty, TCP): frames are told apart by length, not by silence.
    pub untimed: bool,
    /// Seed of whatever is random in the drive (sensor noise).
    pub seed: u64,
    /// Whatever the family knows beyond these: `variant=position`, `dlc=8`.
    pub extra: &'a [(&'a str, &'a str)],
}

/// One family: its products as profiles, and how one is simulated.
pub trait Family {
    /// The word in profiles: `tmcm17x`.
    const NAME: &'static str;
    /// A simulated drive.
    type Device: Station<Stream> + bench::Bench + Send + 'static;
    /// The products, the usual one first.
    fn profiles() -> &'static [&'static Profile];
    /// A drive as from the factory, powered.
    ///
    /// # Errors
    /// The name or value of an option that the family does not know.
    fn device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self::Device, &'a str>;
}

/// Takes every family in turn.
pub trait Visitor {
    /// One family.
    fn family<F: Family>(&mut self);
}

/// Shows every family to `visitor`.
pub fn visit(visitor: &mut impl Visitor) {
    visitor.family::<tmcm17x::Tmcm17x>();
    visitor.family::<syntron_ts::SyntronTs>();
}

/// Every profile that is compiled in.
#[must_use]
pub fn profiles() -> &'static [&'static Profile] {
    static ALL: [&Profile; 4] = [
        &tmcm17x::profile::TMCM_171,
        &tmcm17x::profile::TMCM_170,
        &syntron_ts::profile::SYNTRON_TS,
        &syntron_ts::profile::SYNTRON_DS102,
    ];
    &ALL
}
