//! The PDO engine: mappings resolved when they are written, so that a frame costs a few shifts.

use super::comm::{MAPPED_MAX, Pdo};
use super::{CanEnd, Firmware, emcy};
use crate::medium::Frame;
use crate::proto::canopen::nmt::State;
use crate::proto::canopen::od::Dictionary;
use crate::proto::canopen::pdo::{CobId, Entry, Transmission};
use crate::time::Instant;

/// The identifier of a PDO that is not there: no frame has it.
pub(super) const NONE: u32 = u32::MAX;

/// One mapped value. Bits that map nothing have none.
#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    tag: u16,
    /// Bits of the frame above it.
    above: u8,
    /// Bits that it lacks of 64, and [`Slot::SIGNED`].
    lacks: u8,
}

impl Slot {
    const SIGNED: u8 = 0x80;

    /// A value of so many bits from bit `at` on.
    const fn new(tag: u16, at: u8, bits: u8, signed: bool) -> Self {
        let lacks = 64u8.saturating_sub(bits);
        let above = lacks.saturating_sub(at);
        Self { tag, above, lacks: if signed { lacks | Self::SIGNED } else { lacks } }
    }

    /// `value` at its place, what does not fit cut off, among zeros.
    #[inline]
    const fn place(self, value: u64) -> u64 {
        value << (self.lacks & 63) >> (self.above & 63)
    }

    /// The value at its place.
    #[inline]
    const fn value(self, data: u64) -> u64 {
        let top = data << (self.above & 63);
        if self.lacks & Self::SIGNED != 0 {
            return (top.cast_signed() >> (self.lacks & 63)).cast_unsigned();
        }
        top >> (self.lacks & 63)
    }

    /// Whether so many bits of a frame hold all of it.
    #[inline]
    const fn is_within(self, bits: u8) -> bool {
        64 - self.above <= bits
    }
}

/// The values of a frame.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(super) struct Layout {
    bytes: u8,
    count: u8,
    slots: [Slot; MAPPED_MAX],
}

impl Layout {
    /// What the objects of a PDO map.
    fn of(pdo: &Pdo, dictionary: &Dictionary) -> Self {
        let mut layout = Self::default();
        let mut at = 0;
        for raw in pdo.map.iter().take(usize::from(pdo.count)) {
            let entry = Entry::from(*raw);
            let found = dictionary.find(entry.object.index, entry.object.sub);
            if let Some(found) = found.filter(|_| !entry.is_gap()) {
                let slot = Slot::new(found.tag, at, entry.bits, found.kind.is_signed());
                layout.slots[usize::from(layout.count)] = slot;
                layout.count += 1;
            }
            at += entry.bits;
        }
        layout.bytes = at.div_ceil(8);
        layout
    }

    #[inline]
    fn slots(&self) -> &[Slot] {
        &self.slots[..usize::from(self.count).min(MAPPED_MAX)]
    }

    #[inline]
    fn pack(&self, firmware: &mut impl Firmware) -> u64 {
        self.slots().iter().fold(0, |data, slot| data | slot.place(firmware.get(slot.tag)))
    }

    /// Hands over the values that lie within `bits` bits.
    #[inline]
    fn unpack(&self, now: Instant, data: u64, bits: u8, firmware: &mut impl Firmware) {
        for slot in self.slots() {
            if !slot.is_within(bits) {
                return;
            }
            // What the object does not take stays as it was; no service tells the sender.
            let _ = firmware.set(now, slot.tag, slot.value(data));
        }
    }
}

/// A PDO that is received.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Take {
    /// By when the next one must have come, once one has.
    pub(super) missed_at: Instant,
    /// How long the next one may take, ns; 0 is for ever.
    within_ns: u64,
    /// What came last and may wait for SYNC: data and bits.
    latest: (u64, u8),
    by_sync: bool,
    layout: Layout,
}

