//! The drive's watchdog: its reaction to a silent host.

use super::LocalAxis;
use crate::amount::Amount;
use crate::error::Error;
use polepair_core::convert::saturating;
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::profile::{Access, ParameterId, Persistence, Signal, Watchdog};
use std::fmt;
use std::time::Duration;

/// New value of 6007h if it is 0 (nothing): quick stop (CiA 402-2).
const QUICK_STOP: i64 = 3;
/// Bits of a time in 1016h (CiA 301), behind which its node-ID lies.
const TIME_BITS: u32 = 16;

/// Periods of a heartbeat after which it has stayed out.
const HEARTBEAT_PERIODS: u32 = 3;

/// Present setting of a drive's own watchdog.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WatchdogState {
    /// The drive has none: it continues its last command.
    None,
    /// The drive has a watchdog that is off.
    Off,
    /// The drive stops after this time without a message of its host.
    On(Duration),
    /// The drive watches a heartbeat that is not this host's.
    OtherNode {
        /// Node-ID of the heartbeat.
        node: u8,
    },
    /// The drive reacts after this time without a life guarding request (CiA 301, 100Ch and 100Dh), which this host
    /// does not send.
    LifeGuarding(Duration),
    /// The drive notices a silence of this length, and does nothing then.
    NoReaction(Duration),
    /// The watchdog can be set, and the drive does not report its setting.
    Unknown,
}

impl WatchdogState {
    /// The time after which the drive stops, where that is known.
    #[must_use]
    pub const fn after(self) -> Option<Duration> {
        match self {
            Self::On(after) => Some(after),
            _ => None,
        }
    }
}

impl fmt::Display for WatchdogState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("none: the motor continues its last command"),
            Self::Off => f.write_str("off: the motor continues its last command"),
            Self::On(after) => {
                write!(f, "on, the drive stops after {} of silence", format_time(*after))
            }
            Self::OtherNode { node } => {
                write!(f, "on, but it watches node {node} and not this host")
            }
            Self::LifeGuarding(after) => {
                write!(
                    f,
                    "on, by life guarding: the drive reacts after {} without a guarding request of \
                     its master; this host sends none",
                    format_time(*after)
                )
            }
            Self::NoReaction(after) => {
                write!(
                    f,
                    "without effect: {} of silence are noticed, and no action follows",
                    format_time(*after)
                )
            }
            Self::Unknown => {
                f.write_str("unknown: it can be set, and the drive does not report the setting")
            }
        }
    }
}

/// A time for people.
fn format_time(time: Duration) -> String {
    match time.as_millis() {
        ms if ms % 1000 == 0 => format!("{} s", ms / 1000),
        ms => format!("{ms} ms"),
    }
}

impl LocalAxis {
    /// The parameter that [`set_watchdog`](Self::set_watchdog) writes, for requests of this axis'
    /// medium: a TMCL module has one for its serial lines and one for CAN. `None` where the drive has
    /// no watchdog that can be set.
    #[must_use]
    pub fn watchdog_parameter(&self) -> Option<ParameterId> {
        match self.profile.watchdog {
            Watchdog::Heartbeat { consumer, .. } => Some(consumer),
            watchdog => watchdog.time_parameter(self.medium),
        }
    }

    /// Reaction of the drive when its host falls silent, by its profile. Nothing is sent.
    #[must_use]
    pub fn watchdog_rule(&self) -> String {
        let name = |id| self.parameter(id).map_or("?", |parameter| parameter.name);
        match self.profile.watchdog {
            Watchdog::None => "none: the motor continues its last command".to_owned(),
            Watchdog::Fixed { after_ms } => {
                format!("the drive stops {after_ms} ms after its host falls silent")
            }
            Watchdog::Configurable { .. } => {
                let name = self.watchdog_parameter().map_or("?", name);
                format!(
                    "off while `{name}` is 0: the motor continues its last command; else the \
                     drive stops after that time without requests"
                )
            }
            Watchdog::LifeGuarding { objects: [period, factor], .. } => format!(
                "the drive reacts when its master does not guard it for `{}` times `{}`; this host \
                 does not guard it, and the motor continues its last command",
                name(period),
                name(factor)
            ),
            Watchdog::Heartbeat { consumer, reaction: None, .. } => format!(
                "the drive stops when the heartbeat in `{}` stays out; with 0 it goes on",
                name(consumer)
            ),
            Watchdog::Heartbeat { consumer, reaction: Some(reaction), .. } => format!(
                "the drive does what `{}` says when the heartbeat in `{}` stays out; with 0 in \
                 either it goes on",
                name(reaction),
                name(consumer)
            ),
        }
    }

