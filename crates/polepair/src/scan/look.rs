//! A search that goes on address by address: on lines of its own, or between what an open link does.

use super::{Numbers, Progress, Scan, candidates, leave_alone, tell_clashes};
use crate::axis::Axis;
use crate::bus::{self, Seat};
use crate::connect::{Connector, Kept, Lent, Line, Link};
use crate::error::Error;
use crate::heard::Heard;
use crate::identify::{Probe, Prober, answered};
use crate::scan::Found;
use crate::url::Number;
use polepair_core::profile::{Access, ParameterId};
use polepair_link::{Connection, LinkError};
use std::collections::VecDeque;

/// A look for drives, one address after the other. Only reads are sent.
///
/// On an open link its axes are told apart from what is new: they are asked as always, and only
/// whether they answer. Before each other address the link is waited for until nothing else is under
/// way, and between two addresses whatever else was said meanwhile goes first. So what waits, waits
/// for one address at most; and where `broken` says that somebody cannot wait, for one question.
///
/// ```
/// # if polepair_core::drives::profiles().iter().any(|p| p.protocol == "tmcl") {
/// use polepair::scan::Look;
/// let connector = polepair::Connector::default();
/// let link = connector.connect("sim:tmcl?axes=3&time=virtual#1")?;
/// let mut look = Look::on(&connector, &link, 0, 1..=5)?;
/// while look.next(&|| false)?.is_some() {
///     look.ask(&|| false)?;
/// }
/// let scan = look.finish();
/// assert!(scan.axes[0].answers);
/// let link = link.take_in(0, &scan.found)?;
/// assert_eq!(link.axes().iter().map(|axis| axis.number()).collect::<Vec<_>>(), [1, 3, 4]);
/// # }
/// # Ok::<(), polepair::Error>(())
/// ```
#[derive(Debug)]
pub struct Look {
    connector: Connector,
    /// What is asked one after the other.
    asked: Vec<Asked>,
    numbers: Numbers,
    /// The addresses that a connection string names.
    axes: Vec<u32>,
    known: Vec<Known>,
    /// Whose turn it is, and whether it began.
    at: usize,
    begun: bool,
    queue: VecDeque<u32>,
    done: usize,
    damaged: Vec<u32>,
    /// What came from addresses where nobody answered, of the present protocol.
    heard: Heard,
    /// Of each that was found.
    seats: Vec<(usize, Seat)>,
    scan: Scan,
}

/// One protocol on one wire.
enum Asked {
    /// On a line that is this look's alone.
    Own(Box<Line>),
    /// On a link that somebody has open.
    Open(Box<Kept>, Connection),
}

/// An axis that is there already.
#[derive(Debug)]
struct Known {
    place: usize,
    axis: Axis,
    seat: (usize, Seat),
}

/// Whether an axis that the link has answered.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Answers {
    /// Its place in [`Link::axes`].
    pub place: usize,
    /// Its address.
    pub number: u32,
    /// Whether it said anything.
    pub answers: bool,
    /// Set when more came back than was asked for: another drive may have its address.
    pub clash: Option<String>,
}

impl std::fmt::Debug for Asked {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Own(line) => line.spoken.name,
            Self::Open(kept, _) => kept.spoken.name,
        })
    }
}

impl Asked {
    fn name(&self) -> &'static str {
        match self {
            Self::Own(line) => line.spoken.name,
            Self::Open(kept, _) => kept.spoken.name,
        }
    }

    /// The line, and what keeps others from it meanwhile.
    fn line(&self) -> Result<(Line, Option<Lent>), Error> {
        match self {
            Self::Own(line) => Ok((Line::clone(line), None)),
            Self::Open(kept, connection) => {
                let lent = Lent::of(connection, kept.spoken.medium)?;
                Ok((kept.on(lent.link()), Some(lent)))
            }
        }
    }
}

impl Look {
    /// On lines that were opened for it; of their addresses those in `axes`, unless there are none.
    pub(super) fn own(
        connector: &Connector,
        lines: Vec<Line>,
        axes: Vec<u32>,
        numbers: Numbers,
    ) -> Self {
        let asked = lines.into_iter().map(|line| Asked::Own(Box::new(line))).collect();
        Self::new(connector, asked, axes, numbers)
    }

