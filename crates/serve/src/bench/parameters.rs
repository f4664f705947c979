//! Parameters: told without values, read, and written by a plan that was shown. Nothing here moves a
//! motor: parameters that could are left to commands.

use std::collections::BTreeMap;
use std::sync::Arc;

use polepair::axis::Pending;
use polepair::{Amount, Axis};
use polepair_core::profile::{Access, Parameter, ParameterId};
use serde_json::json;
use tokio::sync::oneshot;

use super::describe::parameter_info;
use super::desk::Desk;
use super::lease::Session;
use super::reply::Reply;
use super::shared::Shared;
use super::wire::{Go, Order, Tell, Wire};
use super::{Bench, Link};
use crate::message::{Change, Deed, Given, ParameterInfo, ParameterRead, Refused, WriteParameters};

/// Parameters of one request.
const WRITES_MAX: usize = 1024;

/// A parameter that is to have a value.
struct Wanted {
    id: ParameterId,
    parameter: &'static Parameter,
    raw: i64,
}

impl Bench {
    /// The parameters of an axis, without their values; nothing is asked.
    ///
    /// # Errors
    /// `E212` where there is no such axis.
    pub fn parameters(&self, axis: u16) -> Result<Vec<ParameterInfo>, Refused> {
        let (link, place) = self.seat(axis)?;
        let axis = &link.wire.axes[place].1;
        let all = (0..).map(ParameterId).zip(axis.params());
        Ok(all.map(|(id, parameter)| parameter_info(axis, id, parameter)).collect())
    }

    /// Reads a parameter now.
    pub fn read_parameter(&self, axis: u16, name: &str) -> Reply<ParameterRead> {
        let (tell, told) = oneshot::channel();
        let asked = self.seat(axis).map(|(link, place)| {
            let (axis, name) = (link.wire.axes[place].1.clone(), name.to_owned());
            link.desk.ask(tell, move || read(&axis, &name));
        });
        Reply::of(told, asked)
    }

    /// Tells what parameters have and would get and, unless that is all that is asked, writes those that
    /// differ: every name and value is checked before the first is written. A dry run needs no lease.
    pub fn apply(
        &self,
        axis: u16,
        session: &Session,
        write: WriteParameters,
    ) -> Reply<Vec<Change>> {
        let (tell, told) = oneshot::channel();
        let asked = self.seat(axis).and_then(|(link, place)| {
            if write.values.len() > WRITES_MAX {
                let what = format!("at most {WRITES_MAX} parameters are written at once");
                return Err(Refused::new("gateway.request", what));
            }
            let (epoch, dry) = (write.epoch, write.dry_run);
            let writer = Writer::new(self, link, place, axis, session, write);
            let desk = Arc::clone(&link.desk);
            if dry {
                desk.ask(tell, move || writer.plan().map(|plan| plan.0));
                return Ok(());
            }
            let go = Box::new(move |may| writer.write(desk, may, tell));
            let session = session.clone();
            link.wire.order(Order::Write { axis: place, session, epoch, go })
        });
        Reply::of(told, asked)
    }
}

fn read(axis: &Axis, name: &str) -> Result<ParameterRead, Refused> {
    let id = axis.find(name)?;
    let raw = axis.read(id)?;
    let value = axis.value(id, raw)?;
    Ok(ParameterRead {
        name: axis.profile().parameter(id).map_or(name, |parameter| parameter.name).to_owned(),
        value: Some(value.value).filter(|value| value.is_finite()),
        raw,
        unit: value.unit.symbol().to_owned(),
        word: value.word.map(str::to_owned),
        text: value.to_string(),
    })
}

/// A raw value: no drive has one that a `f64` cannot hold.
fn whole(number: f64) -> Result<i64, Refused> {
    let is_whole = number.fract() == 0.0 && number.abs() <= 9e15;
    let wrong = || Refused::new("E217", format!("{number} is no whole number"));
    is_whole.then_some(number as i64).ok_or_else(wrong)
}

/// What writes the parameters of one request.
struct Writer {
    axis: Axis,
    id: u16,
    place: usize,
    session: Session,
    epoch: u64,
    values: BTreeMap<String, Given>,
    keep: bool,
    /// Numbers are as they lie in the drive.
    raw: bool,
    wire: Arc<Wire>,
    shared: Arc<Shared>,
}

impl Writer {
    fn new(
        bench: &Bench,
        link: &Link,
        place: usize,
        id: u16,
        session: &Session,
        write: WriteParameters,
    ) -> Self {
        let WriteParameters { values, keep, raw, epoch, .. } = write;
        let (wire, shared) = (link.wire.clone(), bench.0.shared.clone());
        let (axis, session) = (link.wire.axes[place].1.clone(), session.clone());
        Self { axis, id, place, session, epoch, values, keep, raw, wire, shared }
    }

