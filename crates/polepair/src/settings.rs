//! Settings of drives as a text file: sorted, with units, one line each.
//!
//! ```toml
//! version = 2
//!
//! [axis.1]
//! count = 2
//! profile = "tmcm-171"
//! firmware = "1.12"
//!
//! [axis.1.settings]
//! "max current" = "1.2 A"   # AP 6
//! "motor poles" = 8         # AP 253
//! ```
//! A value is text with a unit, a value name, or a number in the parameter's unit; behind the maker's symbol
//! (`"AP 6" = "12"`), text without a unit is the drive's own number. `{ raw = 120 }` is used if no
//! text gives exactly the drive's value. `count` is the number of settings, so that a file that was cut off is seen; a
//! file that a person wrote need not have it.

mod process_data;

use crate::amount::{Amount, Value, WriteValue};
use crate::axis::{LocalAxis, PendingWrites};
use crate::doctor::is_absent_error;
use crate::eds::Eds;
use crate::error::Error;
use crate::identification::Identification;
use crate::profile::read_text;
use crate::toml_file::{FileError, FileLocation, Located, SourceText, TomlTable};
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{
    Access, Certainty, Parameter, ParameterId, Persistence, Profile, encoding_word,
};
pub use process_data::SettingWrite;
use std::fmt::{self, Write};
use std::path::Path;

/// Version of settings files: their key `version`. Version 1, and files without a version that a program wrote, number
/// the user variables of TMCL modules in hexadecimal.
const SETTINGS_VERSION: i64 = 2;

/// Names of the TMCL user variables begin so; their number follows.
const USER_VARIABLE: &str = "user variable ";

/// Returns whether a parameter is a setting: written once and kept, without starting motion.
#[must_use]
pub fn is_setting(parameter: &Parameter) -> bool {
    parameter.access == Access::ReadWrite
        && parameter.persistence != Persistence::Volatile
        && parameter.certainty != Certainty::Undocumented
        && !parameter.moves
        && parameter.encoding.is_number()
}

/// Returns whether a parameter is one that a drive keeps, and no source names. A backup has it all the same: among
/// them may be what the maker tuned.
#[must_use]
pub fn is_unnamed_setting(parameter: &Parameter) -> bool {
    parameter.certainty == Certainty::Undocumented
        && is_setting(&Parameter { certainty: Certainty::Inferred, ..*parameter })
}

/// Content of a settings file.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// One for each drive.
    pub axes: Vec<AxisSettings>,
}

/// The settings of one drive.
#[derive(Clone, Debug)]
pub struct AxisSettings {
    /// The drive's address.
    pub number: u32,
    /// The profile that has these settings.
    pub profile: String,
    /// Firmware version when they were read; empty if the drive does not report it.
    pub firmware: String,
    /// Names and values.
    settings: Vec<Setting>,
    /// Values of registers that no source names, by the maker's symbol.
    unnamed: Vec<Setting>,
    /// Parameters that the drive keeps and that a backup leaves out, because writing them may move the motor.
    pub left_out_moving: Vec<&'static str>,
    /// Settings that could not be read, and why.
    pub unread: Vec<(String, String)>,
    /// They are of a DCF, which lists more than settings: see [`Self::left_out`].
    is_sheet: bool,
    location: FileLocation,
}

#[derive(Clone, Debug)]
struct Setting {
    name: Located<String>,
    value: WriteValue,
    /// Designation in the manual.
    symbol: &'static str,
}

/// A setting that is not as the file has it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SettingChange {
    /// Parameter of the drive.
    pub id: ParameterId,
    /// Present value.
    pub now: Value,
    /// Value of the file.
    pub wanted: Value,
    /// True if it decides how the drive is reached: see [`Profile::link_settings`].
    pub reach: bool,
    /// No source names it: it is written to a drive of the same kind alone.
    pub unnamed: bool,
    /// No table describes it, so the effect of a write is unknown: it needs an armed axis.
    pub undescribed: bool,
}

impl Settings {
    /// Reads a file: TOML, or a CANopen node's configuration (DCF, CiA 306-1), whose values are those of
    /// its `ParameterValue` lines.
    ///
    /// # Errors
    /// [`Error::File`] with file, line, column and reason.
    pub fn load(file: &Path) -> Result<Self, Error> {
        if crate::eds::is_eds_file(file) {
            return Ok(Self::from_dcf(file, &crate::eds::load(file)?)?);
        }
        Ok(Self::parse(&file.display().to_string(), &read_text(file)?)?)
    }

