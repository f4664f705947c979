//! Network management: states, boot-up, heartbeats both ways, guarding.

use super::comm::CONSUMERS_MAX;
use super::{CanEnd, Firmware, emcy};
use crate::medium::Frame;
use crate::proto::canopen::nmt::{Command, Order, State};
use crate::proto::canopen::{NODE_MAX, cob};
use crate::time::Instant;

/// Timers of network management; [`Instant::FAR`] for those that do not run.
#[derive(Clone, Debug)]
pub(super) struct Net {
    /// The next heartbeat of its own.
    beat_at: Instant,
    /// By when each heartbeat watched must have come.
    missed_at: [Instant; CONSUMERS_MAX],
    /// By when guarding must have come.
    guarded_until: Instant,
    toggle: bool,
}

impl Default for Net {
    fn default() -> Self {
        let far = Instant::FAR;
        Self { beat_at: far, missed_at: [far; CONSUMERS_MAX], guarded_until: far, toggle: false }
    }
}

impl Net {
    pub(super) fn due(&self) -> Instant {
        self.missed_at.iter().copied().fold(self.beat_at.min(self.guarded_until), Instant::min)
    }
}

impl<const N: usize> CanEnd<N> {
    /// After power-on and after a reset: the communication objects anew, the boot-up message, then
    /// pre-operational. A node without node-ID waits for LSS.
    pub(super) fn boot(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let id = firmware.node_id();
        self.node = if (1..=NODE_MAX).contains(&id) { id } else { 0 };
        self.comm = self.store.load(firmware.dictionary(), self.node);
        self.silence();
        self.net = Net::default();
        self.alarms.drop_waiting();
        self.due = Instant::FAR;
        self.apply_sync(now);
        self.apply_pdos(now, firmware);
        self.state = State::BootUp;
        if self.node != 0 {
            self.mail.alive(State::BootUp.into());
            self.start_heartbeat(now);
            self.enter(now, State::PreOperational, firmware);
        }
        if let Some(due) = self.store.due() {
            self.arm(due);
        }
        self.arm(now);
    }

    /// Nothing is under way any more.
    fn silence(&mut self) {
        self.mail.clear();
        self.server.end();
        self.sends.ready = 0;
    }

    /// Takes what is neither SYNC nor a PDO.
    pub(super) fn serve(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let id = frame.id as u16;
        let talks = matches!(self.state, State::Operational | State::PreOperational);
        if talks && id == cob::SDO_REQUEST | u16::from(self.node) {
            return self.request(now, frame, firmware);
        }
        match id {
            cob::NMT => self.ordered(now, frame, firmware),
            cob::LSS_REQUEST if self.options.lss => self.lss_request(now, frame, firmware),
            _ if u32::from(id) == self.sync.id && talks => {
                self.synced(now, frame.bytes(), firmware);
            }
            _ if id & 0x780 == cob::HEARTBEAT => self.heard_beat(now, id as u8 & 0x7F, firmware),
            _ if u32::from(id) == self.comm.time_cob & 0x7FF && talks => {
                self.heard_time(now, frame, firmware);
            }
            _ => {}
        }
    }

    fn ordered(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let Ok(order) = Order::parse(frame.bytes()) else { return };
        if self.node == 0 || (order.node != 0 && order.node != self.node) {
            return;
        }
        match order.command {
            Command::Start => self.enter(now, State::Operational, firmware),
            Command::Stop => self.enter(now, State::Stopped, firmware),
            Command::PreOperational => self.enter(now, State::PreOperational, firmware),
            Command::ResetNode => {
                firmware.reset(now);
                self.boot(now, firmware);
            }
            Command::ResetCommunication => self.boot(now, firmware),
            Command::Other(_) => {}
        }
    }

    pub(super) fn enter(&mut self, now: Instant, state: State, firmware: &mut impl Firmware) {
        if self.state == state {
            return;
        }
        self.state = state;
        self.sends.ready = 0;
        if state == State::Stopped {
            self.mail.clear_services();
            self.server.end();
        }
        firmware.entered(now, state);
        if state == State::Operational {
            self.start_pdos(now, firmware);
        }
    }

