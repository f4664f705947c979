//! The links of a rack: simulated, or real if the file has `connect`.

use super::options::{host_options, host_options_on_network, wire_options};
use super::{Connector, build_simulation, open};
use crate::error::Error;
use crate::identification::Identification;
use crate::identify::Prober;
use crate::protocol_line::{ProtocolLine, RackEntry};
use crate::registry::ProtocolInfo;
use crate::simulate::{self, RackDescription, Simulation};
use crate::spelling;
use crate::toml_file::FileLocation;
use crate::url::{AxisNumber, LinkTarget, Url};
use crate::wire::SharedLink;
use polepair_core::profile::Profile;
use polepair_core::proto::{HostOptions, drive_address, sub_axis, with_sub_axis};
use polepair_sim::rack::{RackDrive, RackWire};
use polepair_sim::serial_line::{SerialWireConfig, Timing};
use std::path::Path;
use std::sync::Arc;

impl Connector {
    /// Opens the links of a simulated rack, or one of them.
    pub(super) fn open_simulated(
        &self,
        url: &Url,
        description: RackDescription,
        only: Option<usize>,
    ) -> Result<(Vec<ProtocolLine>, Option<Simulation>), Error> {
        let simulation = build_simulation(url, description)?;
        let mut lines = Vec::new();
        for (index, n) in host_links(simulation.description(), only).into_iter().enumerate() {
            let link = self.wrap_and_tap(index, simulation.open(n)?, Some(&simulation));
            let wire = simulation.description().rack.links[n].wire;
            let options = |protocol: &ProtocolInfo, baud| match wire {
                RackWire::Serial(SerialWireConfig { timing: Timing::Tcp, .. }) => {
                    host_options_on_network(url, protocol)
                }
                _ => Ok(HostOptions { bit_rate: baud, ..host_options(url, protocol, baud)? }),
            };
            let opened = self.open_rack_lines(url, simulation.description(), n, &link, &options)?;
            opened.iter().try_for_each(ProtocolLine::configure_port)?;
            lines.extend(opened);
        }
        Ok((lines, Some(simulation)))
    }

    /// Opens the links of a rack file: real ones if it has `connect`, else simulated.
    pub(super) fn open_rack(
        &self,
        url: &Url,
        file: &str,
    ) -> Result<(Vec<ProtocolLine>, Option<Simulation>), Error> {
        let description = simulate::rack_of_file(Path::new(file), seed_of(url)?)?;
        let only = url.key("link").map(|name| find_link(&description, name)).transpose()?;
        let links = host_links(&description, only);
        let real = links.iter().any(|n| description.wires[*n].connect.is_some());
        if !real {
            return self.open_simulated(url, description, only);
        }
        if let Some(key) = ["time", "seed"].iter().find(|key| url.key(key).is_some()) {
            let what = format!("the key `{key}` is not supported on a real link");
            let hint = format!("`sim:{file}` simulates the same");
            return Err(Error::usage("E210", what, hint));
        }
        let mut lines = Vec::new();
        for (at, n) in links.into_iter().enumerate() {
            let wire = &description.wires[n];
            let Some(connect) = &wire.connect else {
                return Err(missing_connect_error(&description, n));
            };
            let protocols = description.protocols_on(n);
            let names: Vec<&str> = protocols.iter().map(|protocol| protocol.name).collect();
            let locate = |protocol: &ProtocolInfo| {
                real_link_url(url, protocol, &names, &connect.value, wire.baud)
            };
            let Some(first) = protocols.first() else { continue };
            let opened = locate(first)?;
            let link = open(&opened, first, &wire_options(&opened, first)?)?;
            let link = self.wrap_and_tap(at, link, None);
            lines.extend(self.open_rack_lines(url, &description, n, &link, &|protocol, _| {
                wire_options(&locate(protocol)?, protocol)
            })?);
        }
        Ok((lines, None))
    }