    /// Reads a text; `file` is its name in complaints.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn parse(file: &str, text: &str) -> Result<Self, FileError> {
        SourceText::new(file, text).parse_versions(&["axis"], SETTINGS_VERSION, |node, version| {
            let Some(table) = node.table("axis", &[])? else {
                return Err(FileError::for_file(file, "no [axis.1] in it"));
            };
            let axes = table.keys().into_iter().map(|key| read_axis(&table, &key, version));
            Ok(Self { axes: axes.collect::<Result<_, _>>()? })
        })
    }

    /// The values that a DCF gives its node. Store and restore, and values that are no numbers, are left out.
    fn from_dcf(file: &Path, eds: &Eds) -> Result<Self, FileError> {
        let location = FileLocation::built_in(&file.display().to_string());
        let node = eds.node_id();
        let (mut settings, mut left_out) = (Vec::new(), Vec::new());
        for (object, entry) in
            eds.objects.iter().flat_map(|object| object.entries.iter().map(move |e| (object, e)))
        {
            let Some(value) = entry.value.as_ref().filter(|_| entry.access.is_writable()) else {
                continue;
            };
            // Writing an entry that no mapping uses is refused by many drives.
            if process_data::is_unused_entry(eds, object.index, entry.sub) {
                continue;
            }
            let (index, sub) = (object.index, entry.sub);
            let address = crate::eds::symbol(index, sub);
            let reason = match index {
                0x1010 | 0x1011 => Some("it stores or restores settings"),
                _ if !entry.access.is_readable() => Some("it cannot be read back"),
                _ => None,
            };
            if let Some(reason) = reason {
                left_out.push((address, reason.to_owned()));
                continue;
            }
            // With a node-ID of zero such a value would be that of another object.
            if node.is_none() && value.integer(0) != value.integer(1) {
                let reason = "it depends on the node-ID, which the file does not state";
                left_out.push((address, reason.to_owned()));
                continue;
            }
            let encoding = crate::eds::encoding(entry.data_type);
            let raw = encoding
                .and_then(|encoding| crate::eds::raw_value(encoding, value, node.unwrap_or(0)));
            let (Some(encoding), Some(raw)) = (encoding, raw) else {
                left_out.push((address, "it is no number".to_owned()));
                continue;
            };
            let word = encoding_word(encoding).map_or_else(String::new, |word| format!(":{word}"));
            settings.push(Setting {
                name: Located { value: format!("{address}{word}"), location: location.clone() },
                value: WriteValue::Raw(raw),
                symbol: "",
            });
        }
        if settings.is_empty() {
            let reason = "no value to write: a DCF has lines such as ParameterValue=5";
            return Err(location.error(reason));
        }
        Ok(Self {
            axes: vec![AxisSettings {
                number: node.map_or(1, u32::from),
                profile: String::new(),
                firmware: String::new(),
                settings,
                unnamed: Vec::new(),
                left_out_moving: Vec::new(),
                unread: left_out,
                is_sheet: true,
                location,
            }],
        })
    }

    /// The settings that are for an axis: those of its number, or the only ones there are where the
    /// link has one axis, too.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212`.
    pub fn for_axis(&self, axis: &LocalAxis, axes: usize) -> Result<&AxisSettings, Error> {
        let same = self.axes.iter().find(|settings| settings.number == axis.number());
        // One axis and one set: a drive with another address takes the settings of its predecessor.
        let only = self.axes.first().filter(|_| axes == 1 && self.axes.len() == 1);
        same.or(only).ok_or_else(|| {
            let known: Vec<String> = self.axes.iter().map(|axis| axis.number.to_string()).collect();
            let what = format!("the file has no settings of axis {}", axis.number());
            Error::usage("E212", what, format!("it has those of axis {}", known.join(", ")))
        })
    }
}

impl fmt::Display for Settings {
    /// Formats the settings as a file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("# `polepair config diff URL FILE` compares, `polepair config apply URL FILE` writes.\n")?;
        writeln!(f, "version = {SETTINGS_VERSION}")?;
        self.axes.iter().try_for_each(|axis| write!(f, "\n{axis}"))
    }
}

