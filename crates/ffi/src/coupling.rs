//! Coupling: an axis follows another one of its bus.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use polepair::{Cam, CamPoint, GearRatio, LocalAxis};

use crate::axis::pp_axis;
use crate::error::{CallError, pp_status};
use crate::handle::run;

const HINT: &str = "open the drives' link in this program";

/// Lets an axis follow another one of its bus by a ratio, in the drives: `turns` of its motor to `master_turns` of the
/// master's. A negative number turns the other way.
///
/// The axis must be armed and powered, and the master at rest. Nothing moves until the master does. PP_NEGATIVE with
/// E101 if the drive does not receive the master's position: it was not coupled. PP_USAGE with E217 or E245 for what
/// cannot be coupled. The axis follows until `pp_axis_uncouple`, a stop, or another motion of it. Thread-safe.
///
/// Example:
///
/// ```c
/// pp_axis_follow_gear(follower, master, 1, 3);
/// pp_axis_run(master, PP_MOVE_TO, 6.2832, NULL);
/// ```
///
/// # Safety
/// `axis` and `master` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_follow_gear(
    axis: *const pp_axis,
    master: *const pp_axis,
    turns: i32,
    master_turns: i32,
) -> pp_status {
    let ratio = GearRatio { follower: turns, master: master_turns };
    // SAFETY: as promised by the caller.
    unsafe { with_pair(axis, master, |axis, master| Ok(axis.follow_gear(master, ratio)?)) }
}

/// Lets an axis follow another one of its bus by a cam's table, in the drives. As `pp_axis_follow_gear`.
///
/// `points` has `count` pairs in rad, the master's positions ascending: master, follower. The table lies in the
/// drive's memory from `first_address` to `last_address`, which nothing else uses; both 0 for the memory that every
/// such drive has. Its layout is inferred: PP_USAGE with E222 unless `inferred` is 1.
///
/// # Safety
/// `axis` and `master` are NULL or valid; `points` has twice `count` elements.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_follow_cam(
    axis: *const pp_axis,
    master: *const pp_axis,
    points: *const f64,
    count: usize,
    first_address: u32,
    last_address: u32,
    inferred: i32,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_pair(axis, master, |axis, master| {
            let numbers = count.checked_mul(2).filter(|_| !points.is_null());
            let numbers = numbers.ok_or_else(|| CallError::usage("there are no points", ""))?;
            let (pairs, _) = std::slice::from_raw_parts(points, numbers).as_chunks::<2>();
            let point = |[master, follower]: &[f64; 2]| CamPoint {
                master: master / TAU,
                follower: follower / TAU,
            };
            let cam = Cam {
                points: pairs.iter().map(point).collect(),
                memory: read_memory(first_address, last_address)?,
                accept_inferred: inferred != 0,
            };
            let plan = axis.plan_cam(master, &cam)?;
            Ok(axis.follow_cam(master, &plan)?)
        })
    }
}

/// Ends the coupling of an axis: stops it, and the messages of the master, which must be at rest.
///
/// # Safety
/// `axis` and `master` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_uncouple(
    axis: *const pp_axis,
    master: *const pp_axis,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { with_pair(axis, master, |axis, master| Ok(axis.uncouple(master)?)) }
}

/// A caller's range of a drive's memory; 0 and 0 is none.
pub(crate) fn read_memory(first: u32, last: u32) -> Result<Option<RangeInclusive<u16>>, CallError> {
    if (first, last) == (0, 0) {
        return Ok(None);
    }
    match (u16::try_from(first), u16::try_from(last)) {
        (Ok(first), Ok(last)) if first < last => Ok(Some(first..=last)),
        _ => {
            let what = format!("{first:#x} to {last:#x} is no memory of a drive");
            Err(CallError::usage(what, "0x8270 to 0x87FF, for example"))
        }
    }
}

/// Does something with two axes of this program's links.
///
/// # Safety
/// Both are NULL or valid.
unsafe fn with_pair(
    axis: *const pp_axis,
    master: *const pp_axis,
    work: impl FnOnce(&LocalAxis, &LocalAxis) -> Result<(), CallError>,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let master =
                master.as_ref().ok_or_else(|| CallError::usage("the master is NULL", ""))?;
            let what = "coupling";
            let axis = axis.opened()?.require_local(what, HINT)?;
            work(axis, master.opened()?.require_local(what, HINT)?)
        })
    }
}
