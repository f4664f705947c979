//! Calls of Windows that no library offers safely: events, overlapped reads, console signals, timers.
#![allow(unsafe_code, reason = "the only place that calls Windows directly")]

use std::io;
use std::os::windows::io::{AsRawHandle, FromRawHandle, OwnedHandle, RawHandle};
use std::sync::OnceLock;
use std::time::Duration;

use windows_sys::Win32::Devices::Communication::{COMSTAT, ClearCommError};
use windows_sys::Win32::Foundation::{ERROR_IO_PENDING, WAIT_FAILED, WAIT_OBJECT_0};
use windows_sys::Win32::Media::timeBeginPeriod;
use windows_sys::Win32::Storage::FileSystem::ReadFile;
use windows_sys::Win32::System::Console::SetConsoleCtrlHandler;
use windows_sys::Win32::System::IO::{CancelIoEx, GetOverlappedResult, OVERLAPPED};
use windows_sys::Win32::System::Threading::{
    CreateEventW, INFINITE, ResetEvent, SetEvent, WaitForMultipleObjects,
};

/// Bytes that one overlapped read takes at most.
const READ_MAX: usize = 4096;

/// An event that stays set until it is reset.
#[derive(Debug)]
pub(crate) struct WaitEvent(OwnedHandle);

impl WaitEvent {
    pub(crate) fn new() -> io::Result<Self> {
        // SAFETY: null is allowed for attributes and name; the result is checked.
        let handle = unsafe { CreateEventW(std::ptr::null(), 1, 0, std::ptr::null()) };
        if handle.is_null() {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the handle was created just now, and has no other owner.
        Ok(Self(unsafe { OwnedHandle::from_raw_handle(handle) }))
    }

    pub(crate) fn set(&self) {
        // SAFETY: the handle is open as long as `self` is.
        unsafe { SetEvent(self.0.as_raw_handle()) };
    }

    pub(crate) fn reset(&self) {
        // SAFETY: the handle is open as long as `self` is.
        unsafe { ResetEvent(self.0.as_raw_handle()) };
    }
}

/// Waits until one of two events is set. The index of the first that is; `None` after the time.
pub(crate) fn wait_either(
    first: &WaitEvent,
    second: &WaitEvent,
    timeout: Option<Duration>,
) -> io::Result<Option<usize>> {
    let handles = [first.0.as_raw_handle(), second.0.as_raw_handle()];
    // A wait never ends before its time.
    let ms = timeout.map_or(INFINITE, |span| {
        u32::try_from(span.as_nanos().div_ceil(1_000_000)).unwrap_or(INFINITE).min(INFINITE - 1)
    });
    // SAFETY: both handles are open as long as the events are borrowed.
    match unsafe { WaitForMultipleObjects(2, handles.as_ptr(), 0, ms) } {
        WAIT_OBJECT_0 => Ok(Some(0)),
        ready if ready == WAIT_OBJECT_0 + 1 => Ok(Some(1)),
        WAIT_FAILED => Err(io::Error::last_os_error()),
        _ => Ok(None),
    }
}

/// A read of a serial port that goes on while others write to it. It is kept between two waits, so that nothing
/// that arrives in between is lost.
///
/// An overlapped read of one byte, followed by those behind it: of a longer read, some systems report only the end.
pub(crate) struct OverlappedRead {
    event: WaitEvent,
    /// Memory that the system writes until the read has ended.
    shared: Box<ReadShared>,
    is_pending: bool,
    /// The range of bytes that were read and not taken.
    unread: std::ops::Range<usize>,
}

struct ReadShared {
    overlapped: OVERLAPPED,
    buffer: [u8; READ_MAX],
}

// SAFETY: the pointers in `OVERLAPPED` are those of the event, which any thread may use.
unsafe impl Send for OverlappedRead {}

impl OverlappedRead {
    pub(crate) fn new() -> io::Result<Self> {
        let event = WaitEvent::new()?;
        let overlapped = OVERLAPPED { hEvent: event.0.as_raw_handle(), ..OVERLAPPED::default() };
        let shared = Box::new(ReadShared { overlapped, buffer: [0; READ_MAX] });
        Ok(Self { event, shared, is_pending: false, unread: 0..0 })
    }

    /// Set when the read has ended.
    pub(crate) const fn event(&self) -> &WaitEvent {
        &self.event
    }

    /// Starts a read of `device`, unless one is under way or bytes are left.
    pub(crate) fn start(&mut self, device: &impl AsRawHandle) -> io::Result<()> {
        if self.is_pending || !self.unread.is_empty() {
            return Ok(());
        }
        self.begin(device.as_raw_handle(), 0..1)
    }