impl fmt::Display for AxisSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { number, profile, firmware, .. } = self;
        writeln!(f, "[axis.{number}]\ncount = {}\nprofile = {profile:?}", self.len())?;
        if !firmware.is_empty() {
            writeln!(f, "firmware = {firmware:?}")?;
        }
        if !self.left_out_moving.is_empty() {
            writeln!(
                f,
                "# left out, as they may move the motor: {}",
                self.left_out_moving.join(", ")
            )?;
        }
        writeln!(f, "\n[axis.{number}.settings]")?;
        write_lines(f, &self.settings)?;
        self.unread.iter().try_for_each(|(name, why)| writeln!(f, "# {name}: {why}"))?;
        if self.unnamed.is_empty() {
            return Ok(());
        }
        writeln!(f, "\n# No source names these: `config apply --all` writes them.")?;
        writeln!(f, "[axis.{number}.unnamed]")?;
        write_lines(f, &self.unnamed)
    }
}

fn write_lines(f: &mut fmt::Formatter<'_>, settings: &[Setting]) -> fmt::Result {
    let lines: Vec<String> = settings.iter().map(Setting::format_line).collect();
    let width = lines.iter().map(|line| line.chars().count()).fold(0, usize::max);
    for (line, setting) in lines.iter().zip(settings) {
        match setting.symbol {
            "" => writeln!(f, "{line}")?,
            symbol => writeln!(f, "{line:width$}  # {symbol}")?,
        }
    }
    Ok(())
}

impl Setting {
    fn format_line(&self) -> String {
        let name = &self.name.value;
        let mut line = if !name.is_empty()
            && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
        {
            name.clone()
        } else {
            format!("{name:?}")
        };
        let _ = match &self.value {
            WriteValue::Amount(Amount::Number(number) | Amount::Either(number)) => {
                write!(line, " = {number}")
            }
            WriteValue::Amount(Amount::Text(text) | Amount::Own(text)) => {
                write!(line, " = {text:?}")
            }
            WriteValue::Raw(raw) => write!(line, " = {{ raw = {raw} }}"),
        };
        line
    }
}

fn read_axis(
    axes: &TomlTable<'_, '_>,
    key: &Located<&str>,
    version: Option<i64>,
) -> Result<AxisSettings, FileError> {
    let number = key.value.parse::<u32>();
    let number = number.map_err(|_| key.location.error("an axis has a number: [axis.1]"))?;
    let keys = ["count", "profile", "firmware", "settings", "unnamed"];
    let Some(table) = axes.table(key.value, &keys)? else {
        return Err(key.location.error("an axis is a table"));
    };
    let mut settings = read_settings(&table, "settings")?;
    let unnamed = read_settings(&table, "unnamed")?;
    // `count` shows that a program wrote a file without a version.
    let is_of_program = table.integer("count")?.is_some();
    if version.map_or(is_of_program, |version| version < 2) {
        settings.iter_mut().for_each(|setting| renumber_user_variable(&mut setting.name.value));
    }
    if let Some(count) = table.integer("count")?
        && usize::try_from(count.value) != Ok(settings.len() + unnamed.len())
    {
        let found = settings.len() + unnamed.len();
        return Err(count.location.error(format!(
            "it has {found} settings, not {}: the file was cut off, or lines were added or removed; \
             correct `count`, or remove it",
            count.value
        )));
    }
    Ok(AxisSettings {
        number,
        profile: table.required_text("profile")?.value,
        firmware: table.text("firmware")?.map_or_else(String::new, |text| text.value),
        settings,
        unnamed,
        left_out_moving: Vec::new(),
        unread: Vec::new(),
        is_sheet: false,
        location: table.location(),
    })
}

fn read_settings(table: &TomlTable<'_, '_>, key: &str) -> Result<Vec<Setting>, FileError> {
    let Some(table) = table.table(key, &[])? else { return Ok(Vec::new()) };
    table.keys().into_iter().map(|key| read_setting(&table, key)).collect()
}

/// `user variable A` of a file of version 1 is `user variable 10`.
fn renumber_user_variable(name: &mut String) {
    let number = name.strip_prefix(USER_VARIABLE).map(|number| u8::from_str_radix(number, 16));
    if let Some(Ok(number)) = number {
        *name = format!("{USER_VARIABLE}{number}");
    }
}

