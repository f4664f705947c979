//! Events of a link: a queue to poll, or a handler on a thread of its own.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{c_char, c_void};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use polepair::events::{Event, EventKind, Events};

use crate::error::{CallError, PP_NOTHING, PP_OK, pp_status};
use crate::fixed_text::copy_text;
use crate::handle::{run, with_handle};
use crate::link::{pp_link, read_seconds};
use crate::link_events::{CallbackThread, LinkEvents};
use crate::signal::{pp_signal, signal_number};
use crate::text::{SizedStruct, write_struct};

/// Kind of an event.
pub type pp_event_kind = i32;

/// The drive sent the value of a signal.
pub const PP_EVENT_SIGNAL: pp_event_kind = 0;
/// The drive sent the value of a parameter that is no signal.
pub const PP_EVENT_PARAMETER: pp_event_kind = 1;
/// The drive now has a fault.
pub const PP_EVENT_FAULT: pp_event_kind = 2;
/// A fault has gone.
pub const PP_EVENT_FAULT_CLEARED: pp_event_kind = 3;
/// The drive changed its state in the network: it restarted, or is gone.
pub const PP_EVENT_PRESENCE: pp_event_kind = 4;
/// The axis was armed.
pub const PP_EVENT_ARMED: pp_event_kind = 5;
/// The axis was disarmed.
pub const PP_EVENT_DISARMED: pp_event_kind = 6;
/// The link was lost. It is tried again.
pub const PP_EVENT_LINK_LOST: pp_event_kind = 7;
/// The link is there again.
pub const PP_EVENT_LINK_BACK: pp_event_kind = 8;
/// An event that this version of the header does not know: its text describes it.
pub const PP_EVENT_OTHER: pp_event_kind = 99;

/// One thing that happened.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_event {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// Kind of the event: `PP_EVENT_` and a name.
    pub kind: pp_event_kind,
    /// The number of the axis; 0 for what happened to the link.
    pub axis: u32,
    /// The signal of `PP_EVENT_SIGNAL`; -1 otherwise.
    pub signal: pp_signal,
    /// The code of a fault; 0 otherwise.
    pub code: u32,
    /// 0.
    pub reserved: u32,
    /// Seconds on the link's clock.
    pub time: f64,
    /// The value of a signal (SI) or a parameter (in its unit); NaN otherwise.
    pub value: f64,
    /// The event in words: "axis 1: armed".
    pub text: [c_char; 256],
}

// SAFETY: size first, then plain numbers and bytes.
unsafe impl SizedStruct for pp_event {}

/// A function that is called for each event. `event` is valid during the call.
pub type pp_event_handler = Option<extern "C" fn(event: *const pp_event, user: *mut c_void)>;

/// Begins to listen: events from now on wait for `pp_link_next_event`, at most 8192; then the oldest go. PP_USAGE
/// with E257 on a server, and if the link listens already.
///
/// # Safety
/// `link` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_listen(link: *const pp_link) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(link, |link| start(link, None, std::ptr::null_mut())) }
}

/// Begins to listen, and has `handler` called for each event from now on, with `user`.
///
/// All calls come from one thread that the library starts for this link; nothing is called after `pp_link_close`
/// has returned. The handler may call any function but `pp_link_close` of this link, and must not throw.
///
/// # Safety
/// `link` is NULL or valid; `handler` may be called from another thread with `user`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_set_event_handler(
    link: *const pp_link,
    handler: pp_event_handler,
    user: *mut c_void,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(link, |link| match handler {
            None => Err(CallError::usage("the event handler is NULL", "pp_link_listen needs none")),
            Some(_) => start(link, handler, user),
        })
    }
}

fn start(link: &pp_link, handler: pp_event_handler, user: *mut c_void) -> Result<(), CallError> {
    let mut queue = link.events.lock().unwrap_or_else(PoisonError::into_inner);
    if queue.is_some() {
        let hint = "a link has one queue, or one handler";
        return Err(CallError::usage("the link listens already", hint));
    }
    let events = Arc::new(link.opened()?.events()?);
    let handler = handler.map(|handler| start_thread(&events, handler, user)).transpose()?;
    *queue = Some(LinkEvents { events, handler });
    Ok(())
}

