//! The sender of a frame by the predefined connection set, and its possible effect on nodes.

use crate::explain::{Direction, Effect};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::proto::canopen::cob::Cob;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::NmtCommand;
use crate::proto::canopen::sdo::{ObjectIndex, SdoRequest};
use crate::proto::canopen::text::Statement;

pub(super) const fn direction_of(cob: Cob) -> Option<Direction> {
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
pub(super) fn effect_of(cob: Cob, bytes: &[u8], profile: Option<&'static Profile>) -> Effect {
    match Statement::of(&Frame::standard(cob.id(), bytes), false) {
        Err(_) | Ok(Statement::Order(NmtCommand::Other(_), _)) => Effect::UNKNOWN,
        Ok(Statement::Order(NmtCommand::Stop, _)) => Effect::NOTHING,
        Ok(Statement::Process { from_node: false, .. } | Statement::Sync(_)) => Effect::MOTION,
        Ok(Statement::Order(..) | Statement::Time(_)) => Effect::SETTINGS,
        Ok(Statement::Request(request, _)) => request_effect(&request, profile),
        Ok(Statement::Lss(request)) => lss_effect(&request),
        Ok(_) if matches!(direction_of(cob), Some(Direction::ToHost)) => Effect::NOTHING,
        Ok(_) => Effect::UNKNOWN,
    }
}

/// Effect of a request. The effect of a segment follows from the request that started the transfer.
fn request_effect(request: &SdoRequest, profile: Option<&'static Profile>) -> Effect {
    match *request {
        SdoRequest::Write(object, _)
        | SdoRequest::WriteLong(object, _)
        | SdoRequest::WriteBlock { object, .. } => object_effect(object, profile),
        SdoRequest::WriteSegment(_) | SdoRequest::WriteBlockEnd { .. } => Effect::SETTINGS,
        SdoRequest::Other(_) => Effect::UNKNOWN,
        SdoRequest::Read(_)
        | SdoRequest::ReadSegment(_)
        | SdoRequest::ReadBlock { .. }
        | SdoRequest::ReadBlockStart
        | SdoRequest::ReadBlockAck { .. }
        | SdoRequest::ReadBlockEnd
        | SdoRequest::Abort(..) => Effect::NOTHING,
    }
}

/// 1010h and 1011h keep and bring back, 1F50h to 1F57h load programs (CiA 301, CiA 302); what moves
/// of the drive profile is its words, modes and set-points, and what moves them on (CiA 402).
pub(in crate::proto::canopen) fn object_effect(
    object: ObjectIndex,
    profile: Option<&'static Profile>,
) -> Effect {
    let known = profile.and_then(|p| {
        p.parameters.iter().find(|p| is_object(p.index, p.space, object.index, object.sub))
    });
    match object.index {
        0x1010 | 0x1011 | 0x1F50..=0x1F57 => Effect::PERSISTENT,
        _ if known.is_some() => Effect::from_write(known),
        0x1000..=0x1FFF => Effect::SETTINGS,
        0x6040 | 0x6042 | 0x6060 | 0x6071 | 0x607A | 0x60FF => Effect::MOTION,
        0x60B0..=0x60B2 | 0x60C1 | 0x60FE => Effect::MOTION,
        0x6000..=0x67FF => Effect::SETTINGS,
        _ => Effect::UNKNOWN,
    }
}

fn is_object(index: u16, space: u8, object_index: u16, object_sub: u8) -> bool {
    index == object_index && space == object_sub
}

const fn lss_effect(request: &lss::LssRequest) -> Effect {
    use lss::LssRequest as Lss;
    match request {
        Lss::Store => Effect::PERSISTENT,
        Lss::Inquire(_) | Lss::InquireNode | Lss::Identify(..) => Effect::NOTHING,
        Lss::IdentifyUnconfigured | Lss::FastScan { .. } => Effect::NOTHING,
        Lss::Other(_) => Effect::UNKNOWN,
        _ => Effect::SETTINGS,
    }
}
