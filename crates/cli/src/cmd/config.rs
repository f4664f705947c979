//! `polepair config save|diff|apply URL [FILE]`

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use polepair::eds::is_eds_file;
use polepair::settings::{AxisSettings, SettingChange, SettingWrite, Settings};
use polepair::url::{AxisNumber, shell_word};
use polepair::{Identification, LocalAxis};
use polepair_capture::jsonl;
use polepair_core::profile::{ParameterId, Signal};

use crate::consent;
use crate::data_output::DataOutput;
use crate::outcome;
use crate::output_file;
use crate::problem::{self, Exit, Problem, Result};
use crate::progress::Progress;
use crate::session::{LocalSession, read_signal};
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{TextTable, colour_out, print_note, print_warning};
use crate::value::plural;

/// Saves, compares and restores a drive's settings. The file has one sorted line for each setting, with its
/// unit.
#[derive(Subcommand, Debug)]
pub enum ConfigCommand {
    /// Read all settings and write them to a file
    Save(ConfigSave),
    /// Compare a drive with a settings file; the exit code is 1 if they differ
    Diff(ConfigDiff),
    /// Show what differs, write it to the drive, and read it back
    Apply(ConfigApply),
}

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair config save tmcl+serial:///dev/ttyUSB0#1 feeder.toml
  polepair config save sim:tmcl")]
pub struct ConfigSave {
    #[command(flatten)]
    target: DriveArgs,
    /// Settings file to write [default: stdout]
    #[arg(id = "settings", value_name = "FILE")]
    file: Option<PathBuf>,
}

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair config diff tmcl+serial:///dev/ttyUSB0#1 feeder.toml
  polepair config diff sim:tmcl --default      differences from the factory settings")]
pub struct ConfigDiff {
    #[command(flatten)]
    target: DriveArgs,
    /// Settings file to compare with
    #[arg(id = "settings", value_name = "FILE", required_unless_present = "default")]
    file: Option<PathBuf>,
    /// Compare with the factory defaults that the manual states
    #[arg(long, conflicts_with = "settings")]
    default: bool,
    /// Output format
    #[arg(long, value_enum, default_value_t = OutputFormat::Text)]
    format: OutputFormat,
}

#[derive(Args, Debug)]
#[command(after_help = "\
Address, baud rate and locks are not written without --reach, registers that no source names not without --all.

Examples:
  polepair config apply tmcl+serial:///dev/ttyUSB0#1 feeder.toml
  polepair config apply tmcl+serial:///dev/ttyUSB0#1 feeder.toml --yes --store
  polepair config apply canopen+socketcan://can0#5 node5.dcf")]
pub struct ConfigApply {
    #[command(flatten)]
    target: DriveArgs,
    /// Settings file, or a CANopen DCF
    #[arg(id = "settings", value_name = "FILE")]
    file: PathBuf,
    /// Print what would be written, and write nothing
    #[arg(long)]
    dry_run: bool,
    /// Do not ask for confirmation
    #[arg(short, long)]
    yes: bool,
    /// Save the settings to the drive's permanent memory
    #[arg(long)]
    store: bool,
    /// Also write address, baud rate and locks, after all other settings
    #[arg(long)]
    reach: bool,
    /// Also write registers that no source names, to a drive of the same kind without power: a clone
    #[arg(long, conflicts_with = "powered")]
    all: bool,
    /// Write even while a motor is powered
    #[arg(long)]
    powered: bool,
    /// Also write settings with unknown effect; they may move the motor
    #[arg(long)]
    arm: bool,
}

impl ConfigCommand {
    pub fn run(self) -> Result {
        match self {
            Self::Save(verb) => verb.run(),
            Self::Diff(verb) => verb.run(),
            Self::Apply(verb) => verb.run(),
        }
    }
}

impl ConfigSave {
    fn run(self) -> Result {
        if self.file.as_deref().is_some_and(is_eds_file) {
            return Err(Problem::usage("E248", "settings are not saved as a data sheet.")
                .why("A DCF has all objects of its EDS, of which a drive does not tell most facts.")
                .hint("save a .toml file, which `config apply` writes to a drive"));
        }
        output_file::refuse_input(self.file.as_deref(), self.target.profiles.path())?;
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let mut settings = Settings::default();
        for axis in session.axes() {
            let read = with_progress(axis, |progress| AxisSettings::read(axis, progress))?;
            for (name, why) in &read.unread {
                print_warning(&format!("{}: {name} is skipped: {why}", axis.label()));
            }
            if !read.left_out_moving.is_empty() {
                let names = read.left_out_moving.join(", ");
                print_note(&format!("left out, as they may move the motor: {names}"));
            }
            settings.axes.push(read);
        }
        let mut out = DataOutput::to_path(self.file.as_deref())?;
        out.buffer().extend_from_slice(settings.to_string().as_bytes());
        out.finish()?;
        if let Some(file) = self.file.as_deref().filter(|file| file.as_os_str() != "-") {
            let count: usize = settings.axes.iter().map(AxisSettings::len).sum();
            let unnamed: usize = settings.axes.iter().map(AxisSettings::unnamed_len).sum();
            let among = match unnamed {
                0 => String::new(),
                unnamed => format!(", {unnamed} of them without a name in any source"),
            };
            let count = plural(count as u64, "setting");
            print_note(&format!("{count} saved in {}{among}", file.display()));
        }
        Ok(Exit::Ok)
    }
}

