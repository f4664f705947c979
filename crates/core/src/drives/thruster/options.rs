//! What can be chosen when a drive is made.

use crate::drives::DeviceOptions;
use crate::profile::Profile;
use crate::proto::thruster::device::Quirks;
use crate::proto::thruster::readings::Readings;

/// How a drive is built and what of its manual is read how.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Options {
    /// What the wire does.
    pub quirks: Quirks,
    /// Its id.
    pub id: u8,
    /// It has an encoder, and with it positions.
    pub encoder: bool,
    /// Its absolute position goes round at half a turn instead of counting on.
    pub round: bool,
    /// VC below 30 rpm runs at 30 instead of being refused.
    pub runs_slowly: bool,
    /// After LS nothing runs before CF.
    pub latches_stop: bool,
    /// The output is forbidden until the signal was zero.
    pub zero_point: bool,
    /// Share of the output that a hot drive gives.
    pub limit: f64,
    /// Supply below and above which it reports, V.
    pub volts: (f64, f64),
}

/// The id from the factory. \[I\]
const ID: u8 = 1;
/// Thresholds of the supply: the manual's examples have 46.6 to 48 V. \[I\]
const VOLTS: (f64, f64) = (36.0, 60.0);

impl Options {
    /// Reads them.
    ///
    /// # Errors
    /// The name or value that is unknown.
    pub fn read<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self, &'a str> {
        let mut read = Self::of(profile);
        if let Some(address) = options.address {
            read.id = u8::try_from(address).unwrap_or(ID).clamp(1, 127);
        }
        for (key, value) in options.extra {
            read.set(key, value)?;
        }
        Ok(read)
    }

    fn of(profile: &'static Profile) -> Self {
        let encoder = profile.name != "thruster";
        Self {
            quirks: Quirks { readings: Readings::of(profile), ..Quirks::default() },
            id: ID,
            encoder,
            round: false,
            runs_slowly: false,
            latches_stop: false,
            zero_point: true,
            limit: 0.5,
            volts: VOLTS,
        }
    }

    fn set<'a>(&mut self, key: &'a str, value: &'a str) -> Result<(), &'a str> {
        let quirks = &mut self.quirks;
        match (key, value) {
            ("vm-flags", "examples" | "table") => quirks.readings.table_flags = value == "table",
            ("vm-reply", "echo" | "swapped") => quirks.swaps_vm = value == "swapped",
            ("positions", "2+4" | "3+3") => quirks.readings.even_positions = value == "3+3",
            ("refusal", "eeee" | "zero") => quirks.refuses_by_zero = value == "zero",
            ("values", "16" | "32") => quirks.wide = value == "32",
            ("slow-speed", "refused" | "runs") => self.runs_slowly = value == "runs",
            ("after-stop", "ready" | "latched") => self.latches_stop = value == "latched",
            ("zero-point", "on" | "off") => self.zero_point = value == "on",
            ("round", "on" | "off") => self.round = value == "on",
            ("limit-percent", _) => self.limit = number(value, 0.0, 100.0)? / 100.0,
            ("under-volt", _) => self.volts.0 = number(value, 0.0, 1000.0)?,
            ("over-volt", _) => self.volts.1 = number(value, 0.0, 1000.0)?,
            (
                "vm-flags" | "vm-reply" | "positions" | "refusal" | "values" | "slow-speed"
                | "after-stop" | "zero-point" | "round",
                _,
            ) => return Err(value),
            _ => return Err(key),
        }
        Ok(())
    }
}

fn number(value: &str, least: f64, most: f64) -> Result<f64, &str> {
    value.parse().ok().filter(|n| (least..=most).contains(n)).ok_or(value)
}
