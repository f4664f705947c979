//! Changes the address of a drive: writes it last, and reads it back at the new address.

use polepair::url::{LinkTarget, shell_word};
use polepair::{Connector, LocalAxis};
use polepair_core::convert::saturating;
use polepair_core::profile::{AddressRole, ParameterId};

use crate::data_output::DataOutput;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::{LocalSession, read_parameter};
use crate::target::DriveArgs as Drive;
use crate::terminal::print_note;

/// A setting that changes how its drive is reached.
#[derive(Clone, Copy)]
pub struct AddressChange {
    id: ParameterId,
    raw: i64,
    what: AddressRole,
}

impl AddressChange {
    /// Address change of one setting; `None` for one that keeps the drive's address.
    pub fn for_setting(axis: &LocalAxis, id: ParameterId, raw: i64) -> Result<Option<Self>> {
        let what = axis.readdress_effect(id, raw).map_err(outcome::to_problem)?;
        Ok(what.map(|what| Self { id, raw, what }))
    }

    /// Refuses what could not be read back: nothing was sent.
    pub fn check(axis_count: usize, changes: &[Self]) -> Result<()> {
        match (changes, axis_count) {
            ([], _) | ([_], 1) => Ok(()),
            _ => Err(Problem::usage("E242", "One address of one drive at a time.")
                .why("The drive must be found again at its new address; nothing was sent.")
                .hint("name one axis in the connection string: URL#1")),
        }
    }

    /// Writes it, and reads it back at its new place.
    pub fn apply(
        self,
        drive: &Drive,
        session: LocalSession,
        keep: bool,
        out: &mut DataOutput,
    ) -> Result<()> {
        let Self { id, raw, what } = self;
        let axis = &session.axes()[0];
        let name = axis.parameter(id).map_or("?", |parameter| parameter.name);
        let (old, number, label) = (session.link.url().clone(), axis.number(), axis.label());
        let after_restart = what == AddressRole::DriveAfterRestart;
        if !after_restart && axis.read(id).map_err(outcome::to_problem)? == raw {
            out.write_line(&format!("{name} = {raw}"));
            return Ok(());
        }
        if session.link.simulation().is_some() {
            axis.write(id, raw, keep).map_err(outcome::to_problem)?;
            print_note(&format!(
                "{label} accepted {name} = {raw}; the simulation ends with this command, so this \
                 was not verified"
            ));
            return Ok(());
        }
        let address = saturating(raw);
        let new = old.readdressed(number, what, address).to_string();
        let connector = drive.connector()?;
        let session = match what {
            // A port is opened once at a time.
            AddressRole::Drive | AddressRole::DriveAfterRestart => {
                drop(session);
                if address != number {
                    check_free(&connector, &new, address)?;
                }
                drive.open_with(&connector, &old.to_string())?
            }
            AddressRole::Host => session,
        };
        let written = session.axes()[0].write(id, raw, keep);
        if after_restart {
            written.map_err(outcome::to_problem)?;
            out.write_line(&format!("{name} = {raw}"));
            print_note(&format!(
                "{label} is {} after it is switched off and on: {new}",
                polepair::url::AxisNumber(address)
            ));
            return Ok(());
        }
        drop(session);
        match (written, drive.open_with(&connector, &new)) {
            (_, Ok(session)) => {
                let axis = &session.axes()[0];
                let found = read_parameter(axis, id)?;
                out.write_line(&format!("{name} = {found}"));
                if found.raw != raw {
                    let what = format!("{name:?} did not keep what was written.");
                    return Err(Problem::new(Exit::Negative, "E111", what));
                }
                let now = match what {
                    AddressRole::Drive | AddressRole::DriveAfterRestart => {
                        format!("{label} is {} from now on", axis.label())
                    }
                    AddressRole::Host => format!("{label} answers host {raw} from now on"),
                };
                match old.target {
                    LinkTarget::Rack { .. } => print_note(&format!("{now}: change its rack file")),
                    _ => print_note(&format!("{now}: {new}")),
                }
                Ok(())
            }
            (Ok(()), Err(_)) => {
                let what = format!(
                    "{label} accepted {name} = {raw}, but does not reply at the \
                 new address."
                );
                Err(Problem::new(Exit::NoReply, "E401", what)
                    .hint(format!("polepair info {}", shell_word(&new.to_string())))
                    .hint(format!(
                        "`polepair info {}`, if it was not executed",
                        shell_word(&old.to_string())
                    )))
            }
            (Err(error), Err(_)) => {
                Err(outcome::to_problem(error).hint(format!("if it was executed it is at {new}")))
            }
        }
    }
}

/// Refuses an address at which a drive answers.
fn check_free(connector: &Connector, url: &str, address: u32) -> Result<()> {
    match connector.connect_local(url) {
        Err(error) if error.exit() == Exit::NoReply => Ok(()),
        Err(error) => {
            Err(outcome::to_problem(error)
                .hint("the new address must be free: nothing was written"))
        }
        Ok(_) => {
            let what = format!("A drive already has address {address}.");
            Err(Problem::usage("E222", what)
                .why("Two drives with one address disturb each other; nothing was written.")
                .hint(format!("polepair info {}", shell_word(url))))
        }
    }
}
