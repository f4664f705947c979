//! One protocol on an opened wire: the hosts that probe and command its drives.

use std::hash::{BuildHasher as _, RandomState};
use std::sync::Arc;
use std::time::Duration;

use polepair_core::convert::saturating;
use polepair_core::error::{Failure, Outcome};
use polepair_core::medium::{Can, MediumKind, Stream};
use polepair_core::mux::Mux;
use polepair_core::profile::Profile;
use polepair_core::proto::HostOptions;
use polepair_core::station::AxisIndex;
use polepair_link::{Connection, LinkIo as _};

use crate::axis::{DeviceDetail, LocalAxis};
use crate::bus;
use crate::detected_drive::DetectedDrive;
use crate::error::Error;
use crate::identification::Identification;
use crate::mounting::Mounting;
use crate::no_reply::Wiring;
use crate::registry::{self, ProtocolInfo};
use crate::toml_file::FileLocation;
use crate::wire::{OpenWire, SharedLink};

/// Longest wait for an answer at an address that no drive has.
const ANSWER_MAX: Duration = Duration::from_secs(5);

/// One protocol on an opened wire, and the drives to be found there.
#[derive(Clone)]
pub(crate) struct ProtocolLine {
    /// Index of the wire, which its lines share.
    pub(crate) wire: usize,
    pub(crate) link: SharedLink,
    pub(crate) protocol: ProtocolInfo,
    pub(crate) options: HostOptions,
    pub(crate) axis_numbers: Vec<u32>,
    /// Known data of each axis.
    pub(crate) entries: Vec<RackEntry>,
    /// All entries of the rack, also of axes that are not selected.
    pub(crate) rack_entries: Arc<[(u32, RackEntry)]>,
}

/// The entry of a rack for an address.
#[derive(Clone, Debug, Default)]
pub(crate) struct RackEntry {
    pub(crate) name: String,
    pub(crate) mounting: Option<Arc<Mounting>>,
    /// Full steps of a turn of its motor.
    pub(crate) steps: Option<u32>,
    /// The expected profile, and its location in the file.
    pub(crate) profile: Option<(&'static Profile, Option<FileLocation>)>,
}

impl ProtocolLine {
    /// The wire that these share.
    pub(crate) fn open_wire(lines: &[Self]) -> Option<OpenWire> {
        let first = lines.first()?;
        let rate = match first.protocol.medium {
            MediumKind::Serial => first.options.baud,
            MediumKind::Can => first.options.bit_rate,
        };
        Some(OpenWire {
            name: first.link.describe(),
            medium: first.protocol.medium,
            rate: Some(rate).filter(|rate| *rate > 0),
            protocols: lines.iter().map(|line| line.protocol.name).collect(),
        })
    }

    /// A place on the line's wire.
    pub(crate) fn bus_address(&self, address: u32) -> bus::BusAddress {
        bus::BusAddress { protocol: self.protocol.clone(), address }
    }

    /// Kind of the wire.
    pub(crate) fn wiring(&self) -> Wiring {
        match self.protocol.medium {
            MediumKind::Can => Wiring::CanBus,
            MediumKind::Serial if self.protocol.network_port.is_some() => Wiring::Network,
            MediumKind::Serial if self.options.serial_server => Wiring::SerialServer,
            MediumKind::Serial => Wiring::SerialLine,
        }
    }

    /// The number that the host has on it.
    pub(crate) fn host(&self) -> Option<u32> {
        self.options.host_address.or(self.protocol.host)
    }

    /// Period of the host's heartbeat, if it sends one.
    pub(crate) fn heartbeat(&self) -> Option<Duration> {
        let ms = self.options.heartbeat_ms.filter(|ms| *ms > 0)?;
        Some(Duration::from_millis(ms.into()))
    }

    pub(crate) fn mounting(&self, axis: usize) -> Option<Arc<Mounting>> {
        self.entries[axis].mounting.clone()
    }

    /// Sets a simulated port as the protocol's host wants it.
    pub(crate) fn configure_port(&self) -> Result<(), Error> {
        if let SharedLink::Serial(link) = &self.link
            && let Some(lane) =
                registry::build_lane::<Stream>(self.protocol.name, self.options, &[])
        {
            link.set_line(lane.line())?;
        }
        Ok(())
    }