    /// Begins to read into a range of the buffer.
    fn begin(&mut self, device: RawHandle, place: std::ops::Range<usize>) -> io::Result<()> {
        let (out, overlapped) =
            (&raw mut self.shared.buffer[place.clone()], &raw mut self.shared.overlapped);
        // SAFETY: buffer and OVERLAPPED are in a box that lives until the read has ended: `drop` sees to it.
        let done = unsafe {
            ReadFile(device, out.cast(), place.len() as u32, std::ptr::null_mut(), overlapped)
        };
        // One that has ended at once sets the event as well.
        let error = io::Error::last_os_error();
        if done == 0 && error.raw_os_error() != Some(ERROR_IO_PENDING as i32) {
            return Err(error);
        }
        self.is_pending = true;
        Ok(())
    }

    /// Waits for the end of the read, and takes its bytes; 0 if the device gave none.
    pub(crate) fn collect_bytes(
        &mut self,
        device: &impl AsRawHandle,
        out: &mut [u8],
    ) -> io::Result<usize> {
        if self.is_pending {
            let device = device.as_raw_handle();
            let mut count = self.finish(device)?;
            let queued = queued_count(device).min(READ_MAX - 1);
            if count > 0 && queued > 0 {
                self.begin(device, 1..1 + queued)?;
                count += self.finish(device)?;
            }
            self.unread = 0..count;
        }
        Ok(self.take_unread(out))
    }

    /// Takes bytes of an earlier read that were not taken.
    pub(crate) fn take_unread(&mut self, out: &mut [u8]) -> usize {
        let count = self.unread.len().min(out.len());
        let from = self.unread.start;
        out[..count].copy_from_slice(&self.shared.buffer[from..from + count]);
        self.unread.start += count;
        count
    }

    /// Waits for the end of the read.
    fn finish(&mut self, device: RawHandle) -> io::Result<usize> {
        let mut count = 0;
        let overlapped = &raw mut self.shared.overlapped;
        // SAFETY: the read was started with this OVERLAPPED, which lives in a box.
        let done = unsafe { GetOverlappedResult(device, overlapped, &raw mut count, 1) };
        self.is_pending = false;
        match done {
            0 => Err(io::Error::last_os_error()),
            _ => Ok(count as usize),
        }
    }

    /// Ends the read, and forgets its bytes.
    pub(crate) fn cancel(&mut self, device: &impl AsRawHandle) {
        self.unread = 0..0;
        if self.is_pending {
            // SAFETY: the read was started on this device with this OVERLAPPED.
            unsafe { CancelIoEx(device.as_raw_handle(), &raw const self.shared.overlapped) };
            let _ = self.finish(device.as_raw_handle());
        }
    }
}

/// Number of bytes have arrived and were not read.
fn queued_count(device: RawHandle) -> usize {
    let (mut errors, mut status) = (0, COMSTAT::default());
    // SAFETY: both are written by the call alone; a handle that is no port gives an error.
    let done = unsafe { ClearCommError(device, &raw mut errors, &raw mut status) };
    if done == 0 { 0 } else { status.cbInQue as usize }
}

impl Drop for OverlappedRead {
    fn drop(&mut self) {
        // The owner cancels first; a read that is still under way must keep its memory.
        if self.is_pending {
            std::mem::forget(std::mem::replace(
                &mut self.shared,
                Box::new(ReadShared { overlapped: OVERLAPPED::default(), buffer: [0; READ_MAX] }),
            ));
        }
    }
}

/// Function that [`set_console_handler`] registers.
static HANDLER: OnceLock<fn(u32) -> bool> = OnceLock::new();

/// Has `handler` called on a thread of the system for signals of the console; false passes one on.
pub(crate) fn set_console_handler(handler: fn(u32) -> bool) {
    unsafe extern "system" fn call(event: u32) -> i32 {
        HANDLER.get().is_some_and(|handler| handler(event)).into()
    }
    if HANDLER.set(handler).is_ok() {
        // SAFETY: `call` may be called from any thread at any time.
        unsafe { SetConsoleCtrlHandler(Some(call), 1) };
    }
}

/// Has waits of this process end within a millisecond, and not 16.
pub(crate) fn use_fine_timers() {
    static ONCE: OnceLock<()> = OnceLock::new();
    // SAFETY: the call has no requirements. It is undone when the process ends.
    ONCE.get_or_init(|| unsafe {
        timeBeginPeriod(1);
    });
}
