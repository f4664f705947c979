//! Members of a world: clients that send requests and receive results, wires that fail, and observers.

mod replies;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;
use polepair_serve::bench::{
    Bench, BenchEvent, FrameSubscription, PendingReply, SessionName, TelemetryChannel,
};
use polepair_serve::message::{
    CommandArguments, CommandOutcome, CommandRequest, GatewayError, LeaseAction, LeaseGrant,
    SignalValue, StopReport, StopRequest,
};
use polepair_sim::random::{HistoryHash, Ppm, Random};

use crate::client::{ClientAction, ClientPresence, GatewayClient, LeaseProgress};
use crate::drives::RandomRack;
use crate::drives::random_speed;
use crate::history::{hash_text, seconds};
use crate::schedule::{DriveEvent, DriveEventKind, WireDisturbance};
use crate::stop_observer::{StopObserver, StopViolation};
use crate::wire::{AnyPort, UnitOutcome, WireCondition};
use crate::{GatewayReport, HistorySink, VIOLATIONS_MAX, Violation};

/// Verbs that power or move a motor.
const MOTION_VERBS: [&str; 3] = ["velocity", "move-to", "enable"];
/// Interval at which a lease is renewed, ms.
const RENEW_MS: u32 = 450;
/// Time in which a request of unknown execution may still be executed, ms.
const MAY_EXECUTE_MS: u32 = 4_000;
/// Time after which no earlier request moves an axis, once its wire works and it must be at standstill.
const SETTLE_TIME: Duration = Duration::from_millis(3_000);

/// Time after its last event within which a world must end.
const WORLD_MAX: Duration = Duration::from_secs(120);
/// Age of a certain fact above which it is not compared with the present truth.
const CERTAIN_MAX_AGE: Duration = Duration::from_millis(20);

/// Something that a client waits for.
struct PendingCall {
    client: usize,
    axis: u16,
    sent_at: Instant,
    kind: CallKind,
}

enum CallKind {
    Lease(PendingReply<Option<LeaseGrant>>),
    Command {
        verb: &'static str,
        epoch: u64,
        starts: u64,
        alone: bool,
        target: Option<f64>,
        reply: PendingReply<CommandOutcome>,
    },
    Stop {
        turned: Vec<bool>,
        late: bool,
        reply: PendingReply<StopReport>,
    },
    Release(PendingReply<()>),
    Read(PendingReply<Vec<SignalValue>>),
}

/// All that lives.
pub struct WorldRunner {
    random: Random,
    ports: Vec<Arc<dyn AnyPort>>,
    disturbances: VecDeque<WireDisturbance>,
    drive_events: VecDeque<DriveEvent>,
    clients: Vec<GatewayClient>,
    pending: Vec<PendingCall>,
    observers: Vec<StopObserver>,
    axis_verbs: Vec<Vec<String>>,
    events: EventPoll,
    channels: Vec<TelemetryChannel>,
    locked_since: Option<Instant>,
    last_id: u32,
    begin: Instant,
    /// Time from which no client sends anything.
    quiet_from: Instant,
    closing: bool,
    /// Result of the world.
    pub report: GatewayReport,
    history: HistoryHash,
    now: Instant,
    history_sink: Option<HistorySink>,
    frames: Option<FrameSubscription>,
    /// Starts of each axis, and the time of its pending stop at each start.
    seen_starts: Vec<u64>,
}

type EventPoll = Box<dyn FnMut() -> Option<BenchEvent>>;

