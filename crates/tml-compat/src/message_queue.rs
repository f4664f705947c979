//! Messages of a channel that drives sent without a request.

use polepair::LocalAxis;
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::proto::tml::online::OnlineMessage;
use polepair_core::proto::tml::serial::{Deframer, RecoveryPolicy, SerialPiece};
use polepair_core::proto::tml::wire::Instruction;
use polepair_core::proto::tml::{technocan, tmlcan};
use polepair_core::time::Instant;
use polepair_link::{ListenerGuard, Mailbox, Tap, TapDirection};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Messages that wait for `TS_CheckForUnrequestedDriveMessages` at most; then the oldest go.
const QUEUE_MAX: usize = 4096;

/// One value that a drive sent.
#[derive(Clone, Copy, Debug)]
pub struct DriveMessage {
    /// Axis ID of the sender.
    pub axis: u8,
    /// Address in data memory.
    pub address: u16,
    /// The value, in the low word if it has 16 bits.
    pub value: u32,
    /// True for a value of 32 bits.
    pub long: bool,
}

/// Messages of a channel that wait for the program.
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

    /// Takes the oldest message.
    pub fn pop(&self) -> Option<DriveMessage> {
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