    /// A line for each protocol that is spoken on a link of a rack.
    fn open_rack_lines(
        &self,
        url: &Url,
        description: &RackDescription,
        n: usize,
        link: &SharedLink,
        options: &dyn Fn(&ProtocolInfo, u32) -> Result<HostOptions, Error>,
    ) -> Result<Vec<ProtocolLine>, Error> {
        let mut protocols = description.protocols_on(n);
        // A protocol without groups is skipped, unless none has groups.
        if url.axes.iter().any(|axis| AxisNumber(*axis).is_group())
            && protocols.iter().any(|protocol| protocol.groups > 0)
        {
            protocols.retain(|protocol| protocol.groups > 0);
        }
        protocols
            .into_iter()
            .map(|protocol| {
                let options = options(&protocol, description.wires[n].baud)?;
                rack_line(url, description, n, protocol, options, link.clone())
            })
            .collect()
    }
}

/// Error of a link of a rack without a place, while others have one.
pub(super) fn missing_connect_error(description: &RackDescription, n: usize) -> Error {
    let name = &description.rack.links[n].name;
    let reason = format!(
        "`{name}` has no `connect`, but other links have one: `connect = \"…\"`, or remove it \
         from all links to simulate them"
    );
    let location = description.wires[n].location.as_ref();
    location.map_or_else(
        || Error::usage("E210", &reason, ""),
        |location| location.error(&reason).into(),
    )
}

/// The drive that a rack expects at an address, when what answers there can be it.
pub(super) fn identify_expected(
    prober: Prober<'_>,
    number: u32,
    profile: &'static Profile,
    location: Option<&FileLocation>,
) -> Result<(&'static Profile, Identification), Error> {
    let (found, identified) = prober.identify(number)?;
    if std::ptr::eq(found, profile) {
        return Ok((profile, identified));
    }
    // A user's profile that extends another one is identified by the same reply.
    if simulate::is_own_profile(profile) && found.identity == profile.identity {
        return Ok((profile, identified));
    }
    // No reply can identify it: it is what the rack names.
    if profile.identity.is_none() {
        let how = if identified.is_generic() { Identification::Named } else { identified };
        return Ok((profile, how));
    }
    let reason = format!(
        "the device at {number} is no `{}`: `polepair scan` finds what is \
     connected",
        profile.name
    );
    Err(match location {
        Some(location) => location.error(reason).into(),
        None => Error::usage("E213", reason, ""),
    })
}

/// The links of a rack that a host has an end of, or one of them: what a relay brings its host to
/// needs no host of its own.
pub(super) fn host_links(description: &RackDescription, only: Option<usize>) -> Vec<usize> {
    let all = 0..description.wires.len();
    let own =
        |n: &usize| description.relay_link(*n).is_none() && only.is_none_or(|only| only == *n);
    all.filter(own).collect()
}

pub(super) fn find_link(description: &RackDescription, name: &str) -> Result<usize, Error> {
    let links = &description.rack.links;
    links.iter().position(|link| link.name == name).ok_or_else(|| {
        let near = spelling::suggestion(name, links.iter().map(|link| link.name.as_str()));
        Error::usage("E211", format!("the rack has no link `{name}`{near}"), "")
    })
}

pub(super) fn seed_of(url: &Url) -> Result<u64, Error> {
    Ok(url.number("seed")?.unwrap_or(1))
}

/// The connection string of one protocol on a real link of a rack, with its rates.
fn real_link_url(
    url: &Url,
    protocol: &ProtocolInfo,
    others: &[&str],
    connect: &str,
    rate: u32,
) -> Result<Url, Error> {
    let position = format!("{}+{connect}", protocol.name);
    let mut position = Url::parse_among(&position, others, false)?;
    if let LinkTarget::Serial { baud, .. } = &mut position.target {
        *baud = baud.or(Some(rate));
    }
    let tells_rate = match &position.target {
        LinkTarget::Slcan { .. } | LinkTarget::SlcanTcp { .. } => true,
        // One that has none, a virtual bus, has no least time for a frame either.
        #[cfg(target_os = "linux")]
        LinkTarget::Socketcan { interface } => {
            let known = polepair_link::socketcan::interfaces();
            known.iter().any(|one| one.name == *interface && one.bit_rate.is_some())
        }
        _ => false,
    };
    if tells_rate && position.key("bitrate").is_none() {
        position.keys.push(("bitrate".to_owned(), rate.to_string()));
    }
    if let Some(timeout) = url.key("timeout") {
        position.keys.retain(|(key, _)| key != "timeout");
        position.keys.push(("timeout".to_owned(), timeout.to_owned()));
    }
    Ok(position)
}

