//! A running server as the screen shows it. It tells by itself: nothing is asked of a drive, and only
//! Esc sends anything.

use std::time::Duration;

use polepair_client::message::{
    AxisInfo, AxisState, AxisStopped, FrameDirection, FrameItem, StopClass, StopOrder, StopOwed,
    Stopped,
};
use polepair_client::{Frames, Gateway, Live, Pending, Refused};
use polepair_core::explain::Direction;
use polepair_core::profile::Signal;
use polepair_core::proto;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::axes::Doing;
use super::seen::{Came, Seen, Shows, Stop, Value, steady};
use super::served::{doing, left, number, troubles, who};
use super::traffic::{Row, Traffic};
use crate::joined::{self, Joined};
use crate::problem::Result;

/// How long it is told that the server is gone before the screen ends.
const LOST_MAX: Duration = Duration::from_secs(10);
/// How long a stop that has succeeded is told of.
const TOLD_MAX: Duration = Duration::from_secs(10);
/// A stop that was said less long ago is under way; one that is owed for longer is an alarm.
const FRESH: Duration = Duration::from_secs(1);
/// How long leaving waits for a stop that is under way.
const STOP_MAX: Duration = Duration::from_secs(2);

/// A server that is watched.
pub struct Remote {
    gateway: Gateway,
    live: Live,
    frames: Frames,
    axes: Vec<AxisInfo>,
    /// As it told them last: they stay to be seen when it is gone.
    states: Vec<Option<(AxisState, Instant)>>,
    traffic: Traffic,
    /// The links, as frames name them.
    links: Vec<u16>,
    chosen: usize,
    /// Every axis of the server is meant: a stop then locks motion.
    all: bool,
    begun: Instant,
    /// The server's time of the first frame, and ours, in nanoseconds.
    first: Option<(f64, u64)>,
    lost: Option<(Instant, Refused)>,
    stop: Option<Asked>,
    flaws: u64,
}

/// A stop that was asked for here.
struct Asked {
    at: Instant,
    pending: Pending<Stopped>,
    /// Why it was not taken.
    refused: Option<Refused>,
}

impl Remote {
    pub fn new(server: &Joined, axes: Vec<AxisInfo>, all: bool) -> Result<Self> {
        let gateway = server.gateway.clone();
        let live = gateway.live().map_err(joined::refused)?;
        let frames = live.frames(None).map_err(joined::refused)?;
        crate::interrupt::listen(|| {});
        let links = &server.bench.links;
        Ok(Self {
            gateway,
            live,
            frames,
            states: vec![None; axes.len()],
            axes,
            traffic: Traffic::told_of(links.iter().map(|link| link.id.to_string()).collect()),
            links: links.iter().map(|link| link.id).collect(),
            chosen: 0,
            all,
            begun: clock::now(),
            first: None,
            lost: None,
            stop: None,
            flaws: 0,
        })
    }

    fn hear(&mut self) -> std::result::Result<(), Refused> {
        let (items, lost) = self.frames.drain()?;
        self.traffic.lost = lost;
        if self.all {
            // Axes whose link was opened later, or that were taken in, join.
            let mut joined = self.live.axes_from(self.axes.len());
            if self.links.len() > 1 {
                joined.iter_mut().for_each(joined::label_with_link);
            }
            self.axes.extend(joined);
            self.states.resize(self.axes.len(), None);
        }
        for item in items {
            self.take(item);
        }
        for (n, axis) in self.axes.iter().enumerate() {
            if let Some(state) = self.live.state(axis.id)? {
                self.states[n] = Some((state, clock::now()));
            }
        }
        Ok(())
    }