    /// A host that asks these axes who they are. One at a time.
    pub(crate) fn probe_connection(
        &self,
        axes: &[(&'static Profile, u32)],
        scanning: bool,
        urgent: bool,
    ) -> Result<Connection, Error> {
        // A new seed for each session: late replies of the last one must not fit the next.
        let options = self.session_options();
        // A scan accepts any frame as a sign of a drive.
        let doubt = options.probe_seed.filter(|_| !scanning);
        self.open_connection_with(
            HostOptions { scanning, urgent, probe_seed: doubt, ..options },
            axes,
        )
    }

    /// Returns whether what is connected answers at an address that no drive has.
    pub(crate) fn ignores_addresses(&self) -> Result<bool, Error> {
        let Some((address, read)) = self.protocol.unused_address else { return Ok(false) };
        let connection = self.probe_connection(&[(self.protocol.generic, address)], true, false)?;
        let until = connection.now() + ANSWER_MAX;
        let answer = connection
            .request(until, |axes, now, ticket| axes.send_text(now, ticket, AxisIndex(0), read));
        let failure = answer.ok().flatten().and_then(Outcome::failure);
        Ok(match answer {
            Ok(Some(Outcome::Done(_))) => true,
            _ => matches!(failure, Some(Failure::Refused { .. })),
        })
    }

    /// Device information of the drive at an address; empty if it cannot be read.
    pub(crate) fn read_details(&self, number: u32, profile: &'static Profile) -> Vec<DeviceDetail> {
        let Ok(axes) = self.probe_axes(&[(profile, number)], true) else { return Vec::new() };
        let Some(axis) = axes.first() else { return Vec::new() };
        // Another host may have used the wire since the last exchange of this one.
        axis.connection.with_axes(|axes, now| axes.handle_resume(now));
        // A lost link is reported by the scan.
        axis.device_details().unwrap_or_default()
    }

    /// The axes at some addresses, of which nothing is asked. One host at a time.
    pub(crate) fn probe_axes(
        &self,
        drives: &[(&'static Profile, u32)],
        scanning: bool,
    ) -> Result<Vec<LocalAxis>, Error> {
        let connection = self.probe_connection(drives, scanning, false)?;
        Ok(drives
            .iter()
            .enumerate()
            .map(|(n, &(profile, number))| LocalAxis {
                connection: connection.clone(),
                index: AxisIndex(saturating(n)),
                number,
                name: String::new(),
                protocol: self.protocol.name,
                medium: self.protocol.medium,
                host: self.host(),
                relay: self.options.relay_axis,
                heartbeat: self.heartbeat(),
                profile,
                identified: Identification::Named,
                simulation: None,
                mounted: None,
            })
            .collect())
    }

    /// The axes of drives that were found, whatever others the line has. One host at a time.
    pub(crate) fn axes_of_found(&self, found: &[DetectedDrive]) -> Result<Vec<LocalAxis>, Error> {
        let drives: Vec<_> = found.iter().map(|one| (one.profile, one.number)).collect();
        let axes = self.probe_axes(&drives, false)?.into_iter().zip(found);
        Ok(axes
            .map(|(axis, one)| LocalAxis { identified: one.identified.clone(), ..axis })
            .collect())
    }

    /// The host's settings for one session: its requests may still be answered in the next, whose probes
    /// are drawn anew.
    fn session_options(&self) -> HostOptions {
        HostOptions { probe_seed: self.options.probe_seed.map(|_| random_seed()), ..self.options }
    }

    /// A host with these axes on the wire. One at a time.
    pub(crate) fn open_connection(
        &self,
        axes: &[(&'static Profile, u32)],
    ) -> Result<Connection, Error> {
        self.open_connection_with(self.session_options(), axes)
    }

    /// One connection for all that is spoken on a wire, axes of the first line first.
    pub(crate) fn open_shared_connection(
        lines: &[Self],
        axes: &[Vec<(&'static Profile, u32)>],
    ) -> Result<Connection, Error> {
        let [first, _, ..] = lines else { return lines[0].open_connection(&axes[0]) };
        let SharedLink::Can(link) = &first.link else {
            return Err(parse_failure("a serial line carries one protocol"));
        };
        let lanes: Option<Vec<_>> = lines
            .iter()
            .zip(axes)
            .map(|(line, axes)| {
                registry::build_lane::<Can>(line.protocol.name, line.session_options(), axes)
            })
            .collect();
        debug_assert!(lines.iter().all(|line| line.wire == lines[0].wire));
        let mux = Mux::new(lanes.ok_or_else(|| parse_failure("the protocol has no host"))?);
        let mux =
            mux.ok_or_else(|| parse_failure("these drives cannot share a bus: too many axes"))?;
        Ok(Connection::new::<Can>(Box::new(link.clone()), Box::new(mux)))
    }

    fn open_connection_with(
        &self,
        options: HostOptions,
        axes: &[(&'static Profile, u32)],
    ) -> Result<Connection, Error> {
        let name = self.protocol.name;
        Ok(match &self.link {
            SharedLink::Serial(link) => {
                let options = HostOptions { line_used_at: link.used_until(), ..options };
                let lane = registry::build_lane(name, options, axes).ok_or_else(no_host_error)?;
                Connection::new::<Stream>(Box::new(link.clone()), lane)
            }
            SharedLink::Can(link) => {
                let lane = registry::build_lane(name, options, axes).ok_or_else(no_host_error)?;
                Connection::new::<Can>(Box::new(link.clone()), lane)
            }
        })
    }
}

fn no_host_error() -> Error {
    Error::usage("E203", "the protocol has no host", "")
}

fn parse_failure(what: &str) -> Error {
    Error::usage("E203", what, "")
}

/// A number from the system's random source: the probes of one session are not those of the one before.
pub(crate) fn random_seed() -> u32 {
    RandomState::new().hash_one(()) as u32
}
