//! Results of protocol detection: what a detector finds, and what a decoder uses.

use core::fmt;
use std::io;

use polepair_core::explain::Dissector;
use polepair_core::medium::Frame;

use crate::number_text::plural;
use crate::rules::Rules;

/// Detected protocols of a capture.
#[derive(Debug)]
pub(crate) struct DetectedProtocols {
    pub links: Vec<LinkDetection>,
    /// Rules for a decoder.
    pub rules: Rules,
    /// Links on which the host receives its own requests.
    pub echo_links: Vec<String>,
}

/// Detects the protocols of links and identifiers that a decoder meets.
pub(crate) trait ProtocolSource: fmt::Debug + Send {
    /// Returns whether the last result holds for a frame of a link too, or for a link without a frame.
    fn covers(&self, link: &str, frame: Option<&Frame>) -> bool;

    /// Reads on until the result is certain, and holds for `frame` of `link`; otherwise to the end.
    fn read(&mut self, met: Option<(&str, Option<&Frame>)>) -> io::Result<DetectedProtocols>;
}

/// Detected protocol of a capture's link, and its certainty.
#[derive(Clone)]
pub struct LinkDetection {
    /// The link.
    pub link: String,
    /// The protocol; `None` when nothing explains it, or several do equally well.
    pub protocol: Option<&'static dyn Dissector>,
    /// 0 for a guess, 1 for certainty.
    pub confidence: f64,
    /// Whole frames, among those that were weighed.
    pub frames: u64,
    /// Not all of the capture was weighed: it is long.
    pub sampled: bool,
    /// Frames whose check fails.
    pub broken_frames: u64,
    /// Protocols that explain it equally well, if nothing decides between them.
    pub tied: Vec<&'static str>,
    /// Bytes that belong to no frame.
    pub stray_bytes: u64,
    /// Protocols that explain CAN identifiers which the first leaves.
    pub secondary: Vec<&'static dyn Dissector>,
    /// The protocol that explains most beside these, and the share of the bytes it explains.
    pub runner_up: Option<(&'static str, f64)>,
    /// Axes on identifiers that this protocol shares with others and that something else proves
    /// to be its.
    pub proven_axes: Vec<(&'static dyn Dissector, u32)>,
    /// Protocols that may be used too, on identifiers that they share with others, and their axes: no frame proves
    /// them, so a person must decide.
    pub shared_axes: Vec<(&'static str, Vec<u32>)>,
    /// Name of another protocol, which is recognised and not decoded, where none was detected.
    pub foreign: Option<&'static str>,
}

impl fmt::Debug for LinkDetection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Display for LinkDetection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(protocol) = self.protocol else {
            if let [first, rest @ ..] = &self.tied[..] {
                write!(f, "{}: undecided: {first}", self.link)?;
                rest.iter().try_for_each(|other| write!(f, " or {other}"))?;
                return write!(f, " explain it equally well: say which by --as {first}");
            }
            write!(f, "{}: none of the protocols that polepair knows", self.link)?;
            if let Some(name) = self.foreign {
                write!(f, "; it looks like {name}")?;
            }
            return self.write_shared(f);
        };
        let (name, percent) = (protocol.name(), self.confidence * 100.0);
        write!(f, "{}: {name}", self.link)?;
        self.secondary.iter().try_for_each(|other| write!(f, " and {}", other.name()))?;
        write!(f, ", {percent:.0} % sure ({}", plural(self.frames, "frame"))?;
        f.write_str(if self.sampled { " weighed" } else { "" })?;
        if self.broken_frames > 0 {
            write!(f, ", {} broken", self.broken_frames)?;
        }
        if self.stray_bytes > 0 {
            write!(f, ", {}", plural(self.stray_bytes, "stray byte"))?;
        }
        match self.runner_up {
            None => f.write_str("; nothing else fits)"),
            Some((name, share)) => {
                write!(f, "; runner-up {name} explains {:.0} %)", share * 100.0)
            }
        }?;
        self.write_shared(f)
    }
}

impl LinkDetection {
    fn write_shared(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let protocols = self.protocol.iter().chain(&self.secondary).map(|protocol| protocol.name());
        let names: Vec<&str> = protocols.collect();
        for (at, (name, axes)) in self.shared_axes.iter().enumerate() {
            let mut rules: Vec<String> = names.iter().map(|word| (*word).to_owned()).collect();
            if !names.contains(name) {
                rules.extend(axes.iter().map(|axis| format!("{name}@{axis}")));
            }
            let rules = rules.join(",");
            match at {
                0 => write!(f, "; some identifiers may be {name}'s: if they are, --as {rules}")?,
                _ => write!(f, "; or {name}'s: --as {rules}")?,
            }
        }
        Ok(())
    }
}

impl LinkDetection {
    /// A link on which nothing was detected.
    pub(crate) fn unknown(link: &str) -> Self {
        Self {
            link: link.to_owned(),
            protocol: None,
            confidence: 0.0,
            frames: 0,
            sampled: false,
            broken_frames: 0,
            tied: Vec::new(),
            stray_bytes: 0,
            secondary: Vec::new(),
            runner_up: None,
            proven_axes: Vec::new(),
            shared_axes: Vec::new(),
            foreign: None,
        }
    }

    /// The protocols by which its frames are explained.
    pub(crate) fn protocols(&self) -> impl Iterator<Item = &'static dyn Dissector> {
        let proven = self.proven_axes.iter().map(|(protocol, _)| *protocol);
        self.protocol.into_iter().chain(self.secondary.iter().copied()).chain(proven)
    }

    /// Returns whether both are of one link and find the same protocols and axes on it.
    pub(crate) fn has_same_protocols(&self, other: &Self) -> bool {
        self.link == other.link
            && protocol_names(self) == protocol_names(other)
            && proven_axis_numbers(self) == proven_axis_numbers(other)
            && (&self.tied, &self.shared_axes) == (&other.tied, &other.shared_axes)
    }
}

fn proven_axis_numbers(detection: &LinkDetection) -> Vec<u32> {
    detection.proven_axes.iter().map(|(_, axis)| *axis).collect::<Vec<_>>()
}

fn protocol_names(detection: &LinkDetection) -> Vec<&'static str> {
    detection.protocols().map(|each| each.name()).collect::<Vec<_>>()
}
