//! Network management: states, boot-up, heartbeats both ways, guarding.

use super::communication::CONSUMERS_MAX;
use super::{CanEndpoint, Firmware, emcy};
use crate::medium::Frame;
use crate::proto::canopen::nmt::{NmtCommand, NmtMessage, NmtState};
use crate::proto::canopen::{NODE_MAX, cob};
use crate::time::Instant;

/// Timers of network management; [`Instant::FAR_FUTURE`] for those that do not run.
#[derive(Clone, Debug)]
pub(super) struct NetworkTimers {
    /// The next heartbeat of its own.
    heartbeat_at: Instant,
    /// Deadline of each watched heartbeat.
    consumer_deadlines: [Instant; CONSUMERS_MAX],
    /// Deadline of the next guarding request.
    guard_deadline: Instant,
    toggle: bool,
}

impl Default for NetworkTimers {
    fn default() -> Self {
        let far = Instant::FAR_FUTURE;
        Self {
            heartbeat_at: far,
            consumer_deadlines: [far; CONSUMERS_MAX],
            guard_deadline: far,
            toggle: false,
        }
    }
}

impl NetworkTimers {
    pub(super) fn due(&self) -> Instant {
        self.consumer_deadlines
            .iter()
            .copied()
            .fold(self.heartbeat_at.min(self.guard_deadline), Instant::min)
    }
}

impl<const N: usize> CanEndpoint<N> {
    /// After power-on and after a reset: the communication objects anew, the boot-up message, then
    /// pre-operational. A node without node-ID waits for LSS.
    pub(super) fn boot(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let id = firmware.node_id();
        self.node = if (1..=NODE_MAX).contains(&id) { id } else { 0 };
        self.communication = self.settings_store.load(firmware.dictionary(), self.node);
        self.clear_transfers();
        self.network = NetworkTimers::default();
        self.emergencies.clear_queue();
        self.next_due = Instant::FAR_FUTURE;
        self.apply_sync(now);
        self.apply_pdos(now, firmware);
        self.state = NmtState::BootUp;
        if self.node != 0 {
            self.send_slots.set_heartbeat(NmtState::BootUp.into());
            self.start_heartbeat(now);
            self.enter_state(now, NmtState::PreOperational, firmware);
        }
        if let Some(due) = self.settings_store.due() {
            self.schedule(due);
        }
        self.schedule(now);
    }

    /// Nothing is under way any more.
    fn clear_transfers(&mut self) {
        self.send_slots.clear();
        self.sdo_server.end();
        self.tpdos.ready = 0;
    }

    /// Takes frames that are neither SYNC nor a PDO.
    pub(super) fn handle_service(
        &mut self,
        now: Instant,
        frame: &Frame,
        firmware: &mut impl Firmware,
    ) {
        let id = frame.id as u16;
        let talks = matches!(self.state, NmtState::Operational | NmtState::PreOperational);
        if talks && id == cob::SDO_REQUEST | u16::from(self.node) {
            return self.handle_sdo_request(now, frame, firmware);
        }
        match id {
            cob::NMT => self.handle_nmt(now, frame, firmware),
            cob::LSS_REQUEST if self.quirks.lss => self.handle_lss_request(now, frame, firmware),
            _ if u32::from(id) == self.sync.id && talks => {
                self.handle_sync(now, frame.bytes(), firmware);
            }
            _ if id & 0x780 == cob::HEARTBEAT => {
                self.handle_heartbeat(now, id as u8 & 0x7F, firmware)
            }
            _ if u32::from(id) == self.communication.time_cob & 0x7FF && talks => {
                self.handle_time(now, frame, firmware);
            }
            _ => {}
        }
    }

    fn handle_nmt(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let Ok(message) = NmtMessage::parse(frame.bytes()) else { return };
        if self.node == 0 || (message.node != 0 && message.node != self.node) {
            return;
        }
        match message.command {
            NmtCommand::Start => self.enter_state(now, NmtState::Operational, firmware),
            NmtCommand::Stop => self.enter_state(now, NmtState::Stopped, firmware),
            NmtCommand::PreOperational => self.enter_state(now, NmtState::PreOperational, firmware),
            NmtCommand::ResetNode => {
                firmware.reset(now);
                self.boot(now, firmware);
            }
            NmtCommand::ResetCommunication => self.boot(now, firmware),
            NmtCommand::Other(_) => {}
        }
    }