fn start_thread(
    events: &Arc<Events>,
    handler: extern "C" fn(*const pp_event, *mut c_void),
    user: *mut c_void,
) -> Result<CallbackThread, CallError> {
    struct User(*mut c_void);
    // SAFETY: the caller has promised that another thread may use it.
    unsafe impl Send for User {}
    let (ended, events, user) = (Arc::new(AtomicBool::new(false)), Arc::clone(events), User(user));
    let is_over = Arc::clone(&ended);
    let thread = std::thread::Builder::new().name("polepair-events".to_owned()).spawn(move || {
        let user = user;
        while !is_over.load(Ordering::SeqCst) {
            if let Some(event) = events.next(Duration::from_secs(1)) {
                let event = describe(&event);
                handler(&raw const event, user.0);
            }
        }
    });
    Ok(CallbackThread {
        ended,
        thread: Some(
            thread.map_err(|error| {
                CallError::usage(format!("no thread can be started: {error}"), "")
            })?,
        ),
    })
}

/// Returns the next event. Waits for it at most `seconds`, then returns PP_NOTHING.
///
/// # Safety
/// `link` is NULL or valid; `event` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_next_event(
    link: *const pp_link,
    seconds: f64,
    event: *mut pp_event,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(link, |link| {
            let events = {
                let queue = link.events.lock().unwrap_or_else(PoisonError::into_inner);
                let queue = queue.as_ref().filter(|queue| queue.handler.is_none());
                queue.map(|queue| Arc::clone(&queue.events))
            };
            let hint = "call pp_link_listen before";
            let events = events.ok_or_else(|| CallError::usage("the link has no queue", hint))?;
            let Some(found) = events.next(read_seconds(seconds)?) else { return Ok(PP_NOTHING) };
            write_struct(event, &describe(&found))?;
            Ok(PP_OK)
        })
    }
}

/// Gives the number of events that were lost because they were not fetched in time.
///
/// # Safety
/// `link` is NULL or valid; `count` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_lost_events(link: *const pp_link, count: *mut u64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(link, |link| {
            let queue = link.events.lock().unwrap_or_else(PoisonError::into_inner);
            crate::text::write_value(count, queue.as_ref().map_or(0, |queue| queue.events.lost()))
        })
    }
}

fn describe(event: &Event) -> pp_event {
    let (kind, signal, code, value) = match &event.kind {
        EventKind::Signal { signal, reading } => {
            (PP_EVENT_SIGNAL, signal_number(*signal), 0, reading.value)
        }
        EventKind::Parameter { value, .. } => (PP_EVENT_PARAMETER, -1, 0, *value),
        EventKind::FaultAppeared { code, .. } => (PP_EVENT_FAULT, -1, *code, f64::NAN),
        EventKind::FaultCleared { code, .. } => (PP_EVENT_FAULT_CLEARED, -1, *code, f64::NAN),
        EventKind::Presence(_) => (PP_EVENT_PRESENCE, -1, 0, f64::NAN),
        EventKind::Armed => (PP_EVENT_ARMED, -1, 0, f64::NAN),
        EventKind::Disarmed => (PP_EVENT_DISARMED, -1, 0, f64::NAN),
        EventKind::LinkLost { .. } => (PP_EVENT_LINK_LOST, -1, 0, f64::NAN),
        EventKind::LinkBack => (PP_EVENT_LINK_BACK, -1, 0, f64::NAN),
        _ => (PP_EVENT_OTHER, -1, 0, f64::NAN),
    };
    let size = size_of::<pp_event>() as u32;
    let time = event.at.since(polepair_core::time::Instant::ZERO).as_secs_f64();
    let axis = event.axis.unwrap_or(0);
    let mut described =
        pp_event { size, kind, axis, signal, code, reserved: 0, time, value, text: [0; 256] };
    copy_text(&event.to_string(), &mut described.text);
    described
}
