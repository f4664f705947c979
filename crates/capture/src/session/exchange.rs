//! Requests and their replies on a line where one follows the other.

use polepair_core::explain::Direction;

use super::{Exchange, Follower, Heard, Notice, Outcome, name};
use crate::explained::Explained;
use crate::stamp::Stamp;

/// The exchange under way.
#[derive(Debug, Default)]
pub(super) struct Exchanges {
    open: Option<(Exchange, Vec<u8>)>,
}

impl Follower for Exchanges {
    fn take(&mut self, heard: &Heard<'_>, said: &mut Explained, notices: &mut Vec<Notice>) {
        if heard.raw.id.is_some() || heard.echo {
            return;
        }
        let here = (heard.number, heard.time);
        match heard.direction {
            Some(Direction::ToDrive) => self.ask(here, heard.raw.bytes, said, notices),
            Some(Direction::ToHost) => self.answer(here, heard, notices),
            None => {}
        }
    }

    fn end(&mut self, notices: &mut Vec<Notice>) {
        self.give_up(notices);
    }
}

impl Exchanges {
    fn ask(
        &mut self,
        here: (u64, Option<Stamp>),
        bytes: &[u8],
        said: &Explained,
        notices: &mut Vec<Notice>,
    ) {
        if let Some((exchange, asked)) = &mut self.open
            && asked == bytes
        {
            exchange.retries += 1;
            return;
        }
        self.give_up(notices);
        let (axis, op) = (said.axis, name(&said.kind));
        let outcome = Outcome::Unanswered;
        let asked = Exchange { axis, op, asked: here, answered: None, outcome, retries: 0 };
        self.open = Some((asked, bytes.to_vec()));
    }

    fn answer(&mut self, here: (u64, Option<Stamp>), heard: &Heard<'_>, notices: &mut Vec<Notice>) {
        let Some((mut exchange, _)) = self.open.take() else { return };
        exchange.answered = Some(here);
        exchange.outcome = if heard.wrong.is_some() { Outcome::Broken } else { Outcome::Done };
        notices.push(Notice::Exchange(exchange));
    }

    fn give_up(&mut self, notices: &mut Vec<Notice>) {
        notices.extend(self.open.take().map(|(exchange, _)| Notice::Exchange(exchange)));
    }
}