    fn take(&mut self, item: FrameItem) {
        let ours = || clock::wall_ns(clock::now());
        let (theirs, ours) = *self.first.get_or_insert_with(|| (item.t_us, ours()));
        let since = ((item.t_us - theirs).max(0.0) * 1e3) as u64;
        self.flaws += u64::from(!item.ok);
        let wire = self.links.iter().position(|link| *link == item.link).unwrap_or(0);
        let (id, bytes) = parsed(&item.raw);
        let (text, wrong) = match item.text.rsplit_once(" ! ").filter(|_| !item.ok) {
            Some((text, wrong)) => (text.to_owned(), wrong.to_owned()),
            None => (item.text.clone(), String::new()),
        };
        // What is said alike but for its numbers is of one kind.
        let words = || text.split_whitespace().next().unwrap_or_default();
        let kind = match id {
            Some((id, extended)) => format!("{id:08X} {extended}"),
            None => format!("{:?} {:?} {}", item.dir, item.axis, words()),
        };
        let row = Row {
            number: 0,
            time: ours + since,
            wire,
            direction: item.dir.map(|direction| match direction {
                FrameDirection::Tx => Direction::ToDrive,
                FrameDirection::Rx => Direction::ToHost,
            }),
            protocol: proto::dissector(&item.protocol).map(|found| found.name()),
            id,
            bytes,
            changed: 0,
            text,
            wrong,
            haystack: String::new(),
        };
        self.traffic.told(row, &kind);
    }

    fn state(&self, n: usize) -> Option<AxisState> {
        let (mut state, at) = self.states[n].clone()?;
        let ms = clock::now().since(at).as_secs_f64() * 1e3;
        state.signals.iter_mut().for_each(|signal| signal.age_ms += ms);
        Some(state)
    }

    /// How far the stop came that was asked for here.
    fn stop_of(&self, axis: &AxisInfo) -> Option<Stop> {
        let asked = self.stop.as_ref()?;
        let now = clock::now();
        let heard = self.live.stopped(axis.id).filter(|(_, at)| *at >= asked.at);
        let Some((stopped, at)) = heard else {
            let took = now.since(asked.at);
            return asked.refused.is_none().then_some(Stop { class: Came::Sent, took });
        };
        let why = || match &stopped.error {
            Some(error) => error.message.clone(),
            None => "nobody answered".to_owned(),
        };
        let class = match stopped.class {
            StopClass::Standing => Came::Still,
            StopClass::Acknowledged => Came::Acknowledged,
            StopClass::Sent if stopped.error.is_none() => Came::Sent,
            StopClass::Sent | StopClass::Owed | StopClass::Failed => Came::Failed(why()),
        };
        let over = class == Came::Still && now.since(at) > TOLD_MAX;
        let took = Duration::from_secs_f64(stopped.ms.clamp(0.0, 1e9) / 1e3);
        (!over).then_some(Stop { class, took })
    }
}

impl Shows for Remote {
    fn url(&self) -> &str {
        self.gateway.url()
    }

    fn age(&self) -> Duration {
        clock::now().since(self.begun)
    }

    fn began(&self) -> u64 {
        clock::wall_ns(self.begun)
    }

    fn traffic(&self) -> &Traffic {
        &self.traffic
    }

    fn traffic_mut(&mut self) -> &mut Traffic {
        self.flaws = 0;
        &mut self.traffic
    }

    fn count(&self) -> usize {
        self.axes.len()
    }

    fn axis(&self, n: usize) -> Seen {
        let axis = &self.axes[n];
        let mut seen = Seen {
            name: who(axis),
            label: axis.label.clone(),
            drive: [axis.profile.clone(), axis.drive.clone()],
            doing: Doing::Unknown,
            stop: self.stop_of(axis),
            mode: None,
            position: None,
            velocity: None,
            effort: None,
            age: None,
            troubles: Vec::new(),
            facts: Vec::new(),
        };
        if let Some(state) = self.state(n) {
            tell(&state, &mut seen);
        }
        if let Some(state) = self.state(n).filter(|_| self.lost.is_none()) {
            seen.stop = shown_stop(seen.stop, state.owed.as_ref());
        }
        if let (None, Err(gone)) = (&self.lost, self.live.linked(axis.id)) {
            seen.doing = Doing::Silent;
            seen.troubles.insert(0, (gone.message, true));
        }
        seen
    }

