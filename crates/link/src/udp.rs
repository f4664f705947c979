//! CAN over UDP multicast, in the format of python-can's `udp_multicast` interface: every program
//! that joins the group is on the bus.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::os::fd::OwnedFd;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::time::Instant;
use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, socket_with, sockopt};

use crate::clock;
use crate::descriptor::Descriptor;
use crate::error::{Cause, LinkError};
use crate::link::{Link, Losses, Received};
use crate::wake::Waker;

pub mod datagram;
#[cfg(target_os = "linux")]
mod echo;
#[cfg(test)]
mod tests;

use datagram::{DATAGRAM_MAX, Unpacked};

/// The group that python-can prefers: site-local IPv6.
pub const GROUP_IPV6: Ipv6Addr =
    Ipv6Addr::new(0xff15, 0x7079, 0x7468, 0x6f6e, 0x6465, 0x6d6f, 0x6d63, 0x6173);
/// Its group for machines without IPv6, and ours: administratively scoped IPv4.
pub const GROUP_IPV4: Ipv4Addr = Ipv4Addr::new(239, 74, 163, 2);
/// Its port.
pub const PORT: u16 = 43113;
/// What the kernel is asked to hold of unread datagrams; it gives what its limit allows.
const RECEIVE_BUFFER: usize = 1 << 20;

/// Which bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Group {
    /// The multicast group.
    pub address: IpAddr,
    /// The UDP port.
    pub port: u16,
    /// Routers that a datagram passes less one: 0 stays on this machine, 1 in this network.
    pub hops: u8,
}

impl Default for Group {
    fn default() -> Self {
        Self { address: GROUP_IPV4.into(), port: PORT, hops: 1 }
    }
}

impl FromStr for Group {
    type Err = LinkError;

    /// `239.74.163.2:43113`, `[ff15::1]:43113`, or either without a port.
    fn from_str(text: &str) -> Result<Self, LinkError> {
        let bare = text.trim_start_matches('[').trim_end_matches(']');
        let (address, port) = match (text.parse::<SocketAddr>(), bare.parse::<IpAddr>()) {
            (Ok(both), _) => (both.ip(), both.port()),
            (_, Ok(address)) => (address, PORT),
            _ => return Err(no_group(text)),
        };
        if !address.is_multicast() || port == 0 {
            return Err(no_group(text));
        }
        Ok(Self { address, port, ..Self::default() })
    }
}

fn no_group(text: &str) -> LinkError {
    LinkError::new(text, Cause::NotFound).hinting(
        "A CAN group is a multicast address (224.0.0.0 to 239.255.255.255, or ff…), for example \
         239.74.163.2:43113.",
    )
}

/// One end of a bus. Several of them on one machine hear each other, none hears itself.
#[derive(Debug)]
pub struct UdpLink {
    /// Bound to the group: what arrives.
    descriptor: Descriptor,
    /// Sends from a port of its own, by which what comes back is known as ours.
    sender: UdpSocket,
    own: SocketAddr,
    group: Group,
    malformed: AtomicU64,
    errors: AtomicU64,
    #[cfg(target_os = "linux")]
    overrun: crate::sys::Overrun,
}

/// Joins `group`.
///
/// # Errors
/// [`LinkError`], mostly that no network interface has a route for multicast.
pub fn open(group: Group) -> Result<UdpLink, LinkError> {
    let name = SocketAddr::new(group.address, group.port).to_string();
    let explained = |error: io::Error| {
        let hint = "No network interface carries multicast to that group: `ip route add \
                    239.0.0.0/8 dev lo` keeps it on this machine, `dev eth0` puts it on the network.";
        match error.raw_os_error().map(rustix::io::Errno::from_raw_os_error) {
            Some(rustix::io::Errno::NODEV | rustix::io::Errno::NETUNREACH) => {
                LinkError::new(&name, Cause::Unreachable).hinting(hint)
            }
            _ => LinkError::from_io(&name, &error),
        }
    };
    let sender = sender(group).map_err(explained)?;
    let own = sender.local_addr().map_err(explained)?;
    let receiver = receiver(group, own).map_err(explained)?;
    Ok(UdpLink {
        descriptor: Descriptor::new(receiver, &name)?,
        sender,
        own,
        group,
        malformed: AtomicU64::new(0),
        errors: AtomicU64::new(0),
        #[cfg(target_os = "linux")]
        overrun: Default::default(),
    })
}

/// Connected, so that the kernel looks up the route once and the source address stays the same.
fn sender(group: Group) -> io::Result<UdpSocket> {
    let hops = u32::from(group.hops);
    let sender = match group.address {
        IpAddr::V4(_) => {
            let sender = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
            sockopt::set_ip_multicast_ttl(&sender, hops)?;
            sockopt::set_ip_multicast_loop(&sender, true)?;
            sender
        }
        IpAddr::V6(_) => {
            let sender = UdpSocket::bind((Ipv6Addr::UNSPECIFIED, 0))?;
            sockopt::set_ipv6_multicast_hops(&sender, hops)?;
            sockopt::set_ipv6_multicast_loop(&sender, true)?;
            sender
        }
    };
    sender.connect((group.address, group.port))?;
    sender.set_nonblocking(true)?;
    Ok(sender)
}

