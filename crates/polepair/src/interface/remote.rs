//! Links of a running gateway (`polepair serve`): its axes behind the same interface as those of a wire.
//!
//! ```text
//!   RemoteLink            one gateway, its axes, and the leases that this program holds
//!    └ RemoteAxis         implements AxisInterface; arming acquires the axis' lease
//!       ├ RemoteRequest   a command or a read that is under way
//!       └ SampleRows      subscribed signals
//! ```
//!
//! The gateway executes stops without a lease, also of axes that other clients command. A command is sent once; one
//! without a reply may have been executed.

mod convert;
mod options;
mod remote_axis;
mod remote_motion;
mod request;
mod rows;
mod server;

use std::sync::Arc;

use polepair_client::message::{BenchView, StopRequest};
use polepair_client::select_axes;

pub use convert::{drive_unit, format_signal};
pub use options::{find_gateway, open};
pub use polepair_client::message::{AxisInfo, GatewayError};
pub use polepair_client::{Gateway, GatewayOptions};
pub use remote_axis::RemoteAxis;
pub use request::RemoteRequest;
pub use rows::{SampleRow, SampleRows};
pub use server::LeaseGuard;
use server::Server;

use crate::error::Error;

/// A running gateway and its axes. Clones share the connection and the leases.
#[derive(Clone, Debug)]
pub struct RemoteLink {
    server: Arc<Server>,
    axes: Vec<RemoteAxis>,
}

impl RemoteLink {
    /// Reads which axes a gateway has, and selects those that `axes` names (`1,3`, `x`, `LINK#1`); all
    /// without names.
    ///
    /// # Errors
    /// [`Error::Gateway`]: `E314`, `E315` or `E321` if it cannot be reached, `E212` for an unknown axis.
    pub fn open(gateway: Gateway, axes: Option<&str>) -> Result<Self, Error> {
        let bench = gateway.bench()?;
        let server = Arc::new(Server::new(gateway, bench));
        let selected = select_axes(server.bench(), axes.unwrap_or(polepair_client::ALL))?;
        let selected = selected.into_iter();
        let axes = selected.map(|info| RemoteAxis::new(Arc::clone(&server), info)).collect();
        Ok(Self { server, axes })
    }

    /// The gateway.
    #[must_use]
    pub fn gateway(&self) -> &Gateway {
        self.server.gateway()
    }

    /// Links and axes of the gateway, as it described them when this link was opened.
    #[must_use]
    pub fn bench(&self) -> &BenchView {
        self.server.bench()
    }

    /// Axes in the gateway's order.
    #[must_use]
    pub fn axes(&self) -> &[RemoteAxis] {
        &self.axes
    }

    /// The axes of the gateway that these words name, whether they were selected or not.
    ///
    /// # Errors
    /// [`Error::Gateway`] `E212`.
    pub fn find_axes(&self, words: &str) -> Result<Vec<RemoteAxis>, Error> {
        let found = select_axes(self.server.bench(), words)?;
        Ok(found.into_iter().map(|info| RemoteAxis::new(Arc::clone(&self.server), info)).collect())
    }

    /// Stops every axis of this link, also those that other clients command. The gateway's motion lock is not set.
    ///
    /// # Errors
    /// The first error, after every axis was tried.
    pub fn stop_all(&self) -> Result<(), Error> {
        stop_axes(self.gateway(), self.axes.iter().map(|axis| axis.info().id).collect())?;
        Ok(())
    }

    /// Stops, disables and disarms what this program armed through this link.
    ///
    /// # Errors
    /// The first error, after every axis was tried.
    pub fn stop_armed(&self) -> Result<(), Error> {
        Ok(self.server.stop_armed()?)
    }
}

/// Stops axes, also those that other clients command; returns the first error, after every axis was tried.
fn stop_axes(gateway: &Gateway, axes: Vec<u16>) -> Result<(), GatewayError> {
    let request = StopRequest { axes: Some(axes), ..StopRequest::default() };
    let stopped = gateway.stop(&request)?.axes;
    stopped.into_iter().find_map(|axis| axis.error).map_or(Ok(()), Err)
}
