//! Settings of a host, and the keys of connection strings that give them.
//!
//! A protocol lists its keys in [`Protocol::KEYS`](super::Protocol::KEYS). Parsing, errors, completion and the
//! reference are made from these lists.

use crate::time::Instant;

/// Standard of a serial line, for protocols that differ by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SerialStandard {
    /// Point to point, both ways at once.
    Rs232,
    /// Many drives on one pair, one speaker at a time.
    Rs485,
}

/// Settings of a host that a connection string can give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostOptions {
    /// Baud rate of a serial line; 0 on a wire without timing.
    pub baud: u32,
    /// Baud rate that the port is set to, also where bytes take no time (pseudo-terminals); 0 where there is no port.
    pub port_baud: u32,
    /// The port is set to `baud`, but bytes may travel sooner than it allows (USB CDC, emulators of
    /// serial ports): no answer comes too soon.
    pub untimed: bool,
    /// Bit rate of a CAN bus; 0 where the link does not know it (UDP).
    pub bit_rate: u32,
    /// Which standard the serial line follows; the protocol's usual one if `None`.
    pub standard: Option<SerialStandard>,
    /// Time allowed for a reply, ms; the profile's if `None`.
    pub reply_timeout_ms: Option<u32>,
    /// Time allowed for an acknowledgement where it is apart from the reply, ms; the protocol's
    /// if `None`.
    pub ack_timeout_ms: Option<u32>,
    /// Wait for each step of bringing a line back into step, ms; the protocol's if `None`.
    pub resync_pause_ms: Option<u32>,
    /// Silence before a frame, µs; the protocol's standard if `None`.
    pub gap_us: Option<u32>,
    /// Host address; the protocol's default if `None`.
    pub host_address: Option<u32>,
    /// Period of the host's own heartbeat, if the protocol has one, ms; `None` for none. It continues only
    /// while the application sends requests.
    pub heartbeat_ms: Option<u32>,
    /// The adapter returns our own bytes.
    pub echo: bool,
    /// The axis that the host is wired to, where others are reached through it; the first axis if `None`.
    pub relay_axis: Option<u32>,
    /// The highest axis behind the relay, where it relays to a bus with fewer numbers than the line: higher ones are
    /// other numbers of the same axes. From such a bus, replies of groups and unsolicited messages do not come back.
    pub relay_axis_max: Option<u32>,
    /// An earlier program may have used the wire, and a late reply to it may still arrive. Where replies do
    /// not repeat their request, a session then starts with probes, varied by this seed; only stops are sent
    /// before these have replies. `None` where no program was there before (REQ-7).
    pub probe_seed: Option<u32>,
    /// Time until which earlier sessions used a serial line, or may still be answered; `None` where there was none.
    /// Stations that end a frame by silence would read its last reply and a request right behind it as one.
    pub line_used_at: Option<Instant>,
    /// For scans: an address that never replied is asked only once, so that silence costs the least time.
    pub scanning: bool,
    /// A stop waits for the reply: the check for two drives with one address, which takes longer, is left
    /// out.
    pub urgent: bool,
    /// The link is a TCP connection, not a port.
    pub serial_server: bool,
    /// Factor of all time-outs of the host, for tests on a busy machine; 1 otherwise.
    pub timeout_scale: u32,
}

impl HostOptions {
    /// [`gap_us`](Self::gap_us) of 3.5 characters at the line's baud rate.
    pub const GAP_CHARACTERS: u32 = u32::MAX;

    /// The stated [`gap_us`](Self::gap_us) in ns; 0 for none.
    #[must_use]
    pub fn stated_gap_ns(&self) -> u64 {
        u64::from(self.gap_us.unwrap_or(0)) * 1_000
    }

    /// Scales a time-out in milliseconds.
    #[must_use]
    pub const fn scaled_ms(&self, timeout_ms: u32) -> u32 {
        timeout_ms.saturating_mul(self.timeout_scale)
    }

    /// Time-out of a reply, ms, scaled: the stated one, or `usual_ms`.
    #[must_use]
    pub fn reply_timeout_ms(&self, usual_ms: u32) -> u32 {
        self.scaled_ms(self.reply_timeout_ms.unwrap_or(usual_ms))
    }

