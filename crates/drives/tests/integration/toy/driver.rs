//! Parameters ↔ requests of one axis, and the protocol's facts.

use polepair_core::axis::{AnswerDecoder, Driver, RequestEncoder, WriteRules};
use polepair_core::error::{Failure, Unsupported};
use polepair_core::explain::RawFrame;
use polepair_core::medium::Can;
use polepair_core::profile::{Parameter, Profile};
use polepair_core::proto::{HostOptions, OptionKey, Protocol};
use polepair_core::station::RequestClass;

use super::PROFILE;
use super::host::{ToyHost, ToyRequest};
use super::wire::ToyMessage;

/// The protocol.
pub struct Toy;

impl Protocol for Toy {
    type Medium = Can;
    type Host = ToyHost;
    const NAME: &'static str = "toy";
    const PROFILE_PROTOCOL: &'static str = "toy";
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=8;
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=127;
    const KEYS: &'static [OptionKey] = &[];
    const DEFAULT_RATE: u32 = 125_000;

    fn generic_profile() -> &'static Profile {
        &PROFILE
    }

    fn create_host(options: &HostOptions, _axes: &[u32]) -> ToyHost {
        ToyHost::new(options.bit_rate)
    }

    fn create_driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = ToyRequest, Answer = i32> + Send + 'static {
        ToyDriver { profile, address: address as u8 }
    }
}

struct ToyDriver {
    profile: &'static Profile,
    address: u8,
}

impl ToyDriver {
    fn request(&self, register: u16, value: Option<i64>) -> Result<ToyRequest, Unsupported> {
        let register = u8::try_from(register).map_err(|_| Unsupported::NoSuchParameter)?;
        let writes = value.is_some();
        let value = i32::try_from(value.unwrap_or(0)).map_err(|_| Unsupported::BadArgument)?;
        let message = ToyMessage { address: self.address, writes, register, value };
        Ok(ToyRequest { message, is_stop: false })
    }
}

impl RequestEncoder for ToyDriver {
    type Request = ToyRequest;

    fn read_request(&self, parameter: &Parameter) -> Result<ToyRequest, Unsupported> {
        self.request(parameter.index, None)
    }

    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<ToyRequest, Unsupported> {
        let request = self.request(parameter.index, Some(raw))?;
        Ok(ToyRequest { is_stop: class == RequestClass::Stop, ..request })
    }

    /// The drive's only function is a stop.
    fn function_request(
        &self,
        _function: u8,
        index: u16,
        value: i64,
    ) -> Result<ToyRequest, Unsupported> {
        Ok(ToyRequest { is_stop: true, ..self.request(index, Some(value))? })
    }

    fn parse_request(&self, _text: &str) -> Result<ToyRequest, Unsupported> {
        Err(Unsupported::BadText)
    }

    fn decode_request(&self, _frame: &RawFrame<'_>) -> Result<ToyRequest, Unsupported> {
        Err(Unsupported::BadBytes)
    }
}

impl AnswerDecoder for ToyDriver {
    type Answer = i32;

    fn decode_answer(
        &mut self,
        _parameter: Option<&Parameter>,
        answer: &i32,
    ) -> Result<i64, Failure> {
        Ok((*answer).into())
    }
}

impl WriteRules for ToyDriver {}

impl Driver for ToyDriver {
    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        self.address.into()
    }
}