    /// On one wire of an open link, for every protocol that is spoken there. Without `numbers` every
    /// address is asked, whichever the link was opened with.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212` for a wire that there is not.
    pub fn on(
        connector: &Connector,
        link: &Link,
        wire: usize,
        numbers: impl Into<Numbers>,
    ) -> Result<Self, Error> {
        let mut kept = link.kept_on(wire)?.to_vec();
        bus::guests_last(&mut kept, |kept| &kept.spoken);
        let axes = link.axes_on(wire);
        let known = axes.iter().filter(|(_, axis)| !Number(axis.number()).is_group());
        let known = known.filter_map(|(place, axis)| {
            let spoken = &kept.iter().find(|kept| kept.spoken.name == axis.protocol())?.spoken;
            let seat = Seat { spoken: spoken.clone(), address: axis.number() };
            Some(Known { place: *place, axis: Axis::clone(axis), seat: (0, seat) })
        });
        let known = known.collect();
        let connection = axes.first().map(|(_, axis)| axis.connection().clone());
        let connection = connection.ok_or_else(|| Error::usage("E212", "no axis is there", ""))?;
        let asked =
            kept.into_iter().map(|kept| Asked::Open(Box::new(kept.alone()), connection.clone()));
        let look = Self::new(connector, asked.collect(), Vec::new(), numbers.into());
        Ok(Self { known, ..look })
    }

    fn new(connector: &Connector, asked: Vec<Asked>, axes: Vec<u32>, numbers: Numbers) -> Self {
        Self {
            connector: connector.clone(),
            asked,
            numbers,
            axes,
            known: Vec::new(),
            at: 0,
            begun: false,
            queue: VecDeque::new(),
            done: 0,
            damaged: Vec::new(),
            heard: Heard::default(),
            seats: Vec::new(),
            scan: Scan::default(),
        }
    }

    /// The address that [`ask`](Self::ask) asks next; `None` when all were. On a CAN bus this may
    /// first listen who is there, until `broken` says otherwise.
    ///
    /// # Errors
    /// [`Error::Link`] when the link is lost, [`Error::Usage`] `E220` when others do not let it be
    /// for so much as an instant.
    pub fn next(&mut self, broken: &dyn Fn() -> bool) -> Result<Option<Progress>, Error> {
        loop {
            if let Some(&number) = self.queue.front() {
                let (done, of) = (self.done, self.done + self.queue.len());
                return Ok(Some(Progress { number, done, of }));
            }
            if std::mem::take(&mut self.begun) {
                self.tell_damaged();
                self.at += 1;
            }
            if self.at >= self.asked.len() {
                return Ok(None);
            }
            self.begin(broken)?;
        }
    }

    /// Finds out whom there is to ask of the next protocol.
    fn begin(&mut self, broken: &dyn Fn() -> bool) -> Result<(), Error> {
        let (line, lent) = self.asked[self.at].line()?;
        let numbers = self.numbers.of(&line, &self.axes);
        let every = self.numbers.0.is_none() && self.axes.is_empty();
        let known = self.known.iter().map(|known| &known.seat);
        let own: Vec<u32> = known
            .clone()
            .filter(|(_, seat)| seat.spoken.name == line.spoken.name)
            .filter(|(_, seat)| every || numbers.contains(&seat.address))
            .map(|(_, seat)| seat.address)
            .collect();
        let seats: Vec<(usize, Seat)> = known.chain(&self.seats).cloned().collect();
        let tried = &mut self.scan.tried;
        let mut wanted = candidates(&line, numbers, every, tried, broken)?;
        // Who was not heard for a moment is asked all the same where it should be there.
        if !own.is_empty() {
            wanted.extend(own);
            wanted.sort_unstable();
            wanted.dedup();
        }
        leave_alone(&line, &seats, &mut wanted, tried);
        drop((line, lent));
        (self.queue, self.done, self.begun) = (wanted.into(), 0, true);
        Ok(())
    }

    /// Asks who is at the next address. Where `broken` says in between that somebody cannot wait, the
    /// look ends there.
    ///
    /// # Errors
    /// As [`next`](Self::next). That nobody answers is no error.
    pub fn ask(&mut self, broken: &dyn Fn() -> bool) -> Result<(), Error> {
        let Some(&number) = self.queue.front() else { return Ok(()) };
        let name = self.asked[self.at].name();
        let its = |known: &&Known| known.axis.number() == number && known.axis.protocol() == name;
        match self.known.iter().find(its) {
            Some(known) => self.scan.axes.extend(known.ask()),
            None => self.probe(number, broken)?,
        }
        if self.queue.pop_front().is_some() {
            self.done += 1;
        }
        Ok(())
    }

