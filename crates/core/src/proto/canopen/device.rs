//! The obeying end: one node with its dictionary, the firmware behind it, and all services of
//! CiA 301 and LSS of CiA 305.
//!
//! The [`Firmware`] is lent to each call. What the protocol itself keeps, objects 1000h to 1FFFh
//! with the tag [`OWN`](super::od::OWN), lives in the [`CanEnd`]; everything else is the firmware's
//! and reached by the tag of its [`Entry`](super::od::Entry). What devices do otherwise than the
//! standard has it is a switch in [`Options`].

mod comm;
mod emcy;
mod link;
mod lss;
pub mod motion;
mod net;
mod objects;
mod pdo;
mod sdo;
mod sync;
#[cfg(test)]
mod tests;

use super::emcy::Emergency;
use super::nmt;
use super::od::Dictionary;
use super::sdo::Abort;
use super::time::TimeOfDay;
use crate::medium::{CanLine, Frame};
use crate::station::LineEvent;
use crate::time::Instant;

pub use comm::{CONSUMERS_MAX, is_own, standard, standard_len};
pub use emcy::HISTORY_MAX;

/// Which settings are stored or restored (objects 1010h and 1011h).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Group {
    /// All that are there.
    All,
    /// Objects 1000h to 1FFFh.
    Communication,
    /// Objects 6000h to 9FFFh.
    Application,
}

/// What obeys. Values are bytes of the object's type in a number, the first byte lowest.
pub trait Firmware {
    /// Its dictionary.
    fn dictionary(&self) -> &'static Dictionary;
    /// Node-ID from the next reset of the communication on; none outside 1 to 127.
    fn node_id(&self) -> u8;
    /// Bit rate from the next power-on on, bit/s.
    fn bit_rate(&self) -> u32;
    /// Serial number (1018h sub-index 4).
    fn serial(&self) -> u32 {
        0
    }
    /// The value of an object of fixed length. What needs a sign has it in all 64 bits or not; what
    /// lies above the type's length does not count.
    fn get(&mut self, tag: u16) -> u64;
    /// Takes a value of an object of fixed length, within the entry's limits; a signed one has its
    /// sign in all 64 bits.
    ///
    /// # Errors
    /// Why it does not.
    fn set(&mut self, now: Instant, tag: u16, value: u64) -> Result<(), Abort>;
    /// Length of an object of any length, bytes.
    fn length(&mut self, tag: u16) -> u32 {
        let _ = tag;
        0
    }
    /// Part of such an object, from `offset` on, within its length.
    fn read(&mut self, tag: u16, offset: u32, out: &mut [u8]) {
        let _ = (tag, offset, out);
    }
    /// Such an object will be written; the size if the client told it.
    ///
    /// # Errors
    /// Why it cannot.
    fn begin(&mut self, tag: u16, size: Option<u32>) -> Result<(), Abort> {
        let _ = (tag, size);
        Err(Abort::MEMORY)
    }
    /// Part of it, in order.
    ///
    /// # Errors
    /// Why it is not taken.
    fn write(&mut self, tag: u16, offset: u32, data: &[u8]) -> Result<(), Abort> {
        let _ = (tag, offset, data);
        Err(Abort::MEMORY)
    }
    /// All of it is written, and checked where there was a check.
    ///
    /// # Errors
    /// Why it is not taken.
    fn finish(&mut self, now: Instant, tag: u16, size: u32) -> Result<(), Abort> {
        let _ = (now, tag, size);
        Ok(())
    }
    /// A SYNC came in state operational, after the PDOs that wait for it were taken.
    fn synced(&mut self, now: Instant) {
        let _ = now;
    }
    /// The node is in another state.
    fn entered(&mut self, now: Instant, state: nmt::State) {
        let _ = (now, state);
    }
    /// "Reset node": everything as after power-on.
    fn reset(&mut self, now: Instant);
    /// The bus or the master is lost: bus-off, a heartbeat or guarding that failed to come.
    fn lost(&mut self, now: Instant);
    /// What 1001h shows, apart from bit 4, which is the protocol's.
    fn error_register(&self) -> u8;
    /// The next emergency. The register is filled in by the protocol.
    fn poll_emergency(&mut self) -> Option<Emergency>;
    /// Stores its settings.
    fn store(&mut self, group: Group) {
        let _ = group;
    }
    /// From the next reset on, settings are those from the factory.
    fn restore(&mut self, group: Group) {
        let _ = group;
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
    /// LSS asks to keep both over power-off. False when it cannot.
    fn store_link(&mut self) -> bool {
        false
    }
    /// The time of day came.
    fn clock(&mut self, now: Instant, time: TimeOfDay) {
        let _ = (now, time);
    }
    /// Its own time of day, if it has one to tell others.
    fn time_of_day(&mut self, now: Instant) -> Option<TimeOfDay> {
        let _ = now;
        None
    }
}

/// What a node does otherwise than the standard has it, or does not do (SIM-15).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Options {
    /// SDO requests may be short, and their size need not be the object's; PDOs are mapped in any
    /// state without being switched off first; a PDO may be shorter than its mapping.
    pub lenient: bool,
    /// The acknowledgement of a write repeats the data.
    pub echoes: bool,
    /// It knows segmented and block transfer.
    pub segments: bool,
    /// It has layer setting services.
    pub lss: bool,
    /// It takes the time of day.
    pub time: bool,
    /// It answers guarding requests.
    pub guarding: bool,
    /// Emergencies are two bytes, and none tells that all is well again.
    pub short_emcy: bool,
    /// Unit of a PDO's inhibit time, µs.
    pub inhibit_unit_us: u32,
    /// Unit of a PDO's event timer, µs.
    pub event_unit_us: u32,
    /// Transmission type 254 goes by the event timer alone.
    pub timed_254: bool,
}