fn read_setting(table: &TomlTable<'_, '_>, key: Located<&str>) -> Result<Setting, FileError> {
    let name = Located { value: key.value.to_owned(), location: key.location };
    let value = if table.is_table(key.value) {
        let inner = table.table(key.value, &["raw"])?;
        let raw = inner.map(|inner| inner.required_integer("raw")).transpose()?;
        WriteValue::Raw(raw.map_or(0, |found| found.value))
    } else {
        let plain = table.scalar_text(key.value)?.map_or_else(String::new, |found| found.value);
        WriteValue::Amount(Amount::Text(plain))
    };
    Ok(Setting { name, value, symbol: "" })
}

impl AxisSettings {
    /// Reads the settings of a drive, sorted by name. `progress` gets the number of read settings and the number of
    /// all.
    ///
    /// # Errors
    /// [`Error`] by blame; a setting that the drive refuses is listed in [`unread`](Self::unread).
    pub fn read(axis: &LocalAxis, progress: &mut dyn FnMut(usize, usize)) -> Result<Self, Error> {
        let mut made = Self::empty_for(axis.profile());
        made.number = axis.number();
        if let Identification::Queried { firmware: Some(firmware) } = axis.identified() {
            made.firmware.clone_from(firmware);
        }
        let profile = axis.profile();
        let (named, unnamed) = (profile_settings(profile), unnamed_settings(profile));
        let total = named.len() + unnamed.len();
        for (n, &(id, parameter)) in named.iter().enumerate() {
            progress(n, total);
            let name =
                Located { value: parameter.name.to_owned(), location: made.location.clone() };
            match axis.read(id).map_err(refusal) {
                Ok(raw) => made.settings.push(Setting {
                    name,
                    value: exact_value(axis, id, raw)?,
                    symbol: parameter.symbol,
                }),
                Err(Ok(why)) => made.unread.push((parameter.name.to_owned(), why)),
                Err(Err(error)) => return Err(error),
            }
        }
        for (n, &(id, parameter)) in unnamed.iter().enumerate() {
            progress(named.len() + n, total);
            let name =
                Located { value: parameter.symbol.to_owned(), location: made.location.clone() };
            match axis.read(id).map_err(refusal) {
                Ok(raw) => {
                    let value = WriteValue::Amount(Amount::Number(raw as f64));
                    made.unnamed.push(Setting { name, value, symbol: "" });
                }
                // A variant of the drive without it.
                Err(Ok(_)) => {}
                Err(Err(error)) => return Err(error),
            }
        }
        made.left_out_moving = moving_settings(profile);
        Ok(made)
    }

    /// The factory settings of a drive, as far as its manual states them.
    #[must_use]
    pub fn factory(profile: &'static Profile) -> Self {
        let mut made = Self::empty_for(profile);
        for (_, parameter) in profile_settings(profile) {
            let Some(raw) = parameter.default else { continue };
            made.settings.push(Setting {
                name: Located { value: parameter.name.to_owned(), location: made.location.clone() },
                value: WriteValue::Raw(raw),
                symbol: parameter.symbol,
            });
        }
        made
    }

    fn empty_for(profile: &Profile) -> Self {
        Self {
            number: 1,
            profile: profile.name.to_owned(),
            firmware: String::new(),
            settings: Vec::new(),
            unnamed: Vec::new(),
            left_out_moving: Vec::new(),
            unread: Vec::new(),
            is_sheet: false,
            location: FileLocation::built_in(profile.name),
        }
    }

    /// Number of settings there are, with those that no source names.
    #[must_use]
    pub fn len(&self) -> usize {
        self.settings.len() + self.unnamed.len()
    }

    /// Number of settings that no source names.
    #[must_use]
    pub fn unnamed_len(&self) -> usize {
        self.unnamed.len()
    }

    /// True without settings.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Entries of a DCF that are not written to this drive, with the reasons.
    #[must_use]
    pub fn left_out(&self, axis: &LocalAxis) -> Vec<(String, String)> {
        let unfit = self.settings.iter().filter(|_| self.is_sheet).filter_map(|setting| {
            let reason = setting.unfit_reason(axis)?;
            Some((setting.name.value.clone(), reason.to_owned()))
        });
        self.unread.iter().cloned().chain(unfit).collect()
    }