impl WorldRunner {
    #[expect(clippy::too_many_arguments, reason = "each is drawn by the scene, in its order")]
    pub fn new(
        rack: &RandomRack,
        mut random: Random,
        bench: &Bench,
        ports: Vec<Arc<dyn AnyPort>>,
        begin: Instant,
        quiet_from: Instant,
        calamities: Vec<WireDisturbance>,
        drive_events: Vec<DriveEvent>,
        report: GatewayReport,
        history_sink: Option<HistorySink>,
    ) -> Self {
        let mut bench_events = bench.subscribe_events();
        let count = 1 + random.below(4) as usize;
        let clients = (0..count).map(|n| GatewayClient::new(n, &mut random, begin)).collect();
        let view = bench.snapshot();
        let axis_verbs: Vec<Vec<String>> = view
            .axes
            .iter()
            .map(|axis| axis.verbs.iter().map(|verb| verb.verb.clone()).collect())
            .collect();
        let mut channels = Vec::new();
        for axis in &view.axes {
            for signal in &axis.signals {
                let watched = random.chance(Ppm(300_000));
                let hz = random.pick(&[1.0, 5.0, 20.0]);
                if watched {
                    let channel = bench.subscribe(axis.id, Some(&signal.signal), None, hz);
                    channels.extend(channel.ok());
                }
            }
        }
        let frames = history_sink.is_some().then(|| bench.subscribe_frames(None).ok()).flatten();
        let observers: Vec<StopObserver> =
            rack.axes.iter().map(|(kind, wire)| StopObserver::new(kind, *wire)).collect();
        Self {
            random,
            ports,
            disturbances: calamities.into(),
            drive_events: drive_events.into(),
            clients,
            pending: Vec::new(),
            seen_starts: vec![0; observers.len()],
            observers,
            axis_verbs,
            events: Box::new(move || bench_events.try_recv().ok()),
            channels,
            locked_since: None,
            last_id: 0,
            begin,
            quiet_from,
            closing: false,
            report,
            history: HistoryHash::default(),
            now: begin,
            history_sink,
            frames,
        }
    }

    /// Records a line of the history for a listener, and hashes it.
    pub fn log(&mut self, line: impl FnOnce() -> String) {
        let line = line();
        hash_text(&mut self.history, &line);
        self.history.add(self.now.0);
        if let Some(report_line) = &self.history_sink {
            report_line(&format!("{:10.6} {line}", seconds(self.now)));
        }
    }

    /// Everything that is due now. `tends`: a drive is waited for, so that workers run here.
    pub fn step(&mut self, bench: &Bench, tends: bool) {
        self.now = bench.simulation(0).map_or(self.now, |simulation| simulation.now());
        self.report.count("turns");
        let over = self.now.since(self.quiet_from);
        assert!(over < WORLD_MAX, "something waits for ever: {over:?} after the last word");
        while self.disturbances.front().is_some_and(|next| next.at <= self.now) {
            if let Some(WireDisturbance { wire, condition, .. }) = self.disturbances.pop_front() {
                self.log(|| format!("wire {wire} is {condition}"));
                self.report.count(condition_label(condition));
                self.ports[wire].set_condition(condition);
            }
        }
        while self.drive_events.front().is_some_and(|next| next.at <= self.now) {
            if let Some(event) = self.drive_events.pop_front() {
                self.disturb_drive(bench, event);
            }
        }
        self.ports.iter().for_each(|port| port.forward_due());
        if self.now < self.quiet_from {
            self.step_clients(bench);
        }
        if tends {
            bench.run_non_blocking();
        }
        // Reports are compared with the present truth.
        self.check_motors(bench);
        self.process_events(bench);
        self.log_frames();
    }

    fn disturb_drive(&mut self, bench: &Bench, DriveEvent { axis, kind, .. }: DriveEvent) {
        let wire = self.observers[axis].wire;
        let drive = self.observers[..axis].iter().filter(|other| other.wire == wire).count();
        match kind {
            DriveEventKind::Download => self.begin_download(axis, drive),
            DriveEventKind::Act(act) => {
                if bench.simulation(0).is_some_and(|simulation| simulation.act(wire, drive, act)) {
                    self.log(|| format!("axis {axis}: {act:?}"));
                    self.report.count("acts on drives");
                    // Its positions count from another place then.
                    let loses_steps =
                        act == Act::Jam(true) && !self.observers[axis].kind.measures_position;
                    self.observers[axis].counts_anew |= act == Act::PowerCycle || loses_steps;
                }
            }
        }
    }

    /// Another host sends START DOWNLOAD (132) to a TMCL module on a line.
    fn begin_download(&mut self, axis: usize, drive: usize) {
        let StopObserver { kind, wire, .. } = self.observers[axis];
        let address = kind.first_address as u8 + drive as u8;
        let request = [address, 132, 0, 0, 0, 0, 0, 0, address.wrapping_add(132)];
        if kind.name.starts_with("TMCL") && self.ports[wire].send_foreign(&request) {
            self.log(|| format!("axis {axis}: another host loads a program"));
            self.report.count("downloads");
        }
    }

