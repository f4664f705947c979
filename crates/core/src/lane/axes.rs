//! The axes interface of a lane: requests by axis and ticket.

use super::*;
use crate::axis::{
    AxisCommands, AxisData, AxisDirectory, AxisPaths, AxisPrograms, AxisRequests, AxisScales,
    AxisText, AxisTraffic, MotionReport, Refusal, TextRehearsal, UnmetWait,
};
use crate::judge::Tolerance;
use crate::medium::bits::bit_time_ns;
use crate::profile::{Access, Encoding, NoScale, Parameter};
use crate::program::{MemoryBlock, MemoryTransfer, TransferKind};

const ONLY_NUMBERS: &str = "all values of this protocol are numbers";

impl<M: Medium, H: Host<M>> AxisDirectory for Lane<M, H> {
    fn axis_count(&self) -> usize {
        self.slots.len()
    }

    fn address(&self, axis: AxisIndex) -> Option<u32> {
        Some(self.slot(axis).ok()?.driver.address())
    }

    fn profile(&self, axis: AxisIndex) -> Option<&'static Profile> {
        Some(self.slot(axis).ok()?.profile)
    }

    fn state(&self, axis: AxisIndex) -> Option<&AxisStatus> {
        Some(&self.slot(axis).ok()?.state)
    }

    fn parameter(&self, axis: AxisIndex, id: ParameterId) -> Option<&'static Parameter> {
        self.slot(axis).ok()?.parameter(id)
    }

    fn add_parameter(
        &mut self,
        axis: AxisIndex,
        parameter: &'static Parameter,
    ) -> Option<ParameterId> {
        self.slots.get_mut(usize::from(axis.0))?.add_parameter(parameter)
    }

    fn is_confirmed(&self, _axis: AxisIndex) -> bool {
        H::CONFIRMED
    }

    fn refusal(&self, axis: AxisIndex, code: u32) -> Refusal {
        self.slot(axis).map_or(Refusal::Final, |slot| slot.driver.refusal(code))
    }

    fn lacks_parameter(&self, axis: AxisIndex, parameter: ParameterId) -> bool {
        self.slot(axis).is_ok_and(|slot| slot.lacks_parameter(parameter))
    }

    fn add_axis(
        &mut self,
        lane: usize,
        profile: &'static Profile,
        address: u32,
    ) -> Option<AxisIndex> {
        let make = self.driver_factory.filter(|_| self.can_add_axis(lane, address))?;
        let axis = AxisIndex(u8::try_from(self.slots.len()).ok()?);
        self.slots.push(AxisSlot::new(make(profile, address)));
        self.host.add_drive(address);
        if let (Some(event_queue), Some(slot)) = (&mut self.events, self.slots.last()) {
            event_queue.add_axis(&slot.state);
        }
        Some(axis)
    }

    fn can_add_axis(&self, lane: usize, address: u32) -> bool {
        // Two slots of one drive would not know what the other has it do.
        let known = self.slots.iter().any(|slot| slot.driver.address() == address);
        lane == 0 && self.driver_factory.is_some() && !known && self.host.can_add_drive(address)
    }
}

impl<M: Medium, H: Host<M>> AxisRequests for Lane<M, H> {
    fn read_parameter(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
    ) -> Result<(), Unsupported> {
        self.slot(axis)?.read_request(parameter)?;
        self.jobs.add(ticket, axis, JobTask::Read(parameter), false)
    }

    fn write_parameter(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        id: ParameterId,
        raw: i64,
        keep: bool,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let parameter = slot.check_writable(id, raw)?;
        let (profile, reads) = (slot.profile, slot.driver.reads_before_write(parameter));
        self.check_moves(axis, parameter)?;
        self.check_address_change(axis, parameter, raw)?;
        let steps = StepSource::Write(WriteSteps::new(profile, id, parameter, raw, keep, reads));
        let command = Command::new(crate::axis::Verb::Store);
        let run = PlanRun::new(steps, &[], command, None);
        self.jobs.add(ticket, axis, JobTask::Run(run), false)
    }

    fn address_change(
        &self,
        axis: AxisIndex,
        id: ParameterId,
        raw: i64,
    ) -> Result<Option<AddressRole>, Unsupported> {
        let parameter = self.slot(axis)?.parameter(id);
        self.check_address_change(axis, parameter.ok_or(Unsupported::NoSuchParameter)?, raw)
    }