    /// Differences from the drive, those that scale others first: in this order they are written, and raw values are
    /// compared. Values are converted by the scales in the settings. Every name and value is checked before the first
    /// is read.
    ///
    /// # Errors
    /// [`Error::File`] for settings that the drive cannot have; others by blame.
    pub fn changes(
        &self,
        axis: &LocalAxis,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<SettingChange>, Error> {
        let profile = axis.profile();
        if !self.is_sheet && self.profile != profile.name {
            let reason =
                format!("these are settings of {}, this is {}", self.profile, profile.name);
            return Err(self.location.error(reason).into());
        }
        let wanted = match self.raw_values(axis) {
            Ok(wanted) => wanted,
            // A value may have no unit here because the drive lacks what it is scaled by.
            Err(error) => {
                let absent = self.absent_settings(axis)?;
                return Err(self.absent_error(axis, &absent).unwrap_or(error));
            }
        };
        let mut absent = Vec::new();
        let mut pending = PendingWrites::default();
        wanted.iter().for_each(|(id, raw)| pending.insert(*id, *raw));
        let mut changes = Vec::new();
        let is_unnamed = |id| profile.parameter(id).is_some_and(is_unnamed_setting);
        for (n, &(id, raw)) in wanted.iter().enumerate() {
            progress(n, wanted.len());
            let now = match axis.read(id) {
                // An entry that is not in use can be missing.
                Err(error) if process_data::is_refused_entry(axis, id, &error) => 0,
                Err(error) if is_absent_error(axis, &error) => {
                    absent.push(id);
                    continue;
                }
                now => now?,
            };
            if now != raw {
                let (now, wanted) = (axis.value(id, now)?, axis.value_after(id, raw, &pending)?);
                changes.push(SettingChange {
                    id,
                    now,
                    wanted,
                    reach: profile.link_settings.contains(&id),
                    unnamed: is_unnamed(id),
                    undescribed: is_undescribed(axis, id),
                });
            }
        }
        if let Some(error) = self.absent_error(axis, &absent) {
            return Err(error);
        }
        // A drive refuses an S-time of half a ramp or more: what becomes shorter comes before the ramps.
        let is_shorter = |change: &SettingChange| {
            let name = profile.parameter(change.id).map_or("", |parameter| parameter.name);
            name.ends_with(" s-time") && change.wanted.raw < change.now.raw
        };
        changes.sort_by_key(|change| !(axis.scales(change.id) || is_shorter(change)));
        Ok(changes)
    }
}

impl AxisSettings {
    /// Settings whose objects the drive has not.
    fn absent_settings(&self, axis: &LocalAxis) -> Result<Vec<ParameterId>, Error> {
        let mut absent = Vec::new();
        for setting in self.settings.iter().chain(&self.unnamed) {
            let Ok(id) = setting.find_parameter(axis) else { continue };
            match axis.read(id) {
                Err(error) if is_absent_error(axis, &error) => absent.push(id),
                Err(Error::Link(error)) => return Err(Error::Link(error)),
                _ => {}
            }
        }
        Ok(absent)
    }

    /// The error that lists them all, at the line of the first.
    fn absent_error(&self, axis: &LocalAxis, absent: &[ParameterId]) -> Option<Error> {
        let all = || self.settings.iter().chain(&self.unnamed);
        let is_absent =
            |setting: &&Setting| setting.find_parameter(axis).is_ok_and(|id| absent.contains(&id));
        let first = all().find(is_absent)?;
        let names: Vec<&str> = all().filter(is_absent).map(|it| it.name.value.as_str()).collect();
        let reason = format!(
            "the drive lacks {} of these {} settings: {}; remove them, and `count`",
            names.len(),
            self.len(),
            names.join(", ")
        );
        Some(first.name.location.error(reason).into())
    }

    /// Raw values of the drive once all settings are written, those that scale others first.
    fn raw_values(&self, axis: &LocalAxis) -> Result<Vec<(ParameterId, i64)>, Error> {
        let named = self
            .settings
            .iter()
            .chain(&self.unnamed)
            .filter(|setting| !self.is_sheet || setting.unfit_reason(axis).is_none());
        let named = named.map(|setting| Ok((setting.find_parameter(axis)?, setting)));
        let mut named = named.collect::<Result<Vec<_>, Error>>()?;
        // Parameters that scale others come first: the others' texts are read in the new scale.
        named.sort_by_key(|(id, _)| !axis.scales(*id));
        let (mut wanted, mut pending) = (Vec::new(), PendingWrites::default());
        for (id, setting) in named {
            wanted.push((id, setting.raw_value(axis, id, &mut pending)?));
        }
        Ok(wanted)
    }
}

impl Setting {
    /// The error with the setting's place in the file.
    fn locate_error(&self, error: Error) -> Error {
        match error {
            Error::Usage { what, .. } => self.name.location.error(what).into(),
            other => other,
        }
    }