    /// Setting of its watchdog in words, and the sender of the heartbeat that it watches if this connection sends none.
    /// Nothing is sent.
    #[must_use]
    pub fn describe_watchdog(&self, state: WatchdogState) -> String {
        match (state, self.host) {
            (WatchdogState::On(after), Some(host)) if self.needs_heartbeat() => format!(
                "on, for a host that sends its heartbeat: the drive watches node {host} and stops \
                 {} \
                 after the last one; without heartbeat= this connection sends none",
                format_time(after)
            ),
            _ => state.to_string(),
        }
    }

    /// Returns whether the drive watches heartbeats and this connection sends none.
    pub(crate) fn needs_heartbeat(&self) -> bool {
        matches!(self.profile.watchdog, Watchdog::Heartbeat { .. }) && self.heartbeat.is_none()
    }

    /// Period of the heartbeat that this connection sends.
    #[must_use]
    pub const fn heartbeat(&self) -> Option<Duration> {
        self.heartbeat
    }

    /// Caution before [`set_watchdog`](Self::set_watchdog) sets it, or switches it `off`: that the drive keeps it over
    /// power-off by itself, that the host has to send a heartbeat. Nothing is sent.
    #[must_use]
    pub fn watchdog_caution(&self, off: bool) -> Option<String> {
        if let Watchdog::Heartbeat { .. } = self.profile.watchdog {
            return (!off).then(|| {
                "it holds for connections that send a heartbeat: heartbeat=100".to_owned()
            });
        }
        let parameter = self.watchdog_parameter().and_then(|id| self.parameter(id))?;
        let stored = parameter.persistence == Persistence::Always;
        stored
            .then(|| format!("{:?} is kept in its permanent memory if it differs", parameter.name))
    }