impl ConfigDiff {
    fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let file = self.file.as_deref().map(load_settings).transpose()?;
        let mut out = DataOutput::stdout().with_text(self.format == OutputFormat::Text);
        if self.format == OutputFormat::Csv {
            out.write_line("axis,setting,now,wanted,unit");
        }
        let mut count = 0;
        for axis in session.axes() {
            let changes = match &file {
                Some(file) => changes_from(&session, axis, file)?,
                None => {
                    let factory = AxisSettings::factory(axis.profile());
                    with_progress(axis, |progress| factory.changes(axis, progress))?
                }
            };
            count += changes.len();
            match self.format {
                OutputFormat::Text if !changes.is_empty() => {
                    let wanted = if file.is_some() { "file" } else { "default" };
                    let text = changes_table(&session, axis, &changes, ["drive", wanted]);
                    out.buffer().extend_from_slice(text.as_bytes());
                }
                OutputFormat::Text => {}
                OutputFormat::Jsonl => {
                    changes.iter().for_each(|it| write_json(axis, it, out.buffer()))
                }
                OutputFormat::Csv => {
                    changes.iter().for_each(|it| out.write_line(&csv_row(axis, it)))
                }
            }
        }
        out.flush()?;
        print_note(&match count {
            0 => "nothing differs".to_owned(),
            1 => "1 setting differs".to_owned(),
            count => format!("{count} settings differ"),
        });
        Ok(if count == 0 { Exit::Ok } else { Exit::Negative })
    }
}

