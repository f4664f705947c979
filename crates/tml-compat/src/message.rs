//! Messages that drives send without being asked.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::collections::VecDeque;
use std::ffi::c_long;
use std::sync::{Arc, Mutex, PoisonError};

use polepair::LocalAxis;
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::proto::tml::online::OnlineMessage;
use polepair_core::proto::tml::serial::{Deframer, RecoveryPolicy, SerialPiece};
use polepair_core::proto::tml::wire::Instruction;
use polepair_core::proto::tml::{technocan, tmlcan};
use polepair_core::time::Instant;
use polepair_link::{ListenerGuard, Mailbox, Tap, TapDirection};

use crate::Bool;
use crate::call::{TmlError, run_bool};
use crate::channel::{messages, target};

/// A function of the program: axis ID, address in data memory, value.
pub type Handler = extern "system" fn(axis: u16, address: u16, value: c_long);

static HANDLER: Mutex<Option<Handler>> = Mutex::new(None);

/// Messages that wait for [`TS_CheckForUnrequestedDriveMessages`] at most; then the oldest go.
const QUEUE_MAX: usize = 4096;
/// Bit 0 of MASTERID: the receiver is a host. Bits 4 to 11 are its axis ID.
const HOST_BIT: u16 = 1;

/// One value that a drive sent.
#[derive(Clone, Copy, Debug)]
struct DriveMessage {
    axis: u8,
    address: u16,
    value: u32,
    long: bool,
}

/// The messages of a channel that were not handed over yet.
#[derive(Clone, Debug, Default)]
pub struct MessageQueue(Arc<Mutex<VecDeque<DriveMessage>>>);

impl MessageQueue {
    fn push(&self, message: DriveMessage) {
        let mut queue = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if queue.len() == QUEUE_MAX {
            queue.pop_front();
        }
        queue.push_back(message);
    }

    fn pop(&self) -> Option<DriveMessage> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }
}

/// Sees everything on a channel's wire. Values that this library asks for come as TakeData; TakeData2 is what
/// drives send by themselves.
#[derive(Debug)]
pub struct MessageTap {
    queue: MessageQueue,
    deframer: Deframer,
}

impl MessageTap {
    /// A tap that fills a queue.
    pub fn new(queue: MessageQueue) -> Self {
        Self { queue, deframer: Deframer::new(RecoveryPolicy::Search) }
    }

    fn see(&self, instruction: &Instruction) {
        if let Some(OnlineMessage::TakeData2 { sender, address, long, value }) =
            OnlineMessage::parse(instruction)
        {
            self.queue.push(DriveMessage { axis: sender, address, value, long });
        }
    }
}

impl Tap<Stream> for MessageTap {
    fn record_unit(&mut self, _at: Instant, direction: TapDirection, unit: &[u8]) {
        if direction == TapDirection::ToDrive {
            return;
        }
        for byte in unit {
            self.deframer.push(*byte);
            while let Some(piece) = self.deframer.next_piece() {
                if let SerialPiece::Message(message) = piece {
                    self.see(&message.instruction);
                }
            }
        }
    }
}

impl Tap<Can> for MessageTap {
    fn record_unit(&mut self, _at: Instant, direction: TapDirection, frame: &Frame) {
        if direction == TapDirection::ToDrive {
            return;
        }
        if frame.extended {
            if let Ok(message) = tmlcan::decode(frame) {
                self.see(&message.instruction);
            }
        } else if let Ok(content) = technocan::decode(frame) {
            self.see(&content.instruction);
        }
    }
}

/// Keeps a channel reading while no request is under way.
#[derive(Debug)]
pub struct MessageListener {
    _mailbox: Mailbox,
    _guard: ListenerGuard,
}

impl MessageListener {
    /// Begins to read.
    pub fn start(axis: &LocalAxis) -> Self {
        let mailbox = Mailbox::new(1);
        let guard = axis.connection().listen(&mailbox, 0, None);
        Self { _mailbox: mailbox, _guard: guard }
    }
}

/// Sets the function that [`TS_CheckForUnrequestedDriveMessages`] calls, for the whole process. NULL removes it.
#[unsafe(no_mangle)]
pub extern "system" fn TS_RegisterHandlerForUnrequestedDriveMessages(handler: Option<Handler>) {
    *HANDLER.lock().unwrap_or_else(PoisonError::into_inner) = handler;
    // A channel that is open listens from now on. Without one, it begins with the first check.
    let _ = messages();
}

/// Calls the program's handler for each message that drives of the selected channel have sent, in the calling
/// thread. Values of 16 bits have their sign.
#[unsafe(no_mangle)]
pub extern "system" fn TS_CheckForUnrequestedDriveMessages() -> Bool {
    run_bool("TS_CheckForUnrequestedDriveMessages", || {
        let queue = messages()?;
        let handler = *HANDLER.lock().unwrap_or_else(PoisonError::into_inner);
        let handler = handler.ok_or_else(|| {
            TmlError::new(
                "there is no handler: call TS_RegisterHandlerForUnrequestedDriveMessages first",
            )
        })?;
        while let Some(DriveMessage { axis, address, value, long }) = queue.pop() {
            let value = if long {
                c_long::from(value.cast_signed())
            } else {
                c_long::from((value as u16).cast_signed())
            };
            handler(axis.into(), address, value);
        }
        Ok(())
    })
}

/// Has the drive send its status (SRL low word, SRH high word) and MER to a host when one of these bits changes.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SendDataToHost(host: u8, status_bits: u32, error_bits: u16) -> Bool {
    run_bool("TS_SendDataToHost", || {
        let [low, high] = [status_bits as u16, (status_bits >> 16) as u16];
        let target = target()?;
        if !target.may_send_unasked {
            return Err(TmlError::new(
                "drives on RS-485 do not send without being asked: read the status instead",
            ));
        }
        let master = u16::from(host) << 4 | HOST_BIT;
        target.execute(&format!(
            "MASTERID = {master};SRL_MASK = {low};SRH_MASK = {high};MER_MASK = {error_bits}"
        ))
    })
}
