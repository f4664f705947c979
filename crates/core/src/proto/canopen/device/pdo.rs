//! The PDO engine. Mappings are resolved when they are written, so a frame costs a few shifts.

use super::communication::{MAPPED_MAX, PdoObjects};
use super::{CanEndpoint, Firmware, emcy};
use crate::medium::Frame;
use crate::proto::canopen::nmt::NmtState;
use crate::proto::canopen::od::Dictionary;
use crate::proto::canopen::pdo::{CobId, MappingEntry, Transmission};
use crate::time::Instant;

/// The identifier of a PDO that is not there: no frame has it.
pub(super) const NO_ID: u32 = u32::MAX;

/// One mapped value. Bits that map nothing have none.
#[derive(Clone, Copy, Debug, Default)]
struct MappedSlot {
    tag: u16,
    /// Bits of the frame above it.
    bits_above: u8,
    /// Bits that it lacks of 64, and [`MappedSlot::SIGNED`].
    bits_missing: u8,
}

impl MappedSlot {
    const SIGNED: u8 = 0x80;

    /// A value of `bits` bits from bit `at` on.
    const fn new(tag: u16, at: u8, bits: u8, signed: bool) -> Self {
        let lacks = 64u8.saturating_sub(bits);
        let bits_above = lacks.saturating_sub(at);
        Self { tag, bits_above, bits_missing: if signed { lacks | Self::SIGNED } else { lacks } }
    }

    /// `value` at its place, what does not fit cut off, among zeros.
    #[inline]
    const fn shift_in(self, value: u64) -> u64 {
        value << (self.bits_missing & 63) >> (self.bits_above & 63)
    }

    /// The value at its place.
    #[inline]
    const fn extract(self, data: u64) -> u64 {
        let top = data << (self.bits_above & 63);
        if self.bits_missing & Self::SIGNED != 0 {
            return (top.cast_signed() >> (self.bits_missing & 63)).cast_unsigned();
        }
        top >> (self.bits_missing & 63)
    }

    /// Returns whether it begins within `bits` bits of a frame.
    const fn begins_within(self, bits: u8) -> bool {
        self.bits_missing - self.bits_above < bits
    }

    /// Returns whether `bits` bits of a frame hold all of it.
    #[inline]
    const fn is_within(self, bits: u8) -> bool {
        64 - self.bits_above <= bits
    }
}

/// The values of a frame.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(super) struct PdoLayout {
    bytes: u8,
    count: u8,
    slots: [MappedSlot; MAPPED_MAX],
}

impl PdoLayout {
    /// The mapping in a PDO's objects.
    fn of(pdo: &PdoObjects, dictionary: &Dictionary) -> Self {
        let mut layout = Self::default();
        let mut at = 0;
        for raw in pdo.map.iter().take(usize::from(pdo.count)) {
            let entry = MappingEntry::from(*raw);
            let found = dictionary.find(entry.object.index, entry.object.sub);
            if let Some(found) = found.filter(|_| !entry.is_gap()) {
                let slot = MappedSlot::new(found.tag, at, entry.bits, found.kind.is_signed());
                layout.slots[usize::from(layout.count)] = slot;
                layout.count += 1;
            }
            at += entry.bits;
        }
        layout.bytes = at.div_ceil(8);
        layout
    }

    #[inline]
    fn slots(&self) -> &[MappedSlot] {
        &self.slots[..usize::from(self.count).min(MAPPED_MAX)]
    }

    #[inline]
    fn pack(&self, firmware: &mut impl Firmware) -> u64 {
        self.slots().iter().fold(0, |data, slot| data | slot.shift_in(firmware.get(slot.tag)))
    }

    /// Returns whether a value begins within `bits` bits and does not end there.
    fn cuts(&self, bits: u8) -> bool {
        self.slots().iter().any(|slot| slot.begins_within(bits) && !slot.is_within(bits))
    }

    /// Passes on the values within `bits` bits.
    #[inline]
    fn unpack(&self, now: Instant, data: u64, bits: u8, firmware: &mut impl Firmware) {
        for slot in self.slots() {
            if !slot.is_within(bits) {
                return;
            }
            // A value that the object refuses is dropped; no service notifies the sender.
            let _ = firmware.set(now, slot.tag, slot.extract(data));
        }
    }
}