    /// Present setting of the drive's own watchdog, by reads.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn watchdog(&self) -> Result<WatchdogState, Error> {
        match self.profile.watchdog {
            Watchdog::None => Ok(WatchdogState::None),
            Watchdog::Fixed { after_ms } => Ok(on_after(after_ms.into())),
            Watchdog::Configurable { .. } => {
                let Some(id) = self.watchdog_parameter() else { return Ok(WatchdogState::None) };
                if self.parameter(id).is_some_and(|p| p.access == Access::Write) {
                    return Ok(WatchdogState::Unknown);
                }
                let Some(raw) = self.read_optional(id)? else { return Ok(WatchdogState::None) };
                if raw == 0 {
                    return Ok(WatchdogState::Off);
                }
                let value = self.value(id, raw)?;
                let seconds = value.value * value.unit.si_factor();
                // A value that is no time is not one of zero.
                let after = Duration::try_from_secs_f64(seconds);
                Ok(after.map_or(WatchdogState::Unknown, WatchdogState::On))
            }
            Watchdog::LifeGuarding { objects, reaction } => {
                Ok(self.life_guarding(objects, reaction)?.unwrap_or(WatchdogState::Off))
            }
            Watchdog::Heartbeat { consumer, reaction, life_guarding } => {
                let heartbeat = self.heartbeat_watchdog(consumer, reaction)?;
                match (heartbeat, life_guarding) {
                    (WatchdogState::None | WatchdogState::Off, Some(objects)) => {
                        let guarding = self.life_guarding(objects, reaction)?;
                        Ok(guarding.unwrap_or(heartbeat))
                    }
                    _ => Ok(heartbeat),
                }
            }
        }
    }

    fn heartbeat_watchdog(
        &self,
        consumer: ParameterId,
        reaction: Option<ParameterId>,
    ) -> Result<WatchdogState, Error> {
        let Some(watched) = self.read_optional(consumer)? else {
            return Ok(WatchdogState::None);
        };
        let is_ignored = match reaction.map(|id| self.read_optional(id)).transpose()? {
            None => false,
            Some(None) => return Ok(WatchdogState::None),
            Some(Some(reaction)) => reaction == 0,
        };
        let ms = watched & ((1 << TIME_BITS) - 1);
        let node = (watched >> TIME_BITS & 0x7F) as u8;
        Ok(match (node, ms) {
            (0, _) | (_, 0) => WatchdogState::Off,
            // A heartbeat of another node is no sign of this program; the drive would turn on without it.
            (node, _) if self.host != Some(node.into()) => WatchdogState::OtherNode { node },
            (_, ms) if is_ignored => {
                WatchdogState::NoReaction(Duration::from_millis(ms.unsigned_abs()))
            }
            (_, ms) => on_after(ms),
        })
    }

    /// Setting of life guarding; `None` if the drive has none, or it is off.
    fn life_guarding(
        &self,
        objects: [ParameterId; 2],
        reaction: Option<ParameterId>,
    ) -> Result<Option<WatchdogState>, Error> {
        let [period, factor] = objects;
        let Some(ms) = self.read_optional(period)?.filter(|ms| *ms > 0) else { return Ok(None) };
        let Some(factor) = self.read_optional(factor)?.filter(|n| *n > 0) else { return Ok(None) };
        let after = Duration::from_millis(ms.saturating_mul(factor).unsigned_abs());
        // A drive without a selection of the reaction reacts in its own way.
        let selected = reaction.map(|id| self.read_optional(id)).transpose()?.flatten();
        Ok(Some(match selected {
            Some(0) => WatchdogState::NoReaction(after),
            _ => WatchdogState::LifeGuarding(after),
        }))
    }

    /// Sets the drive to stop by itself after this time without a message of its host; `None` switches it
    /// off. It is written if the drive has another value, and stored only if the drive always stores it,
    /// see [`Persistence`]. The write moves nothing, but a turning motor stops if the host is silent. A
    /// drive that monitors a heartbeat needs a connection with `heartbeat=`.
    ///
    /// # Errors
    /// [`Error::Unsupported`] `E218` for a drive without a watchdog; `E216` for an invalid time; others by
    /// source.
    pub fn set_watchdog(&self, after: Option<Duration>) -> Result<WatchdogState, Error> {
        const WHAT: &str = "setting its watchdog";
        if after.is_some_and(|after| after.is_zero()) {
            let what = format!("{}: {WHAT}: 0 s is not a time to wait for a host", self.label());
            return Err(Error::usage("E216", what, "`off` switches a watchdog off"));
        }
        match self.profile.watchdog {
            Watchdog::None | Watchdog::Fixed { .. } | Watchdog::LifeGuarding { .. } => {
                return Err(self.unsupported_error(WHAT, Unsupported::NoPlan));
            }
            Watchdog::Configurable { .. } => {
                let id = self.watchdog_parameter();
                let id = id.ok_or_else(|| self.unsupported_error(WHAT, Unsupported::NoPlan))?;
                let after = after.unwrap_or_default();
                let text = Amount::Text(format!("{} s", after.as_secs_f64()));
                let raw = self.raw_within_limits(id, &text)?;
                // What is more than nothing must not be rounded to never.
                let raw = if after.is_zero() { 0 } else { raw.max(1) };
                if self.parameter(id).is_some_and(|p| p.access == Access::Write) {
                    self.write(id, raw, false)?;
                    return Ok(if after.is_zero() {
                        WatchdogState::Off
                    } else {
                        WatchdogState::On(after)
                    });
                }
                self.write_if_different(id, raw)?;
            }
            Watchdog::Heartbeat { consumer, reaction, .. } => {
                let host = self.host.filter(|host| (1..=127).contains(host));
                let host = host.ok_or_else(|| self.unsupported_error(WHAT, Unsupported::NoPlan))?;
                let ms = after.unwrap_or_default().as_millis();
                let limit = (1_u32 << TIME_BITS) - 1;
                let ms = u32::try_from(ms).ok().filter(|ms| *ms <= limit).ok_or_else(|| {
                    let (parameter, min, max) = (consumer, 0, i64::from(limit));
                    let value = saturating(ms);
                    self.unsupported_error(
                        WHAT,
                        Unsupported::OutOfRange { parameter, value, min, max },
                    )
                })?;
                let ms = if after.is_some_and(|after| !after.is_zero()) { ms.max(1) } else { ms };
                // Before the first write: a drive that watches for less than a period stops at once.
                self.check_longer_than_heartbeat(ms)?;
                // The reaction goes first: a watch without one is none.
                if let Some(reaction) = reaction.filter(|_| ms > 0)
                    && self.read(reaction)? == 0
                {
                    self.write(reaction, QUICK_STOP, false)?;
                }
                let raw = if ms == 0 { 0 } else { i64::from(host << TIME_BITS | ms) };
                self.write_if_different(consumer, raw)?;
            }
        }
        self.watchdog()
    }

    /// Refuses to have the heartbeat watched for less time than lies between two of it: the drive would
    /// stop at once.
    fn check_longer_than_heartbeat(&self, ms: u32) -> Result<(), Error> {
        match self.heartbeat.map(|period| period.as_millis()) {
            Some(period) if ms > 0 && u128::from(ms) <= period => {
                let what = format!(
                    "{}: a watchdog of {ms} ms ends before the next heartbeat of this connection",
                    self.label()
                );
                let hint =
                    format!("more than {period} ms, better three times; or a shorter heartbeat=");
                Err(Error::usage("E216", what, hint))
            }
            _ => Ok(()),
        }
    }

    /// Sets a drive to monitor this host's heartbeat, if the connection sends one (`heartbeat=`) and the
    /// drive monitors no node: 1016h to this host and three periods, 6007h to quick stop if it is 0. Other
    /// settings are not changed. Written to working memory only; the motor stops if the host is silent.
    /// Returns the earlier and the new setting, or `None` if no heartbeat is sent or the drive monitors
    /// none.
    ///
    /// # Errors
    /// As [`set_watchdog`](Self::set_watchdog).
    pub fn watch_host(&self) -> Result<Option<[WatchdogState; 2]>, Error> {
        let (Some(period), Watchdog::Heartbeat { .. }) = (self.heartbeat, self.profile.watchdog)
        else {
            return Ok(None);
        };
        let found = self.watchdog()?;
        let now = match found {
            WatchdogState::Off => self.set_watchdog(Some(period * HEARTBEAT_PERIODS))?,
            WatchdogState::NoReaction(after) => self.set_watchdog(Some(after))?,
            other => other,
        };
        Ok(Some([found, now]))
    }

    /// Returns whether the drive has a signal: its profile has a source for it, and the drive does not lack it. It is
    /// read if this is unknown.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn provides_signal(&self, signal: Signal) -> Result<bool, Error> {
        let Some(source) = self.profile.signal(signal) else { return Ok(false) };
        // What every drive of the product has is not asked for.
        let sure = !self.profile.optional.contains(&source.parameter);
        if sure || self.state().reading(signal).at.is_some() {
            return Ok(!self.lacks(source.parameter));
        }
        self.read_optional(source.parameter).map(|raw| raw.is_some())
    }

    /// Setting of its watchdog, as parameters and raw values, to be written back later; `None` if the drive does not
    /// report it.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn watchdog_setting(&self) -> Result<Option<Vec<(ParameterId, i64)>>, Error> {
        let ids: Vec<ParameterId> = match self.profile.watchdog {
            Watchdog::Heartbeat { consumer, reaction, .. } => {
                [Some(consumer), reaction].into_iter().flatten().collect()
            }
            _ => self.watchdog_parameter().into_iter().collect(),
        };
        // Half a setting cannot be put back.
        if !ids
            .iter()
            .all(|id| self.parameter(*id).is_some_and(|found| found.access != Access::Write))
        {
            return Ok(None);
        }
        ids.into_iter().map(|id| Ok((id, self.read(id)?))).collect::<Result<_, _>>().map(Some)
    }

    /// Writes raw settings where the drive has others.
    pub(crate) fn restore_settings(&self, settings: &[(ParameterId, i64)]) -> Result<(), Error> {
        settings.iter().try_for_each(|(id, raw)| self.write_if_different(*id, *raw))
    }

    fn write_if_different(&self, id: ParameterId, raw: i64) -> Result<(), Error> {
        // Some drives keep every write in their EEPROM, which a few hundred thousand writes wear out.
        if self.read(id)? == raw { Ok(()) } else { self.write(id, raw, false) }
    }

    /// Reads a parameter, raw; `None` where the drive [lacks](Self::lacks) it.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn read_optional(&self, id: ParameterId) -> Result<Option<i64>, Error> {
        if self.lacks(id) {
            return Ok(None);
        }
        match self.read(id) {
            Ok(raw) => Ok(Some(raw)),
            Err(Error::Failed { outcome: Outcome::NotDone(_), .. }) if self.lacks(id) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns whether the drive refused a parameter as missing. Only parameters that the profile calls optional can be
    /// missing; it is not read again.
    #[must_use]
    pub fn lacks(&self, id: ParameterId) -> bool {
        self.connection.with_axes(|axes, _| axes.lacks_parameter(self.index, id))
    }
}

const fn on_after(ms: i64) -> WatchdogState {
    WatchdogState::On(Duration::from_millis(ms.unsigned_abs()))
}
