//! Layers between an open link and its connection: taps and replacement links.

use super::Connector;
use crate::simulate::Simulation;
use crate::tap::{AnyTap, SharedTap};
use crate::wire::{AnyLink, SharedLink};
use std::sync::Arc;

/// Factory of the tap of a wire, by its number.
#[derive(Clone)]
pub(super) struct TapFactory(Arc<dyn Fn(usize) -> SharedTap + Send + Sync>);

/// Wrapper of an opened link, by the number of its wire.
#[derive(Clone)]
pub(super) struct LinkWrapper(Arc<WrapLinkFn>);

type WrapLinkFn = dyn Fn(usize, AnyLink, Option<&Simulation>) -> AnyLink + Send + Sync;

impl std::fmt::Debug for TapFactory {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Taps")
    }
}

impl std::fmt::Debug for LinkWrapper {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Links")
    }
}

impl Connector {
    /// With a tap that sees every unit on every link that is opened from now on.
    #[must_use]
    pub fn with_tap(mut self, tap: impl AnyTap + 'static) -> Self {
        let tap = SharedTap::new(tap);
        self.tap_factory = Some(TapFactory(Arc::new(move |_| tap.clone())));
        self
    }

    /// With a tap for each wire that is opened from now on, made by the number that the wire has
    /// among those of its connection string.
    #[must_use]
    pub fn with_taps<T: AnyTap + 'static>(
        mut self,
        make: impl Fn(usize) -> T + Send + Sync + 'static,
    ) -> Self {
        self.tap_factory = Some(TapFactory(Arc::new(move |wire| SharedTap::new(make(wire)))));
        self
    }

    /// With each link that is opened from now on replaced by what `instead` makes of it and of the
    /// number that its wire has among those of its connection string: a link that counts, delays or
    /// loses frames. The simulation is that of a simulated wire. Taps see the frames to and from the new
    /// link.
    #[must_use]
    pub fn with_link_wrapper(
        mut self,
        instead: impl Fn(usize, AnyLink, Option<&Simulation>) -> AnyLink + Send + Sync + 'static,
    ) -> Self {
        self.link_wrapper = Some(LinkWrapper(Arc::new(instead)));
        self
    }

    /// A link that was opened, with its tap.
    pub(super) fn wrap_and_tap(
        &self,
        wire: usize,
        link: AnyLink,
        simulation: Option<&Simulation>,
    ) -> SharedLink {
        let link = match &self.link_wrapper {
            Some(links) => links.0(wire, link, simulation),
            None => link,
        };
        SharedLink::new(
            link,
            self.tap_factory.as_ref().map(|taps| taps.0(wire)),
            &self.sent_counter,
        )
    }
}