    fn step_clients(&mut self, bench: &Bench) {
        for who in 0..self.clients.len() {
            self.update_presence(who, bench);
            if self.clients[who].presence != ClientPresence::Present {
                continue;
            }
            self.renew_leases(who, bench);
            if self.clients[who].next_at <= self.now {
                let pause = self.random.pick(&[5, 20, 60, 150, 400]);
                self.clients[who].next_at = self.now.plus_ms(1 + self.random.below(pause) as u32);
                let axes = self.observers.len() as u16;
                let (locked, random) = (self.locked_since.is_some(), &mut self.random);
                let word = self.clients[who].choose_action(random, axes, locked);
                self.perform_action(who, word, bench);
            }
        }
    }

    /// Comes back, goes on, or is noticed to have gone.
    fn update_presence(&mut self, who: usize, bench: &Bench) {
        let (now, person) = (self.now, &mut self.clients[who]);
        match person.presence {
            ClientPresence::Present => {}
            ClientPresence::Hung(until) if now >= until => {
                person.presence = ClientPresence::Present;
                let name = person.name.clone();
                self.log(|| format!("{name} goes on"));
            }
            ClientPresence::Gone(Some(noticed), back) if now >= noticed => {
                person.presence = ClientPresence::Gone(None, back);
                let name = person.name.clone();
                self.log(|| format!("the server notices that {name} is gone"));
                bench.end_session(&name);
            }
            ClientPresence::Gone(_, back) if now >= back => {
                person.reconnects += 1;
                person.name = format!("client-{who}/{}", person.reconnects).into();
                person.leases.clear();
                person.presence = ClientPresence::Present;
                let name = person.name.clone();
                self.log(|| format!("{name} comes back"));
            }
            ClientPresence::Hung(_) | ClientPresence::Gone(..) => {}
        }
    }

    fn renew_leases(&mut self, who: usize, bench: &Bench) {
        let now = self.now;
        let due: Vec<(u16, u64)> = self.clients[who]
            .leases
            .iter_mut()
            .filter(|(_, hold)| hold.renew_at <= now)
            .map(|(axis, hold)| {
                hold.renew_at = now.plus_ms(RENEW_MS);
                (*axis, hold.epoch)
            })
            .collect();
        for (axis, epoch) in due {
            let reply =
                bench.request_lease(axis, &self.clients[who].name, LeaseAction::Renew, epoch);
            self.pending.push(PendingCall {
                client: who,
                axis,
                sent_at: now,
                kind: CallKind::Lease(reply),
            });
        }
    }

    fn perform_action(&mut self, who: usize, word: ClientAction, bench: &Bench) {
        let (name, now) = (self.clients[who].name.clone(), self.now);
        match word {
            ClientAction::Wait => {}
            ClientAction::TakeLease(axis, over) => {
                self.log(|| format!("{name} takes axis {axis}{}", if over { " over" } else { "" }));
                let act = if over { LeaseAction::TakeOver } else { LeaseAction::Take };
                let reply = bench.request_lease(axis, &name, act, 0);
                self.pending.push(PendingCall {
                    client: who,
                    axis,
                    sent_at: now,
                    kind: CallKind::Lease(reply),
                });
            }
            ClientAction::DropLease(axis) => {
                self.log(|| format!("{name} gives axis {axis} back"));
                if let Some(hold) = self.clients[who].leases.remove(&axis) {
                    drop(bench.request_lease(axis, &name, LeaseAction::Drop, hold.epoch));
                }
            }
            ClientAction::Command(axis, verb) => self.send_command(who, axis, verb, bench),
            ClientAction::Stop(axis) => {
                self.log(|| format!("{name} says STOP to axis {axis}"));
                self.send_stop(who, Some(vec![axis]), bench);
            }
            ClientAction::StopAll => {
                self.log(|| format!("{name} says STOP ALL"));
                self.send_stop(who, None, bench);
            }
            ClientAction::ReleaseLocks => {
                self.log(|| format!("{name} lets motion again"));
                let reply = bench.release(&name, bench.lock_count());
                self.pending.push(PendingCall {
                    client: who,
                    axis: 0,
                    sent_at: now,
                    kind: CallKind::Release(reply),
                });
            }
            ClientAction::ReadSpeed(axis) => {
                let reply = bench.read_signals(axis, &["velocity"]);
                self.pending.push(PendingCall {
                    client: who,
                    axis,
                    sent_at: now,
                    kind: CallKind::Read(reply),
                });
            }
            ClientAction::Hang => {
                let ms = self.random.between(200, 4000) as u32;
                self.log(|| format!("{name} hangs for {ms} ms"));
                self.clients[who].presence = ClientPresence::Hung(now.plus_ms(ms));
            }
            ClientAction::Vanish => {
                let noticed = self.random.chance(Ppm(700_000));
                let after = self.random.below(1500) as u32;
                let back = self.random.between(1500, 6000) as u32;
                self.log(|| format!("{name} vanishes, for {back} ms"));
                let noticed = noticed.then(|| now.plus_ms(after));
                self.clients[who].presence = ClientPresence::Gone(noticed, now.plus_ms(back));
            }
        }
    }