/// A PDO that is received.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct ReceivePdo {
    /// Deadline of the next one, once one has arrived.
    pub(super) deadline: Instant,
    /// Longest pause to the next one, ns; 0 is for ever.
    timeout_ns: u64,
    /// Last received PDO that may wait for SYNC: data and bits.
    last_data: (u64, u8),
    on_sync: bool,
    layout: PdoLayout,
}

impl Default for ReceivePdo {
    fn default() -> Self {
        let layout = PdoLayout::default();
        Self {
            layout,
            on_sync: false,
            last_data: (0, 0),
            timeout_ns: 0,
            deadline: Instant::FAR_FUTURE,
        }
    }
}

/// A PDO that is sent.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct TransmitPdo {
    free_at: Instant,
    event_at: Instant,
    /// Least time between two, ns.
    inhibit_ns: u64,
    /// Data of the next or last sent PDO.
    data: u64,
    id: u32,
    kind: Transmission,
    remote: bool,
    /// Something was changed and waits for the inhibit time.
    send_pending: bool,
    start: u8,
    /// SYNCs until the next one is sent; 0 waits for the start value.
    syncs_left: u8,
    layout: PdoLayout,
}

/// The PDOs that are sent.
#[derive(Clone, Debug)]
pub(super) struct TransmitPdos<const N: usize> {
    /// PDOs that are to be sent, a bit each.
    pub(super) ready: u32,
    /// PDOs that are sent by change.
    pub(super) event_driven: u32,
    /// PDOs that are sent by SYNC.
    sync_driven: u32,
    /// PDOs that are sent by the SYNC after a change.
    sync_after_change: u32,
    all: [TransmitPdo; N],
}

impl<const N: usize> TransmitPdos<N> {
    pub(super) const fn new() -> Self {
        const { assert!(N <= 32, "a PDO is a bit") };
        let slots = [MappedSlot::new(0, 0, 0, false); MAPPED_MAX];
        let none = TransmitPdo {
            layout: PdoLayout { slots, count: 0, bytes: 0 },
            id: NO_ID,
            kind: Transmission::Profile,
            remote: false,
            data: 0,
            syncs_left: 0,
            start: 0,
            send_pending: false,
            inhibit_ns: 0,
            free_at: Instant::ZERO,
            event_at: Instant::FAR_FUTURE,
        };
        Self { ready: 0, event_driven: 0, sync_driven: 0, sync_after_change: 0, all: [none; N] }
    }

    pub(super) fn due(&self) -> Instant {
        self.all
            .iter()
            .map(
                |send| {
                    if send.send_pending { send.event_at.min(send.free_at) } else { send.event_at }
                },
            )
            .fold(Instant::FAR_FUTURE, Instant::min)
    }
}

/// Numbers of the bits that are set.
fn set_bits(mut mask: u32) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let n = mask.trailing_zeros();
        mask &= mask.wrapping_sub(1);
        (n < 32).then_some(n as usize)
    })
}

impl<const N: usize> CanEndpoint<N> {
    /// Applies all PDOs by their present objects.
    pub(super) fn apply_pdos(&mut self, now: Instant, firmware: &mut impl Firmware) {
        for n in 0..N {
            self.apply_rpdo(n, firmware);
            self.apply_tpdo(now, n, firmware);
        }
    }

    /// An RPDO's objects were written.
    pub(super) fn apply_rpdo(&mut self, n: usize, firmware: &impl Firmware) {
        let pdo = &self.communication.rpdo[n];
        let exists = pdo.is_valid() && pdo.count > 0;
        self.rpdo_ids[n] = if exists { CobId(pdo.cob).id() } else { NO_ID };
        let layout = PdoLayout::of(pdo, firmware.dictionary());
        self.rpdos_waiting &= !(1 << n);
        let within_ns = u64::from(pdo.event) * u64::from(self.quirks.event_unit_us) * 1000;
        self.rpdos[n] = ReceivePdo {
            layout,
            on_sync: pdo.kind <= 240,
            timeout_ns: within_ns,
            ..ReceivePdo::default()
        };
    }