    /// Returns whether a drive on the line has this address for itself.
    #[must_use]
    pub fn is_distinct_address(&self, address: u32) -> bool {
        self.relay_axis_max.is_none_or(|max| (1..=max).contains(&address))
            || self.relay_axis == Some(address)
    }

    /// The baud rate that no byte travels faster than; 0 where there is none.
    #[must_use]
    pub const fn timed_baud(&self) -> u32 {
        if self.untimed { 0 } else { self.baud }
    }

    /// Everything as the protocol has it, on a wire of that baud or bit rate.
    #[must_use]
    pub const fn new(rate: u32) -> Self {
        Self {
            baud: rate,
            port_baud: rate,
            untimed: false,
            bit_rate: rate,
            standard: None,
            reply_timeout_ms: None,
            ack_timeout_ms: None,
            resync_pause_ms: None,
            gap_us: None,
            host_address: None,
            heartbeat_ms: None,
            echo: false,
            relay_axis: None,
            relay_axis_max: None,
            probe_seed: None,
            line_used_at: None,
            scanning: false,
            urgent: false,
            serial_server: false,
            timeout_scale: 1,
        }
    }
}

/// A key of a connection string.
#[derive(Clone, Copy, Debug)]
pub struct OptionKey {
    /// Name of the key: `timeout`.
    pub name: &'static str,
    /// Kind of the value.
    pub kind: OptionKind,
    /// Effect of the key, in a phrase.
    pub help: &'static str,
    /// True if it describes the drive: a simulated one is built by it.
    pub is_of_drive: bool,
    apply: fn(&mut HostOptions, u32),
}

/// Kind of a key's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionKind {
    /// A time of at most an hour: milliseconds, or with a unit.
    Milliseconds,
    /// A silence: a time, or `3.5c` in characters at the line's baud rate.
    Gap,
    /// A whole number of this range.
    Number(u32, u32),
    /// Yes or no.
    Flag,
    /// One of these words.
    Word(&'static [&'static str]),
    /// A name or a file.
    Text,
}

impl OptionKey {
    /// A key that sets something of the host. `apply` gets milliseconds, microseconds of a gap, the number, 0 or
    /// 1 of a flag, or the index of the word.
    #[must_use]
    pub const fn new(
        name: &'static str,
        kind: OptionKind,
        help: &'static str,
        apply: fn(&mut HostOptions, u32),
    ) -> Self {
        Self { name, kind, help, is_of_drive: false, apply }
    }

    /// A key that the opener of the link reads.
    #[must_use]
    pub const fn for_link(name: &'static str, kind: OptionKind, help: &'static str) -> Self {
        Self { name, kind, help, is_of_drive: false, apply: |_, _| {} }
    }

    /// A key that describes the drive: a simulated one is made so.
    #[must_use]
    pub const fn for_drive(name: &'static str, kind: OptionKind, help: &'static str) -> Self {
        Self { name, kind, help, is_of_drive: true, apply: |_, _| {} }
    }

    /// Sets a value of its [kind](Self::kind).
    pub fn apply(&self, options: &mut HostOptions, value: u32) {
        (self.apply)(options, value);
    }
}

/// Time limit of a reply.
pub(crate) const TIMEOUT: OptionKey = OptionKey::new(
    "timeout",
    OptionKind::Milliseconds,
    "time limit of a reply [default: that of the drive's profile]",
    |options, ms| options.reply_timeout_ms = Some(ms),
);
/// Silence before a frame.
pub(crate) const GAP: OptionKey = OptionKey::new(
    "gap",
    OptionKind::Gap,
    "silence before a frame [default: that of the protocol; none on pseudo-terminals and TCP]",
    |options, us| options.gap_us = Some(us),
);
/// Address of the host, in this range.
pub(crate) const fn host_key(min: u32, max: u32) -> OptionKey {
    OptionKey::new(
        "host",
        OptionKind::Number(min, max),
        "address of the host",
        |options, address| {
            options.host_address = Some(address);
        },
    )
}
