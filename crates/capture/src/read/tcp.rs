//! Serial bytes in TCP connections of a network capture: drives behind serial servers, and gateways that carry
//! the same bytes.
//!
//! A link is the server's address, `10.0.0.5:4001`. The server is the drive's side: the one that accepts the
//! connection, or that has the lower port if the start is not captured. Segments that come twice are dropped,
//! and segments out of order wait for those before them.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::net::{IpAddr, SocketAddr};

use etherparse::{NetSlice, SlicedPacket, TcpSlice, TransportSlice};
use polepair_core::explain::Direction;

use super::{CapturePosition, Damage, ReadError, RecordSink};
use crate::record::{Record, RecordData};
use crate::timestamp::Timestamp;

/// Link types of network packets: LINKTYPE_ETHERNET, LINKTYPE_RAW (and its older numbers), LINKTYPE_IPV4,
/// LINKTYPE_IPV6.
const ETHERNET: u32 = 1;
const RAW_IP: [u32; 5] = [101, 12, 14, 228, 229];
/// LINKTYPE_LINUX_SLL, which carries other packets too.
const COOKED: u32 = 113;
/// Connections that are followed at once.
const CONNECTIONS_MAX: usize = 1024;
/// Segments of a direction that wait for others at most; then the missing ones count as lost.
const WAITING_MAX: usize = 64;
/// Protocol numbers of IP in a cooked header.
const IP_PROTOCOLS: [[u8; 2]; 2] = [[0x08, 0x00], [0x86, 0xDD]];

/// Returns whether packets of that link type may be network packets.
pub(super) fn is_network(kind: u32, packet: &[u8]) -> bool {
    match kind {
        ETHERNET => true,
        COOKED => packet.get(14..16).is_some_and(|p| IP_PROTOCOLS.iter().any(|ip| ip == p)),
        _ => RAW_IP.contains(&kind),
    }
}

/// The connections of a capture.
#[derive(Debug, Default)]
pub(super) struct TcpStreams {
    connections: HashMap<(SocketAddr, SocketAddr), TcpConnection>,
}

/// One connection, by its client and its server.
#[derive(Debug, Default)]
struct TcpConnection {
    link: String,
    to_server: SegmentQueue,
    to_client: SegmentQueue,
}

/// One direction of a connection.
#[derive(Debug, Default)]
struct SegmentQueue {
    /// Sequence number of the next byte.
    next: Option<u32>,
    /// Segments behind a gap, by their distance from `next` when they came.
    waiting: BTreeMap<u32, (Option<Timestamp>, Vec<u8>)>,
}

/// When a packet was captured, and where in the file it begins.
#[derive(Clone, Copy)]
pub(super) struct PacketOrigin {
    pub time: Option<Timestamp>,
    pub offset: u64,
}

impl TcpStreams {
    /// Reads a packet, and passes on the bytes that follow the earlier ones of their connection.
    pub(super) fn read_packet(
        &mut self,
        kind: u32,
        packet: &[u8],
        origin: PacketOrigin,
        taker: &mut dyn RecordSink,
    ) {
        let sliced = match kind {
            ETHERNET => SlicedPacket::from_ethernet(packet).ok(),
            COOKED => SlicedPacket::from_linux_sll(packet).ok(),
            _ => SlicedPacket::from_ip(packet).ok(),
        };
        let Some(SlicedPacket {
            net: Some(net), transport: Some(TransportSlice::Tcp(tcp)), ..
        }) = sliced
        else {
            return taker.handle_skipped("packets that are not TCP");
        };
        let Some((source, destination)) = addresses(&net) else {
            return taker.handle_skipped("packets that are not TCP");
        };
        let source = SocketAddr::new(source, tcp.source_port());
        let destination = SocketAddr::new(destination, tcp.destination_port());
        self.read_segment(source, destination, &tcp, origin, taker);
    }