    /// What would change, and the writes that make it so.
    fn plan(&self) -> Result<(Vec<Change>, Vec<Wanted>), Refused> {
        // What scales others goes first, and they are what they mean by it.
        let named =
            self.values.iter().map(|(name, given)| Ok((self.axis.find(name)?, name, given)));
        let mut named = named.collect::<Result<Vec<_>, Refused>>()?;
        named.sort_by_key(|(id, ..)| !self.axis.scales(*id));
        let (mut all, mut pending) = (Vec::new(), Pending::default());
        for (id, name, given) in named {
            let wanted = self.wanted((id, name), given, &pending)?;
            pending.add(id, wanted.raw);
            all.push(wanted);
        }
        let (mut changes, mut writes) = (Vec::new(), Vec::new());
        for wanted in all {
            let change = self.change(&wanted, &pending)?;
            if change.changed || self.keep {
                writes.push(wanted);
            }
            changes.push(change);
        }
        Ok((changes, writes))
    }

    fn wanted(
        &self,
        (id, name): (ParameterId, &str),
        given: &Given,
        pending: &Pending,
    ) -> Result<Wanted, Refused> {
        let meant = |amount: &Amount| self.axis.raw_of_after(id, amount, pending);
        let missing = || Refused::new("E213", format!("there is no parameter `{name}`"));
        let parameter = self.axis.profile().parameter(id).ok_or_else(missing)?;
        if parameter.moves {
            let what = format!("`{}` may move the motor", parameter.name);
            return Err(Refused::new("E219", what).hint("that is for commands, not for settings"));
        }
        if parameter.access == Access::Read {
            return Err(Refused::new("E214", format!("`{}` can only be read", parameter.name)));
        }
        let raw = match given {
            Given::Number(number) if self.raw => whole(*number)?,
            Given::Number(number) => meant(&Amount::Number(*number))?,
            Given::Text(text) => meant(&Amount::Text(text.clone()))?,
        };
        if !(parameter.min..=parameter.max).contains(&raw) {
            let (min, max) =
                (self.axis.value(id, parameter.min)?, self.axis.value(id, parameter.max)?);
            let what = format!("`{}` takes {min} to {max}", parameter.name);
            return Err(Refused::new("E216", what).hint("nothing was written"));
        }
        Ok(Wanted { id, parameter, raw })
    }

    fn change(&self, wanted: &Wanted, pending: &Pending) -> Result<Change, Refused> {
        let readable = wanted.parameter.access != Access::Write;
        let now = readable.then(|| self.axis.read(wanted.id)).transpose()?;
        let to = self.axis.value_after(wanted.id, wanted.raw, pending)?;
        let from = now.map(|raw| self.axis.value(wanted.id, raw)).transpose()?;
        Ok(Change {
            name: wanted.parameter.name.to_owned(),
            from: from.map(|from| from.value).filter(|from| from.is_finite()),
            to: to.value,
            unit: to.unit.symbol().to_owned(),
            changed: now != Some(wanted.raw),
        })
    }

    /// Plans at the desk, announces the plan, and writes there what it says.
    fn write(self, desk: Arc<Desk>, may: Result<(), Refused>, tell: Tell<Vec<Change>>) {
        // Who has gone does not want to know, here and below.
        if let Err(refused) = may {
            return drop(tell.send(Err(refused)));
        }
        let again = Arc::clone(&desk);
        desk.leave(Box::new(move |may| {
            let (changes, writes) = match may.and_then(|()| self.plan()) {
                Ok(plan) => plan,
                Err(refused) => return drop(tell.send(Err(refused))),
            };
            let detail = json!({ "keep": self.keep, "changes": changes });
            let (session, shared) = (self.session.clone(), Arc::clone(&self.shared));
            let what = (&session, Deed::Parameters, Some(self.id));
            let then: Go = Box::new(move |kept| match kept {
                Ok(()) => again.ask(tell, move || self.carry_out(&writes).map(|()| changes)),
                Err(refused) => drop(tell.send(Err(refused))),
            });
            shared.notes.announce(what, detail, shared.now(), then);
        }));
    }

    fn carry_out(&self, writes: &[Wanted]) -> Result<(), Refused> {
        let written = writes.iter().try_for_each(|wanted| {
            still_holds(&self.wire, self.place, self.epoch, &self.session)?;
            self.axis.write(wanted.id, wanted.raw, self.keep)?;
            // The others were converted by it.
            let scales = self.axis.scales(wanted.id) && wanted.parameter.access != Access::Write;
            if scales && self.axis.read(wanted.id)? != wanted.raw {
                let what = format!("the drive did not keep `{}`", wanted.parameter.name);
                return Err(Refused::new("E111", what).hint(
                    "others are scaled by it: see what was written, and write the rest again",
                ));
            }
            Ok(())
        });
        let detail = json!({ "error": written.as_ref().err() });
        self.shared.noted(&self.session, Deed::Outcome, Some(self.id), detail);
        written
    }
}

/// A lease that ended meanwhile ends the writing as well.
pub(super) fn still_holds(
    wire: &Wire,
    place: usize,
    epoch: u64,
    session: &Session,
) -> Result<(), Refused> {
    let lease = wire.lease(place);
    let its = lease.is_some_and(|lease| lease.epoch == epoch && *lease.owner == **session);
    let ended = || Refused::new("gateway.lease", "the lease ended while this was written");
    if its { Ok(()) } else { Err(ended().hint("see what was written, and write the rest again")) }
}
