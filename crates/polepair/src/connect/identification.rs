//! Identifies the drives at the addresses of a connection string.

use super::{Connector, LocalLink, ProtocolLine, identify_expected};
use crate::error::Error;
use crate::identification::Identification;
use crate::identify::{IDENTIFY_RETRY_MAX, Prober};
use crate::profile::profile_with_steps;
use crate::url::{AxisNumber, Url};
use polepair_core::profile::Profile;
use polepair_core::proto::{drive_address, sub_axis};

impl Connector {
    /// Opens a link as [`connect`](Self::connect), and leaves out the axes that do not answer, or are other
    /// drives than stated: their addresses come beside it, each with its error.
    ///
    /// # Errors
    /// As [`connect`](Self::connect); the first axis' error when there is none left.
    pub fn connect_present(&self, text: &str) -> Result<(LocalLink, Vec<(u32, Error)>), Error> {
        let url = self.url(text)?;
        let (mut lines, simulation) = self.open_lines(&url)?;
        match self.assemble_link(url.clone(), &lines, simulation.clone(), true) {
            Ok(link) => return Ok((link, Vec::new())),
            // Several addresses are searched on the same link, for a serial server may accept only one connection.
            Err(Error::Failed { .. }) if url.axes.len() != 1 => {}
            Err(error) => return Err(error),
        }
        let (mut absent, mut names) = (Vec::new(), Vec::new());
        for line in &mut lines {
            let named = self.chosen_profile(&url, &line.protocol)?;
            for at in (0..line.axis_numbers.len()).rev() {
                let Err(error) = self.identify_axis(line, at, named, true) else { continue };
                if matches!(error, Error::Link(_)) {
                    return Err(error);
                }
                absent.insert(0, (line.axis_numbers.remove(at), error));
                names.push(line.entries.remove(at).name);
            }
        }
        lines.retain(|line| !line.axis_numbers.is_empty());
        if let (true, Some((_, error))) = (lines.is_empty(), absent.first()) {
            return Err(error.clone());
        }
        let found = Url { names: Vec::new(), ..url.clone() };
        let link =
            LocalLink { url: url.clone(), ..self.assemble_link(found, &lines, simulation, true)? };
        let mut wanted = url.names.iter().filter(|name| !names.contains(name));
        wanted.try_for_each(|name| link.axis_named(name).map(drop))?;
        Ok((link, absent))
    }

    /// Identifies each axis of a line: by the string, or by requests if a rack names the expected drive.
    pub(super) fn identify_axes(
        &self,
        url: &Url,
        line: &ProtocolLine,
        must_ask: bool,
    ) -> Result<Vec<(&'static Profile, Identification)>, Error> {
        let named = self.chosen_profile(url, &line.protocol)?;
        let mut found: Vec<(&'static Profile, Identification)> = Vec::new();
        for (at, number) in line.axis_numbers.iter().enumerate() {
            let identified = line.axis_numbers[..at].iter().position(|other| {
                sub_axis(*number) != 0 && drive_address(*other) == drive_address(*number)
            });
            found.push(match identified {
                Some(known) => found[known].clone(),
                None => self.identify_axis(line, at, named, must_ask)?,
            });
            check_motor(*number, line, found[at].0)?;
        }
        for ((profile, _), number) in found.iter_mut().zip(&line.axis_numbers) {
            *profile = line.protocol.profile_of_axis(profile, *number);
        }
        let steps = url.number("steps")?;
        for ((profile, _), entry) in found.iter_mut().zip(&line.entries) {
            let steps = entry.steps.map(u64::from).or(steps);
            if let Some(steps) = steps {
                *profile = profile_with_steps(profile, steps)?;
            }
        }
        // Drives of a group cannot all be asked: they are taken for what the first axis is.
        if let Some((profile, _)) =
            found.iter().find(|(_, how)| *how != Identification::Group).cloned()
        {
            let groups = found.iter_mut().filter(|(_, how)| *how == Identification::Group);
            groups.for_each(|(of_group, _)| *of_group = profile);
        }
        Ok(found)
    }

    /// Identifies one axis of a line, by its index.
    fn identify_axis(
        &self,
        line: &ProtocolLine,
        at: usize,
        named: Option<&'static Profile>,
        must_ask: bool,
    ) -> Result<(&'static Profile, Identification), Error> {
        let number = line.axis_numbers[at];
        Ok(match (named, &line.entries[at].profile) {
            (Some(profile), _) => (profile, Identification::Named),
            _ if line.protocol.is_unanswered(number) => {
                let prober = Prober::new(line, &self.config);
                let first = prober.profiles().first().copied();
                (first.unwrap_or(line.protocol.generic), Identification::Group)
            }
            _ if AxisNumber(number).is_group() => (line.protocol.generic, Identification::Group),
            (None, Some((profile, _))) if !must_ask => (*profile, Identification::Named),
            (None, Some((profile, location))) => {
                let prober = Prober::new(line, &self.config);
                identify_expected(
                    prober.with_candidate(profile),
                    number,
                    profile,
                    location.as_ref(),
                )?
            }
            (None, None) => self.query_identity(line, number)?,
        })
    }

    /// Requests the identity of one drive. Callers that remove power repeat it.
    fn query_identity(
        &self,
        line: &ProtocolLine,
        number: u32,
    ) -> Result<(&'static Profile, Identification), Error> {
        let prober = Prober::new(line, &self.config);
        let end = line.link.deadline(IDENTIFY_RETRY_MAX);
        loop {
            match prober.identify(number) {
                Err(Error::Failed { .. }) if self.is_for_stop && line.link.now() < end => {}
                Err(error) if self.is_for_stop => return Err(prober.with_profile_hint(error)),
                result => return result,
            }
        }
    }
}

/// Refuses a motor that a drive has not.
fn check_motor(number: u32, line: &ProtocolLine, profile: &Profile) -> Result<(), Error> {
    let (sub, first) = (sub_axis(number), *line.protocol.sub_axes.start());
    let motors = profile.motors;
    if sub == 0 || motors == 0 || sub < first + motors {
        return Ok(());
    }
    let (number, drive) = (AxisNumber(number), AxisNumber(drive_address(number)));
    let what = format!("`#{number}`: {} has no such motor", profile.title);
    Err(Error::usage(
        "E212",
        what,
        match motors {
            1 => format!("it has one: `#{drive}`"),
            motors => format!("it has {motors}: `#{drive}.{first}-{}`", first + motors - 1),
        },
    ))
}