    fn probe(&mut self, number: u32, broken: &dyn Fn() -> bool) -> Result<(), Error> {
        let asked = &self.asked[self.at];
        let (line, lent) = asked.line()?;
        let prober = Prober::new(&line, &self.connector.config).looking().until(broken);
        let probe = prober.probe(number)?;
        drop(lent);
        if let Asked::Open(_, connection) = asked
            && let Some(trouble) = connection.trouble()
        {
            return Err(trouble.into());
        }
        match probe {
            Probe::Silent(_) if broken() => self.break_off(),
            Probe::Silent(heard) => self.unanswered(heard),
            Probe::Damaged(_) => self.damaged.push(number),
            Probe::Forbidden(hint) => {
                self.scan.tried.push(format!("not address {number}: {hint}"));
            }
            Probe::Found { profile, identified, stray, .. } => {
                let found = Found::named(&line, number, profile);
                self.scan.found.push(Found { identified, clash: too_many(stray), ..found });
                self.seats.push((line.wire, line.seat(number)));
            }
        }
        Ok(())
    }

    /// Notes what came where nobody answered.
    fn unanswered(&mut self, heard: Heard) {
        self.heard = self.heard.plus(heard.of_others());
    }

    fn tell_damaged(&mut self) {
        let heard = std::mem::take(&mut self.heard);
        if !heard.is_nothing() {
            let hint = heard.hint();
            self.scan.heard = self.scan.heard.plus(heard);
            self.scan.tried.push(format!(
                "addresses that did not answer, though something came ({heard}): {hint}"
            ));
        }
        let damaged = std::mem::take(&mut self.damaged);
        if let (Some(first), Some(last)) = (damaged.first(), damaged.last()) {
            self.scan.tried.push(format!(
                "{} addresses from {first} to {last} where only damaged answers came: two drives \
                 with one address, noise, or another baud rate?",
                damaged.len()
            ));
        }
    }

    /// Ends it here: what was found is kept.
    pub fn break_off(&mut self) {
        self.scan.unasked = self.queue.len();
        self.queue.clear();
        self.asked.truncate(self.at + usize::from(self.begun));
    }

    /// Ends it because the link is lost: what was found is kept, the others are told as not asked. The
    /// address at which it was lost is one of them.
    pub(super) fn lose(&mut self, error: LinkError) {
        let left = |asked: &Asked| {
            let line = asked.line().ok()?.0;
            Some(self.numbers.of(&line, &self.axes).len())
        };
        let rest = self.asked.iter().skip(self.at + usize::from(self.begun)).filter_map(left);
        let rest: usize = rest.sum();
        self.break_off();
        self.scan.unasked += rest;
        self.scan.lost = Some(error);
    }

    /// What was tried and found.
    #[must_use]
    pub fn finish(mut self) -> Scan {
        if self.begun {
            self.tell_damaged();
        }
        let known: Vec<_> = self.known.iter().map(|known| known.seat.clone()).collect();
        tell_clashes(&self.seats, &known, &mut self.scan.found);
        self.scan
    }
}

impl Known {
    /// Asks the axis for something as always. `None` where it has nothing that can be asked for.
    fn ask(&self) -> Option<Answers> {
        let profile = self.axis.profile();
        let readable = |id: &ParameterId| {
            profile.parameter(*id).is_some_and(|parameter| parameter.access != Access::Write)
        };
        let told = profile.signals.iter().map(|source| source.parameter);
        let all = (0..).map(ParameterId).take(profile.parameters.len());
        let id = told.chain(all).find(readable)?;
        let counters = || self.axis.connection().with(|axes, _| axes.counters());
        let before = counters();
        let answers = match self.axis.read(id) {
            Ok(_) => true,
            Err(Error::Failed { outcome, .. }) => answered(outcome),
            Err(_) => false,
        };
        let clash = too_many(counters().since(before).unaccounted());
        let clash = clash.filter(|_| answers);
        Some(Answers { place: self.place, number: self.axis.number(), answers, clash })
    }
}

fn too_many(stray: u64) -> Option<String> {
    (stray > 0)
        .then(|| format!("{stray} answers too many or damaged: two drives with this address?"))
}
