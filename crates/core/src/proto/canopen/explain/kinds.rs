//! Short names of the message kinds.

use super::*;

/// Name of a frame of that identifier before its bytes are read.
pub(super) const fn cob_kind(cob: Cob) -> &'static str {
    match cob {
        Cob::Nmt => "NMT",
        Cob::Sync => "SYNC",
        Cob::Time => "TIME",
        Cob::Emcy(_) => "EMCY",
        Cob::Rpdo(1, _) => "RPDO1",
        Cob::Rpdo(2, _) => "RPDO2",
        Cob::Rpdo(3, _) => "RPDO3",
        Cob::Rpdo(..) => "RPDO4",
        Cob::Tpdo(1, _) => "TPDO1",
        Cob::Tpdo(2, _) => "TPDO2",
        Cob::Tpdo(3, _) => "TPDO3",
        Cob::Tpdo(..) => "TPDO4",
        Cob::SdoReply(_) | Cob::SdoRequest(_) => "SDO",
        Cob::Heartbeat(_) => "heartbeat",
        Cob::LssReply | Cob::LssRequest => "LSS",
        Cob::Other(_) => "canopen",
    }
}

pub(super) fn message_kind(statement: &Statement, frame: &Frame) -> &'static str {
    match *statement {
        Statement::State(heartbeat) if heartbeat.state == NmtState::BootUp => "boot-up",
        Statement::Guard => "guarding",
        Statement::Request(request, _) => request_kind(request),
        Statement::Reply(reply, _) => reply_kind(reply),
        Statement::BlockSegment(_, false) => "SDO block write segment",
        Statement::BlockSegment(_, true) => "SDO block read segment",
        Statement::Lss(request) => lss_kind(request),
        Statement::LssReply(reply) => lss_reply_kind(reply),
        _ => cob_kind(Cob::of(frame.id as u16)),
    }
}

pub(super) const fn request_kind(request: SdoRequest) -> &'static str {
    match request {
        SdoRequest::Write(..) => "SDO write",
        SdoRequest::WriteLong(..) => "SDO segmented write",
        SdoRequest::WriteSegment(_) => "SDO write segment",
        SdoRequest::Read(_) => "SDO read",
        SdoRequest::ReadSegment(_) => "SDO read segment",
        SdoRequest::WriteBlock { .. } => "SDO block write",
        SdoRequest::WriteBlockEnd { .. } => "SDO block write end",
        SdoRequest::ReadBlock { .. } => "SDO block read",
        SdoRequest::ReadBlockStart => "SDO block read start",
        SdoRequest::ReadBlockAck { .. } => "SDO block read acknowledge",
        SdoRequest::ReadBlockEnd => "SDO block read done",
        SdoRequest::Abort(..) => "SDO abort",
        SdoRequest::Other(_) => "SDO unknown request",
    }
}

pub(super) const fn reply_kind(reply: SdoReply) -> &'static str {
    match reply {
        SdoReply::Written(..) => "SDO written",
        SdoReply::WrittenSegment(_) => "SDO written segment",
        SdoReply::Value(..) => "SDO value",
        SdoReply::ValueLong(..) => "SDO segmented value",
        SdoReply::ValueSegment(_) => "SDO value segment",
        SdoReply::WriteBlockReady { .. } => "SDO block write ready",
        SdoReply::WriteBlockAck { .. } => "SDO block write acknowledge",
        SdoReply::WriteBlockDone => "SDO block write done",
        SdoReply::ReadBlockReady { .. } => "SDO block read ready",
        SdoReply::ReadBlockEnd { .. } => "SDO block read end",
        SdoReply::Abort(..) => "SDO abort",
        SdoReply::Other(_) => "SDO unknown reply",
    }
}

/// The word for a request of layer setting.
#[must_use]
pub const fn lss_kind(request: lss::LssRequest) -> &'static str {
    use lss::LssRequest;
    match request {
        LssRequest::SwitchGlobal(_) => "LSS switch all",
        LssRequest::SwitchSelective(..) => "LSS select",
        LssRequest::SetNode(_) => "LSS set node-ID",
        LssRequest::SetBitTiming(..) => "LSS set bit timing",
        LssRequest::ActivateBitTiming(_) => "LSS activate bit timing",
        LssRequest::Store => "LSS store",
        LssRequest::Inquire(_) | LssRequest::InquireNode => "LSS inquire",
        LssRequest::Identify(..) => "LSS identify",
        LssRequest::IdentifyUnconfigured => "LSS identify unconfigured",
        LssRequest::FastScan { .. } => "LSS fast scan",
        LssRequest::Other(_) => "LSS unknown request",
    }
}

pub(super) const fn lss_reply_kind(reply: lss::LssReply) -> &'static str {
    use lss::LssReply;
    match reply {
        LssReply::Selected => "LSS selected",
        LssReply::SetNode(..) => "LSS node-ID set",
        LssReply::SetBitTiming(..) => "LSS bit timing set",
        LssReply::Store(..) => "LSS stored",
        LssReply::Number(..) | LssReply::Node(_) => "LSS answer",
        LssReply::Identified => "LSS identified",
        LssReply::Unconfigured => "LSS unconfigured",
        LssReply::Other(_) => "LSS unknown reply",
    }
}
