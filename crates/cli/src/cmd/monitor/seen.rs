//! What the screen shows, whoever knows it: a link of one's own, or a server.

use std::time::Duration;

use polepair::axis::{Class, Stopping};
use polepair::url::shell_word;
use polepair_core::profile::Signal;

use super::axes::{Doing, Shown, Watched};
use super::model::Monitor;
use super::plain::{trouble_counts, troubles};
use super::traffic::Traffic;
use crate::problem::Result;

/// What is watched, and what can be done to it.
pub trait Shows {
    /// How the user named it.
    fn url(&self) -> &str;
    /// How long it has been watched.
    fn age(&self) -> Duration;
    /// When it was begun, in nanoseconds since 1970, as frames have it.
    fn began(&self) -> u64;
    /// The frames that pass.
    fn traffic(&self) -> &Traffic;
    /// The same, to forget them.
    fn traffic_mut(&mut self) -> &mut Traffic;
    /// How many axes there are.
    fn count(&self) -> usize;
    /// One of them.
    fn axis(&self, n: usize) -> Seen;
    /// Which one is chosen.
    fn chosen(&self) -> usize;
    /// Chooses one.
    fn choose(&mut self, n: usize);
    /// It only listens: nothing can be stopped from here.
    fn is_mute(&self) -> bool;
    /// Why nothing comes, in a line.
    fn trouble(&self) -> Option<String>;
    /// Why nothing may move, in a line.
    fn lock(&self) -> Option<String>;
    /// Links that are not open, and what is missing of them, a line each.
    fn wanting(&self) -> Vec<String>;
    /// What was not as it should be with the frames, by its word.
    fn flaws(&self) -> Vec<(u64, &'static str)>;
    /// The same where all was.
    fn fine(&self) -> &'static str;
    /// Takes what came; waits for nothing.
    ///
    /// # Errors
    /// When it is gone and does not come back.
    fn look(&mut self) -> Result<()>;
    /// Stops every axis.
    fn stop(&mut self);
    /// Why the stop could not be said, in a line.
    fn unsaid(&self) -> Option<String>;
    /// What a person who leaves must know.
    fn farewell(&mut self) -> Vec<String>;
}

/// An axis.
pub struct Seen {
    /// Short, for the table.
    pub name: String,
    /// What people call it.
    pub label: String,
    /// The drive's word, and its full name.
    pub drive: [String; 2],
    /// What it does.
    pub doing: Doing,
    /// How far its stop came, since somebody asked for one.
    pub stop: Option<Stop>,
    /// Its mode of operation.
    pub mode: Option<Value>,
    pub position: Option<Value>,
    pub velocity: Option<Value>,
    /// Its torque, or the current that stands for it.
    pub effort: Option<Value>,
    /// The age of the oldest value of the table.
    pub age: Option<Duration>,
    /// What is wrong, a line each, and whether it stopped the drive.
    pub troubles: Vec<(String, bool)>,
    /// What else there is to say of it when it is chosen, by a word or without.
    pub facts: Vec<(&'static str, Value)>,
}

/// A value as it is written.
#[derive(Clone, Debug)]
pub struct Value {
    pub text: String,
    pub age: Duration,
}

/// How far a stop came.
pub struct Stop {
    pub class: Came,
    /// After how long.
    pub took: Duration,
}

/// What is certain of a stop.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Came {
    Sent,
    Acknowledged,
    Still,
    /// The drive answered all of it, and tells nothing by which it could be seen to stand.
    Unseen,
    Failed(String),
}

impl Came {
    /// Whether it is an alarm.
    pub const fn failed(&self) -> bool {
        matches!(self, Self::Failed(_))
    }
}

impl Shows for Monitor {
    fn wanting(&self) -> Vec<String> {
        Vec::new()
    }

    fn url(&self) -> &str {
        &self.url
    }

    fn age(&self) -> Duration {
        self.age()
    }

    fn began(&self) -> u64 {
        self.began()
    }

    fn traffic(&self) -> &Traffic {
        &self.traffic
    }

    fn traffic_mut(&mut self) -> &mut Traffic {
        &mut self.traffic
    }

    fn count(&self) -> usize {
        self.axes.len()
    }

    fn axis(&self, n: usize) -> Seen {
        seen(&self.axes[n], n == self.chosen)
    }

    fn chosen(&self) -> usize {
        self.chosen
    }

    fn choose(&mut self, n: usize) {
        self.chosen = n;
    }

    fn is_mute(&self) -> bool {
        self.is_listening()
    }

    fn trouble(&self) -> Option<String> {
        let (since, error) = self.trouble()?;
        Some(format!("LINK DOWN for {} s: {error}. Trying to open it again.", since.as_secs()))
    }

    fn lock(&self) -> Option<String> {
        None
    }

    fn flaws(&self) -> Vec<(u64, &'static str)> {
        trouble_counts(self, self.traffic.counts().1).into()
    }

    fn fine(&self) -> &'static str {
        "none lost, late, foreign, corrupt or unanswered"
    }

    fn look(&mut self) -> Result<()> {
        self.look(&mut |_| ()).map(drop)
    }

    fn stop(&mut self) {
        self.stop();
    }

    fn unsaid(&self) -> Option<String> {
        let link = shell_word(self.url.split('#').next().unwrap_or_default());
        let told = format!("NOT STOPPED: this view only listens; polepair stop {link}");
        self.is_listening().then_some(told)
    }

    fn farewell(&mut self) -> Vec<String> {
        self.farewell()
    }
}

fn seen(watched: &Watched, chosen: bool) -> Seen {
    let profile = watched.axis.profile();
    let value = |signal| watched.shown(signal).map(|shown| written(&shown));
    let details = [
        ("target", Signal::TargetPosition),
        ("target", Signal::TargetVelocity),
        ("supply", Signal::Voltage),
        ("", Signal::Temperature),
    ];
    let facts = details.into_iter().filter(|_| chosen);
    Seen {
        name: watched.name(),
        label: watched.axis.label(),
        drive: [profile.name.to_owned(), profile.title.to_owned()],
        doing: watched.doing(),
        stop: watched.stopping.as_ref().map(came),
        mode: value(Signal::Mode),
        position: value(Signal::Position),
        velocity: value(Signal::Velocity),
        effort: watched.effort().map(|shown| written(&shown)),
        age: watched.age(),
        troubles: if chosen { troubles(watched) } else { Vec::new() },
        facts: facts.filter_map(|(word, signal)| Some((word, value(signal)?))).collect(),
    }
}

fn came(stopping: &Stopping) -> Stop {
    let class = match stopping.class() {
        Class::Sent => Came::Sent,
        Class::Acknowledged => Came::Acknowledged,
        Class::Still => Came::Still,
        Class::Unseen => Came::Unseen,
        Class::Failed(why) => Came::Failed(why.to_string()),
    };
    Stop { class, took: stopping.took() }
}

fn written(shown: &Shown) -> Value {
    let text = match shown.word {
        Some(word) => word.to_owned(),
        None => steady(shown.value, shown.unit),
    };
    Value { text, age: shown.age }
}

/// A value with as many decimals whatever it is, so that the eye finds it in its place.
pub fn steady(value: f64, unit: &str) -> String {
    match unit {
        "" => crate::value::number(value),
        "A" | "V" => format!("{value:.2} {unit}"),
        _ => format!("{value:.1} {unit}"),
    }
}