    fn send_command(&mut self, who: usize, axis: u16, verb: &'static str, bench: &Bench) {
        let of = usize::from(axis);
        let offered =
            ["arm", "disarm"].contains(&verb) || self.axis_verbs[of].iter().any(|v| v == verb);
        let Some(hold) = self.clients[who].leases.get_mut(&axis) else { return };
        if !offered {
            // Powered by whatever moves it.
            hold.progress = hold.progress.max(LeaseProgress::Enabled);
            return;
        }
        hold.command_pending = true;
        let epoch = hold.epoch;
        let watch = &mut self.observers[of];
        let velocity = matches!(verb, "velocity" | "move-to")
            .then(|| random_speed(watch.kind, &mut self.random))
            .map(|speed| if verb == "move-to" { speed.abs() } else { speed });
        let target = (verb == "move-to").then(|| self.random.between(-1_200, 1_200) as f64 / 100.0);
        let moves = MOTION_VERBS.contains(&verb);
        let alone = watch.open_commands == 0 && watch.unknown_until < self.now;
        let starts = watch.truth.starts;
        if moves {
            watch.open_commands += 1;
            // Whatever else is open is not alone any more.
            for pending_call in
                self.pending.iter_mut().filter(|pending_call| pending_call.axis == axis)
            {
                if let CallKind::Command { alone, .. } = &mut pending_call.kind {
                    *alone = false;
                }
            }
        }
        if ["stop", "disable"].contains(&verb) {
            watch.stopped_at = self.now;
        }
        if verb == "stop" {
            watch.require_holder_stop(epoch, self.now);
        }
        if verb != "reached" {
            watch.target = None;
        }
        if matches!(verb, "velocity" | "move-to") {
            // A client that lost its lease without notice moves nothing.
            watch.moved_epoch = watch.moved_epoch.max(Some(epoch));
            watch.record_motion_order(epoch, self.now);
        }
        // Some clients use an id again; a stop is executed all the same.
        let share = if verb == "stop" { 300_000 } else { 10_000 };
        if self.last_id == 0 || !self.random.chance(Ppm(share)) {
            self.last_id += 1;
        }
        let request = CommandRequest {
            id: format!("id-{}", self.last_id),
            issued_ms: bench.now_ms(),
            ttl_ms: 500.25,
            epoch,
            verb: verb.into(),
            arguments: CommandArguments { velocity, target, ..CommandArguments::default() },
        };
        let name = self.clients[who].name.clone();
        let id = self.last_id;
        let asks = target.map_or(String::new(), |target| format!(" {target} rad at"))
            + &velocity.map_or(String::new(), |v| format!(" {v} rad/s"));
        self.log(|| format!("{name} says {verb}{asks} to axis {axis} (id-{id}, epoch {epoch})"));
        let reply = bench.command(axis, &name, request);
        let what = CallKind::Command { verb, epoch, starts, alone, target, reply };
        self.pending.push(PendingCall { client: who, axis, sent_at: self.now, kind: what });
    }

    fn send_stop(&mut self, who: usize, axes: Option<Vec<u16>>, bench: &Bench) {
        let name = self.clients[who].name.clone();
        self.send_stop_as(who, &name, axes, bench);
    }