impl Default for Take {
    fn default() -> Self {
        let layout = Layout::default();
        Self { layout, by_sync: false, latest: (0, 0), within_ns: 0, missed_at: Instant::FAR }
    }
}

/// A PDO that is sent.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Send {
    free_at: Instant,
    event_at: Instant,
    /// Least time between two, ns.
    inhibit_ns: u64,
    /// What is sent next, or was sent last.
    data: u64,
    id: u32,
    kind: Transmission,
    remote: bool,
    /// Something was changed and waits for the inhibit time.
    wanted: bool,
    start: u8,
    /// SYNCs until the next one is sent; 0 waits for the start value.
    left: u8,
    layout: Layout,
}

/// The PDOs that are sent.
#[derive(Clone, Debug)]
pub(super) struct Sends<const N: usize> {
    /// Those to be sent, a bit each.
    pub(super) ready: u32,
    /// Those that go by change.
    pub(super) watch: u32,
    /// Those that go by SYNC.
    synced: u32,
    /// Those that go by the SYNC after a change.
    on_change: u32,
    all: [Send; N],
}

impl<const N: usize> Sends<N> {
    pub(super) const fn new() -> Self {
        const { assert!(N <= 32, "a PDO is a bit") };
        let slots = [Slot::new(0, 0, 0, false); MAPPED_MAX];
        let none = Send {
            layout: Layout { slots, count: 0, bytes: 0 },
            id: NONE,
            kind: Transmission::Profile,
            remote: false,
            data: 0,
            left: 0,
            start: 0,
            wanted: false,
            inhibit_ns: 0,
            free_at: Instant::ZERO,
            event_at: Instant::FAR,
        };
        Self { ready: 0, watch: 0, synced: 0, on_change: 0, all: [none; N] }
    }

    pub(super) fn due(&self) -> Instant {
        let at = |send: &Send| match send.wanted {
            true => send.event_at.min(send.free_at),
            false => send.event_at,
        };
        self.all.iter().map(at).fold(Instant::FAR, Instant::min)
    }
}

/// Numbers of the bits that are set.
fn bits(mut mask: u32) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let n = mask.trailing_zeros();
        mask &= mask.wrapping_sub(1);
        (n < 32).then_some(n as usize)
    })
}

impl<const N: usize> CanEnd<N> {
    /// All PDOs as their objects now say.
    pub(super) fn apply_pdos(&mut self, now: Instant, firmware: &mut impl Firmware) {
        for n in 0..N {
            self.apply_take(n, firmware);
            self.apply_send(now, n, firmware);
        }
    }

    /// An RPDO's objects were written.
    pub(super) fn apply_take(&mut self, n: usize, firmware: &impl Firmware) {
        let pdo = &self.comm.rpdo[n];
        let exists = pdo.is_valid() && pdo.count > 0;
        self.heard[n] = if exists { CobId(pdo.cob).id() } else { NONE };
        let layout = Layout::of(pdo, firmware.dictionary());
        self.waiting &= !(1 << n);
        let within_ns = u64::from(pdo.event) * u64::from(self.options.event_unit_us) * 1000;
        self.takes[n] = Take { layout, by_sync: pdo.kind <= 240, within_ns, ..Take::default() };
    }

    /// A TPDO's objects were written.
    pub(super) fn apply_send(&mut self, now: Instant, n: usize, firmware: &mut impl Firmware) {
        let pdo = &self.comm.tpdo[n];
        let exists = pdo.is_valid() && pdo.count > 0;
        let kind = Transmission::from(pdo.kind);
        let bit = 1 << n;
        let send = &mut self.sends.all[n];
        send.layout = Layout::of(pdo, firmware.dictionary());
        send.id = if exists { CobId(pdo.cob).id() } else { NONE };
        send.remote = pdo.cob & CobId::FLAG == 0;
        (send.kind, send.start) = (kind, pdo.start);
        send.inhibit_ns = u64::from(pdo.inhibit) * u64::from(self.options.inhibit_unit_us) * 1000;
        (send.wanted, send.event_at) = (false, Instant::FAR);
        let event = matches!(kind, Transmission::Manufacturer | Transmission::Profile);
        let timed = kind == Transmission::Manufacturer && self.options.timed_254;
        let put = |mask: &mut u32, on: bool| *mask = if on { *mask | bit } else { *mask & !bit };
        put(&mut self.sends.watch, exists && event && !timed);
        put(&mut self.sends.synced, exists && kind.is_synchronous());
        put(&mut self.sends.on_change, exists && kind == Transmission::OnChange);
        put(&mut self.sends.ready, false);
        if self.state == State::Operational && exists {
            self.start_pdo(now, n, firmware);
        }
    }