/// Bound to the group's address, so that another group on the same port is not heard.
fn receiver(group: Group, own: SocketAddr) -> io::Result<OwnedFd> {
    let family = if own.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let fd = socket_with(family, SocketType::DGRAM, SocketFlags::CLOEXEC, None)?;
    rustix::io::ioctl_fionbio(&fd, true)?;
    sockopt::set_socket_reuseaddr(&fd, true)?;
    // Linux needs the former alone, the BSDs this one.
    let _ = sockopt::set_socket_reuseport(&fd, true);
    let _ = sockopt::set_socket_recv_buffer_size(&fd, RECEIVE_BUFFER);
    #[cfg(target_os = "linux")]
    {
        crate::sys::ask_for_stamps(&fd);
        echo::filter_out(&fd, own);
    }
    bind(&fd, &SocketAddr::new(group.address, group.port))?;
    match group.address {
        IpAddr::V4(address) => {
            sockopt::set_ip_add_membership(&fd, &address, &Ipv4Addr::UNSPECIFIED)?;
        }
        IpAddr::V6(address) => sockopt::set_ipv6_add_membership(&fd, &address, 0)?,
    }
    Ok(fd)
}

impl UdpLink {
    /// Takes one datagram; `None` when there is none, or it was none of a frame from elsewhere.
    fn read(&self, frame: &mut Frame) -> Result<Option<Received>, LinkError> {
        let mut buffer = [0; DATAGRAM_MAX];
        let Some((len, from, at)) = self.take(&mut buffer)? else { return Ok(None) };
        if from == Some(self.own) {
            return Ok(None);
        }
        match datagram::unpack(&buffer[..len]) {
            Some(Unpacked::Frame(unpacked)) => {
                *frame = unpacked;
                return Ok(Some(Received::Bytes { len: 1, at }));
            }
            Some(Unpacked::ErrorFrame) => self.errors.fetch_add(1, Ordering::Relaxed),
            None => self.malformed.fetch_add(1, Ordering::Relaxed),
        };
        Ok(None)
    }

    #[cfg(target_os = "linux")]
    fn take(&self, buffer: &mut [u8]) -> Result<Option<Taken>, LinkError> {
        let message = crate::sys::receive(&self.descriptor.fd, buffer)
            .map_err(|error| LinkError::from_io(&self.descriptor.name, &error))?;
        Ok(message.map(|message| {
            self.overrun.note(message.overrun);
            let at = message.stamp_ns.map_or_else(clock::now, clock::of_stamp);
            (message.len, message.from, at)
        }))
    }

    #[cfg(not(target_os = "linux"))]
    fn take(&self, buffer: &mut [u8]) -> Result<Option<Taken>, LinkError> {
        use rustix::io::Errno;
        use rustix::net::{RecvFlags, recvfrom};
        match recvfrom(&self.descriptor.fd, buffer, RecvFlags::empty()) {
            Ok((_, len, from)) => {
                let from = from.and_then(|from| SocketAddr::try_from(from).ok());
                Ok(Some((len, from, clock::now())))
            }
            Err(Errno::AGAIN | Errno::INTR) => Ok(None),
            Err(errno) => Err(self.descriptor.error(errno)),
        }
    }
}

/// Length, sender and arrival of a datagram.
type Taken = (usize, Option<SocketAddr>, Instant);

impl Link<Can> for UdpLink {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        let mut buffer = [0; DATAGRAM_MAX];
        let len = datagram::pack(frame, clock::wall_ns(clock::now()), &mut buffer);
        match self.sender.send(&buffer[..len]) {
            Ok(_) => Ok(()),
            // No room in the interface's queue: lost, as on a bus that nobody acknowledges.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                Err(LinkError::new(&self.descriptor.name, Cause::Stalled))
            }
            Err(error) => Err(LinkError::from_io(&self.descriptor.name, &error)),
        }
    }

    fn receive(&self, frame: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        self.descriptor.receive_with(until, || self.read(frame))
    }

    fn set_line(&self, _line: CanLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> Waker {
        self.descriptor.wake.clone()
    }

    fn describe(&self) -> String {
        self.descriptor.name.clone()
    }

    fn losses(&self) -> Losses {
        Losses {
            #[cfg(target_os = "linux")]
            overrun: self.overrun.total(),
            malformed: self.malformed.load(Ordering::Relaxed),
            errors: self.errors.load(Ordering::Relaxed),
            ..Losses::default()
        }
    }

    fn reopen(&self) -> Result<Box<dyn Link<Can>>, LinkError> {
        Ok(Box::new(open(self.group)?))
    }
}