    fn chosen(&self) -> usize {
        self.chosen
    }

    fn choose(&mut self, n: usize) {
        self.chosen = n;
    }

    fn is_mute(&self) -> bool {
        false
    }

    fn trouble(&self) -> Option<String> {
        let (since, why) = self.lost.as_ref()?;
        let seconds = clock::now().since(*since).as_secs();
        let why = &why.message;
        Some(format!("SERVER GONE for {seconds} s, nothing here is known any more: {why}"))
    }

    fn lock(&self) -> Option<String> {
        let lock = self.live.lock().filter(|_| self.lost.is_none())?;
        let why =
            if lock.reason.is_empty() { String::new() } else { format!(" ({})", lock.reason) };
        Some(format!("LOCKED: {} stopped everything{why}; the server's page releases it", lock.by))
    }

    fn wanting(&self) -> Vec<String> {
        let links = if self.lost.is_none() { self.live.links() } else { Vec::new() };
        links.iter().flat_map(joined::wanting).collect()
    }

    fn flaws(&self) -> Vec<(u64, &'static str)> {
        vec![(self.flaws, "wrong"), (self.traffic.lost, "lost")]
    }

    fn fine(&self) -> &'static str {
        "none wrong or lost"
    }

    fn look(&mut self) -> Result<()> {
        if let Some(asked) = &mut self.stop
            && asked.refused.is_none()
        {
            asked.refused = asked.pending.wait(Duration::ZERO).err();
        }
        let now = clock::now();
        if self.lost.is_none()
            && let Err(gone) = self.hear()
        {
            self.lost = Some((now, gone));
        }
        self.traffic.pace(now);
        match &self.lost {
            Some((since, why)) if now.since(*since) > LOST_MAX => Err(joined::refused(why.clone())),
            _ => Ok(()),
        }
    }

    fn stop(&mut self) {
        let ids = self.axes.iter().map(|axis| axis.id).collect();
        let axes = (!self.all).then_some(ids);
        let order = StopOrder { axes, reason: "polepair monitor".to_owned() };
        let pending = self.gateway.start(move |gateway| gateway.stop(&order));
        self.stop = Some(Asked { at: clock::now(), pending, refused: None });
    }

    fn unsaid(&self) -> Option<String> {
        let refused = self.stop.as_ref()?.refused.as_ref()?;
        Some(format!("STOP NOT CONFIRMED: {}; cut the power if it turns", refused.message))
    }

    fn farewell(&mut self) -> Vec<String> {
        let mut said = Vec::new();
        match self.stop.as_mut().map(|asked| asked.pending.wait(STOP_MAX)) {
            None => {}
            Some(Err(why)) => said.push(format!("the stop is not confirmed: {}", why.message)),
            Some(Ok(None)) => said.push(
                "the stop is not confirmed: the server does not answer; cut the power if it turns"
                    .into(),
            ),
            Some(Ok(Some(stopped))) => {
                let failed = |axis: &&AxisStopped| axis.error.is_some();
                said.extend(stopped.axes.iter().filter(failed).map(|axis| {
                    let why = axis.error.as_ref().map_or("", |error| &*error.message);
                    format!("axis {} may not have stopped: {why}", axis.id)
                }));
            }
        }
        // What came of it in the meantime.
        let _ = self.hear();
        let here = self.live.check().is_ok().then(|| self.url());
        for n in 0..self.axes.len() {
            let (axis, state) = (&self.axes[n], self.state(n));
            let told = state.and_then(|s| left(here, &axis.label, &number(axis), &s));
            said.extend(told);
        }
        said
    }
}

