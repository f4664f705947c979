//! The device end: one node with its dictionary, its firmware, and all services of CiA 301 and LSS of CiA
//! 305.
//!
//! The [`Firmware`] is passed to each call. Objects of the protocol (1000h to 1FFFh with the tag
//! [`PROTOCOL_TAG`](super::od::PROTOCOL_TAG)) are in the [`CanEndpoint`]. All others belong to the
//! firmware, and are accessed by the tag of their [`ObjectEntry`](super::od::ObjectEntry). [`Quirks`] are
//! deviations from the standard.

mod communication;
mod emcy;
mod lss;
pub mod motion;
mod network;
mod objects;
mod pdo;
mod sdo;
mod send_slots;
mod sync;
#[cfg(test)]
mod tests;

use super::emcy::Emergency;
use super::nmt;
use super::od::Dictionary;
use super::sdo::AbortCode;
use super::time::TimeOfDay;
use crate::medium::{CanLine, Frame};
use crate::station::LineEvent;
use crate::time::Instant;

pub use communication::{CONSUMERS_MAX, is_protocol_object, standard_entries, standard_len};
pub use emcy::HISTORY_MAX;

/// Group of settings that is stored or restored (objects 1010h and 1011h).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SettingsGroup {
    /// All that are there.
    All,
    /// Objects 1000h to 1FFFh.
    Communication,
    /// Objects 6000h to 9FFFh.
    Application,
}

/// Identity of the node on its bus, which LSS may change.
pub trait NodeIdentity {
    /// Node-ID from the next reset of the communication on; none outside 1 to 127.
    fn node_id(&self) -> u8;

    /// Bit rate from the next power-on on, bit/s.
    fn bit_rate(&self) -> u32;

    /// Serial number (1018h sub-index 4).
    fn serial(&self) -> u32 {
        0
    }

    /// LSS gave another node-ID; 255 is none.
    fn set_node_id(&mut self, node: u8) {
        let _ = node;
    }

    /// LSS gave another bit rate. False when it has none such.
    fn set_bit_rate(&mut self, bit_rate: u32) -> bool {
        let _ = bit_rate;
        false
    }

    /// Stores node-ID and bit rate for LSS. False when it cannot.
    fn store_link(&mut self) -> bool {
        false
    }
}

/// Objects of any length.
pub trait DomainObjects {
    /// Length of an object of any length, bytes.
    fn length(&mut self, tag: u16) -> u32 {
        let _ = tag;
        0
    }

    /// Part of such an object, from `offset` on, within its length.
    fn read(&mut self, tag: u16, offset: u32, out: &mut [u8]) {
        let _ = (tag, offset, out);
    }

    /// Starts a write to an object; the size if the client stated it.
    ///
    /// # Errors
    /// Why it cannot.
    fn begin_write(&mut self, tag: u16, size: Option<u32>) -> Result<(), AbortCode> {
        let _ = (tag, size);
        Err(AbortCode::MEMORY)
    }

    /// Part of it, in order.
    ///
    /// # Errors
    /// Why it is not taken.
    fn write(&mut self, tag: u16, offset: u32, data: &[u8]) -> Result<(), AbortCode> {
        let _ = (tag, offset, data);
        Err(AbortCode::MEMORY)
    }

    /// All of it is written, and checked where there was a check.
    ///
    /// # Errors
    /// Why it is not taken.
    fn finish_write(&mut self, now: Instant, tag: u16, size: u32) -> Result<(), AbortCode> {
        let _ = (now, tag, size);
        Ok(())
    }
}

/// Settings in permanent memory.
pub trait NodeStorage {
    /// Stores its settings.
    fn store(&mut self, group: SettingsGroup) {
        let _ = group;
    }

    /// From the next reset on, settings are those from the factory.
    fn restore(&mut self, group: SettingsGroup) {
        let _ = group;
    }
}

/// The time of day of the device.
pub trait NodeClock {
    /// Sets the time of day.
    fn set_time_of_day(&mut self, now: Instant, time: TimeOfDay) {
        let _ = (now, time);
    }

