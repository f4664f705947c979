//! Linux functions that rustix lacks: socket options by number, and messages with time stamps.
#![allow(unsafe_code)]

use std::io;
use std::mem::{MaybeUninit, size_of};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use libc::{c_int, c_void, socklen_t};

/// Room for the control messages asked for: a time stamp of up to three `timespec` and a counter.
const CONTROL_MAX: usize = 192;

/// Data that came with a message.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Message {
    pub(crate) len: usize,
    /// Time of arrival, nanoseconds since 1970.
    pub(crate) stamp_ns: Option<u64>,
    /// When it arrived by the clock of the hardware, nanoseconds since whatever that counts from.
    pub(crate) hardware_ns: Option<u64>,
    /// Number of were thrown away so far for want of room, modulo 2³².
    pub(crate) overrun: Option<u32>,
}

/// Requests a time stamp and the count of losses with every message. A kernel without them refuses, and they are left
/// out.
pub(crate) fn enable_timestamps(fd: &OwnedFd) {
    let _ = set_option(fd, libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, &1_i32);
    let _ = set_option(fd, libc::SOL_SOCKET, libc::SO_RXQ_OVFL, &1_i32);
}

/// A raw CAN socket on the interface of that index, which never waits.
pub(crate) fn can_socket(index: c_int) -> io::Result<OwnedFd> {
    let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
    // SAFETY: plain numbers.
    let fd = unsafe { libc::socket(libc::PF_CAN, kind, libc::CAN_RAW) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the kernel has just returned this descriptor, and it has no other owner.
    let fd = unsafe { OwnedFd::from_raw_fd(fd) };
    // SAFETY: all zeros is a valid sockaddr_can.
    let mut name: libc::sockaddr_can = unsafe { MaybeUninit::zeroed().assume_init() };
    name.can_family = libc::AF_CAN as _;
    name.can_ifindex = index;
    let len = size_of::<libc::sockaddr_can>() as socklen_t;
    // SAFETY: the pointer is to a whole sockaddr_can, `len` bytes long.
    let bound = unsafe { libc::bind(fd.as_raw_fd(), (&raw const name).cast(), len) };
    if bound == 0 { Ok(fd) } else { Err(io::Error::last_os_error()) }
}

/// `setsockopt`. `T` is what the option takes: an integer, or an array of plain numbers.
pub(crate) fn set_option<T: PlainData + ?Sized>(
    fd: &OwnedFd,
    level: c_int,
    name: c_int,
    value: &T,
) -> io::Result<()> {
    let len = size_of_val(value) as socklen_t;
    // SAFETY: the pointer is to `len` initialised bytes that live through the call (`PlainData`).
    let done = unsafe {
        libc::setsockopt(fd.as_raw_fd(), level, name, std::ptr::from_ref(value).cast(), len)
    };
    if done == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Types without padding or pointers.
pub(crate) trait PlainData {}
impl PlainData for i32 {}
impl PlainData for u32 {}
impl PlainData for [libc::can_filter] {}

/// Lets the kernel drop what `program` (classic BPF) refuses before it wakes anybody.
pub(crate) fn attach_filter(fd: &OwnedFd, program: &mut [libc::sock_filter]) -> io::Result<()> {
    let program = libc::sock_fprog {
        len: u16::try_from(program.len()).map_err(|_| io::ErrorKind::InvalidInput)?,
        filter: program.as_mut_ptr(),
    };
    let len = size_of::<libc::sock_fprog>() as socklen_t;
    // SAFETY: `program` is a whole sock_fprog whose pointer is to `len` filters; the kernel copies
    // them before it returns.
    let done = unsafe {
        libc::setsockopt(
            fd.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_ATTACH_FILTER,
            std::ptr::from_ref(&program).cast(),
            len,
        )
    };
    if done == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Number of messages a socket has dropped so far, for want of room or by its filter.
pub(crate) fn dropped_count(fd: &OwnedFd) -> u32 {
    // `SK_MEMINFO_VARS` and `SK_MEMINFO_DROPS` of linux/sock_diag.h.
    let mut info = [0_u32; 9];
    let mut len = size_of_val(&info) as socklen_t;
    // SAFETY: the kernel writes at most `len` bytes to `info`, which has that many.
    let done = unsafe {
        libc::getsockopt(
            fd.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_MEMINFO,
            info.as_mut_ptr().cast(),
            &raw mut len,
        )
    };
    if done == 0 { info[8] } else { 0 }
}

/// Takes one message with its stamps, if there is one; never waits.
pub(crate) fn receive(fd: &OwnedFd, buffer: &mut [u8]) -> io::Result<Option<Message>> {
    let mut vector =
        libc::iovec { iov_base: buffer.as_mut_ptr().cast::<c_void>(), iov_len: buffer.len() };
    let mut control = ControlBuffer([0; CONTROL_MAX]);
    // SAFETY: all zeros is a valid msghdr (no name, no vector, no control).
    let mut header: libc::msghdr = unsafe { MaybeUninit::zeroed().assume_init() };
    header.msg_iov = &raw mut vector;
    header.msg_iovlen = 1;
    header.msg_control = control.0.as_mut_ptr().cast();
    header.msg_controllen = CONTROL_MAX as _;
    // SAFETY: the header's pointers are to live buffers of the lengths that stand beside them.
    let len = unsafe { libc::recvmsg(fd.as_raw_fd(), &raw mut header, libc::MSG_DONTWAIT) };
    let Ok(len) = usize::try_from(len) else {
        let error = io::Error::last_os_error();
        let nothing =
            matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted);
        return if nothing { Ok(None) } else { Err(error) };
    };
    let mut message = Message { len, ..Message::default() };
    read_control(&header, &mut message);
    Ok(Some(message))
}

/// Aligned as control messages are.
#[repr(align(16))]
struct ControlBuffer([u8; CONTROL_MAX]);

fn read_control(header: &libc::msghdr, message: &mut Message) {
    // SAFETY: `header` is what recvmsg filled in, and its control buffer still lives; the macros
    // stay within msg_controllen.
    unsafe {
        let mut next = libc::CMSG_FIRSTHDR(header);
        while let Some(control) = next.as_ref() {
            if control.cmsg_level == libc::SOL_SOCKET {
                let data = libc::CMSG_DATA(control);
                match control.cmsg_type {
                    libc::SCM_TIMESTAMPNS => {
                        let at = data.cast::<libc::timespec>().read_unaligned();
                        message.stamp_ns = Some(nanoseconds(at));
                    }
                    libc::SO_TIMESTAMPING => {
                        // Software, a transformed one, hardware.
                        let stamps = data.cast::<[libc::timespec; 3]>().read_unaligned();
                        message.hardware_ns = Some(nanoseconds(stamps[2])).filter(|&ns| ns != 0);
                    }
                    libc::SO_RXQ_OVFL => {
                        message.overrun = Some(data.cast::<u32>().read_unaligned());
                    }
                    _ => {}
                }
            }
            next = libc::CMSG_NXTHDR(header, control);
        }
    }
}

#[allow(clippy::unnecessary_cast, reason = "the width of time_t differs by platform")]
fn nanoseconds(at: libc::timespec) -> u64 {
    let whole = u64::try_from(at.tv_sec as i64).unwrap_or(0).saturating_mul(1_000_000_000);
    whole.saturating_add(u64::try_from(at.tv_nsec as i64).unwrap_or(0))
}

/// The kernel's count of messages that a socket had no room for, which wraps at 2³².
#[derive(Debug, Default)]
pub(crate) struct OverrunCounter {
    seen: AtomicU32,
    total: AtomicU64,
}

impl OverrunCounter {
    /// Only the thread that receives calls it.
    pub(crate) fn update(&self, count: Option<u32>) {
        let Some(count) = count else { return };
        let more = count.wrapping_sub(self.seen.swap(count, Ordering::Relaxed));
        self.total.fetch_add(more.into(), Ordering::Relaxed);
    }

    pub(crate) fn total(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }
}