    /// A TPDO's objects were written.
    pub(super) fn apply_tpdo(&mut self, now: Instant, n: usize, firmware: &mut impl Firmware) {
        let pdo = &self.communication.tpdo[n];
        let exists = pdo.is_valid() && pdo.count > 0;
        let kind = Transmission::from(pdo.kind);
        let bit = 1 << n;
        let send = &mut self.tpdos.all[n];
        send.layout = PdoLayout::of(pdo, firmware.dictionary());
        send.id = if exists { CobId(pdo.cob).id() } else { NO_ID };
        send.remote = pdo.cob & CobId::FLAG == 0;
        (send.kind, send.start) = (kind, pdo.start);
        send.inhibit_ns = u64::from(pdo.inhibit) * u64::from(self.quirks.inhibit_unit_us) * 1000;
        (send.send_pending, send.event_at) = (false, Instant::FAR_FUTURE);
        let event = matches!(kind, Transmission::Manufacturer | Transmission::Profile);
        let timed = kind == Transmission::Manufacturer && self.quirks.type_254_by_timer;
        put_bit(&mut self.tpdos.event_driven, exists && event && !timed, bit);
        put_bit(&mut self.tpdos.sync_driven, exists && kind.is_synchronous(), bit);
        put_bit(&mut self.tpdos.sync_after_change, exists && kind == Transmission::OnChange, bit);
        put_bit(&mut self.tpdos.ready, false, bit);
        if self.state == NmtState::Operational && exists {
            self.start_pdo(now, n, firmware);
        }
    }

    /// Operational begins.
    pub(super) fn start_pdos(&mut self, now: Instant, firmware: &mut impl Firmware) {
        self.rpdos_waiting = 0;
        for n in 0..N {
            if self.tpdos.all[n].id != NO_ID {
                self.start_pdo(now, n, firmware);
            }
        }
    }

    /// Sends event-driven PDOs once, so that receivers know the values.
    fn start_pdo(&mut self, now: Instant, n: usize, firmware: &mut impl Firmware) {
        let send = &mut self.tpdos.all[n];
        send.data = send.layout.pack(firmware);
        send.free_at = now;
        send.syncs_left = match (send.kind, send.start) {
            (_, 1..) => 0,
            (Transmission::Cyclic(every), _) => every,
            _ => 1,
        };
        if self.tpdos.event_driven >> n & 1 != 0 || send.kind == Transmission::OnChange {
            self.request_send(now, n);
        }
        self.arm_event(now, n);
    }

    fn arm_event(&mut self, now: Instant, n: usize) {
        let event =
            u64::from(self.communication.tpdo[n].event) * u64::from(self.quirks.event_unit_us);
        let send = &mut self.tpdos.all[n];
        let timed = matches!(send.kind, Transmission::Manufacturer | Transmission::Profile);
        send.event_at =
            if event > 0 && timed { now.plus_ns(event * 1000) } else { Instant::FAR_FUTURE };
        let at = send.event_at;
        self.schedule(at);
    }

    /// A PDO is to be sent, as soon as its inhibit time lets it; one of type 0 with the next SYNC.
    #[inline]
    fn request_send(&mut self, now: Instant, n: usize) {
        let send = &mut self.tpdos.all[n];
        if send.kind == Transmission::OnChange || now < send.free_at {
            send.send_pending = true;
            let at = send.free_at;
            if send.kind != Transmission::OnChange {
                self.schedule(at);
            }
        } else {
            self.tpdos.ready |= 1 << n;
        }
    }

    /// Looks whether values have changed that are sent when they do.
    #[inline]
    pub(super) fn check_changes(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let watched = self.tpdos.event_driven | self.tpdos.sync_after_change;
        if watched != 0 && self.is_active() {
            self.compare_values(now, watched, firmware);
        }
    }

    fn compare_values(&mut self, now: Instant, watched: u32, firmware: &mut impl Firmware) {
        for n in set_bits(watched) {
            let send = &mut self.tpdos.all[n];
            let data = send.layout.pack(firmware);
            if data != send.data {
                send.data = data;
                self.request_send(now, n);
            }
        }
    }

    pub(super) fn run_pdo_timers(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let operational = self.state == NmtState::Operational;
        for n in 0..N {
            let send = &mut self.tpdos.all[n];
            let (freed, event) = (send.send_pending && now >= send.free_at, now >= send.event_at);
            if freed && send.kind != Transmission::OnChange {
                send.send_pending = false;
                self.tpdos.ready |= u32::from(operational) << n;
            }
            if event {
                send.data = send.layout.pack(firmware);
                self.arm_event(now, n);
                self.tpdos.ready |= u32::from(operational) << n;
            }
            if now >= self.rpdos[n].deadline {
                self.rpdos[n].deadline = Instant::FAR_FUTURE;
                self.raise_error(emcy::PDO_MISSING, false, firmware);
            }
        }
    }