    /// The device's own time of day, if it produces one.
    fn time_of_day(&mut self, now: Instant) -> Option<TimeOfDay> {
        let _ = now;
        None
    }
}

/// The firmware of a simulated node. Values are bytes of the object's type in a number, the first byte
/// lowest.
pub trait Firmware: NodeIdentity + DomainObjects + NodeStorage + NodeClock {
    /// Object dictionary of the device.
    fn dictionary(&self) -> &'static Dictionary;

    /// The value of an object of fixed length. What needs a sign has it in all 64 bits or not; what
    /// lies above the type's length does not count.
    fn get(&mut self, tag: u16) -> u64;

    /// Takes a value of an object of fixed length, within the entry's limits; a signed one has its
    /// sign in all 64 bits.
    ///
    /// # Errors
    /// Why it does not.
    fn set(&mut self, now: Instant, tag: u16, value: u64) -> Result<(), AbortCode>;

    /// Handles a SYNC in state operational, after the PDOs that wait for it.
    fn handle_sync(&mut self, now: Instant) {
        let _ = now;
    }

    /// The node is in another state.
    fn handle_nmt_state(&mut self, now: Instant, state: nmt::NmtState) {
        let _ = (now, state);
    }

    /// "Reset node": everything as after power-on.
    fn reset(&mut self, now: Instant);

    /// The bus or the master is lost: bus-off, a heartbeat or guarding that failed to come.
    fn handle_link_loss(&mut self, now: Instant);

    /// Value of 1001h, except for bit 4, which is the protocol's.
    fn error_register(&self) -> u8;

    /// The next emergency. The register is filled in by the protocol.
    fn poll_emergency(&mut self) -> Option<Emergency>;
}

/// Deviations of a node from the standard (SIM-15).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Quirks {
    /// SDO requests may be short, and their size need not be the object's; PDOs are mapped in any
    /// state without being switched off first; a PDO may be shorter than its mapping.
    pub lenient: bool,
    /// Process data are mapped and switched in the state pre-operational alone.
    pub maps_pre_operational: bool,
    /// The acknowledgement of a write repeats the data.
    pub echoes_writes: bool,
    /// True if it supports segmented and block transfer.
    pub segmented_sdo: bool,
    /// True if it has layer setting services.
    pub lss: bool,
    /// True if it accepts the time of day.
    pub time: bool,
    /// True if it replies to guarding requests.
    pub guarding: bool,
    /// Emergencies have two bytes, and none reports the end of a fault.
    pub short_emcy: bool,
    /// Unit of a PDO's inhibit time, µs.
    pub inhibit_unit_us: u32,
    /// Unit of a PDO's event timer, µs.
    pub event_unit_us: u32,
    /// Transmission type 254 goes by the event timer alone.
    pub type_254_by_timer: bool,
}

impl Quirks {
    /// Services as the standard has them.
    pub const STRICT: Self = Self {
        lenient: false,
        maps_pre_operational: false,
        echoes_writes: false,
        segmented_sdo: true,
        lss: true,
        time: true,
        guarding: true,
        short_emcy: false,
        inhibit_unit_us: 100,
        event_unit_us: 1000,
        type_254_by_timer: false,
    };
}

/// The node's end of the bus, with up to `N` PDOs each way.
///
/// The fields lie in memory in this order: what each cycle needs is together, at the end, where the firmware that is
/// kept behind it begins with what it needs each cycle.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct CanEndpoint<const N: usize = 4> {
    settings_store: communication::SettingsStore<N>,
    communication: communication::CommunicationObjects<N>,
    network: network::NetworkTimers,
    lss: lss::LssSlave,
    quirks: Quirks,
    bit_rate: u32,
    emergencies: emcy::EmergencyQueue,
    sdo_server: sdo::SdoServer,
    send_slots: send_slots::SendSlots,
    next_due: Instant,
    state: nmt::NmtState,
    node: u8,
    /// PDOs that came and wait for SYNC, a bit each.
    rpdos_waiting: u32,
    /// Identifiers of the PDOs that are received; [`pdo::NO_ID`] for one that is not there.
    rpdo_ids: [u32; N],
    sync: sync::SyncState,
    rpdos: [pdo::ReceivePdo; N],
    tpdos: pdo::TransmitPdos<N>,
}

