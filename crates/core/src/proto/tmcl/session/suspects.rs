//! Modules of which an answer to an earlier request may still come.

use super::{
    Ask, LATEST_TIMEOUTS, Opcode, PROBES_MAX, Pending, Request, SUSPECTS_MAX, Session, Suspect,
    TAGS_MAX,
};
use crate::time::Instant;

impl Suspect {
    /// Opcodes of requests whose answers may still come.
    pub(super) fn owes(&self, now: Instant) -> impl Iterator<Item = u8> {
        let tags = &self.tags[..usize::from(self.count)];
        tags.iter().filter(move |(_, until)| now < *until).map(|(opcode, _)| *opcode)
    }

    /// Lets go of requests whose answers can come no more.
    fn forget(&mut self, now: Instant) {
        let mut kept = 0;
        for n in 0..usize::from(self.count) {
            if now < self.tags[n].1 {
                self.tags[kept] = self.tags[n];
                kept += 1;
            }
        }
        self.count = kept as u8;
    }
}

impl Session {
    /// What a module said of a parameter cannot be: since a copy of an older reply each answer may be the one
    /// to the question before, and the last is still to come. So a probe of another opcode is asked.
    #[cold]
    pub(in crate::proto::tmcl) fn mistrust(&mut self, now: Instant, address: u32) {
        let Ok(address) = u8::try_from(address) else { return };
        let request = Request { address, opcode: Opcode::Gap, kind: 0, motor: 0, value: 0 };
        let owed = Pending { attempts: 1, ..Pending::new(now, None, Ask::of(request), 0) };
        self.suspect(now, &owed, true);
        self.next(now);
    }

    /// Notes that replies of `pending` may still come.
    pub(super) fn suspect(&mut self, now: Instant, pending: &Pending, probe: bool) {
        if pending.attempts == 0 {
            return;
        }
        let module = pending.ask.request.address;
        let until = now.plus_ns(LATEST_TIMEOUTS * self.timeout_ns);
        let of_module = |s: &Option<Suspect>| s.is_some_and(|s| s.module == module);
        let free = |slots: &[Option<Suspect>]| slots.iter().position(Option::is_none);
        let place = self.suspects.iter().position(of_module).or_else(|| free(&self.suspects));
        // A full table keeps its oldest entry longest: the line is closed until one is out.
        let place = place.unwrap_or(SUSPECTS_MAX - 1);
        let tags = [(0, until); TAGS_MAX];
        let fresh = Suspect { module, tags, count: 0, probes: 0, probe_due: false, until };
        let suspect = self.suspects[place].get_or_insert(fresh);
        suspect.forget(now);
        for _ in 0..pending.attempts {
            if let Some(tag) = suspect.tags.get_mut(usize::from(suspect.count)) {
                *tag = (pending.ask.request.opcode.number(), until);
                suspect.count += 1;
            }
        }
        suspect.until = suspect.until.max(until);
        // A module that says "wrong checksum" is there and quick: it is worth trying on.
        suspect.probe_due = probe && (suspect.probes < PROBES_MAX || pending.doubts.bad_sum);
        self.suspicious = true;
    }

    pub(super) fn trust(&mut self, module: u8) {
        for slot in &mut self.suspects {
            if slot.is_some_and(|suspect| suspect.module == module) {
                *slot = None;
            }
        }
        self.note_suspicion();
    }

    pub(super) fn expire_suspects(&mut self, now: Instant) {
        let probed = self.pending.map(|pending| pending.ask.request.address);
        for slot in &mut self.suspects {
            let over = |s: &Suspect| now >= s.until && probed != Some(s.module);
            let Some(Suspect { module, .. }) = slot.filter(over) else { continue };
            *slot = None;
            // Time has passed, and proves nothing.
            self.proven.remove(module);
        }
        self.note_suspicion();
    }

    pub(super) fn note_suspicion(&mut self) {
        let suspects = self.suspects.iter().any(Option::is_some);
        self.suspicious = suspects || !self.unheard.is_empty() || !self.motors.is_empty();
    }

    pub(super) fn trusts(&mut self, now: Instant, module: u8) -> bool {
        self.expire_suspects(now);
        let full = self.suspects.iter().all(Option::is_some);
        !full && !self.suspects.iter().flatten().any(|suspect| suspect.module == module)
    }
}
