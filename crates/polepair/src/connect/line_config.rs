//! Settings of an open link that are needed to scan it and to add drives. It does not keep the link open:
//! only the connections own it.

use super::LocalLink;
use crate::axis::LocalAxis;
use crate::detected_drive::DetectedDrive;
use crate::error::Error;
use crate::identification::Identification;
use crate::mounting::ResolvedMounting;
use crate::protocol_line::{ProtocolLine, RackEntry};
use crate::registry::ProtocolInfo;
use crate::url::AxisNumber;
use crate::wire::SharedLink;
use polepair_core::medium::{Can, MediumKind, Stream};
use polepair_core::profile::Profile;
use polepair_core::proto::HostOptions;
use polepair_link::{BorrowedLink, Connection};
use std::sync::Arc;
use std::time::Duration;

/// Time limit of a scan's wait until no other request is active on a link.
const IDLE_WAIT_MAX: Duration = Duration::from_secs(6);

/// One protocol on a wire, without the wire.
#[derive(Clone)]
pub(crate) struct LineConfig {
    wire: usize,
    pub(crate) protocol: ProtocolInfo,
    options: HostOptions,
    rack_entries: Arc<[(u32, RackEntry)]>,
}

impl std::fmt::Debug for LineConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.protocol.name)
    }
}

/// A connection that is set aside; its link is lent for as long as this is there.
pub(crate) enum AnyBorrowedLink {
    Serial(BorrowedLink<Stream>),
    Can(BorrowedLink<Can>),
}

impl AnyBorrowedLink {
    /// The link of a connection.
    pub(crate) fn borrow(connection: &Connection, medium: MediumKind) -> Result<Self, Error> {
        let until = connection.now() + IDLE_WAIT_MAX;
        let borrowed = match medium {
            MediumKind::Serial => connection.borrow_link(until)?.map(Self::Serial),
            MediumKind::Can => connection.borrow_link(until)?.map(Self::Can),
        };
        borrowed.ok_or_else(|| {
            let what = format!("a request is running on {}", connection.describe());
            let hint = "end it first: a scan is not possible meanwhile, nor while drives depend \
             on periodic messages of this host (heartbeat, SYNC, watchdog)";
            Error::usage("E220", what, hint)
        })
    }

    pub(crate) fn link(&self) -> SharedLink {
        match self {
            Self::Serial(aside) => SharedLink::borrowed_serial(aside.link()),
            Self::Can(aside) => SharedLink::borrowed_can(aside.link()),
        }
    }
}

impl ProtocolLine {
    /// Configuration of the line, for reopening.
    pub(super) fn to_config(&self) -> LineConfig {
        let Self { wire, protocol, options, rack_entries, .. } = self;
        let (info, all) = (protocol.clone(), Arc::clone(rack_entries));
        LineConfig { wire: *wire, protocol: info, options: *options, rack_entries: all }
    }
}

impl LineConfig {
    /// The error reduced to a single wire, if only one matters.
    pub(crate) fn with_single_wire(self) -> Self {
        Self { wire: 0, ..self }
    }

    /// Builds the line on a link.
    pub(crate) fn on_link(&self, link: SharedLink) -> ProtocolLine {
        let Self { wire, protocol, options, rack_entries } = self.clone();
        let (numbers, seats) = (Vec::new(), Vec::new());
        ProtocolLine {
            wire,
            link,
            protocol,
            options,
            axis_numbers: numbers,
            entries: seats,
            rack_entries,
        }
    }

    /// The rack's entry of an address.
    fn rack_entry(&self, number: u32) -> RackEntry {
        let known = self.rack_entries.iter().find(|(other, _)| *other == number);
        known.map_or_else(RackEntry::default, |(_, entry)| entry.clone())
    }

    /// The rack's profile of a found drive, if the replies match it.
    fn expected_profile(
        &self,
        found: &DetectedDrive,
        entry: &RackEntry,
    ) -> Result<&'static Profile, Error> {
        let Some((drive, location)) = &entry.profile else { return Ok(found.profile) };
        match self.protocol.profile_of_axis(drive, found.number) {
            expected if std::ptr::eq(expected, found.profile) => Ok(expected),
            expected if expected.identity.is_none() => Ok(expected),
            expected => {
                let reason = format!("the device at {} is no `{}`", found.number, expected.name);
                let error = location.as_ref().map(|location| location.error(&reason).into());
                Err(error.unwrap_or_else(|| Error::usage("E213", reason, "")))
            }
        }
    }
}

