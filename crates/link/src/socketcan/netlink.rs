//! State of CAN interfaces from the kernel: rtnetlink's `RTM_GETLINK`.

use polepair_core::convert::tail;
use std::io;

use rustix::net::netlink::SocketAddrNetlink;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, recv, sendto, socket_with,
    sockopt,
};

use super::{CanInterface, ControllerState};

/// Interfaces and answers that are looked at.
const INTERFACES_MAX: usize = 256;
const ANSWERS_MAX: usize = 256;
/// The kernel fills what the reader offers, 32 KiB at most.
const ANSWER_MAX: usize = 32 * 1024;
/// Time limit of the kernel's reply.
const ANSWER_TIMEOUT: std::time::Duration = std::time::Duration::from_secs(1);

/// `linux/netlink.h`, `linux/rtnetlink.h`.
const HEADER: usize = 16;
const LINK_HEADER: usize = 16;
const NEW_LINK: u16 = 16;
const GET_LINK: u16 = 18;
const ERROR: u16 = 2;
const DONE: u16 = 3;
const REQUEST_DUMP: u16 = 0x1 | 0x300;
/// `ARPHRD_CAN` of `linux/if_arp.h`, `IFF_UP` of `linux/if.h`.
const KIND_CAN: u16 = 280;
const UP: u32 = 1;
/// Attributes of `linux/if_link.h` and `linux/can/netlink.h`.
const NAME: u16 = 3;
const LINK_INFO: u16 = 18;
const INFO_KIND: u16 = 1;
const INFO_DATA: u16 = 2;
const CAN_BIT_TIMING: u16 = 1;
const CAN_STATE: u16 = 4;
const CAN_RESTART_MS: u16 = 6;

/// Every CAN interface of this network namespace.
pub(super) fn interfaces() -> io::Result<Vec<CanInterface>> {
    // Protocol 0 is NETLINK_ROUTE.
    let socket = socket_with(AddressFamily::NETLINK, SocketType::RAW, SocketFlags::CLOEXEC, None)?;
    sockopt::set_socket_timeout(
        &socket,
        sockopt::Timeout::Recv,
        Some(crate::clock::scale_timeout(ANSWER_TIMEOUT)),
    )?;
    sendto(&socket, &dump_request(), SendFlags::empty(), &SocketAddrNetlink::new(0, 0))?;
    let mut found = Vec::new();
    let mut answer = vec![0; ANSWER_MAX];
    for _ in 0..ANSWERS_MAX {
        let (len, _) = recv(&socket, &mut answer[..], RecvFlags::empty())?;
        if parse_answer(&answer[..len], &mut found) {
            break;
        }
    }
    Ok(found)
}

/// A request for all links.
fn dump_request() -> [u8; HEADER + LINK_HEADER] {
    let mut request = [0; HEADER + LINK_HEADER];
    request[..4].copy_from_slice(&((HEADER + LINK_HEADER) as u32).to_ne_bytes());
    request[4..6].copy_from_slice(&GET_LINK.to_ne_bytes());
    request[6..8].copy_from_slice(&REQUEST_DUMP.to_ne_bytes());
    request
}

/// Takes the CAN interfaces out of one answer; true when it was the last.
pub(super) fn parse_answer(mut answer: &[u8], found: &mut Vec<CanInterface>) -> bool {
    while let (Some(len), Some(kind)) = (read_u32(answer, 0), read_u16(answer, 4)) {
        let len = len as usize;
        if len < HEADER || len > answer.len() || kind == DONE || kind == ERROR {
            return true;
        }
        if kind == NEW_LINK && found.len() < INTERFACES_MAX {
            found.extend(parse_interface(&answer[HEADER..len]));
        }
        answer = tail(answer, aligned(len));
    }
    false
}

fn parse_interface(message: &[u8]) -> Option<CanInterface> {
    if read_u16(message, 2)? != KIND_CAN {
        return None;
    }
    let mut interface = CanInterface {
        name: String::new(),
        index: read_u32(message, 4)?,
        up: read_u32(message, 8)? & UP != 0,
        kind: String::new(),
        bit_rate: None,
        controller: None,
        restart_ms: None,
    };
    for (attribute, value) in Attributes(message.get(LINK_HEADER..)?) {
        match attribute {
            NAME => interface.name = read_string(value),
            LINK_INFO => parse_link_info(value, &mut interface),
            _ => {}
        }
    }
    (!interface.name.is_empty()).then_some(interface)
}

fn parse_link_info(info: &[u8], interface: &mut CanInterface) {
    for (attribute, value) in Attributes(info) {
        match attribute {
            INFO_KIND => interface.kind = read_string(value),
            INFO_DATA => parse_can_info(value, interface),
            _ => {}
        }
    }
}

fn parse_can_info(data: &[u8], interface: &mut CanInterface) {
    for (attribute, value) in Attributes(data) {
        match attribute {
            // `struct can_bittiming` begins with it; 0 while it was never set.
            CAN_BIT_TIMING => interface.bit_rate = read_u32(value, 0).filter(|&rate| rate != 0),
            CAN_STATE => {
                interface.controller = read_u32(value, 0).map(ControllerState::from_kernel)
            }
            CAN_RESTART_MS => interface.restart_ms = read_u32(value, 0),
            _ => {}
        }
    }
}

/// Type and value of one attribute after another.
struct Attributes<'a>(&'a [u8]);

impl<'a> Iterator for Attributes<'a> {
    type Item = (u16, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        // The two highest bits give the type of the value, which is known here.
        let (len, kind) = (usize::from(read_u16(self.0, 0)?), read_u16(self.0, 2)? & 0x3FFF);
        let value = self.0.get(4..len)?;
        self.0 = tail(self.0, aligned(len));
        Some((kind, value))
    }
}

const fn aligned(len: usize) -> usize {
    len.next_multiple_of(4)
}

fn read_u16(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_ne_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

fn read_u32(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_ne_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn read_string(value: &[u8]) -> String {
    let end = value.iter().position(|&byte| byte == 0).unwrap_or(value.len());
    String::from_utf8_lossy(&value[..end]).into_owned()
}
