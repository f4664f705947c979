//! Who sends a frame by the predefined connection set, and what it may do to nodes.

use crate::explain::{Direction, Effect};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::proto::canopen::cob::Cob;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::Command;
use crate::proto::canopen::sdo::{Object, Request};
use crate::proto::canopen::text::Said;

pub(super) const fn speaker(cob: Cob) -> Option<Direction> {
    match cob {
        Cob::Nmt | Cob::Sync | Cob::Time | Cob::Rpdo(..) => Some(Direction::ToDrive),
        Cob::SdoRequest(_) | Cob::LssRequest => Some(Direction::ToDrive),
        Cob::Emcy(_) | Cob::Tpdo(..) | Cob::Heartbeat(_) => Some(Direction::ToHost),
        Cob::SdoReply(_) | Cob::LssReply => Some(Direction::ToHost),
        Cob::Other(_) => None,
    }
}

/// Process data are held for set-points, and SYNC for what has them followed: their mapping is the
/// node's.
pub(super) fn of(cob: Cob, bytes: &[u8], profile: Option<&'static Profile>) -> Effect {
    match Said::of(&Frame::standard(cob.id(), bytes), false) {
        Err(_) | Ok(Said::Order(Command::Other(_), _)) => Effect::UNKNOWN,
        Ok(Said::Order(Command::Stop, _)) => Effect::NOTHING,
        Ok(Said::Process { told: false, .. } | Said::Sync(_)) => Effect::MOVES,
        Ok(Said::Order(..) | Said::Time(_)) => Effect::SETS,
        Ok(Said::Request(request, _)) => of_request(&request, profile),
        Ok(Said::Lss(request)) => of_lss(&request),
        Ok(_) if matches!(speaker(cob), Some(Direction::ToHost)) => Effect::NOTHING,
        Ok(_) => Effect::UNKNOWN,
    }
}

/// What a segment belongs to was told by the request that began.
fn of_request(request: &Request, profile: Option<&'static Profile>) -> Effect {
    match *request {
        Request::Write(object, _)
        | Request::WriteLong(object, _)
        | Request::WriteBlock { object, .. } => of_object(object, profile),
        Request::WriteSegment(_) | Request::WriteBlockEnd { .. } => Effect::SETS,
        Request::Other(_) => Effect::UNKNOWN,
        Request::Read(_)
        | Request::ReadSegment(_)
        | Request::ReadBlock { .. }
        | Request::ReadBlockStart
        | Request::ReadBlockAck { .. }
        | Request::ReadBlockEnd
        | Request::Abort(..) => Effect::NOTHING,
    }
}

/// 1010h and 1011h keep and bring back, 1F50h to 1F57h load programs (CiA 301, CiA 302); what moves
/// of the drive profile is its words, modes and set-points, and what moves them on (CiA 402).
fn of_object(object: Object, profile: Option<&'static Profile>) -> Effect {
    let is_it = |index: u16, space: u8| index == object.index && space == object.sub;
    let known = profile.and_then(|p| p.parameters.iter().find(|p| is_it(p.index, p.space)));
    match object.index {
        0x1010 | 0x1011 | 0x1F50..=0x1F57 => Effect::KEEPS,
        _ if known.is_some() => Effect::of_writing(known),
        0x1000..=0x1FFF => Effect::SETS,
        0x6040 | 0x6042 | 0x6060 | 0x6071 | 0x607A | 0x60FF => Effect::MOVES,
        0x60B0..=0x60B2 | 0x60C1 | 0x60FE => Effect::MOVES,
        0x6000..=0x67FF => Effect::SETS,
        _ => Effect::UNKNOWN,
    }
}

const fn of_lss(request: &lss::Request) -> Effect {
    use lss::Request as Lss;
    match request {
        Lss::Store => Effect::KEEPS,
        Lss::Inquire(_) | Lss::InquireNode | Lss::Identify(..) => Effect::NOTHING,
        Lss::IdentifyUnconfigured | Lss::FastScan { .. } => Effect::NOTHING,
        Lss::Other(_) => Effect::UNKNOWN,
        _ => Effect::SETS,
    }
}
