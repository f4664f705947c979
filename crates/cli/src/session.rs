//! An open link for the verbs: interruptible, with errors as texts.

use polepair::remote::RemoteLink;
use polepair::url::shell_word;
use polepair::url::{AxisNumber, Url};
use polepair::{Axis, Link, LocalAxis, LocalLink, Value};
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;

use crate::outcome;
use crate::problem::Result;
use crate::remote;
use crate::terminal::print_note;

/// A link, of this program or of a server, and how the user named it.
pub struct Session {
    pub link: Link,
    /// Arguments that name it to another verb.
    pub arguments: String,
    local: Option<LocalSession>,
}

impl From<LocalSession> for Session {
    fn from(session: LocalSession) -> Self {
        let (link, arguments) = (session.link.clone().into(), session.arguments.clone());
        Self { link, arguments, local: Some(session) }
    }
}

impl Session {
    /// The axes of a server.
    pub fn of_server(link: RemoteLink, words: &str) -> Self {
        let address = format!("{}#{words}", link.gateway().url());
        let arguments = shell_word(&address).into_owned();
        Self { link: link.into(), arguments, local: None }
    }

    /// The link of this program; `None` for a server.
    pub fn into_local(self) -> Option<LocalSession> {
        self.local
    }

    /// The connection string of a link of this program.
    pub fn local_url(&self) -> Option<&Url> {
        self.local.as_ref().map(|session| session.link.url())
    }

    /// Makes Ctrl-C end what waits.
    pub fn listen_for_interrupts(&self) {
        match &self.local {
            Some(session) => session.listen_for_interrupts(),
            // Waits for a server end by themselves.
            None => crate::interrupt::listen(|| {}),
        }
    }

    /// Prints why links of a server that its axes are on are not open, and their missing axes.
    pub fn print_link_troubles(&self) {
        let Some(remote) = self.link.remote() else { return };
        let is_used = |link: u16| remote.axes().iter().any(|axis| axis.info().link == link);
        for link in remote.bench().links.iter().filter(|link| is_used(link.id)) {
            remote::link_troubles(link).iter().for_each(|line| print_note(line));
        }
    }

    /// The present time of the link: a simulation has a clock of its own.
    pub fn now(&self) -> Instant {
        self.axes().first().map_or(Instant::ZERO, Axis::now)
    }

    /// Every axis.
    pub fn axes(&self) -> &[Axis] {
        self.link.axes()
    }

    /// `#1 ` before what concerns an axis, where there are several.
    pub fn axis_prefix(&self, axis: &Axis) -> String {
        let links = self.link.remote().map_or(1, |link| link.bench().links.len());
        let link = axis.remote().filter(|_| links > 1).map(|axis| axis.info().link);
        match (self.axes().len(), axis.name(), link) {
            (0 | 1, ..) => String::new(),
            (_, "", Some(link)) => format!("{link}#{} ", AxisNumber(axis.number())),
            (_, "", None) => format!("#{} ", AxisNumber(axis.number())),
            (_, name, _) => format!("{name} "),
        }
    }
}

/// A link of this program, and how the user named it.
pub struct LocalSession {
    pub link: LocalLink,
    /// Arguments that name it to another verb: its URL, and the profile's file if one was given.
    pub arguments: String,
}

impl LocalSession {
    /// Makes Ctrl-C end what waits.
    pub fn listen_for_interrupts(&self) {
        let interrupters = self.link.interrupters();
        crate::interrupt::listen(move || {
            interrupters.iter().for_each(polepair_link::Interrupter::interrupt);
        });
    }

    /// The present time of the link: a simulation has a clock of its own.
    pub fn now(&self) -> Instant {
        self.axes().first().map_or(Instant::ZERO, |axis| axis.connection().now())
    }

    /// Every axis.
    pub fn axes(&self) -> &[LocalAxis] {
        self.link.axes()
    }

    /// `#1 ` before what concerns an axis, where there are several.
    pub fn axis_prefix(&self, axis: &LocalAxis) -> String {
        match (self.axes().len(), axis.name()) {
            (0 | 1, _) => String::new(),
            (_, "") => format!("#{} ", AxisNumber(axis.number())),
            (_, name) => format!("{name} "),
        }
    }
}

impl LocalSession {
    /// Notes a parameter that spares the permanent memory, and that stays as this program set it.
    fn note_memory_mode(&self, axis: &LocalAxis) {
        let mode = axis.profile().ram.zip(axis.state().ram_mode_before);
        let Some((ram, before)) = mode.filter(|(ram, before)| *before == ram.flash) else { return };
        let Some(parameter) = axis.parameter(ram.parameter) else { return };
        let (name, symbol) = (parameter.name, parameter.symbol);
        print_note(&format!(
            "{}: {symbol} ({name}) was {before} and stays {}, to spare that memory: later writes \
             are lost at power-off; polepair set {} \"{symbol}={before}\" puts it back",
            axis.label(),
            ram.ram,
            self.arguments
        ));
    }
}

impl Drop for LocalSession {
    /// Prints a write to a drive's permanent memory in any case.
    fn drop(&mut self) {
        for axis in self.link.axes() {
            // Printed at the end whatever happened: a script in a loop wears the memory out within a day.
            let writes = axis.state().flash_writes;
            if writes > 0 {
                let label = axis.label();
                print_note(&format!("{label}: writes to the drive's permanent memory: {writes}"));
            }
            self.note_memory_mode(axis);
        }
    }
}

/// Reads a parameter in its unit.
pub fn read_parameter(axis: &LocalAxis, id: ParameterId) -> Result<Value> {
    axis.read(id).and_then(|raw| axis.value(id, raw)).map_err(outcome::to_problem)
}

/// Carries out a verb without arguments.
pub fn run_verb(axis: &LocalAxis, verb: Verb) -> Result<i64> {
    axis.run(Command::new(verb)).map_err(outcome::to_problem)
}

/// Returns whether the motor has power, as far as the drive reports it.
pub fn is_enabled(axis: &Axis) -> Result<bool> {
    match axis.local() {
        Some(axis) => {
            let read = axis.unless_forbidden(axis.signal_value(Signal::Enabled));
            Ok(read.map_err(outcome::to_problem)?.flatten().is_some_and(|read| read.raw != 0))
        }
        None if !axis.has_signal(Signal::Enabled) => Ok(false),
        None => {
            let read = axis.signals(&[Signal::Enabled]).map_err(outcome::to_problem)?;
            Ok(read.first().is_some_and(|read| !read.value.is_nan() && read.value != 0.0))
        }
    }
}

/// A signal as it is now, as people read it.
pub fn signal_text(axis: &Axis, signal: Signal) -> Result<Option<String>> {
    let text = axis.interface().signal_text(signal).map_err(outcome::to_problem)?;
    note_unit(axis.local(), signal);
    Ok(text)
}

/// Reads a signal, if the drive has it. Flags are 0 or 1, without a unit.
pub fn read_signal(axis: &LocalAxis, signal: Signal) -> Result<Option<Value>> {
    let value = axis.signal_value(signal).map_err(outcome::to_problem)?;
    note_unit(Some(axis), signal);
    Ok(value)
}

fn note_unit(axis: Option<&LocalAxis>, signal: Signal) {
    if let Some(axis) = axis
        && let Some(source) = axis.profile().signal(signal)
    {
        outcome::note_missing_unit(axis, source.parameter);
    }
}