impl Options {
    /// As the standard has it.
    pub const STRICT: Self = Self {
        lenient: false,
        echoes: false,
        segments: true,
        lss: true,
        time: true,
        guarding: true,
        short_emcy: false,
        inhibit_unit_us: 100,
        event_unit_us: 1000,
        timed_254: false,
    };
}

/// The node's end of the bus, with up to `N` PDOs each way.
///
/// It lies in memory in this order: what each cycle needs is together, at the end, where the
/// firmware that is kept behind it begins with what it needs each cycle.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct CanEnd<const N: usize = 4> {
    store: comm::Store<N>,
    comm: comm::Comm<N>,
    net: net::Net,
    lss: lss::Slave,
    options: Options,
    bit_rate: u32,
    alarms: emcy::Alarms,
    server: sdo::Server,
    mail: link::Mail,
    due: Instant,
    state: nmt::State,
    node: u8,
    /// PDOs that came and wait for SYNC, a bit each.
    waiting: u32,
    /// Identifiers of the PDOs that are received; [`pdo::NONE`] for one that is not there.
    heard: [u32; N],
    sync: sync::Sync,
    takes: [pdo::Take; N],
    sends: pdo::Sends<N>,
}

impl<const N: usize> CanEnd<N> {
    /// The end of a node that was just powered.
    #[must_use]
    pub fn new(options: Options, firmware: &mut impl Firmware) -> Self {
        let comm = comm::Comm::EMPTY;
        let mut end = Self {
            node: 0,
            state: nmt::State::BootUp,
            sync: sync::Sync::default(),
            heard: [pdo::NONE; N],
            waiting: 0,
            due: Instant::FAR,
            sends: pdo::Sends::new(),
            takes: [pdo::Take::default(); N],
            net: net::Net::default(),
            mail: link::Mail::default(),
            server: sdo::Server::default(),
            options,
            alarms: emcy::Alarms::default(),
            lss: lss::Slave::default(),
            bit_rate: firmware.bit_rate(),
            comm,
            store: comm::Store::default(),
        };
        end.boot(Instant::ZERO, firmware);
        end
    }

    /// The node-ID in force; 0 for none.
    #[must_use]
    pub const fn node(&self) -> u8 {
        self.node
    }

    /// What the node is in.
    #[must_use]
    pub const fn state(&self) -> nmt::State {
        self.state
    }

    /// Power off and on. What was being stored is not.
    pub fn power_cycle(&mut self, now: Instant, firmware: &mut impl Firmware) {
        self.store.lose();
        self.bit_rate = firmware.bit_rate();
        self.lss = lss::Slave::default();
        self.alarms.forget();
        self.boot(now, firmware);
    }

    /// Takes a frame from the bus.
    #[inline]
    pub fn handle_input(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        if frame.extended || self.mail.is_quiet(now) {
            return;
        }
        if frame.remote {
            return self.asked(now, frame.id, firmware);
        }
        if self.state == nmt::State::Operational {
            if frame.id == self.sync.id {
                return self.synced(now, frame.bytes(), firmware);
            }
            if let Some(n) = self.heard.iter().position(|id| *id == frame.id) {
                return self.take(now, n, frame, firmware);
            }
        }
        self.serve(now, frame, firmware);
    }

    /// To be called when [`poll_timeout`](Self::poll_timeout) says so, and after anything that may
    /// have changed a value.
    #[inline]
    pub fn handle_timeout(&mut self, now: Instant, firmware: &mut impl Firmware) {
        self.collect(now, firmware);
        if now >= self.due {
            self.timers(now, firmware);
        }
        self.look(now, firmware);
    }

    /// When it next wants [`handle_timeout`](Self::handle_timeout).
    #[inline]
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.due != Instant::FAR).then_some(self.due)
    }

    /// Somebody has set it going: what changes by time is worth a look each tick.
    #[must_use]
    pub const fn is_live(&self) -> bool {
        matches!(self.state, nmt::State::Operational)
    }

    /// What happened to the wire.
    pub fn handle_line(&mut self, now: Instant, event: LineEvent, firmware: &mut impl Firmware) {
        if event == LineEvent::BusOff {
            self.lose(now, emcy::BUS_OFF, firmware);
        }
    }

    /// How this end now drives the bus.
    #[must_use]
    pub const fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }

    /// Something is to be done at `at`.
    #[inline]
    fn arm(&mut self, at: Instant) {
        self.due = self.due.min(at);
    }
}