impl ConfigApply {
    fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let file = load_settings(&self.file)?;
        let mut plan: Vec<(&LocalAxis, Vec<SettingChange>)> = Vec::new();
        let mut out = DataOutput::stdout();
        for axis in session.axes() {
            let mut changes = changes_from(&session, axis, &file)?;
            self.drop_unnamed(axis, &file, &mut changes)?;
            // A stable order: what scales others stays before them.
            changes.sort_by_key(|change| change.reach);
            let left: Vec<&str> = parameter_names(axis, changes.iter().filter(|it| it.reach));
            if !left.is_empty() && !self.reach {
                print_warning(&format!(
                    "not written, because it is needed to reach the drive: {}",
                    left.join(", ")
                ));
                changes.retain(|change| !change.reach);
            }
            if !changes.is_empty() {
                let text = changes_table(&session, axis, &changes, ["now", "becomes"]);
                out.buffer().extend_from_slice(text.as_bytes());
            }
            plan.push((axis, changes));
        }
        out.flush()?;
        let count: usize = plan.iter().map(|(_, changes)| changes.len()).sum();
        if count == 0 {
            print_note("nothing to write");
            return Ok(Exit::Ok);
        }
        if self.dry_run {
            print_note("dry run: none of this was written");
            return Ok(Exit::Ok);
        }
        self.check_power(&plan)?;
        self.check_arming(&plan)?;
        consent::ask(self.yes, &plural(count as u64, "setting"), self.store)?;
        self.write_changes(&session, &file, &plan)
    }

    /// Leaves out what no source names, unless it is for a drive of the same firmware.
    fn drop_unnamed(
        &self,
        axis: &LocalAxis,
        file: &Settings,
        changes: &mut Vec<SettingChange>,
    ) -> Result<()> {
        let count = changes.iter().filter(|change| change.unnamed).count();
        if count == 0 {
            return Ok(());
        }
        if !self.all {
            changes.retain(|change| !change.unnamed);
            let registers = plural(count as u64, "register");
            print_warning(&format!(
                "not written, because no source names them: {registers}; --all writes them too"
            ));
            return Ok(());
        }
        let saved = file.axes.iter().find(|it| it.number == axis.number()).or(file.axes.first());
        let saved = saved.map_or("", |settings| settings.firmware.as_str());
        let Identification::Queried { firmware: Some(now) } = axis.identified() else {
            return Ok(());
        };
        if saved.is_empty() || saved == now {
            return Ok(());
        }
        let what = format!("the file is of firmware {saved}, and {} has {now}.", axis.label());
        Err(Problem::usage("E247", what)
            .why("Registers without a name may mean something else there. Nothing was written.")
            .hint("leave --all away: the named settings are written"))
    }

    /// A powered motor takes new gains and limits at once.
    fn check_power(&self, plan: &[(&LocalAxis, Vec<SettingChange>)]) -> Result<()> {
        for (axis, _) in plan.iter().filter(|(_, changes)| !changes.is_empty() && !self.powered) {
            let powered = read_signal(axis, Signal::Enabled)?;
            if powered.is_some_and(|value| value.raw != 0) {
                let what = format!("{} is powered.", axis.label());
                return Err(Problem::usage("E246", what)
                    .why("New limits and gains would take effect at once. Nothing was written.")
                    .hint(format!("polepair disable {}", shell_word(&self.target.url)))
                    .hint("--powered writes anyway"));
            }
        }
        Ok(())
    }

    /// A parameter that no table describes may start a motor.
    fn check_arming(&self, plan: &[(&LocalAxis, Vec<SettingChange>)]) -> Result<()> {
        for (axis, changes) in plan.iter().filter(|_| !self.arm) {
            let undescribed = changes.iter().filter(|change| change.undescribed);
            let names = parameter_names(axis, undescribed);
            if !names.is_empty() {
                let what = format!("{}: no table describes {}.", axis.label(), names.join(", "));
                return Err(Problem::usage("E219", what)
                    .why("The effect of writing it is unknown. Nothing was written.")
                    .hint("--arm writes it"));
            }
        }
        Ok(())
    }

    /// Writes the settings of an axis; `progress` has the number of writes done, and of all.
    fn write_axis<'w>(
        &self,
        axis: &LocalAxis,
        writes: impl Iterator<Item = &'w SettingWrite>,
        progress: (&mut usize, usize),
    ) -> Result<()> {
        let (written, count) = progress;
        for write in writes {
            if let Err(error) = axis.write(write.id, write.raw, self.store && !write.is_step) {
                if *written == 0 {
                    return Err(outcome::to_problem(error));
                }
                let what = format!("{written} of {count} writes were done, then one failed.");
                return Err(Problem::new(Exit::Partial, "E701", what)
                    .why(error.to_string())
                    .hint("`polepair config diff URL FILE` shows the remaining differences"));
            }
            *written += 1;
            // The others were converted by it.
            if axis.scales(write.id) {
                let stored = axis.read(write.id).map_err(outcome::to_problem)?;
                if stored != write.raw {
                    let name = axis.parameter(write.id).map_or("?", |p| p.name);
                    let what = format!("the drive did not keep {name}.");
                    return Err(Problem::new(Exit::Negative, "E111", what).why(format!(
                        "Other settings are scaled by it: {written} of {count} writes were \
                         executed."
                    )));
                }
            }
        }
        Ok(())
    }

    fn write_changes(
        &self,
        session: &LocalSession,
        file: &Settings,
        plan: &[(&LocalAxis, Vec<SettingChange>)],
    ) -> Result {
        let mut writes = Vec::new();
        for (axis, changes) in plan {
            let settings = file.for_axis(axis, session.axes().len());
            let its = settings.and_then(|settings| settings.writes(axis, changes));
            writes.push((*axis, its.map_err(outcome::to_problem)?));
        }
        let count: usize = writes.iter().map(|(_, its)| its.len()).sum();
        let mut written = 0;
        for (axis, writes) in &writes {
            axis.arm(self.arm);
            let memory = MemoryMode::begin(axis, self.store)?;
            let done = self.write_axis(axis, memory.other_writes(writes), (&mut written, count));
            // Also after an error: others rely on the mode that they left.
            let ended = memory.end(axis, writes);
            axis.arm(false);
            done.and(ended)?;
        }
        let (mut differing, mut unread) = (Vec::new(), Vec::new());
        for (axis, changes) in plan {
            for change in changes.iter().filter(|change| !change.reach) {
                match axis.read(change.id) {
                    Ok(stored) if stored == change.wanted.raw => {}
                    Ok(_) => differing.extend(parameter_names(axis, [change])),
                    // The outcome of a write is the write's.
                    Err(_) => unread.extend(parameter_names(axis, [change])),
                }
            }
        }
        if !unread.is_empty() {
            print_note(&format!("written, but not read back: {}", unread.join(", ")));
        }
        if differing.is_empty() {
            let changed: usize = plan.iter().map(|(_, changes)| changes.len()).sum();
            let changed = changed - unread.len();
            print_note(&format!("{} written and read back", plural(changed as u64, "setting")));
            return Ok(Exit::Ok);
        }
        let what = format!("the drive did not keep {}.", differing.join(", "));
        Err(Problem::new(Exit::Negative, "E111", what)
            .why("It was written and accepted, but another value was read back."))
    }
}

/// The parameter of a drive that selects RAM or permanent memory, while settings are written.
struct MemoryMode {
    parameter: Option<ParameterId>,
    /// Value before.
    before: Option<i64>,
}