    fn read_segment(
        &mut self,
        source: SocketAddr,
        destination: SocketAddr,
        tcp: &TcpSlice<'_>,
        origin: PacketOrigin,
        taker: &mut dyn RecordSink,
    ) {
        let from_client = if self.connections.contains_key(&(source, destination)) {
            true
        } else if self.connections.contains_key(&(destination, source)) {
            false
        } else {
            let client = match (tcp.syn(), tcp.ack()) {
                (true, acknowledges) => !acknowledges,
                // In the middle of a connection the lower port is taken for the server's: clients get theirs from
                // above 1024.
                (false, _) => source.port() > destination.port(),
            };
            // Bare acknowledgements of a connection that carries nothing.
            if tcp.payload().is_empty() && !tcp.syn() {
                return;
            }
            if self.connections.len() >= CONNECTIONS_MAX {
                return taker.handle_skipped("packets of further TCP connections");
            }
            let key = if client { (source, destination) } else { (destination, source) };
            let mut connection = TcpConnection::default();
            let _ = write!(connection.link, "{}", key.1);
            self.connections.insert(key, connection);
            client
        };
        let key = if from_client { (source, destination) } else { (destination, source) };
        let Some(connection) = self.connections.get_mut(&key) else { return };
        let TcpConnection { link, to_server, to_client } = connection;
        let (queue, direction) = if from_client {
            (to_server, Direction::ToDrive)
        } else {
            (to_client, Direction::ToHost)
        };
        if tcp.syn() {
            // The sequence number of a SYN is one before that of the first byte.
            *queue = SegmentQueue {
                next: Some(tcp.sequence_number().wrapping_add(1)),
                ..Default::default()
            };
        }
        let mut emit = |time: Option<Timestamp>, bytes: &[u8]| {
            if !bytes.is_empty() {
                taker.handle_record(&Record {
                    time,
                    link,
                    direction: Some(direction),
                    data: RecordData::Bytes(bytes),
                    offset: origin.offset,
                });
            }
        };
        let gap = queue.push(tcp.sequence_number(), tcp.payload(), origin.time, &mut emit);
        if gap {
            taker.handle_damage(Damage {
                position: CapturePosition::Byte(origin.offset),
                reason: ReadError("bytes of a TCP connection are missing before this packet"),
            });
        }
        if tcp.rst() {
            self.connections.remove(&key);
        }
    }
}

impl SegmentQueue {
    /// Takes a segment, and emits the bytes that are complete now. True when bytes before it were given up.
    fn push(
        &mut self,
        sequence: u32,
        bytes: &[u8],
        time: Option<Timestamp>,
        emit: &mut dyn FnMut(Option<Timestamp>, &[u8]),
    ) -> bool {
        if bytes.is_empty() {
            return false;
        }
        let next = *self.next.get_or_insert(sequence);
        let ahead = sequence.wrapping_sub(next).cast_signed();
        let mut gap = false;
        if ahead > 0 {
            // The first of two segments with one number stays: TCP repeats, it does not change.
            self.waiting.entry(sequence).or_insert_with(|| (time, bytes.to_vec()));
            if self.waiting.len() <= WAITING_MAX {
                return false;
            }
            // More waiting segments than a network reorders: the missing one was not captured.
            gap = true;
            let first = self.waiting.keys().copied().min_by_key(|at| at.wrapping_sub(next));
            self.next = first.or(self.next);
        } else {
            self.deliver(sequence, bytes, time, emit);
        }
        while let Some(next) = self.next {
            // A segment that begins before `next` is one that was sent again with more bytes.
            let ready =
                self.waiting.keys().copied().find(|at| at.wrapping_sub(next).cast_signed() <= 0);
            let Some((at, (time, bytes))) =
                ready.and_then(|at| Some((at, self.waiting.remove(&at)?)))
            else {
                break;
            };
            self.deliver(at, &bytes, time, emit);
        }
        gap
    }

    /// Emits the bytes of a segment that are new.
    fn deliver(
        &mut self,
        sequence: u32,
        bytes: &[u8],
        time: Option<Timestamp>,
        emit: &mut dyn FnMut(Option<Timestamp>, &[u8]),
    ) {
        let next = self.next.unwrap_or(sequence);
        // Bytes that were sent again count once.
        let known = next.wrapping_sub(sequence) as usize;
        if let Some(fresh) = bytes.get(known..) {
            emit(time, fresh);
            self.next = Some(sequence.wrapping_add(bytes.len() as u32));
        }
    }
}