impl<const N: usize> CanEndpoint<N> {
    /// The end of a node that was just powered.
    #[must_use]
    pub fn new(options: Quirks, firmware: &mut impl Firmware) -> Self {
        let comm = communication::CommunicationObjects::EMPTY;
        let mut end = Self {
            node: 0,
            state: nmt::NmtState::BootUp,
            sync: sync::SyncState::default(),
            rpdo_ids: [pdo::NO_ID; N],
            rpdos_waiting: 0,
            next_due: Instant::FAR_FUTURE,
            tpdos: pdo::TransmitPdos::new(),
            rpdos: [pdo::ReceivePdo::default(); N],
            network: network::NetworkTimers::default(),
            send_slots: send_slots::SendSlots::default(),
            sdo_server: sdo::SdoServer::default(),
            quirks: options,
            emergencies: emcy::EmergencyQueue::default(),
            lss: lss::LssSlave::default(),
            bit_rate: firmware.bit_rate(),
            communication: comm,
            settings_store: communication::SettingsStore::default(),
        };
        end.boot(Instant::ZERO, firmware);
        end
    }

    /// The node-ID in force; 0 for none.
    #[must_use]
    pub const fn node(&self) -> u8 {
        self.node
    }

    /// State of the node.
    #[must_use]
    pub const fn state(&self) -> nmt::NmtState {
        self.state
    }

    /// Power off and on. A store that is running is lost.
    pub fn power_cycle(&mut self, now: Instant, firmware: &mut impl Firmware) {
        self.settings_store.abort_write();
        self.bit_rate = firmware.bit_rate();
        self.lss = lss::LssSlave::default();
        self.emergencies.reset();
        self.boot(now, firmware);
    }

    /// Takes a frame from the bus.
    #[inline]
    pub fn handle_input(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        if frame.extended || self.send_slots.is_silenced(now) {
            return;
        }
        if frame.remote {
            return self.handle_remote_request(now, frame.id, firmware);
        }
        if self.state == nmt::NmtState::Operational {
            if frame.id == self.sync.id {
                return self.handle_sync(now, frame.bytes(), firmware);
            }
            if let Some(n) = self.rpdo_ids.iter().position(|id| *id == frame.id) {
                return self.handle_rpdo(now, n, frame, firmware);
            }
        }
        self.handle_service(now, frame, firmware);
    }

    /// To be called at the time of [`poll_timeout`](Self::poll_timeout), and after any change of a value.
    #[inline]
    pub fn handle_timeout(&mut self, now: Instant, firmware: &mut impl Firmware) {
        self.collect_emergencies(now, firmware);
        if now >= self.next_due {
            self.run_timers(now, firmware);
        }
        self.check_changes(now, firmware);
    }

    /// Time of the next call of [`handle_timeout`](Self::handle_timeout).
    #[inline]
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.next_due != Instant::FAR_FUTURE).then_some(self.next_due)
    }

    /// Returns whether something is running whose values change with time.
    #[must_use]
    pub const fn is_active(&self) -> bool {
        matches!(self.state, nmt::NmtState::Operational)
    }

    /// Handles an event of the wire.
    pub fn handle_line(&mut self, now: Instant, event: LineEvent, firmware: &mut impl Firmware) {
        if event == LineEvent::BusOff {
            self.handle_link_loss(now, emcy::BUS_OFF, firmware);
        }
    }

    /// Present bus settings of this end.
    #[must_use]
    pub const fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }

    /// Something is to be done at `at`.
    #[inline]
    fn schedule(&mut self, at: Instant) {
        self.next_due = self.next_due.min(at);
    }
}