    /// Operational begins.
    pub(super) fn start_pdos(&mut self, now: Instant, firmware: &mut impl Firmware) {
        self.waiting = 0;
        for n in 0..N {
            if self.sends.all[n].id != NONE {
                self.start_pdo(now, n, firmware);
            }
        }
    }

    /// Those that go by events are sent once, so that whoever listens knows.
    fn start_pdo(&mut self, now: Instant, n: usize, firmware: &mut impl Firmware) {
        let send = &mut self.sends.all[n];
        send.data = send.layout.pack(firmware);
        send.free_at = now;
        send.left = match (send.kind, send.start) {
            (_, 1..) => 0,
            (Transmission::Cyclic(every), _) => every,
            _ => 1,
        };
        if self.sends.watch >> n & 1 != 0 || send.kind == Transmission::OnChange {
            self.want(now, n);
        }
        self.arm_event(now, n);
    }

    fn arm_event(&mut self, now: Instant, n: usize) {
        let event = u64::from(self.comm.tpdo[n].event) * u64::from(self.options.event_unit_us);
        let send = &mut self.sends.all[n];
        let timed = matches!(send.kind, Transmission::Manufacturer | Transmission::Profile);
        send.event_at = if event > 0 && timed { now.plus_ns(event * 1000) } else { Instant::FAR };
        let at = send.event_at;
        self.arm(at);
    }

    /// A PDO is to be sent, as soon as its inhibit time lets it; one of type 0 with the next SYNC.
    #[inline]
    fn want(&mut self, now: Instant, n: usize) {
        let send = &mut self.sends.all[n];
        if send.kind == Transmission::OnChange || now < send.free_at {
            send.wanted = true;
            let at = send.free_at;
            if send.kind != Transmission::OnChange {
                self.arm(at);
            }
        } else {
            self.sends.ready |= 1 << n;
        }
    }

    /// Looks whether values have changed that are sent when they do.
    #[inline]
    pub(super) fn look(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let watched = self.sends.watch | self.sends.on_change;
        if watched != 0 && self.is_live() {
            self.compare(now, watched, firmware);
        }
    }

    fn compare(&mut self, now: Instant, watched: u32, firmware: &mut impl Firmware) {
        for n in bits(watched) {
            let send = &mut self.sends.all[n];
            let data = send.layout.pack(firmware);
            if data != send.data {
                send.data = data;
                self.want(now, n);
            }
        }
    }

    pub(super) fn pdo_timers(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let operational = self.state == State::Operational;
        for n in 0..N {
            let send = &mut self.sends.all[n];
            let (freed, event) = (send.wanted && now >= send.free_at, now >= send.event_at);
            if freed && send.kind != Transmission::OnChange {
                send.wanted = false;
                self.sends.ready |= u32::from(operational) << n;
            }
            if event {
                send.data = send.layout.pack(firmware);
                self.arm_event(now, n);
                self.sends.ready |= u32::from(operational) << n;
            }
            if now >= self.takes[n].missed_at {
                self.takes[n].missed_at = Instant::FAR;
                self.raise(emcy::PDO_MISSING, false, firmware);
            }
        }
    }