    fn unread_prerequisite(&self, axis: AxisIndex, n: usize) -> Option<ParameterId> {
        self.slot(axis).ok()?.driver.unread_prerequisite(n)
    }

    fn report_setting(
        &self,
        axis: AxisIndex,
        parameters: &[ParameterId],
        interval_ms: u16,
    ) -> Option<(ParameterId, i64)> {
        self.slot(axis).ok()?.driver.reports()?.report_setting(parameters, interval_ms)
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        self.jobs.disable_retries(ticket);
    }

    fn poll_group_answer(&mut self, ticket: Ticket) -> Option<GroupAnswer> {
        let at = self.group_answers.iter().position(|part| part.ticket == ticket)?;
        self.group_answers.remove(at)
    }

    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        let cyclic = self.cyclic.as_mut();
        let cycle = cyclic.and_then(|cycle| cycle.take_outcome(&mut self.slots));
        cycle.or_else(|| self.jobs.pop_outcome())
    }
}

impl<M: Medium, H: Host<M>> AxisScales for Lane<M, H> {
    fn to_si(&self, axis: AxisIndex, parameter: ParameterId, raw: i64) -> Option<f64> {
        self.slot(axis).ok()?.to_si(parameter, raw)
    }

    fn to_raw(&self, axis: AxisIndex, parameter: ParameterId, si: f64) -> Option<i64> {
        self.slot(axis).ok()?.to_raw(parameter, si)
    }

    fn scale_input(&self, axis: AxisIndex, parameter: ParameterId) -> Option<i64> {
        self.slot(axis).ok()?.scale_input(parameter)
    }

    fn scale_error(&self, axis: AxisIndex, parameter: ParameterId) -> Option<NoScale> {
        self.slot(axis).ok()?.scale_error(parameter)
    }

    fn visit_axes_alike(&self, axis: AxisIndex, visit: &mut dyn FnMut(AxisIndex)) {
        let Ok(own) = self.slot(axis) else { return };
        for (index, slot) in (0..).map(AxisIndex).zip(&self.slots) {
            let is_alike = core::ptr::eq(slot.profile, own.profile) && !slot.driver.is_group();
            if is_alike && index != axis {
                visit(index);
            }
        }
    }

    fn adopt_scales(&mut self, axis: AxisIndex) {
        let mut others = Vec::new();
        self.visit_axes_alike(axis, &mut |index| others.extend(self.slot(index).ok()));
        let Ok(own) = self.slot(axis) else { return };
        let agreed = |id: ParameterId| {
            let mut values = others.iter().map(|slot| slot.scale_input(id));
            let first = values.next().flatten()?;
            values.all(|value| value == Some(first)).then_some((id, first))
        };
        let adopted: Vec<_> = own.scale_inputs().filter_map(agreed).collect();
        if let Some(slot) = self.slots.get_mut(usize::from(axis.0)) {
            slot.adopt_scale_inputs(&adopted);
        }
    }
}

impl<M: Medium, H: Host<M>> AxisCommands for Lane<M, H> {
    fn set_armed(&mut self, axis: AxisIndex, armed: bool) {
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
        slot.check_steps(plan.steps, &command)?;
        if verb.needs_arming() {
            if !slot.state.armed {
                return Err(Unsupported::NotArmed);
            }
            if self.is_moving(axis) {
                return Err(Unsupported::Busy);
            }
        }
        let halt = verb.is_stop().then_some(plan.before_wait().len());
        self.start_steps(ticket, axis, plan.steps, plan.undo, halt, command)
    }

    fn stop(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
        part: StopPart,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let plan = slot.profile.plan(command.verb).ok_or(Unsupported::NoPlan)?;
        slot.check_steps(plan.steps, &command)?;
        let steps = match part {
            StopPart::Halt => plan.before_wait(),
            StopPart::Release => plan.after_wait(),
        };
        let halt = (part == StopPart::Halt).then_some(steps.len());
        self.start_steps(ticket, axis, steps, &[], halt, command)
    }

    fn rehearse(
        &self,
        axis: AxisIndex,
        command: Command,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let plan = slot.profile.plan(command.verb).ok_or(Unsupported::NoPlan)?;
        slot.check_steps(plan.steps, &command)?;
        let Some(end) = slot.program_end_request(&command) else {
            return self.rehearse_steps(slot, plan.steps, &command, show);
        };
        self.rehearse_steps(slot, plan.before_wait(), &command, show)?;
        if let Some(query) = slot.program_request(ProgramCommand::QueryProgram) {
            self.show_request(RehearsalAction::QueryProgram, &query, show);
        }
        self.show_request(RehearsalAction::EndProgram, &end, show);
        self.rehearse_steps(slot, plan.steps, &command, show)
    }