impl MemoryMode {
    /// Selects permanent memory once for all writes, if they are to be stored: each would select it by itself.
    fn begin(axis: &LocalAxis, store: bool) -> Result<Self> {
        let Some(ram) = axis.profile().ram else {
            return Ok(Self { parameter: None, before: None });
        };
        let before = axis.read(ram.parameter).map_err(outcome::to_problem)?;
        if store && before != ram.flash {
            axis.write(ram.parameter, ram.flash, false).map_err(outcome::to_problem)?;
        }
        Ok(Self { parameter: Some(ram.parameter), before: Some(before) })
    }

    fn other_writes<'w>(
        &self,
        writes: &'w [SettingWrite],
    ) -> impl Iterator<Item = &'w SettingWrite> {
        let own = self.parameter;
        writes.iter().filter(move |write| Some(write.id) != own)
    }

    /// Writes the value that the settings have, or puts the value back that was found.
    fn end(&self, axis: &LocalAxis, writes: &[SettingWrite]) -> Result<()> {
        let (Some(id), Some(before)) = (self.parameter, self.before) else { return Ok(()) };
        let wanted = writes.iter().find(|write| write.id == id).map_or(before, |write| write.raw);
        if axis.read(id).map_err(outcome::to_problem)? != wanted {
            axis.write(id, wanted, false).map_err(outcome::to_problem)?;
        }
        Ok(())
    }
}

fn load_settings(file: &Path) -> Result<Settings> {
    if !file.exists() {
        return Err(problem::file_problem(file, "read", &std::io::ErrorKind::NotFound.into()));
    }
    Settings::load(file).map_err(outcome::to_problem)
}

/// Differences of one axis from the file.
fn changes_from(
    session: &LocalSession,
    axis: &LocalAxis,
    file: &Settings,
) -> Result<Vec<SettingChange>> {
    let settings = file.for_axis(axis, session.axes().len()).map_err(outcome::to_problem)?;
    for (name, why) in settings.left_out(axis) {
        print_warning(&format!("{}: {name} is skipped: {why}", axis.label()));
    }
    with_progress(axis, |progress| settings.changes(axis, progress))
}

/// Reads settings, which takes a while on a slow line, and shows how far it is.
fn with_progress<T>(
    axis: &LocalAxis,
    read: impl FnOnce(&mut dyn FnMut(usize, usize)) -> std::result::Result<T, polepair::Error>,
) -> Result<T> {
    let bar = Progress::of_count(0, &format!("settings of {}", axis.label()));
    read(&mut |done, of| bar.set_of(done, of)).map_err(outcome::to_problem)
}

fn parameter_names<'a>(
    axis: &LocalAxis,
    changes: impl IntoIterator<Item = &'a SettingChange>,
) -> Vec<&'static str> {
    changes.into_iter().filter_map(|change| axis.parameter(change.id).map(|p| p.name)).collect()
}

fn changes_table(
    session: &LocalSession,
    axis: &LocalAxis,
    changes: &[SettingChange],
    heads: [&str; 2],
) -> String {
    let mut table = TextTable::with_heads(&["setting", "symbol", heads[0], heads[1]]);
    for change in changes {
        let Some(parameter) = axis.parameter(change.id) else { continue };
        table.add_row([
            format!("{}{}", session.axis_prefix(axis), parameter.name),
            parameter.symbol.to_owned(),
            change.now.to_string(),
            change.wanted.to_string(),
        ]);
    }
    table.render(colour_out())
}

fn csv_row(axis: &LocalAxis, change: &SettingChange) -> String {
    let parameter = axis.parameter(change.id);
    let (name, unit) = (parameter.map_or("", |p| p.name), change.now.unit.symbol());
    let number = AxisNumber(axis.number());
    format!("{number},{name},{},{},{unit}", change.now.value, change.wanted.value)
}

fn write_json(axis: &LocalAxis, change: &SettingChange, out: &mut Vec<u8>) {
    let Some(parameter) = axis.parameter(change.id) else { return };
    out.extend_from_slice(
        format!("{{\"axis\":{},\"setting\":", AxisNumber(axis.number()).json()).as_bytes(),
    );
    jsonl::write_string(out, parameter.name);
    for (key, value) in [("now", change.now), ("wanted", change.wanted)] {
        out.extend_from_slice(format!(",\"{key}\":").as_bytes());
        jsonl::write_real(out, value.value);
        out.extend_from_slice(format!(",\"{key}_raw\":{}", value.raw).as_bytes());
    }
    out.extend_from_slice(b",\"unit\":");
    jsonl::write_string(out, change.now.unit.symbol());
    out.extend_from_slice(format!(",\"reach\":{}}}\n", change.reach).as_bytes());
}