    /// Why a line of a DCF is no setting of this drive.
    fn unfit_reason(&self, axis: &LocalAxis) -> Option<&'static str> {
        let id = axis.find(&self.name.value).ok()?;
        let parameter = axis.parameter(id)?;
        match parameter.access {
            Access::ReadWrite if parameter.moves && !is_undescribed(axis, id) => {
                Some("it moves the motor")
            }
            Access::ReadWrite => None,
            _ => Some("the drive's profile cannot read and write it"),
        }
    }

    fn find_parameter(&self, axis: &LocalAxis) -> Result<ParameterId, Error> {
        axis.find(&self.name.value).map_err(|error| self.locate_error(error))
    }

    /// The raw value, after the pending writes.
    fn raw_value(
        &self,
        axis: &LocalAxis,
        id: ParameterId,
        pending: &mut PendingWrites,
    ) -> Result<i64, Error> {
        let planned = axis.plan_write(id, &self.name.value, &self.value, pending);
        let planned = planned.map_err(|error| self.locate_error(error))?;
        // A file of settings must not start a motor.
        let moves = planned.parameter.moves && !is_undescribed(axis, id);
        if planned.parameter.access != Access::ReadWrite || moves {
            return self.name_error(format!("`{}` is no setting", planned.parameter.name));
        }
        Ok(planned.raw)
    }

    fn name_error(&self, reason: String) -> Result<i64, Error> {
        Err(self.name.location.error(reason).into())
    }
}

/// Returns whether no table describes a parameter that was found by its number.
fn is_undescribed(axis: &LocalAxis, id: ParameterId) -> bool {
    let parameter = axis.parameter(id);
    axis.profile().parameter(id).is_none() && parameter.is_some_and(is_undescribed_motion)
}

fn is_undescribed_motion(p: &Parameter) -> bool {
    p.certainty == Certainty::Undocumented && p.moves
}

/// A drive's refusal in words, or another error.
fn refusal(error: Error) -> Result<String, Error> {
    match error {
        Error::Failed { what, outcome: Outcome::NotDone(Failure::Refused { .. }), .. } => Ok(what),
        error => Err(error),
    }
}

/// Parameters that a drive keeps, and that may move its motor when they are written.
fn moving_settings(profile: &'static Profile) -> Vec<&'static str> {
    let kept = profile.parameters.iter().filter(|it| {
        it.moves && it.access == Access::ReadWrite && it.persistence != Persistence::Volatile
    });
    kept.map(|parameter| parameter.name).collect()
}

/// Settings that no source names, by their place.
fn unnamed_settings(profile: &'static Profile) -> Vec<(ParameterId, &'static Parameter)> {
    let ids = (0..).map(ParameterId).zip(profile.parameters);
    let mut settings: Vec<_> = ids.filter(|(_, parameter)| is_unnamed_setting(parameter)).collect();
    settings.sort_by_key(|(_, parameter)| (parameter.index, parameter.space));
    settings
}

/// The settings of a profile by name.
fn profile_settings(profile: &'static Profile) -> Vec<(ParameterId, &'static Parameter)> {
    let ids = (0..).map(ParameterId).zip(profile.parameters);
    let mut settings: Vec<_> = ids.filter(|(_, parameter)| is_setting(parameter)).collect();
    // By name, so that two files differ only where the drives do.
    settings.sort_by_key(|(_, parameter)| parameter.name);
    settings
}

/// The shortest text that means exactly this value at this drive.
fn exact_value(axis: &LocalAxis, id: ParameterId, raw: i64) -> Result<WriteValue, Error> {
    let value = axis.value(id, raw)?;
    let unit = value.unit.symbol();
    let rounded = value.to_string();
    let exact = format!("{} {unit}", value.value);
    for text in [rounded, exact.trim_end().to_owned()] {
        let amount = match text.parse::<f64>() {
            Ok(number) if unit.is_empty() && value.word.is_none() => Amount::Number(number),
            _ => Amount::Text(text),
        };
        // The text has to lead back to the very raw value, otherwise the raw value is written.
        if axis.raw_of(id, &amount).is_ok_and(|back| back == raw) {
            return Ok(WriteValue::Amount(amount));
        }
    }
    Ok(WriteValue::Raw(raw))
}
