//! CAN over UDP multicast, in the format of python-can's `udp_multicast` interface. Every program in the
//! group is on the bus.
//!
//! Why: LINK-5, LINK-7.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::time::Instant;
use rustix::fd::{AsFd, OwnedFd};
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SocketAddrAny, SocketType, bind, recv, recvfrom, socket, sockopt,
};

use crate::clock;
use crate::descriptor::Descriptor;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Losses, Received};
use crate::read_mode::ReadMode;
use crate::waker::LinkWaker;

pub mod datagram;
#[cfg(target_os = "linux")]
mod echo_filter;
#[cfg(test)]
mod tests;

use datagram::{DATAGRAM_MAX, UnpackedDatagram};

/// The group that python-can prefers: site-local IPv6.
pub const GROUP_IPV6: Ipv6Addr =
    Ipv6Addr::new(0xff15, 0x7079, 0x7468, 0x6f6e, 0x6465, 0x6d6f, 0x6d63, 0x6173);
/// IPv4 group for machines without IPv6, administratively scoped.
pub const GROUP_IPV4: Ipv4Addr = Ipv4Addr::new(239, 74, 163, 2);
/// UDP port of the bus.
pub const PORT: u16 = 43113;
/// Size of the receive buffer that the kernel is asked for; it gives at most its limit.
const RECEIVE_BUFFER: usize = 1 << 20;

/// Multicast group and port that form a bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MulticastGroup {
    /// The multicast group.
    pub address: IpAddr,
    /// The UDP port.
    pub port: u16,
    /// Routers that a datagram passes less one: 0 stays on this machine, 1 in this network.
    pub hops: u8,
}

impl Default for MulticastGroup {
    fn default() -> Self {
        Self { address: GROUP_IPV4.into(), port: PORT, hops: 1 }
    }
}

impl FromStr for MulticastGroup {
    type Err = LinkError;

    /// `239.74.163.2:43113`, `[ff15::1]:43113`, or either without a port.
    fn from_str(text: &str) -> Result<Self, LinkError> {
        let bare = text.trim_start_matches('[').trim_end_matches(']');
        let (address, port) = match (text.parse::<SocketAddr>(), bare.parse::<IpAddr>()) {
            (Ok(both), _) => (both.ip(), both.port()),
            (_, Ok(address)) => (address, PORT),
            _ => return Err(not_a_group(text)),
        };
        if !address.is_multicast() || port == 0 {
            return Err(not_a_group(text));
        }
        Ok(Self { address, port, ..Self::default() })
    }
}

fn not_a_group(text: &str) -> LinkError {
    LinkError::new(text, Cause::NotFound).with_hint(
        "A CAN group is a multicast address (224.0.0.0 to 239.255.255.255, or ff…), for example \
         239.74.163.2:43113.",
    )
}

/// One end of a bus. All ends on one machine receive each other's frames, but not their own.
#[derive(Debug)]
pub struct UdpLink {
    /// Bound to the group: what arrives.
    descriptor: Descriptor,
    /// Sends from a port of its own, by which echoes are recognised.
    sender: UdpSocket,
    own: SocketAddr,
    group: MulticastGroup,
    malformed: AtomicU64,
    errors: AtomicU64,
    /// The kernel drops what we send before we would read it.
    echo_filtered: bool,
    sent: AtomicU64,
}

/// Joins `group`. With 0 hops, and no network that carries multicast, the loopback interface does.
///
/// # Errors
/// [`LinkError`], mostly that no network interface has a route for multicast.
pub fn open(group: MulticastGroup) -> Result<UdpLink, LinkError> {
    let name = SocketAddr::new(group.address, group.port).to_string();
    let opened = open_sockets(group, Ipv4Addr::UNSPECIFIED).or_else(|error| match group {
        MulticastGroup { hops: 0, address: IpAddr::V4(_), .. } => {
            open_sockets(group, Ipv4Addr::LOCALHOST)
        }
        _ => Err(error),
    });
    let (sender, own, receiver) = opened.map_err(|error| explain_error(&name, &error))?;
    #[cfg(target_os = "linux")]
    let echo_filtered = echo_filter::drop_own_datagrams(&receiver, own);
    #[cfg(not(target_os = "linux"))]
    let echo_filtered = false;
    Ok(UdpLink {
        descriptor: Descriptor::with_mode(ReadMode::Messages, receiver, &name)?,
        sender,
        own,
        group,
        echo_filtered,
        sent: AtomicU64::new(0),
        malformed: AtomicU64::new(0),
        errors: AtomicU64::new(0),
    })
}

fn explain_error(name: &str, error: &io::Error) -> LinkError {
    match error.raw_os_error().map(Errno::from_raw_os_error) {
        Some(errno) if has_no_route(errno) => {
            let hint = "No network interface carries multicast to that group: `sudo ip route add \
                        239.0.0.0/8 dev eth0`, with the name of yours.";
            LinkError::new(name, Cause::Unreachable).with_hint(hint)
        }
        _ => LinkError::from_io(name, error),
    }
}

/// The sending socket, its address, and the receiving socket; on the interface with the address `by`,
/// or by the routing table.
fn open_sockets(
    group: MulticastGroup,
    by: Ipv4Addr,
) -> io::Result<(UdpSocket, SocketAddr, OwnedFd)> {
    let sender = open_sender(group, by)?;
    let own = sender.local_addr()?;
    Ok((sender, own, open_receiver(group, by)?))
}

