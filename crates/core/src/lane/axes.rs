//! A lane as axes: what callers ask of it, by axis and ticket.

use super::*;

impl<M: Medium, H: Host<M>> Axes for Lane<M, H> {
    fn axes(&self) -> usize {
        self.slots.len()
    }

    fn address(&self, axis: AxisIndex) -> Option<u32> {
        Some(self.slot(axis).ok()?.driver.address())
    }

    fn profile(&self, axis: AxisIndex) -> Option<&'static Profile> {
        Some(self.slot(axis).ok()?.profile)
    }

    fn is_confirmed(&self, _axis: AxisIndex) -> bool {
        H::CONFIRMED
    }

    fn state(&self, axis: AxisIndex) -> Option<&State> {
        Some(&self.slot(axis).ok()?.state)
    }

    fn arm(&mut self, axis: AxisIndex, armed: bool) {
        if let Some(slot) = self.slots.get_mut(usize::from(axis.0)) {
            slot.state.armed = armed;
        }
    }

    fn command(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let verb = command.verb;
        let plan = slot.profile.plan(verb).ok_or(Unsupported::NoPlan)?;
        slot.check_all(plan.steps, &command)?;
        if verb.needs_arming() {
            if !slot.state.armed {
                return Err(Unsupported::NotArmed);
            }
            if self.moving(axis) {
                return Err(Unsupported::Busy);
            }
        }
        self.start(ticket, axis, (plan.steps, plan.undo), command)
    }

    fn stop(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        part: StopPart,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let plan = slot.profile.plan(Verb::Stop).ok_or(Unsupported::NoPlan)?;
        let command = Command::new(Verb::Stop);
        slot.check_all(plan.steps, &command)?;
        let steps = match part {
            StopPart::Tell => plan.before_wait(),
            StopPart::Release => plan.after_wait(),
        };
        self.start(ticket, axis, (steps, &[]), command)
    }

    fn send_once(&mut self, ticket: Ticket) {
        self.jobs.send_once(ticket);
    }

    fn read(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
    ) -> Result<(), Unsupported> {
        self.slot(axis)?.read(parameter)?;
        self.jobs.add(ticket, axis, Task::Read(parameter), false)
    }

    fn write(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        id: ParameterId,
        raw: i64,
        keep: bool,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let parameter = slot.writable(id, raw)?;
        if parameter.moves && !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        if parameter.moves && self.follows_beat(axis) {
            return Err(Unsupported::Busy);
        }
        self.may_readdress(axis, parameter, raw)?;
        let steps = Steps::Write(Write::new(slot.profile, id, raw, keep));
        let command = Command::new(crate::axis::Verb::Store);
        let run = Run::new(steps, &[], command, None);
        self.jobs.add(ticket, axis, Task::Run(run), false)
    }

    fn raw(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        text: &str,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let request = slot.driver.parse(text)?;
        self.say(ticket, axis, request)
    }

    fn raw_frame(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        frame: &Raw<'_>,
    ) -> Result<(), Unsupported> {
        let request = self.slot(axis)?.driver.decode(frame)?;
        self.say(ticket, axis, request)
    }

    fn stream(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: PathKind,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let parameters = slot.driver.path_parameters().ok_or(Unsupported::NoPlan)?;
        if !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        if self.moving(axis) {
            return Err(Unsupported::Busy);
        }
        self.jobs.add(ticket, axis, Task::Path, false)?;
        if let Some(slot) = self.slots.get_mut(usize::from(axis.0)) {
            slot.path = Some(Box::new(Path::new(kind, parameters)));
        }
        Ok(())
    }

    fn feed(&mut self, ticket: Ticket, points: &[Point], complete: bool) -> Option<usize> {
        let axis = self.jobs.fed(ticket)?;
        let path = self.slots.get_mut(usize::from(axis))?.path.as_mut()?;
        Some(path.feed(points, complete))
    }

    fn follow(
        &mut self,
        now: Instant,
        ticket: Ticket,
        following: &Following<'_>,
    ) -> Result<(), Unsupported> {
        const BEATS: &str = "other axes of this link follow a beat; there is one for all";
        const FULL: &str = "the set-points of these axes and what the drives tell take more than 80 % \
                            of the bus: choose a longer period, a higher bit rate or fewer axes";
        if self.cycle.as_ref().is_some_and(|cycle| cycle.runs()) {
            return Err(Unsupported::Forbidden(BEATS));
        }
        if following.axes.iter().any(|axis| self.moving(*axis)) {
            return Err(Unsupported::Busy);
        }
        let cycle = Cycle::new(now, ticket, following, &self.slots)?;
        let needs = u128::from(self.cycle_ns(following.axes).unwrap_or(0));
        if needs * 100 > following.period.as_nanos() * u128::from(LOAD_MAX_PERCENT) {
            return Err(Unsupported::Forbidden(FULL));
        }
        self.cycle = Some(Box::new(cycle));
        Ok(())
    }

    fn feed_cycles(&mut self, ticket: Ticket, setpoints: &[f64], complete: bool) -> Option<usize> {
        let cycle = self.cycle.as_mut().filter(|cycle| cycle.ticket() == ticket)?;
        cycle.feed(&self.slots, setpoints, complete)
    }

    fn account(&self, axis: AxisIndex) -> Option<&Account> {
        self.cycle.as_ref().filter(|cycle| cycle.has(axis)).map(|cycle| cycle.account())
    }

    fn cycle_ns(&self, axes: &[AxisIndex]) -> Option<u64> {
        let mut bits = (0, 0);
        for axis in axes {
            let (own, beat) = self.slot(*axis).ok()?.driver.cycle_bits();
            bits = (bits.0 + u64::from(own), u64::from(beat));
        }
        let ns = (bits.0 + bits.1) * 1_000_000_000;
        Some(ns.checked_div(self.host.bit_rate().into()).unwrap_or(0))
    }

    fn memory(&self, axis: AxisIndex) -> Option<&'static MemoryRules> {
        self.slot(axis).ok()?.driver.memory()
    }

    fn transfer(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: TransferKind,
        pieces: &[Piece],
    ) -> Result<(), Unsupported> {
        let rules = self.slot(axis)?.driver.memory().ok_or(Unsupported::NoPlan)?;
        if self.moving(axis) || self.jobs.transfers(axis) {
            return Err(Unsupported::Busy);
        }
        let transfer = Transfer::new(kind, rules, pieces.to_vec())?;
        self.jobs.add(ticket, axis, Task::Transfer(kind), false)?;
        if let Some(slot) = self.slots.get_mut(usize::from(axis.0)) {
            slot.transfer = Some(Box::new(transfer));
        }
        Ok(())
    }

    fn transferred(&self, axis: AxisIndex) -> Option<&Transfer> {
        self.slot(axis).ok()?.transfer.as_deref()
    }

    fn order(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        order: Order,
    ) -> Result<(), Unsupported> {
        let request = self.slot(axis)?.driver.order(order).ok_or(Unsupported::NoPlan)?;
        if request.class() == Class::Never && self.moving(axis) {
            return Err(Unsupported::Busy);
        }
        self.say(ticket, axis, request)
    }

    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        let cycle = self.cycle.as_mut().and_then(|cycle| cycle.take_outcome());
        cycle.or_else(|| self.jobs.outcome())
    }

    fn readdresses(
        &self,
        axis: AxisIndex,
        id: ParameterId,
        raw: i64,
    ) -> Result<Option<Readdress>, Unsupported> {
        let parameter = self.slot(axis)?.profile.parameter(id);
        self.may_readdress(axis, parameter.ok_or(Unsupported::NoSuchParameter)?, raw)
    }

    fn unlearnt(&self, axis: AxisIndex, n: usize) -> Option<ParameterId> {
        self.slot(axis).ok()?.driver.unlearnt(n)
    }

    fn listen(&mut self, on: bool) {
        let states = self.slots.iter().map(|slot| &slot.state);
        self.tidings = on.then(|| Box::new(Tidings::new(states)));
    }

    fn poll_news(&mut self, now: Instant) -> Option<News> {
        let tidings = self.tidings.as_mut()?;
        tidings.take(now).or_else(|| {
            tidings.compare(now, &self.slots);
            tidings.take(now)
        })
    }

    fn poll_part(&mut self, ticket: Ticket) -> Option<Part> {
        let at = self.parts.iter().position(|part| part.ticket == ticket)?;
        self.parts.remove(at)
    }

    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        self.host.poll_bytes(self.jobs.raw(ticket)?, out)
    }

    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        self.host.feed_bytes(self.jobs.raw(ticket)?, bytes)
    }

    fn rehearse(
        &self,
        axis: AxisIndex,
        command: Command,
        show: &mut dyn FnMut(Rehearsed<'_>),
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let plan = slot.profile.plan(command.verb).ok_or(Unsupported::NoPlan)?;
        slot.check_all(plan.steps, &command)?;
        plan.steps.iter().try_for_each(|step| self.rehearse_step(slot, *step, &command, show))
    }

    fn lacks(&self, axis: AxisIndex, parameter: ParameterId) -> bool {
        self.slot(axis).is_ok_and(|slot| slot.lacks(parameter))
    }

    fn to_si(&self, axis: AxisIndex, parameter: ParameterId, raw: i64) -> Option<f64> {
        self.slot(axis).ok()?.to_si(parameter, raw)
    }

    fn to_raw(&self, axis: AxisIndex, parameter: ParameterId, si: f64) -> Option<i64> {
        self.slot(axis).ok()?.to_raw(parameter, si)
    }

    fn counters(&self) -> Counters {
        self.host.counters()
    }

    fn heard(&self, axis: AxisIndex) -> Counters {
        self.slot(axis).map_or(Counters::default(), |slot| slot.heard)
    }

    fn join(&mut self, lane: usize, profile: &'static Profile, address: u32) -> Option<AxisIndex> {
        let make = self.make.filter(|_| self.may_join(lane, address))?;
        let axis = AxisIndex(u8::try_from(self.slots.len()).ok()?);
        self.slots.push(Slot::new(make(profile, address)));
        self.host.joined(address);
        if let (Some(tidings), Some(slot)) = (&mut self.tidings, self.slots.last()) {
            tidings.know(&slot.state);
        }
        Some(axis)
    }

    fn may_join(&self, lane: usize, address: u32) -> bool {
        // Two slots of one drive would not know what the other has it do.
        let known = self.slots.iter().any(|slot| slot.driver.address() == address);
        lane == 0 && self.make.is_some() && !known && self.host.may_join(address)
    }

    fn keeps_alive(&self) -> bool {
        self.cycle.as_ref().is_some_and(|cycle| cycle.runs()) || self.host.keeps_alive()
    }

    fn disturbed(&mut self, now: Instant) {
        self.host.disturbed(now);
    }
}
