//! A client: its leases, and its next action.

use std::collections::BTreeMap;

use polepair_core::time::Instant;
use polepair_serve::bench::SessionName;
use polepair_sim::random::{Ppm, Random};

/// Progress of a client with an axis that it holds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum LeaseProgress {
    /// The client has the lease.
    Held,
    /// Motion is allowed.
    Armed,
    /// The motor is powered, where that is a verb of its own.
    Enabled,
    /// A speed was commanded.
    Moved,
    /// A position was commanded.
    Sent,
}

/// A lease that a client has.
#[derive(Clone, Copy, Debug)]
pub struct HeldLease {
    /// Epoch of the lease.
    pub epoch: u64,
    /// Time of the next renewal.
    pub renew_at: Instant,
    /// Progress of the client.
    pub progress: LeaseProgress,
    /// A command is under way.
    pub command_pending: bool,
}

/// Presence of a client.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ClientPresence {
    /// The client is running.
    Present,
    /// The client sends and renews nothing until then, and then continues as before.
    Hung(Instant),
    /// The client left. The server notices at the first instant, if at all; the client returns at the second.
    Gone(Option<Instant>, Instant),
}

/// A client of the bench.
#[derive(Debug)]
pub struct GatewayClient {
    /// The session that it has now.
    pub name: SessionName,
    /// Number of its reconnections.
    pub reconnects: u32,
    /// Presence of the client.
    pub presence: ClientPresence,
    /// Time of its next action.
    pub next_at: Instant,
    /// Leases of the client.
    pub leases: BTreeMap<u16, HeldLease>,
    /// Chance that its next action is a stop, ppm.
    stop_ppm: u32,
    /// Chance that it leaves or hangs, ppm.
    leave_ppm: u32,
}

/// Action of a client.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum ClientAction {
    /// Requests the lease; `true` takes it from another holder.
    TakeLease(u16, bool),
    /// A verb of an axis that it holds.
    Command(u16, &'static str),
    /// Gives the lease back.
    DropLease(u16),
    /// Stops an axis, which needs no lease.
    Stop(u16),
    /// Stops everything, which locks motion.
    StopAll,
    /// Lets motion again.
    ReleaseLocks,
    /// Asks for the speed now.
    ReadSpeed(u16),
    /// Goes without a word.
    Vanish,
    /// Sends nothing for a while.
    Hang,
    /// Nothing.
    Wait,
}

impl GatewayClient {
    /// One that begins about then.
    pub fn new(number: usize, random: &mut Random, begin: Instant) -> Self {
        Self {
            name: format!("client-{number}").into(),
            reconnects: 0,
            presence: ClientPresence::Present,
            next_at: begin.plus_ms(random.below(600) as u32),
            leases: BTreeMap::new(),
            stop_ppm: random.pick(&[20_000, 60_000, 200_000]),
            leave_ppm: random.pick(&[0, 20_000, 80_000]),
        }
    }

    /// Chooses the next action.
    pub fn choose_action(&self, random: &mut Random, axes: u16, locked: bool) -> ClientAction {
        let axis = random.below(u64::from(axes)) as u16;
        if locked && random.chance(Ppm(250_000)) {
            return ClientAction::ReleaseLocks;
        }
        if random.chance(Ppm(self.leave_ppm)) {
            return if random.chance(Ppm(500_000)) {
                ClientAction::Vanish
            } else {
                ClientAction::Hang
            };
        }
        if random.chance(Ppm(self.stop_ppm)) {
            return if random.chance(Ppm(250_000)) {
                ClientAction::StopAll
            } else {
                ClientAction::Stop(axis)
            };
        }
        if random.chance(Ppm(40_000)) {
            return ClientAction::ReadSpeed(axis);
        }
        match self.leases.get(&axis) {
            None => ClientAction::TakeLease(axis, random.chance(Ppm(120_000))),
            Some(hold) if hold.command_pending => ClientAction::Wait,
            Some(HeldLease { progress: LeaseProgress::Held, .. }) => {
                ClientAction::Command(axis, "arm")
            }
            Some(HeldLease { progress: LeaseProgress::Armed, .. }) => {
                ClientAction::Command(axis, "enable")
            }
            Some(HeldLease { progress: LeaseProgress::Enabled, .. }) => {
                let verb = if random.chance(Ppm(400_000)) { "move-to" } else { "velocity" };
                ClientAction::Command(axis, verb)
            }
            Some(HeldLease { progress: LeaseProgress::Sent, .. })
                if random.chance(Ppm(500_000)) =>
            {
                ClientAction::Command(axis, "reached")
            }
            Some(_) => match random.below(100) {
                0..15 => ClientAction::Command(axis, "velocity"),
                15..30 => ClientAction::Command(axis, "move-to"),
                30..42 => ClientAction::Command(axis, "stop"),
                42..46 => ClientAction::Command(axis, "disable"),
                46..49 => ClientAction::Command(axis, "disarm"),
                49..54 => ClientAction::DropLease(axis),
                _ => ClientAction::Wait,
            },
        }
    }
}