    fn unmet_wait(&self, axis: AxisIndex) -> Option<UnmetWait> {
        self.slot(axis).ok()?.unmet_wait
    }

    fn motion_report(&self, axis: AxisIndex, n: usize) -> Option<MotionReport> {
        self.slot(axis).ok()?.motion.report(n)
    }

    fn tolerance(&self, axis: AxisIndex) -> Option<Tolerance> {
        Some(self.slot(axis).ok()?.tolerance(None))
    }
}

impl<M: Medium, H: Host<M>> AxisText for Lane<M, H> {
    fn send_text(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        text: &str,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let request = slot.driver.parse_request(text)?;
        self.queue_raw_request(ticket, axis, request)
    }

    fn rehearse_text(
        &self,
        axis: AxisIndex,
        text: &str,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<TextRehearsal, Unsupported> {
        let slot = self.slot(axis)?;
        let request = slot.driver.parse_request(text)?;
        self.show_request(RehearsalAction::Send, &request, show);
        Ok(TextRehearsal {
            effect: request.effect(slot.profile),
            is_stop: request.is_stop(),
            moves_bytes: request.moves_bytes(),
            line_change: request.line_change(),
        })
    }

    fn send_frame(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        frame: &RawFrame<'_>,
    ) -> Result<(), Unsupported> {
        let request = self.slot(axis)?.driver.decode_request(frame)?;
        self.queue_raw_request(ticket, axis, request)
    }
}

impl<M: Medium, H: Host<M>> AxisData for Lane<M, H> {
    fn read_data(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        id: ParameterId,
        block: bool,
        max: u16,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let parameter = slot.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
        if parameter.access == Access::Write {
            return Err(Unsupported::WriteOnly(id));
        }
        let request = slot
            .driver
            .data()
            .ok_or(Unsupported::Forbidden(ONLY_NUMBERS))?
            .data_read_request(parameter, block, max)?;
        self.queue_raw_request(ticket, axis, request)
    }

    fn write_data(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        id: ParameterId,
        size: u32,
        block: bool,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let parameter = slot.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
        // Bytes need no type.
        let untyped = parameter.encoding == Encoding::AnyLength;
        if parameter.access == Access::Read && !untyped {
            return Err(Unsupported::ReadOnly(id));
        }
        self.check_moves(axis, parameter)?;
        let request = self
            .slot(axis)?
            .driver
            .data()
            .ok_or(Unsupported::Forbidden(ONLY_NUMBERS))?
            .data_write_request(parameter, size, block)?;
        self.queue_raw_request(ticket, axis, request)
    }

    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        self.host.poll_bytes(self.jobs.raw_request_ticket(ticket)?, out)
    }

    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        self.host.feed_bytes(self.jobs.raw_request_ticket(ticket)?, bytes)
    }
}

impl<M: Medium, H: Host<M>> AxisPaths for Lane<M, H> {
    fn start_path(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: PathKind,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let parameters = slot.driver.paths().and_then(|paths| paths.path_parameters());
        let parameters = parameters.ok_or(Unsupported::NoPlan)?;
        if !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        if self.is_moving(axis) {
            return Err(Unsupported::Busy);
        }
        self.jobs.add(ticket, axis, JobTask::Path, false)?;
        if let Some(slot) = self.slots.get_mut(usize::from(axis.0)) {
            slot.forget_motion();
            slot.path = Some(Box::new(PathStream::new(kind, parameters)));
        }
        Ok(())
    }

    fn feed_points(&mut self, ticket: Ticket, points: &[Point], complete: bool) -> Option<usize> {
        let axis = self.jobs.resume_path(ticket)?;
        let path = self.slots.get_mut(usize::from(axis))?.path.as_mut()?;
        Some(path.feed(points, complete))
    }

