//! A simulated drive at the far end of a pseudo-terminal or a TCP connection, and what passed there by
//! the clock of the test.

use std::sync::{Arc, Mutex};

use polepair::simulate::{self, DriveLine};
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::time::Instant as At;
use polepair_drives::surroundings::GroundTruth;
use polepair_link::{LinkError, LinkIo, LinkWaker, Received, ServeThread, clock};
use polepair_test_support::wait_for;

/// Bytes that passed, and when: after the last of them was read here, before the first was written.
#[derive(Clone, Debug)]
pub struct Passed {
    pub at: At,
    pub to_drive: bool,
    pub bytes: Vec<u8>,
}

/// Frames that passed so far.
#[derive(Clone, Default)]
pub struct Log(Arc<Mutex<Vec<Passed>>>);

impl Passed {
    /// A TMCL request of one of these commands.
    pub fn is(&self, commands: &[u8]) -> bool {
        self.to_drive && self.bytes.get(1).is_some_and(|command| commands.contains(command))
    }
}

impl Log {
    fn note(&self, at: At, to_drive: bool, bytes: &[u8]) {
        self.0.lock().unwrap().push(Passed { at, to_drive, bytes: bytes.to_vec() });
    }

    /// Takes what passed.
    pub fn drain(&self) -> Vec<Passed> {
        std::mem::take(&mut *self.0.lock().unwrap())
    }
}

/// The drive, for as long as this lives.
pub struct Drive {
    pub log: Log,
    line: DriveLine,
    served: Option<ServeThread>,
}

impl Drive {
    /// Puts a simulated drive (`tmcl:1`) on that end.
    pub fn on(end: Box<dyn LinkIo<Stream>>, word: &str) -> Self {
        let description = simulate::rack_of_words(&[word], 1).unwrap();
        let line = simulate::drive_lines(&description, 1).unwrap().remove(0);
        let log = Log::default();
        let stamped: Box<dyn LinkIo<Stream>> = Box::new(Stamped { end, log: log.clone() });
        Self { log, line: line.clone(), served: Some(line.serve(stamped)) }
    }

    /// Takes it off its end; its motor goes on.
    pub fn unplug(&mut self) {
        drop(self.served.take());
    }

    /// Puts it on another end.
    pub fn plug(&mut self, end: Box<dyn LinkIo<Stream>>) {
        let stamped: Box<dyn LinkIo<Stream>> = Box::new(Stamped { end, log: self.log.clone() });
        self.served = Some(self.line.clone().serve(stamped));
    }

    /// True state of the simulated motor, read beside the wire.
    pub fn truth(&self) -> GroundTruth {
        self.line.with_bench(0, |bench| bench.ground_truth(clock::now())).expect("it has a motor")
    }

    /// Waits until the motor is at standstill.
    pub fn wait_standstill(&self) {
        wait_for("the motor stands", || match self.truth() {
            truth if truth.velocity.abs() <= 0.1 => Ok(()),
            truth => Err(format!("{truth:?}")),
        });
    }
}

impl Drop for Drive {
    fn drop(&mut self) {
        drop(self.served.take());
    }
}

struct Stamped {
    end: Box<dyn LinkIo<Stream>>,
    log: Log,
}

impl LinkIo<Stream> for Stamped {
    fn now(&self) -> At {
        self.end.now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        self.log.note(self.now(), false, unit);
        self.end.send(unit)
    }

    fn receive(&self, buffer: &mut [u8], until: At) -> Result<Received, LinkError> {
        let received = self.end.receive(buffer, until)?;
        if let Received::Bytes { len, at } = received {
            self.log.note(at, true, &buffer[..len]);
        }
        Ok(received)
    }

    fn set_line(&self, line: SerialLine) -> Result<(), LinkError> {
        self.end.set_line(line)
    }

    fn waker(&self) -> LinkWaker {
        self.end.waker()
    }

    fn describe(&self) -> String {
        self.end.describe()
    }
}