impl LocalLink {
    /// The axes of a wire, with their places among all of the link, in the order of its connection.
    pub(crate) fn axes_on(&self, wire: usize) -> Vec<(usize, &LocalAxis)> {
        let Some((Some(connection), _)) = self.line_configs.get(wire) else { return Vec::new() };
        let axes = self.axes.iter().enumerate();
        axes.filter(|(_, axis)| axis.connection.is_same(connection)).collect()
    }

    /// The number of an axis' wire, among [all of them](Self::wires).
    #[must_use]
    pub fn wire_index(&self, axis: &LocalAxis) -> Option<usize> {
        self.line_configs.iter().position(|(connection, _)| {
            connection.as_ref().is_some_and(|connection| connection.is_same(&axis.connection))
        })
    }

    /// Protocols on a wire.
    pub(crate) fn line_configs_on(&self, wire: usize) -> Result<&Arc<[LineConfig]>, Error> {
        self.line_configs.get(wire).map(|(_, stored)| stored).ok_or_else(|| {
            let what = format!("this link has no wire {wire}");
            Error::usage("E212", what, "wires count from 0")
        })
    }

    /// The link with further drives that a [`DriveScanner`](crate::scan::DriveScanner) found on a wire, after its
    /// existing axes. Nothing is sent. Running requests continue, and both links have the same axes. The rack's entry
    /// of an address (name, mounting, limits) is applied.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212` for a missing wire, for an address that is already an axis or is invalid;
    /// `E213` if the rack names another drive; `E220` if no more axes fit, or a drive has the host's
    /// address or is an axis that this handle does not know. No drive was added then.
    pub fn add_drives(&self, wire: usize, found: &[DetectedDrive]) -> Result<Self, Error> {
        let stored = self.line_configs_on(wire)?;
        let known = self.axes_on(wire);
        let connection = known.first().map(|(_, axis)| axis.connection.clone());
        let connection = connection.ok_or_else(|| Error::usage("E212", "no axis replied", ""))?;
        let mut ready: Vec<(usize, &DetectedDrive, RackEntry, &'static Profile)> = Vec::new();
        for found in found {
            let lane =
                stored.iter().position(|line_config| line_config.protocol.name == found.protocol);
            let lane = lane.ok_or_else(|| {
                let what = format!("no axis of this wire uses {}", found.protocol);
                Error::usage("E212", what, "scan this link first")
            })?;
            stored[lane].protocol.check_address(found.number)?;
            let same =
                |number: u32, protocol: &str| number == found.number && protocol == found.protocol;
            if known.iter().any(|(_, axis)| same(axis.number, axis.protocol))
                || ready.iter().any(|(_, other, ..)| same(other.number, other.protocol))
            {
                let what = format!("the drive at {} is an axis already", AxisNumber(found.number));
                return Err(Error::usage("E212", what, "it need not be added"));
            }
            let entry = stored[lane].rack_entry(found.number);
            let profile = stored[lane].expected_profile(found, &entry)?;
            ready.push((lane, found, entry, profile));
        }
        let model = known[0].1.clone();
        // All of them or none.
        let joined = connection.with_axes(|axes, _| {
            if axes.axis_count() + ready.len() > 256 {
                let what = format!("{} more axes do not fit on this link", ready.len());
                return Err(Error::usage("E220", what, "256 are the most"));
            }
            let cannot =
                ready.iter().find(|(lane, found, ..)| !axes.can_add_axis(*lane, found.number));
            if let Some((_, found, ..)) = cannot {
                let what = format!("the drive at {} cannot join", AxisNumber(found.number));
                let hint = "it has the address of the host, or it is already an axis, or the baud \
                 rate is being set: change the address, or try again";
                return Err(Error::usage("E220", what, hint));
            }
            Ok(ready
                .iter()
                .filter_map(|(lane, found, _, profile)| axes.add_axis(*lane, profile, found.number))
                .collect::<Vec<_>>())
        })?;
        let mut link = self.clone();
        for ((lane, found, entry, profile), index) in ready.into_iter().zip(joined) {
            let mounted = entry.mounting.map(|m| Arc::new(ResolvedMounting::new(m, profile)));
            let identified = if std::ptr::eq(profile, found.profile) {
                found.identified.clone()
            } else {
                Identification::Named
            };
            link.axes.push(LocalAxis {
                index,
                number: found.number,
                name: entry.name,
                protocol: stored[lane].protocol.name,
                profile,
                identified,
                mounted,
                ..model.clone()
            });
        }
        Ok(link)
    }
}
