//! Options of a simulated drive.

use crate::DeviceOptions;
use polepair_core::profile::Profile;
use polepair_core::proto::thruster::device::Quirks;
use polepair_core::proto::thruster::interpretation::Interpretation;

/// Options of a drive, with the interpretation of its manual.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Options {
    /// Deviations on the wire.
    pub quirks: Quirks,
    /// CAN id of the drive.
    pub id: u8,
    /// True if it has an encoder, and with it positions.
    pub encoder: bool,
    /// True if its absolute position wraps at half a turn instead of counting on.
    pub wraps_around: bool,
    /// VC below 30 rpm runs at 30 instead of being refused.
    pub runs_slowly: bool,
    /// After LS nothing runs before CF.
    pub latches_stop: bool,
    /// The output is forbidden until the signal was zero.
    pub zero_point: bool,
    /// Share of the output that a hot drive gives.
    pub limit: f64,
    /// Hard stops, tenths of a degree, or of a millimetre of the actuator's stroke.
    pub ends: Option<(i64, i64)>,
    /// Supply below and above which it reports, V.
    pub volts: (f64, f64),
}

/// The id from the factory. \[I\]
const FACTORY_ID: u8 = 1;
/// Hard stops of a servo and an actuator: LA reaches to ±1799 (section 4.1). \[I\]
const END_TENTHS: i64 = 1799;
/// Thresholds of the supply: the manual's examples have 46.6 to 48 V. \[I\]
const SUPPLY_LIMITS_V: (f64, f64) = (36.0, 60.0);

impl Options {
    /// Reads them.
    ///
    /// # Errors
    /// The name or value that is unknown.
    pub fn from_device_options<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self, &'a str> {
        let mut read = Self::for_profile(profile);
        if let Some(address) = options.address {
            read.id = u8::try_from(address).unwrap_or(FACTORY_ID).clamp(1, 127);
        }
        for (key, value) in options.extra {
            read.set_option(key, value)?;
        }
        Ok(read)
    }

    fn for_profile(profile: &'static Profile) -> Self {
        let encoder = profile.name != "thruster";
        Self {
            quirks: Quirks { interpretation: Interpretation::of(profile), ..Quirks::default() },
            id: FACTORY_ID,
            encoder,
            wraps_around: false,
            runs_slowly: false,
            latches_stop: false,
            zero_point: true,
            limit: 0.5,
            ends: encoder.then_some((-END_TENTHS, END_TENTHS)),
            volts: SUPPLY_LIMITS_V,
        }
    }

    fn set_option<'a>(&mut self, key: &'a str, value: &'a str) -> Result<(), &'a str> {
        let quirks = &mut self.quirks;
        match (key, value) {
            ("vm-flags", "examples" | "table") => {
                quirks.interpretation.table_flags = value == "table"
            }
            ("vm-reply", "echo" | "swapped") => quirks.swaps_vm = value == "swapped",
            ("positions", "2+4" | "3+3") => quirks.interpretation.even_positions = value == "3+3",
            ("refusal", "eeee" | "zero") => quirks.refuses_by_zero = value == "zero",
            ("values", "16" | "32") => quirks.wide_values = value == "32",
            ("slow-speed", "refused" | "runs") => self.runs_slowly = value == "runs",
            ("after-stop", "ready" | "latched") => self.latches_stop = value == "latched",
            ("zero-point", "on" | "off") => self.zero_point = value == "on",
            ("round", "on" | "off") => {
                self.wraps_around = value == "on";
                self.ends = self.ends.filter(|_| value == "off");
            }
            ("ends", "none") => self.ends = None,
            ("ends", _) if self.encoder => self.ends = Some(parse_ends(value).ok_or(value)?),
            ("limit-percent", _) => self.limit = parse_number(value, 0.0, 100.0)? / 100.0,
            ("under-volt", _) => self.volts.0 = parse_number(value, 0.0, 1000.0)?,
            ("over-volt", _) => self.volts.1 = parse_number(value, 0.0, 1000.0)?,
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

/// `-90..90` in degrees or mm, with zero between.
fn parse_ends(value: &str) -> Option<(i64, i64)> {
    let (low, high) = value.split_once("..")?;
    let (low, high) = (parse_tenths(low)?, parse_tenths(high)?);
    (low <= 0 && high >= 0 && low < high).then_some((low, high))
}

fn parse_tenths(text: &str) -> Option<i64> {
    let number = text.trim().parse::<f64>().ok()?;
    number.is_finite().then(|| libm::round(number * 10.0) as i64)
}

fn parse_number(value: &str, min: f64, max: f64) -> Result<f64, &str> {
    value.parse().ok().filter(|n| (min..=max).contains(n)).ok_or(value)
}