    fn send_stop_as(
        &mut self,
        who: usize,
        name: &SessionName,
        axes: Option<Vec<u16>>,
        bench: &Bench,
    ) {
        self.report.count("stops said");
        let named: Vec<u16> =
            axes.clone().unwrap_or_else(|| (0..self.observers.len() as u16).collect());
        for axis in named {
            let watch = &mut self.observers[usize::from(axis)];
            watch.stop_pending_since = None;
            watch.require_stop(self.now);
        }
        let turned = self.observers.iter().map(StopObserver::is_turning).collect();
        let reply = bench.stop(name, &StopRequest { axes, ..StopRequest::default() });
        let what = CallKind::Stop { turned, late: false, reply };
        self.pending.push(PendingCall { client: who, axis: 0, sent_at: self.now, kind: what });
    }

    /// An unknown client stops everything.
    pub fn stop_all(&mut self, bench: &Bench) {
        self.log(|| "the supervisor says STOP ALL".to_owned());
        self.send_stop_as(0, &"supervisor".into(), None, bench);
    }

    /// The server is about to end.
    pub fn begin_shutdown(&mut self) {
        self.closing = true;
        let now = self.now;
        self.observers
            .iter_mut()
            .filter(|watch| watch.is_turning())
            .for_each(|watch| watch.require_stop(now));
    }

    /// Checks the end of the bench, which named these axes as not at standstill.
    pub fn check_shutdown(&mut self, bench: &Bench, left: &[String]) {
        self.step(bench, false);
        let view = bench.snapshot();
        for n in 0..self.observers.len() {
            let named = view.axes.get(n).is_some_and(|axis| {
                let link = view.links.iter().find(|link| link.id == axis.link);
                link.is_some_and(|link| left.contains(&format!("{} of {}", axis.label, link.url)))
            });
            let well = self.ports[self.observers[n].wire].working_since();
            let found = self.observers[n].check_after_shutdown(self.now, named, well);
            self.add_violations(n, found);
        }
    }

    fn process_events(&mut self, bench: &Bench) {
        while let Some(event) = (self.events)() {
            match event {
                BenchEvent::Lease { axis, lease } => {
                    let epoch = lease.as_ref().map(|lease| lease.epoch);
                    let watch = &mut self.observers[usize::from(axis)];
                    if watch.epoch != epoch {
                        let owner = lease.map_or_else(|| "nobody".to_owned(), |l| l.owner);
                        watch.record_lease(epoch, self.now);
                        self.log(|| format!("axis {axis} is {owner}'s"));
                    }
                }
                BenchEvent::Stopped(stopped) => {
                    let (id, class) = (stopped.id, stopped.class);
                    self.log(|| format!("all are told: axis {id} stop {class:?}"));
                    self.check_stop(id, class);
                }
                BenchEvent::Locked(motion_lock) => {
                    self.locked_since = Some(self.now);
                    self.log(|| format!("motion is locked by {}", motion_lock.by));
                }
                BenchEvent::Unlocked => {
                    self.locked_since = None;
                    self.log(|| "motion is allowed again".to_owned());
                }
                BenchEvent::BenchChanged => {
                    let states: Vec<_> = bench
                        .snapshot()
                        .links
                        .iter()
                        .map(|link| format!("{:?}", link.state))
                        .collect();
                    self.log(|| format!("links: {}", states.join(", ")));
                }
                BenchEvent::Scan(_) | BenchEvent::Search(_) => {}
                #[allow(unreachable_patterns, reason = "later kinds of events")]
                _ => {}
            }
        }
        let mut n = 0;
        while n < self.pending.len() {
            if self.poll_reply(n) {
                self.pending.swap_remove(n);
            } else {
                n += 1;
            }
        }
    }

    /// The truth of each motor, and what is broken.
    fn check_motors(&mut self, bench: &Bench) {
        for n in 0..self.observers.len() {
            let Some(truth) = bench.truth(n as u16) else { continue };
            let well = self.ports[self.observers[n].wire].working_since();
            let turned = self.observers[n].is_turning();
            let outstanding =
                bench.axis_state(n as u16).ok().map(|state| state.pending_stop.is_some());
            let found = self.observers[n].check(self.now, truth, well, outstanding, false);
            let watch = &self.observers[n];
            if watch.is_turning() != turned {
                let (turns, speed, outstanding) =
                    (watch.is_turning(), truth.velocity, watch.stop_pending_since.is_some());
                let pending = if outstanding { ", its stop is pending" } else { "" };
                self.log(|| {
                    if turns {
                        format!("truth: axis {n} turns{pending}, {speed:.1} rad/s")
                    } else {
                        format!("truth: axis {n} turns no more{pending}, {speed:.1} rad/s")
                    }
                });
            }
            if truth.starts != self.seen_starts[n] {
                self.seen_starts[n] = truth.starts;
                self.report.count("motion executed");
                let starts = truth.starts;
                self.log(|| format!("truth: axis {n} executed motion, number {starts}"));
                self.check_start(n, well);
            }
            self.add_violations(n, found);
        }
    }

