//! A socket filter in the kernel that drops our own datagrams. Without it they are recognised by their
//! sender, at the cost of two system calls each.

use std::net::{IpAddr, SocketAddr};
use std::os::fd::OwnedFd;

use libc::sock_filter;

/// Instructions of classic BPF: load a half-word or word at a fixed place, jump if equal, return.
const LOAD_HALF: u16 = 0x28;
const LOAD_WORD: u16 = 0x20;
const JUMP_EQUAL: u16 = 0x15;
const RETURN: u16 = 0x06;
/// Places that count from the network header, not from the UDP header (`SKF_NET_OFF`).
const NETWORK: u32 = -0x10_0000_i32 as u32;
/// Offset of the source address in the IPv4 header.
const SOURCE_IPV4: u32 = 12;
const SOURCE_IPV6: u32 = 8;

/// Asks the kernel to drop datagrams from `own`. False if it does not (a sandbox): every echo
/// is then read and thrown away.
pub(super) fn drop_own_datagrams(fd: &OwnedFd, own: SocketAddr) -> bool {
    crate::sys::attach_filter(fd, &mut filter_program(own)).is_ok()
}

/// Drops a datagram if every one of the fields is ours, else lets it through.
fn filter_program(own: SocketAddr) -> Vec<sock_filter> {
    let mut fields = vec![(LOAD_HALF, 0, u32::from(own.port()))];
    match own.ip() {
        IpAddr::V4(ip) => fields.push((LOAD_WORD, NETWORK + SOURCE_IPV4, u32::from(ip))),
        IpAddr::V6(ip) => {
            for (n, word) in ip.octets().chunks_exact(4).enumerate() {
                let value = u32::from_be_bytes([word[0], word[1], word[2], word[3]]);
                fields.push((LOAD_WORD, NETWORK + SOURCE_IPV6 + 4 * n as u32, value));
            }
        }
    }
    let mut program = Vec::new();
    for (n, &(load, index, value)) in fields.iter().enumerate() {
        program.push(sock_filter { code: load, jt: 0, jf: 0, k: index });
        // The fields left take two instructions each, then comes the drop, then the pass.
        let pass = 2 * (fields.len() - n - 1) + 1;
        program.push(sock_filter { code: JUMP_EQUAL, jt: 0, jf: pass as u8, k: value });
    }
    program.push(sock_filter { code: RETURN, jt: 0, jf: 0, k: 0 });
    program.push(sock_filter { code: RETURN, jt: 0, jf: 0, k: u32::MAX });
    program
}
