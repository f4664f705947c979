//! Who is at the addresses that a connection string names.

use super::{Connector, Line, Link, expected};
use crate::error::Error;
use crate::identify::{AGAIN_MAX, Identified, Prober};
use crate::url::{Number, Url};
use polepair_core::profile::Profile;
use polepair_link::clock;

impl Connector {
    /// Opens a link as [`connect`](Self::connect), and leaves out the axes that do not answer, or are not
    /// what they should be: their addresses come beside it, each with its error.
    ///
    /// # Errors
    /// As [`connect`](Self::connect); the first axis' error when there is none left.
    pub fn connect_present(&self, text: &str) -> Result<(Link, Vec<(u32, Error)>), Error> {
        let url = self.url(text)?;
        let (mut lines, simulation) = self.lines(&url)?;
        match self.link(url.clone(), &lines, simulation.clone(), true) {
            Ok(link) => return Ok((link, Vec::new())),
            // Of several, the others are looked for: on the same link, for a serial server may let
            // nobody in a second time.
            Err(Error::Failed { .. }) if url.axes.len() != 1 => {}
            Err(error) => return Err(error),
        }
        let (mut absent, mut names) = (Vec::new(), Vec::new());
        for line in &mut lines {
            let named = self.chosen_profile(&url, &line.spoken)?;
            for at in (0..line.numbers.len()).rev() {
                let Err(error) = self.identified_one(line, at, named, true) else { continue };
                if matches!(error, Error::Link(_)) {
                    return Err(error);
                }
                absent.insert(0, (line.numbers.remove(at), error));
                names.push(line.seats.remove(at).name);
            }
        }
        lines.retain(|line| !line.numbers.is_empty());
        if let (true, Some((_, error))) = (lines.is_empty(), absent.first()) {
            return Err(error.clone());
        }
        let found = Url { names: Vec::new(), ..url.clone() };
        let link = Link { url: url.clone(), ..self.link(found, &lines, simulation, true)? };
        let mut wanted = url.names.iter().filter(|name| !names.contains(name));
        wanted.try_for_each(|name| link.named(name).map(drop))?;
        Ok((link, absent))
    }

    /// What each axis of a line is: as the string says, or by asking, where a rack says what is to be
    /// there.
    pub(super) fn identified(
        &self,
        url: &Url,
        line: &Line,
        ask: bool,
    ) -> Result<Vec<(&'static Profile, Identified)>, Error> {
        let named = self.chosen_profile(url, &line.spoken)?;
        let each = (0..line.numbers.len()).map(|at| self.identified_one(line, at, named, ask));
        let mut found = each.collect::<Result<Vec<_>, _>>()?;
        // Drives of a group cannot all be asked: they are taken for what the first axis is.
        if let Some((profile, _)) = found.iter().find(|(_, how)| *how != Identified::Group).cloned()
        {
            let groups = found.iter_mut().filter(|(_, how)| *how == Identified::Group);
            groups.for_each(|(of_group, _)| *of_group = profile);
        }
        Ok(found)
    }

    /// What one axis of a line is, by its place.
    fn identified_one(
        &self,
        line: &Line,
        at: usize,
        named: Option<&'static Profile>,
        ask: bool,
    ) -> Result<(&'static Profile, Identified), Error> {
        let number = line.numbers[at];
        Ok(match (named, &line.seats[at].profile) {
            (Some(profile), _) => (profile, Identified::Named),
            _ if Number(number).is_group() => (line.spoken.generic, Identified::Group),
            (None, Some((profile, _))) if !ask => (*profile, Identified::Named),
            (None, Some((profile, place))) => {
                let prober = Prober::new(line, &self.config);
                expected(prober.expecting(profile), number, profile, place.as_ref())?
            }
            (None, None) => self.asked(line, number)?,
        })
    }

    /// What one says that it is. Who takes power off motors asks again and again.
    fn asked(&self, line: &Line, number: u32) -> Result<(&'static Profile, Identified), Error> {
        let (prober, end) = (Prober::new(line, &self.config), clock::now() + AGAIN_MAX);
        loop {
            match prober.identify(number) {
                Err(Error::Failed { .. }) if self.stops && clock::now() < end => {}
                Err(error) if self.stops => return Err(prober.naming(error)),
                asked => return asked,
            }
        }
    }
}