    /// Checks that nothing starts an axis while motion is locked, once all earlier requests have arrived.
    fn check_start(&mut self, n: usize, well: Option<Instant>) {
        let settled =
            |since: Instant| well.is_some_and(|well| self.now.since(well.max(since)) > SETTLE_TIME);
        // The values that a stop writes may look like motion.
        let stopped = self.observers[n].stopped_at;
        if let Some(locked) = self.locked_since
            && settled(locked.max(stopped))
        {
            let since = self.now.since(locked).as_secs_f64();
            self.add_violation(
                "G10",
                format!("axis {n} is moved though motion is locked for {since:.2} s"),
            );
        }
    }

    fn add_violations(&mut self, axis: usize, found: impl IntoIterator<Item = StopViolation>) {
        let kind = self.observers[axis].kind.name;
        for (invariant, what) in found {
            self.add_violation(invariant, format!("axis {axis} ({kind}): {what}"));
        }
    }

    fn add_violation(&mut self, invariant: &'static str, what: String) {
        self.log(|| format!("!!! {invariant} {what}"));
        if self.report.violations.len() < VIOLATIONS_MAX {
            self.report.violations.push(Violation { invariant, at: self.now, what });
        }
    }

    fn log_frames(&mut self) {
        for wire in 0..self.ports.len() {
            for seen in self.ports[wire].take_observed() {
                self.history.add(seen.at.0);
                self.history.add_bytes(&seen.bytes);
                if self.history_sink.is_some() && seen.outcome != UnitOutcome::Forwarded {
                    let way = if seen.to_drives { "to drives" } else { "to the host" };
                    let (fate, bytes) = (seen.outcome, &seen.bytes);
                    let line = format!("  wire {wire} {way}, {fate:?}: {bytes:02X?}");
                    self.history_sink.iter().for_each(|report_line| {
                        report_line(&format!("{:10.6} {line}", seconds(seen.at)))
                    });
                }
            }
        }
        let Some(frames) = &mut self.frames else { return };
        for item in frames.drain(usize::MAX).0 {
            let way = match item.dir {
                Some(polepair_serve::message::FrameDirection::Tx) => '>',
                Some(polepair_serve::message::FrameDirection::Rx) => '<',
                None => '?',
            };
            let at = item.t_us / 1e6 + seconds(self.begin);
            let line = format!("{at:10.6}   wire {} {way} {} | {}", item.link, item.raw, item.text);
            self.history_sink.iter().for_each(|report_line| report_line(&line));
        }
    }

    /// The report.
    pub fn into_report(mut self) -> GatewayReport {
        for port in &self.ports {
            let counts = port.counts();
            let mut add = |name, count| *self.report.counts.entry(name).or_default() += count;
            add("links lost", counts.lost);
            add("links opened again", counts.opened);
            add("links refused", counts.refused);
            add("units sent", counts.sent);
            add("units lost on the way", counts.missing);
        }
        self.channels.clear();
        self.report.history = self.history.value();
        self.report
    }
}

fn error_text(error: Option<&GatewayError>) -> String {
    error.map_or(String::new(), |refused| {
        // A reported age is rounded by the machine's clock.
        let message = if refused.code == "gateway.expired" { "" } else { &*refused.message };
        format!("({}: {message}; executed {:?})", refused.code, refused.executed)
    })
}

fn condition_label(condition: WireCondition) -> &'static str {
    match condition {
        WireCondition::Working => "wires well again",
        WireCondition::Gone => "wires gone",
        WireCondition::Drops(_) => "wires dropping",
        WireCondition::Silent { .. } => "wires silent",
        WireCondition::Slow(_) => "wires slow",
        WireCondition::Busy => "nodes busy",
    }
}