fn rack_line(
    url: &Url,
    description: &RackDescription,
    n: usize,
    info: ProtocolInfo,
    mut options: HostOptions,
    link: SharedLink,
) -> Result<ProtocolLine, Error> {
    let first = *info.addresses.start();
    let is_file = matches!(url.target, LinkTarget::Rack { .. });
    let seats = |n: usize, own: bool| {
        let (rack, wire) = (&description.rack.links[n], &description.wires[n]);
        let info = &info;
        let drives =
            rack.drives.iter().enumerate().filter(move |(_, drive)| is_served(drive, own, info));
        drives.flat_map(move |(at, drive)| {
            let address = drive.address.unwrap_or(first);
            let entry = |name: &str, mounting: &Option<_>, steps| RackEntry {
                name: name.to_owned(),
                mounting: mounting.clone(),
                steps,
                profile: (is_file || simulate::is_own_profile(drive.profile))
                    .then(|| (drive.profile, wire.location.clone())),
            };
            let steps = wire.steps[at];
            let mut axes = vec![(address, entry(&wire.names[at], &wire.mountings[at], steps))];
            axes.extend(wire.axes[at].iter().map(|axis| {
                let its = entry(&axis.name, &axis.mounting, axis.steps.or(steps));
                (with_sub_axis(address, axis.number), its)
            }));
            if axes.len() == 1 {
                let (start, motors) = (info.sub_axes.start(), drive.profile.motors);
                let further = (1..motors).map(|motor| with_sub_axis(address, start + motor));
                axes.extend(further.map(|number| (number, entry("", &None, steps))));
            }
            axes
        })
    };
    let mut all: Vec<(u32, RackEntry)> = seats(n, true).collect();
    let here = all.len();
    for behind in description.links_behind(n) {
        all.extend(seats(behind, false));
    }
    let groups = url.axes.iter().filter(|axis| AxisNumber(**axis).is_group());
    // The mounting of a drive is that of its first axis.
    let further = |axis: &u32| {
        let is_listed = all.iter().any(|(number, _)| number == axis);
        let (_, drive) = all
            .iter()
            .filter(|_| !is_listed)
            .find(|(number, _)| *number == drive_address(*axis))?;
        Some((*axis, RackEntry { profile: drive.profile.clone(), ..RackEntry::default() }))
    };
    let further: Vec<(u32, RackEntry)> =
        url.axes.iter().filter(|axis| sub_axis(**axis) != 0).filter_map(further).collect();
    further.iter().try_for_each(|(axis, _)| info.check_address(*axis))?;
    groups.clone().try_for_each(|axis| info.check_address(*axis))?;
    let every = url.axes.is_empty() && url.names.is_empty();
    let addresses: Vec<u32> = all.iter().map(|(number, _)| *number).collect();
    // Of a group it is known that one of its drives is mounted somehow.
    let mounting = all.iter().find_map(|(_, entry)| entry.mounting.clone());
    let groups = groups
        .map(|axis| (*axis, RackEntry { mounting: mounting.clone(), ..RackEntry::default() }));
    let everything = Arc::from(&*all);
    let (numbers, seats) = all
        .into_iter()
        .filter(|(number, entry)| {
            every || url.axes.contains(number) || url.names.contains(&entry.name)
        })
        .chain(further)
        .chain(groups)
        .unzip();
    options.standard = options.standard.or(description.line_standard(n));
    // Behind a relay are axes that the host must not be taken for either.
    let beside = description.host_address(n, &info);
    options.host_address =
        options.host_address.or(beside).or_else(|| info.alternative_host(&addresses));
    let relay = addresses.first().copied().filter(|_| addresses.len() > here);
    options.relay_axis = options.relay_axis.or(relay);
    Ok(ProtocolLine {
        wire: n,
        link,
        protocol: info,
        options,
        axis_numbers: numbers,
        entries: seats,
        rack_entries: everything,
    })
}

fn is_served(drive: &RackDrive, own: bool, info: &ProtocolInfo) -> bool {
    !own || simulate::speaks_protocol(drive, info)
}
