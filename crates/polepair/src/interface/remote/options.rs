//! A gateway's connection string: `ws://HOST:PORT[?key=value&…][#AXES]`.

use polepair_client::{Gateway, GatewayOptions};

use super::RemoteLink;
use crate::error::Error;
use crate::url::decode;

/// Keys of the connection string: how the client authenticates itself and the gateway.
const KEYS: [&str; 4] = ["token-file", "certificate", "client-cert", "client-key"];

/// Opens a gateway by its connection string, whose keys replace those of `options`.
///
/// # Errors
/// [`Error::Usage`] `E210` for an unknown key; as [`RemoteLink::open`].
pub fn open(url: &str, options: GatewayOptions) -> Result<RemoteLink, Error> {
    let (gateway, axes) = find_gateway(url, options)?;
    RemoteLink::open(gateway, axes)
}

/// The gateway and the axes that a connection string names. Nothing is sent.
///
/// # Errors
/// [`Error::Usage`] `E210` for an unknown key; [`Error::Gateway`] for an unusable token or certificate.
pub fn find_gateway(url: &str, options: GatewayOptions) -> Result<(Gateway, Option<&str>), Error> {
    let (options, axes) = parse(url, options)?;
    Ok((Gateway::new(&options)?, axes))
}

/// The options and the axes in a connection string.
fn parse(url: &str, mut options: GatewayOptions) -> Result<(GatewayOptions, Option<&str>), Error> {
    let (rest, axes) = url.split_once('#').map_or((url, None), |(rest, axes)| (rest, Some(axes)));
    let (address, query) = rest.split_once('?').unwrap_or((rest, ""));
    options.url = address.to_owned();
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
        let value = decode(value)?;
        let place = match key {
            "token-file" => &mut options.token_file,
            "client-cert" => &mut options.client_cert,
            "client-key" => &mut options.client_key,
            "certificate" => {
                options.certificate = Some(value);
                continue;
            }
            _ => {
                let what = format!("a gateway's address has no key `{key}`");
                let known = format!("it has {}", KEYS.join(", "));
                return Err(Error::usage("E210", what, known));
            }
        };
        *place = Some(value.into());
    }
    Ok((options, axes))
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_gateways_address_has_keys_and_axes() {
        let url = "wss://host:7365?token-file=/run/a%26b&certificate=ab12#x,2#1";
        let (options, axes) = super::parse(url, Default::default()).expect("known keys");
        assert_eq!(options.url, "wss://host:7365");
        assert_eq!(options.token_file.as_deref(), Some(std::path::Path::new("/run/a&b")));
        assert_eq!(options.certificate.as_deref(), Some("ab12"));
        assert_eq!(axes, Some("x,2#1"));
        let error =
            super::parse("ws://host:7365?tokenfile=a", Default::default()).expect_err("unknown");
        assert_eq!(error.code(), "E210");
    }
}