    /// The next PDO to send, unless its SYNC window is over.
    #[inline]
    pub(super) fn next_pdo(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        while self.sends.ready != 0 {
            let n = self.sends.ready.trailing_zeros() as usize;
            self.sends.ready &= self.sends.ready - 1;
            let send = &mut self.sends.all[n];
            let late = self.sends.synced >> n & 1 != 0 && now > self.sync.open_until;
            if send.id == NONE || late {
                continue;
            }
            if send.inhibit_ns > 0 {
                send.free_at = now.plus_ns(send.inhibit_ns);
            }
            let (id, len) = (send.id, send.layout.bytes);
            let data = send.data.to_le_bytes();
            if send.event_at != Instant::FAR {
                self.arm_event(now, n);
            }
            *out = Frame { id, extended: false, remote: false, len, data };
            return Some(1);
        }
        None
    }

    /// A PDO came.
    #[inline]
    pub(super) fn take(
        &mut self,
        now: Instant,
        n: usize,
        frame: &Frame,
        firmware: &mut impl Firmware,
    ) {
        let take = &mut self.takes[n];
        let (len, bytes) = (frame.len, take.layout.bytes);
        if len != bytes {
            if len > bytes {
                self.raise_length(emcy::PDO_LONG, firmware);
            } else if !self.options.lenient {
                return self.raise_length(emcy::PDO_SHORT, firmware);
            }
        }
        let take = &mut self.takes[n];
        let (data, bits) = (u64::from_le_bytes(frame.data), 8 * len.min(8));
        if take.within_ns > 0 {
            take.missed_at = now.plus_ns(take.within_ns);
            self.due = self.due.min(take.missed_at);
        }
        if take.by_sync {
            if now <= self.sync.open_until {
                take.latest = (data, bits);
                self.waiting |= 1 << n;
            }
            return;
        }
        take.layout.unpack(now, data, bits, firmware);
        self.look(now, firmware);
    }

    #[cold]
    fn raise_length(&mut self, code: u16, firmware: &impl Firmware) {
        if !self.options.lenient {
            self.raise(code, false, firmware);
        }
    }

    /// What waited for SYNC is taken.
    #[inline]
    pub(super) fn take_waiting(&mut self, now: Instant, firmware: &mut impl Firmware) {
        for n in bits(core::mem::take(&mut self.waiting)) {
            let (data, bits) = self.takes[n].latest;
            self.takes[n].layout.unpack(now, data, bits, firmware);
        }
    }

    /// What goes with SYNC is sampled and sent.
    #[inline]
    pub(super) fn sample(&mut self, counter: u8, firmware: &mut impl Firmware) {
        for n in bits(self.sends.synced) {
            let send = &mut self.sends.all[n];
            match send.kind {
                Transmission::Cyclic(every) => {
                    if send.left == 0 {
                        if counter != send.start {
                            continue;
                        }
                        send.left = 1;
                    }
                    send.left -= 1;
                    if send.left == 0 {
                        send.left = every;
                        send.data = send.layout.pack(firmware);
                        self.sends.ready |= 1 << n;
                    }
                }
                Transmission::OnChange if send.wanted => {
                    send.wanted = false;
                    send.data = send.layout.pack(firmware);
                    self.sends.ready |= 1 << n;
                }
                Transmission::SampledOnRequest => send.data = send.layout.pack(firmware),
                _ => {}
            }
        }
    }

    /// A remote request for a PDO.
    pub(super) fn pdo_asked(&mut self, now: Instant, id: u32, firmware: &mut impl Firmware) {
        if self.state != State::Operational {
            return;
        }
        let Some(n) = self.sends.all.iter().position(|send| send.id == id && send.remote) else {
            return;
        };
        let send = &mut self.sends.all[n];
        if send.kind != Transmission::SampledOnRequest {
            send.data = send.layout.pack(firmware);
        }
        // What is sampled by SYNC is sent outside its window too when somebody asks.
        self.sync.open_until = self.sync.open_until.max(now);
        self.sends.ready |= 1 << n;
    }
}