    pub(super) fn enter_state(
        &mut self,
        now: Instant,
        state: NmtState,
        firmware: &mut impl Firmware,
    ) {
        if self.state == state {
            return;
        }
        self.state = state;
        self.tpdos.ready = 0;
        if state == NmtState::Stopped {
            self.send_slots.clear_services();
            self.sdo_server.end();
        }
        firmware.handle_nmt_state(now, state);
        if state == NmtState::Operational {
            self.start_pdos(now, firmware);
        }
    }

    /// 1017h was written, or the node boots.
    pub(super) fn start_heartbeat(&mut self, now: Instant) {
        let period = u32::from(self.communication.heartbeat_ms);
        self.network.heartbeat_at =
            if period > 0 { now.plus_ms(period) } else { Instant::FAR_FUTURE };
        self.schedule(self.network.heartbeat_at);
    }

    /// 1016h was written: that watch begins with the next heartbeat.
    pub(super) fn restart_consumer(&mut self, consumer: usize) {
        self.network.consumer_deadlines[consumer] = Instant::FAR_FUTURE;
    }

    fn handle_heartbeat(&mut self, now: Instant, node: u8, firmware: &mut impl Firmware) {
        for n in 0..CONSUMERS_MAX {
            let watched = self.communication.consumers[n];
            let (of, ms) = ((watched >> 16) as u8, watched & 0xFFFF);
            if of == node && node != 0 && ms > 0 {
                self.network.consumer_deadlines[n] = now.plus_ms(ms);
                self.schedule(self.network.consumer_deadlines[n]);
                self.clear_error(firmware);
            }
        }
    }

    /// A remote request: guarding, or a PDO.
    pub(super) fn handle_remote_request(
        &mut self,
        now: Instant,
        id: u32,
        firmware: &mut impl Firmware,
    ) {
        let guards = id == u32::from(cob::HEARTBEAT | u16::from(self.node)) && self.node != 0;
        if !guards {
            return self.handle_pdo_request(now, id, firmware);
        }
        if !self.quirks.guarding || self.communication.heartbeat_ms != 0 {
            return;
        }
        self.send_slots.set_heartbeat(u8::from(self.state) | u8::from(self.network.toggle) << 7);
        self.network.toggle = !self.network.toggle;
        let life =
            u32::from(self.communication.guard_ms) * u32::from(self.communication.life_factor);
        if life > 0 {
            self.network.guard_deadline = now.plus_ms(life);
            self.schedule(self.network.guard_deadline);
            self.clear_error(firmware);
        }
    }

    /// Whatever is due by time.
    #[cold]
    pub(super) fn run_timers(&mut self, now: Instant, firmware: &mut impl Firmware) {
        if now >= self.network.heartbeat_at {
            self.send_slots.offer_heartbeat(self.state.into());
            self.start_heartbeat(now);
        }
        let mut missed = now >= self.network.guard_deadline;
        if missed {
            self.network.guard_deadline = Instant::FAR_FUTURE;
        }
        for at in &mut self.network.consumer_deadlines {
            if now >= *at {
                *at = Instant::FAR_FUTURE;
                missed = true;
            }
        }
        if missed {
            self.handle_link_loss(now, emcy::NO_HEARTBEAT, firmware);
        }
        if let Some(group) = self.settings_store.finish_write(now) {
            self.send_slots.awaits_store = false;
            firmware.store(group);
        }
        self.run_sync_timers(now, firmware);
        self.run_pdo_timers(now, firmware);
        self.run_lss_timers(now);
        self.next_due = self.next_due(now);
    }

    fn next_due(&self, now: Instant) -> Instant {
        let mut due =
            self.network.due().min(self.sync.due()).min(self.tpdos.due()).min(self.lss.due());
        due = self.rpdos.iter().map(|take| take.deadline).fold(due, Instant::min);
        due = due.min(self.settings_store.due().unwrap_or(Instant::FAR_FUTURE));
        due.min(self.emergencies.due(now))
    }

    /// The link is lost: an emergency, then what 1029h and the firmware make of it.
    pub(super) fn handle_link_loss(
        &mut self,
        now: Instant,
        code: u16,
        firmware: &mut impl Firmware,
    ) {
        self.raise_error(code, true, firmware);
        self.apply_error_behaviour(now, 0, firmware);
        firmware.handle_link_loss(now);
    }

    /// Behaviour by 1029h: sub-index 1 for communication errors, 2 for faults of the drive.
    pub(super) fn apply_error_behaviour(
        &mut self,
        now: Instant,
        which: usize,
        firmware: &mut impl Firmware,
    ) {
        match self.communication.behaviour[which] {
            0 if self.state == NmtState::Operational => {
                self.enter_state(now, NmtState::PreOperational, firmware);
            }
            2 => self.enter_state(now, NmtState::Stopped, firmware),
            _ => {}
        }
    }
}