    /// The next PDO to send, unless its SYNC window is over.
    #[inline]
    pub(super) fn next_pdo(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        while self.tpdos.ready != 0 {
            let n = self.tpdos.ready.trailing_zeros() as usize;
            self.tpdos.ready &= self.tpdos.ready - 1;
            let send = &mut self.tpdos.all[n];
            let late = self.tpdos.sync_driven >> n & 1 != 0 && now > self.sync.window_until;
            if send.id == NO_ID || late {
                continue;
            }
            if send.inhibit_ns > 0 {
                send.free_at = now.plus_ns(send.inhibit_ns);
            }
            let (id, len) = (send.id, send.layout.bytes);
            let data = send.data.to_le_bytes();
            if send.event_at != Instant::FAR_FUTURE {
                self.arm_event(now, n);
            }
            *out = Frame { id, extended: false, remote: false, len, data };
            return Some(1);
        }
        None
    }

    /// A PDO came.
    #[inline]
    pub(super) fn handle_rpdo(
        &mut self,
        now: Instant,
        n: usize,
        frame: &Frame,
        firmware: &mut impl Firmware,
    ) {
        let take = &mut self.rpdos[n];
        let (len, bytes) = (frame.len, take.layout.bytes);
        if len != bytes {
            if len > bytes {
                self.raise_length_error(emcy::PDO_LONG, firmware);
            } else if !self.quirks.lenient || take.layout.cuts(8 * len) {
                return self.raise_error(emcy::PDO_SHORT, false, firmware);
            }
        }
        let take = &mut self.rpdos[n];
        let (data, bits) = (u64::from_le_bytes(frame.data), 8 * len.min(8));
        if take.timeout_ns > 0 {
            take.deadline = now.plus_ns(take.timeout_ns);
            self.next_due = self.next_due.min(take.deadline);
        }
        if take.on_sync {
            if now <= self.sync.window_until {
                take.last_data = (data, bits);
                self.rpdos_waiting |= 1 << n;
            }
            return;
        }
        take.layout.unpack(now, data, bits, firmware);
        self.check_changes(now, firmware);
    }

    #[cold]
    fn raise_length_error(&mut self, code: u16, firmware: &impl Firmware) {
        if !self.quirks.lenient {
            self.raise_error(code, false, firmware);
        }
    }

    /// Applies the PDOs that waited for SYNC.
    #[inline]
    pub(super) fn apply_waiting_rpdos(&mut self, now: Instant, firmware: &mut impl Firmware) {
        for n in set_bits(core::mem::take(&mut self.rpdos_waiting)) {
            let (data, bits) = self.rpdos[n].last_data;
            self.rpdos[n].layout.unpack(now, data, bits, firmware);
        }
    }

    /// Samples and sends the PDOs of this SYNC.
    #[inline]
    pub(super) fn sample_tpdos(&mut self, counter: u8, firmware: &mut impl Firmware) {
        for n in set_bits(self.tpdos.sync_driven) {
            let send = &mut self.tpdos.all[n];
            match send.kind {
                Transmission::Cyclic(every) => {
                    if send.syncs_left == 0 {
                        if counter != send.start {
                            continue;
                        }
                        send.syncs_left = 1;
                    }
                    send.syncs_left -= 1;
                    if send.syncs_left == 0 {
                        send.syncs_left = every;
                        send.data = send.layout.pack(firmware);
                        self.tpdos.ready |= 1 << n;
                    }
                }
                Transmission::OnChange if send.send_pending => {
                    send.send_pending = false;
                    send.data = send.layout.pack(firmware);
                    self.tpdos.ready |= 1 << n;
                }
                Transmission::SampledOnRequest => send.data = send.layout.pack(firmware),
                _ => {}
            }
        }
    }

    /// A remote request for a PDO.
    pub(super) fn handle_pdo_request(
        &mut self,
        now: Instant,
        id: u32,
        firmware: &mut impl Firmware,
    ) {
        if self.state != NmtState::Operational {
            return;
        }
        let Some(n) = self.tpdos.all.iter().position(|send| send.id == id && send.remote) else {
            return;
        };
        let send = &mut self.tpdos.all[n];
        if send.kind != Transmission::SampledOnRequest {
            send.data = send.layout.pack(firmware);
        }
        // A PDO that is sampled by SYNC is sent outside its window too on a remote request.
        self.sync.window_until = self.sync.window_until.max(now);
        self.tpdos.ready |= 1 << n;
    }
}

fn put_bit(mask: &mut u32, on: bool, bit: u32) {
    *mask = if on { *mask | bit } else { *mask & !bit }
}