    /// 1017h was written, or the node boots.
    pub(super) fn start_heartbeat(&mut self, now: Instant) {
        let period = u32::from(self.comm.heartbeat_ms);
        self.net.beat_at = if period > 0 { now.plus_ms(period) } else { Instant::FAR };
        self.arm(self.net.beat_at);
    }

    /// 1016h was written: that watch begins with the next heartbeat.
    pub(super) fn restart_watch(&mut self, consumer: usize) {
        self.net.missed_at[consumer] = Instant::FAR;
    }

    fn heard_beat(&mut self, now: Instant, node: u8, firmware: &mut impl Firmware) {
        for n in 0..CONSUMERS_MAX {
            let watched = self.comm.consumers[n];
            let (of, ms) = ((watched >> 16) as u8, watched & 0xFFFF);
            if of == node && node != 0 && ms > 0 {
                self.net.missed_at[n] = now.plus_ms(ms);
                self.arm(self.net.missed_at[n]);
                self.calm(firmware);
            }
        }
    }

    /// A remote request: guarding, or a PDO.
    pub(super) fn asked(&mut self, now: Instant, id: u32, firmware: &mut impl Firmware) {
        let guards = id == u32::from(cob::HEARTBEAT | u16::from(self.node)) && self.node != 0;
        if !guards {
            return self.pdo_asked(now, id, firmware);
        }
        if !self.options.guarding || self.comm.heartbeat_ms != 0 {
            return;
        }
        self.mail.alive(u8::from(self.state) | u8::from(self.net.toggle) << 7);
        self.net.toggle = !self.net.toggle;
        let life = u32::from(self.comm.guard_ms) * u32::from(self.comm.life_factor);
        if life > 0 {
            self.net.guarded_until = now.plus_ms(life);
            self.arm(self.net.guarded_until);
            self.calm(firmware);
        }
    }

    /// Whatever is due by time.
    #[cold]
    pub(super) fn timers(&mut self, now: Instant, firmware: &mut impl Firmware) {
        if now >= self.net.beat_at {
            self.mail.beat(self.state.into());
            self.start_heartbeat(now);
        }
        let mut missed = now >= self.net.guarded_until;
        if missed {
            self.net.guarded_until = Instant::FAR;
        }
        for at in &mut self.net.missed_at {
            if now >= *at {
                *at = Instant::FAR;
                missed = true;
            }
        }
        if missed {
            self.lose(now, emcy::NO_HEARTBEAT, firmware);
        }
        if let Some(group) = self.store.done(now) {
            self.mail.stores = false;
            firmware.store(group);
        }
        self.sync_timers(now, firmware);
        self.pdo_timers(now, firmware);
        self.lss_timers(now);
        self.due = self.next_due(now);
    }

    fn next_due(&self, now: Instant) -> Instant {
        let mut due = self.net.due().min(self.sync.due()).min(self.sends.due()).min(self.lss.due());
        due = self.takes.iter().map(|take| take.missed_at).fold(due, Instant::min);
        due = due.min(self.store.due().unwrap_or(Instant::FAR));
        due.min(self.alarms.due(now))
    }

    /// The link is lost: an emergency, then what 1029h and the firmware make of it.
    pub(super) fn lose(&mut self, now: Instant, code: u16, firmware: &mut impl Firmware) {
        self.raise(code, true, firmware);
        self.behave(now, 0, firmware);
        firmware.lost(now);
    }

    /// What 1029h says: sub-index 1 for communication errors, 2 for faults of the drive.
    pub(super) fn behave(&mut self, now: Instant, which: usize, firmware: &mut impl Firmware) {
        match self.comm.behaviour[which] {
            0 if self.state == State::Operational => {
                self.enter(now, State::PreOperational, firmware);
            }
            2 => self.enter(now, State::Stopped, firmware),
            _ => {}
        }
    }
}