fn addresses(net: &NetSlice<'_>) -> Option<(IpAddr, IpAddr)> {
    match net {
        NetSlice::Ipv4(ip) => {
            let header = ip.header();
            Some((header.source_addr().into(), header.destination_addr().into()))
        }
        NetSlice::Ipv6(ip) => {
            let header = ip.header();
            Some((header.source_addr().into(), header.destination_addr().into()))
        }
        NetSlice::Arp(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use etherparse::PacketBuilder;

    use super::{ETHERNET, PacketOrigin, TcpStreams};
    use crate::read::{Damage, RecordSink};
    use crate::record::{Record, RecordData};

    /// Read records, in a line each.
    #[derive(Default)]
    struct Seen(Vec<String>);

    impl RecordSink for Seen {
        fn handle_record(&mut self, record: &Record<'_>) {
            let RecordData::Bytes(bytes) = record.data else { panic!("{record:?}") };
            let arrow = match record.direction {
                Some(polepair_core::explain::Direction::ToDrive) => '>',
                _ => '<',
            };
            self.0.push(format!("{} {arrow} {bytes:02X?}", record.link));
        }
        fn handle_damage(&mut self, damage: Damage) {
            self.0.push(damage.to_string());
        }
        fn handle_skipped(&mut self, kind: &'static str) {
            self.0.push(kind.to_owned());
        }
    }

    const CLIENT: ([u8; 4], u16) = ([10, 0, 0, 2], 50_000);
    const SERVER: ([u8; 4], u16) = ([10, 0, 0, 5], 4001);

    fn packet(
        from: ([u8; 4], u16),
        to: ([u8; 4], u16),
        seq: u32,
        syn: bool,
        data: &[u8],
    ) -> Vec<u8> {
        let builder = PacketBuilder::ethernet2([1; 6], [2; 6])
            .ipv4(from.0, to.0, 64)
            .tcp(from.1, to.1, seq, 1024);
        let builder = if syn { builder.syn() } else { builder.ack(1) };
        let mut bytes = Vec::new();
        builder.write(&mut bytes, data).expect("written");
        // Short frames are padded on the wire.
        bytes.resize(bytes.len().max(60), 0);
        bytes
    }

    fn read(packets: &[Vec<u8>]) -> Vec<String> {
        let (mut streams, mut seen) = (TcpStreams::default(), Seen::default());
        for (n, packet) in packets.iter().enumerate() {
            let origin = PacketOrigin { time: None, offset: n as u64 };
            streams.read_packet(ETHERNET, packet, origin, &mut seen);
        }
        seen.0
    }

    #[test]
    fn bytes_are_put_in_order_once() {
        let up = |seq, data: &[u8]| packet(CLIENT, SERVER, seq, false, data);
        let down = |seq, data: &[u8]| packet(SERVER, CLIENT, seq, false, data);
        let seen = read(&[
            packet(CLIENT, SERVER, u32::MAX, true, &[]),
            up(0, &[1, 2]),
            down(500, &[9]),
            up(0, &[1, 2]),
            up(4, &[5]),
            up(1, &[2, 3, 4]),
            up(5, &[]),
            down(501, &[8]),
        ]);
        let expected = [
            "10.0.0.5:4001 > [01, 02]",
            "10.0.0.5:4001 < [09]",
            "10.0.0.5:4001 > [03, 04]",
            "10.0.0.5:4001 > [05]",
            "10.0.0.5:4001 < [08]",
        ];
        assert_eq!(seen, expected);
    }

    #[test]
    fn a_gap_is_damage_and_the_rest_is_read() {
        let mut packets = vec![packet(SERVER, CLIENT, 10, false, &[1])];
        packets.extend((0..65).map(|n| packet(SERVER, CLIENT, 20 + n, false, &[n as u8])));
        let seen = read(&packets);
        assert_eq!(seen.len(), 67);
        assert_eq!(seen[1], "10.0.0.5:4001 < [00]");
        assert_eq!(seen[66], "byte 65: bytes of a TCP connection are missing before this packet");
    }

    #[test]
    fn other_packets_are_counted() {
        assert_eq!(read(&[vec![0; 60], vec![]]), ["packets that are not TCP"; 2]);
    }
}