/// What is shown of the stop that was asked for here, and of the one that the axis is owed, whoever
/// said that: it is told for as long as it is owed.
fn shown_stop(own: Option<Stop>, owed: Option<&StopOwed>) -> Option<Stop> {
    match (own, owed) {
        (Some(own), Some(_)) if own.took < FRESH && !own.class.failed() => Some(own),
        (_, Some(owed)) => Some(owed_stop(owed)),
        (Some(own), None) if own.class.failed() => None,
        (own, None) => own,
    }
}

/// A stop that is owed.
fn owed_stop(owed: &StopOwed) -> Stop {
    let since_ms = clock::wall_ns(clock::now()) as f64 / 1e6 - owed.since_ms;
    let why = match &owed.error {
        Some(error) => error.message.clone(),
        None => "it was not seen standing yet".to_owned(),
    };
    Stop { class: Came::Failed(why), took: ms(since_ms) }
}

fn tell(state: &AxisState, seen: &mut Seen) {
    let value = |signal: Signal| {
        let told = state.signals.iter().find(|told| told.signal == signal.name())?;
        Some(Value { text: steady(told.value?, &told.unit), age: ms(told.age_ms) })
    };
    let ages = || state.signals.iter().map(|signal| signal.age_ms);
    let newest = ms(ages().fold(f64::MAX, f64::min));
    seen.doing = doing(state);
    seen.mode = state.mode.clone().map(|text| Value { text, age: newest });
    seen.position = value(Signal::Position);
    seen.velocity = value(Signal::Velocity);
    seen.effort = value(Signal::Torque).or_else(|| value(Signal::Current));
    seen.age = ages().reduce(f64::max).map(ms);
    seen.troubles = troubles(state)
        .into_iter()
        .map(|line| {
            let stops = !line.starts_with(' ');
            (line, stops)
        })
        .collect();
    for (word, signal) in [
        ("target", Signal::TargetPosition),
        ("target", Signal::TargetVelocity),
        ("supply", Signal::Voltage),
        ("", Signal::Temperature),
    ] {
        seen.facts.extend(value(signal).map(|value| (word, value)));
    }
    if let Some(lease) = &state.lease {
        seen.facts.push(("commanded by", Value { text: lease.owner.clone(), age: newest }));
    }
}

fn ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms.clamp(0.0, 1e9) / 1e3)
}

/// `123#0102` or `0102` as identifier and bytes.
fn parsed(raw: &str) -> (Option<(u32, bool)>, Vec<u8>) {
    let (id, data) = match raw.split_once('#') {
        Some((id, data)) => (u32::from_str_radix(id, 16).ok().map(|n| (n, id.len() > 3)), data),
        None => (None, raw),
    };
    let byte = |at| u8::from_str_radix(data.get(at..at + 2)?, 16).ok();
    (id, (0..data.len()).step_by(2).map_while(byte).collect())
}

#[cfg(test)]
mod tests {
    use polepair_client::message::OwedWhy;

    use super::*;

    #[test]
    fn a_stop_is_an_alarm_for_exactly_as_long_as_it_is_owed() {
        let owed = StopOwed {
            since_ms: clock::wall_ns(clock::now()) as f64 / 1e6 - 5000.0,
            why: OwedWhy::LinkLost,
            by: "server".into(),
            class: StopClass::Failed,
            said: 0,
            error: None,
        };
        let own = |class, ms| Some(Stop { class, took: Duration::from_millis(ms) });
        let class = |own, owed| shown_stop(own, owed).map(|stop| stop.class);
        let alarm = |shown: Option<Came>| shown.is_some_and(|class| class.failed());
        assert!(alarm(class(None, Some(&owed))) && class(None, None).is_none());
        assert_eq!(class(own(Came::Sent, 100), Some(&owed)), Some(Came::Sent));
        assert!(alarm(class(own(Came::Sent, 3000), Some(&owed))));
        assert!(alarm(class(own(Came::Failed("silent".into()), 10), Some(&owed))));
        assert_eq!(class(own(Came::Failed("silent".into()), 10), None), None, "dismissed");
        assert_eq!(class(own(Came::Still, 3000), None), Some(Came::Still));
    }
}