    fn start_cyclic(
        &mut self,
        now: Instant,
        ticket: Ticket,
        following: &CyclicConfig<'_>,
    ) -> Result<(), Unsupported> {
        const ALREADY_CYCLIC: &str = "other axes of this link follow a beat; there is one for all";
        const BUS_OVERLOADED: &str = "the set-points of these axes and what the drives tell take more than 80 % \
                            of the bus: choose a longer period, a higher bit rate or fewer axes";
        if self.cyclic.as_ref().is_some_and(|cycle| cycle.is_running()) {
            return Err(Unsupported::Forbidden(ALREADY_CYCLIC));
        }
        if following.axes.iter().any(|axis| self.is_moving(*axis)) {
            return Err(Unsupported::Busy);
        }
        let cycle = CyclicMotion::new(now, ticket, following, &self.slots)?;
        let needs = u128::from(self.cycle_ns(following.axes).ok_or(Unsupported::NoSuchAxis)?);
        if needs * 100 > following.period.as_nanos() * u128::from(LOAD_MAX_PERCENT) {
            return Err(Unsupported::Forbidden(BUS_OVERLOADED));
        }
        self.cyclic = Some(Box::new(cycle));
        Ok(())
    }

    fn feed_cycles(&mut self, ticket: Ticket, setpoints: &[f64], complete: bool) -> Option<usize> {
        let cycle = self.cyclic.as_mut().filter(|cycle| cycle.ticket() == ticket)?;
        cycle.feed_cycles(&self.slots, setpoints, complete)
    }

    fn cycle_statistics(&self, axis: AxisIndex) -> Option<&CycleStatistics> {
        self.cyclic.as_ref().filter(|cycle| cycle.has_axis(axis)).map(|cycle| cycle.statistics())
    }

    fn cycle_ns(&self, axes: &[AxisIndex]) -> Option<u64> {
        let mut bits = (0, 0);
        for axis in axes {
            // A drive without cycles takes no bits of them.
            let cycles = self.slot(*axis).ok()?.driver.cycles();
            let (own, beat) = cycles.map_or((0, 0), |cycles| cycles.cycle_bits());
            bits = (bits.0 + u64::from(own), u64::from(beat));
        }
        Some(bit_time_ns(bits.0 + bits.1, self.host.bit_rate()))
    }
}

impl<M: Medium, H: Host<M>> AxisPrograms for Lane<M, H> {
    fn memory_rules(&self, axis: AxisIndex) -> Option<&'static MemoryRules> {
        Some(self.slot(axis).ok()?.driver.memory()?.memory_rules())
    }

    fn start_transfer(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: TransferKind,
        pieces: &[MemoryBlock],
    ) -> Result<(), Unsupported> {
        let rules = self.slot(axis)?.driver.memory().ok_or(Unsupported::NoPlan)?.memory_rules();
        let disturbs = kind == TransferKind::Write && self.is_moving(axis);
        if disturbs || self.jobs.has_transfer(axis) {
            return Err(Unsupported::Busy);
        }
        let transfer = MemoryTransfer::new(kind, rules, pieces.to_vec())?;
        self.jobs.add(ticket, axis, JobTask::Transfer(kind), false)?;
        if let Some(slot) = self.slots.get_mut(usize::from(axis.0)) {
            slot.transfer = Some(Box::new(transfer));
        }
        Ok(())
    }

    fn last_transfer(&self, axis: AxisIndex) -> Option<&MemoryTransfer> {
        self.slot(axis).ok()?.transfer.as_deref()
    }

    fn send_program_command(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: ProgramCommand,
    ) -> Result<(), Unsupported> {
        let request = self.slot(axis)?.program_request(command).ok_or(Unsupported::NoPlan)?;
        if request.class() == RequestClass::NoRetry && self.is_moving(axis) {
            return Err(Unsupported::Busy);
        }
        self.queue_raw_request(ticket, axis, request)
    }
}

impl<M: Medium, H: Host<M>> AxisTraffic for Lane<M, H> {
    fn counters(&self) -> Counters {
        self.host.counters()
    }

    fn silence_counters(&self, axis: AxisIndex) -> Counters {
        self.slot(axis).map_or(Counters::default(), |slot| slot.silence_counters)
    }

    fn enable_events(&mut self, on: bool) {
        let states = self.slots.iter().map(|slot| &slot.state);
        self.events = on.then(|| Box::new(EventQueue::new(states)));
    }

    fn poll_axis_event(&mut self, now: Instant) -> Option<AxisEvent> {
        let event_queue = self.events.as_mut()?;
        event_queue.pop(now).or_else(|| {
            event_queue.compare(now, &self.slots);
            event_queue.pop(now)
        })
    }

    fn sends_keepalive(&self) -> bool {
        self.cyclic.as_ref().is_some_and(|cycle| cycle.is_running()) || self.host.sends_keepalive()
    }

    fn handle_resume(&mut self, now: Instant) {
        self.host.handle_resume(now);
    }
}