/// Connected, so that the kernel looks up the route once and the source address stays the same.
fn open_sender(group: MulticastGroup, by: Ipv4Addr) -> io::Result<UdpSocket> {
    let hops = u32::from(group.hops);
    let sender = match group.address {
        IpAddr::V4(_) => {
            // A socket that is bound to an interface's address sends multicast through it.
            let sender = UdpSocket::bind((by, 0))?;
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

/// The address that a receiver binds: that of the group. Windows takes none but its own.
fn bound_address(group: IpAddr) -> IpAddr {
    match group {
        group if cfg!(unix) => group,
        IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    }
}

/// Returns whether no interface leads to a group.
fn has_no_route(errno: Errno) -> bool {
    #[cfg(unix)]
    if errno == Errno::NODEV {
        return true;
    }
    errno == Errno::NETUNREACH
}

/// Bound to the group's address, so that other groups on the same port are not received.
fn open_receiver(group: MulticastGroup, by: Ipv4Addr) -> io::Result<OwnedFd> {
    let v4 = group.address.is_ipv4();
    let family = if v4 { AddressFamily::INET } else { AddressFamily::INET6 };
    let fd = socket(family, SocketType::DGRAM, None)?;
    #[cfg(unix)]
    rustix::io::fcntl_setfd(&fd, rustix::io::FdFlags::CLOEXEC)?;
    rustix::io::ioctl_fionbio(&fd, true)?;
    sockopt::set_socket_reuseaddr(&fd, true)?;
    // Linux needs the former alone, the BSDs this one.
    #[cfg(unix)]
    let _ = sockopt::set_socket_reuseport(&fd, true);
    let _ = sockopt::set_socket_recv_buffer_size(&fd, RECEIVE_BUFFER);
    bind(&fd, &SocketAddr::new(bound_address(group.address), group.port))?;
    match group.address {
        IpAddr::V4(address) => sockopt::set_ip_add_membership(&fd, &address, &by)?,
        IpAddr::V6(address) => sockopt::set_ipv6_add_membership(&fd, &address, 0)?,
    }
    Ok(fd)
}

impl UdpLink {
    /// Datagrams that there was no room for. The kernel counts them together with those that the
    /// filter refused, which are those that we sent.
    fn overrun_count(&self) -> u64 {
        #[cfg(target_os = "linux")]
        let dropped = u64::from(crate::sys::dropped_count(&self.descriptor.fd));
        #[cfg(not(target_os = "linux"))]
        let dropped = 0_u64;
        let echoes = if self.echo_filtered { self.sent.load(Ordering::Relaxed) } else { 0 };
        dropped.saturating_sub(echoes)
    }

    /// Takes one datagram; `None` when there is none, or it was none of a frame from elsewhere.
    fn read_frame(&self, frame: &mut Frame) -> Result<Option<Received>, LinkError> {
        let mut buffer = [0; DATAGRAM_MAX];
        let Some((len, at)) = self.receive_datagram(&mut buffer)? else { return Ok(None) };
        match datagram::unpack(&buffer[..len]) {
            Some(UnpackedDatagram::Frame(unpacked)) => {
                *frame = unpacked;
                return Ok(Some(Received::Bytes { len: 1, at }));
            }
            Some(UnpackedDatagram::ErrorFrame) => self.errors.fetch_add(1, Ordering::Relaxed),
            None => self.malformed.fetch_add(1, Ordering::Relaxed),
        };
        Ok(None)
    }

    /// Length and arrival of a datagram from elsewhere.
    fn receive_datagram(&self, buffer: &mut [u8]) -> Result<Option<(usize, Instant)>, LinkError> {
        let fd = &self.descriptor.fd;
        let taken = if self.echo_filtered {
            recv(fd, buffer, RecvFlags::empty()).map(|(_, len)| (len, None))
        } else {
            recvfrom(fd, buffer, RecvFlags::empty()).map(|(_, len, from)| (len, from))
        };
        match taken {
            Ok((_, Some(from))) if self.is_own(&from) => Ok(None),
            Ok((len, _)) => Ok(Some((len, clock::now()))),
            Err(Errno::WOULDBLOCK | Errno::INTR) => Ok(None),
            Err(errno) => Err(self.descriptor.error(errno)),
        }
    }

    /// Compares address and port only: the scope of an IPv6 address may differ.
    fn is_own(&self, from: &SocketAddrAny) -> bool {
        let from = SocketAddr::try_from(from.clone());
        from.is_ok_and(|from| (from.ip(), from.port()) == (self.own.ip(), self.own.port()))
    }
}

impl LinkIo<Can> for UdpLink {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        let mut buffer = [0; DATAGRAM_MAX];
        let len = datagram::pack(frame, clock::wall_ns(clock::now()), &mut buffer);
        loop {
            match self.sender.send(&buffer[..len]) {
                Ok(_) => {
                    self.sent.fetch_add(1, Ordering::Relaxed);
                    return Ok(());
                }
                // A burst, on a busy machine, is handed over more slowly than it is sent.
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.descriptor.wait_for_room(self.sender.as_fd())?;
                }
                Err(error) => return Err(LinkError::from_io(&self.descriptor.name, &error)),
            }
        }
    }

    fn receive(&self, frame: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        self.descriptor.receive_with(until, || self.read_frame(frame))
    }

    fn set_line(&self, _line: CanLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.descriptor.waker.clone()
    }

    fn describe(&self) -> String {
        self.descriptor.name.clone()
    }

    fn losses(&self) -> Losses {
        Losses {
            overrun: self.overrun_count(),
            malformed: self.malformed.load(Ordering::Relaxed),
            errors: self.errors.load(Ordering::Relaxed),
            ..Losses::default()
        }
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<Can>>, LinkError> {
        Ok(Box::new(open(self.group)?))
    }
}
