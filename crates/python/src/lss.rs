//! Node-IDs and bit rates of CANopen devices by layer setting services.

use std::path::PathBuf;
use std::sync::Mutex;

use polepair::Error;
use polepair::lss::{LssIdentity, LssMaster as Inner};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::to_py_error;
use crate::link::build_connector;
use crate::process_local::ProcessLocal;

/// Vendor, product, revision, serial number.
type IdentityTuple = (u32, u32, u32, u32);

/// The LSS master of a CAN bus.
#[pyclass(frozen, name = "LssMaster", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyLssMaster(ProcessLocal<Mutex<Option<Inner>>>);

impl PyLssMaster {
    /// Runs a service while other Python threads go on.
    fn run<T: Send>(
        &self,
        py: Python<'_>,
        service: impl FnOnce(&Inner) -> Result<T, Error> + Send,
    ) -> PyResult<T> {
        let inner = self.0.in_own_process(py)?;
        let result = py.detach(|| {
            let inner = inner.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            inner.as_ref().map(service)
        });
        let result = result.ok_or_else(|| PyValueError::new_err("this LSS master is closed"))?;
        result.map_err(|error| to_py_error(py, &error))
    }
}

#[pymethods]
impl PyLssMaster {
    #[new]
    #[pyo3(signature = (url, profile=None))]
    fn open(py: Python<'_>, url: &str, profile: Option<PathBuf>) -> PyResult<Self> {
        let connector = build_connector(py, profile)?;
        let inner = py.detach(|| Inner::open(&connector, url));
        let inner = inner.map_err(|error| to_py_error(py, &error))?;
        Ok(Self(Mutex::new(Some(inner)).into()))
    }

    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let inner = self.0.in_own_process(py)?;
        py.detach(|| drop(inner.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take()));
        Ok(())
    }

    fn identity_of(&self, py: Python<'_>, node_id: u8) -> PyResult<IdentityTuple> {
        self.run(py, |lss| lss.identity_of(node_id)).map(identity_tuple)
    }

    fn node_answers(&self, py: Python<'_>, node_id: u8) -> PyResult<bool> {
        self.run(py, |lss| lss.node_answers(node_id))
    }

    fn has_unconfigured(&self, py: Python<'_>) -> PyResult<bool> {
        self.run(py, Inner::has_unconfigured)
    }

    fn find_unconfigured(&self, py: Python<'_>) -> PyResult<Option<IdentityTuple>> {
        Ok(self.run(py, Inner::find_unconfigured)?.map(identity_tuple))
    }

    fn select(
        &self,
        py: Python<'_>,
        vendor: u32,
        product: u32,
        revision: u32,
        serial: u32,
    ) -> PyResult<bool> {
        self.run(py, |lss| lss.select(LssIdentity { vendor, product, revision, serial }))
    }

    fn select_only_device(&self, py: Python<'_>) -> PyResult<IdentityTuple> {
        self.run(py, Inner::select_only_device).map(identity_tuple)
    }

    fn selected_identity(&self, py: Python<'_>) -> PyResult<IdentityTuple> {
        self.run(py, Inner::selected_identity).map(identity_tuple)
    }

    fn node_id(&self, py: Python<'_>) -> PyResult<Option<u8>> {
        self.run(py, Inner::node_id)
    }

    fn set_node_id(&self, py: Python<'_>, node_id: Option<u8>) -> PyResult<()> {
        self.run(py, |lss| lss.set_node_id(node_id))
    }

    fn set_bit_rate(&self, py: Python<'_>, bit_per_s: u32) -> PyResult<()> {
        self.run(py, |lss| lss.set_bit_rate(bit_per_s))
    }

    fn store(&self, py: Python<'_>) -> PyResult<()> {
        self.run(py, Inner::store)
    }

    fn leave_configuration(&self, py: Python<'_>) -> PyResult<()> {
        self.run(py, Inner::leave_configuration)
    }

    fn restart_communication(&self, py: Python<'_>, node_id: u8) -> PyResult<()> {
        self.run(py, |lss| lss.node(node_id)?.raw("nmt reset-communication").map(drop))
    }
}

fn identity_tuple(identity: LssIdentity) -> IdentityTuple {
    (identity.vendor, identity.product, identity.revision, identity.serial)
}
