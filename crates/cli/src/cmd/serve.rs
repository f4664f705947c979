//! `polepair serve [URL…]`: runs the gateway with its page.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use polepair_serve::{GatewayServer, PORT, Scopes, ServerOptions, SetupError};

use crate::data_output::DataOutput;
use crate::outcome::to_sentence;
use crate::problem::{Exit, Problem, Result};
use crate::profile_args::ProfileFile;
use crate::terminal::{print_note, print_warning};
use tracing_subscriber::EnvFilter;

/// Opens links and serves them to browsers and programs until Ctrl-C.
///
/// Without a URL, the server simulates a rack. It prints a URL that admits one browser, once. By default it
/// accepts connections from this machine only; other addresses need --tls. On Ctrl-C the server stops all
/// moving axes and exits. This is not a certified safety function: use hard-wired STO and an emergency
/// stop.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair serve                                 a simulated rack
  polepair serve tmcl+serial:///dev/ttyUSB0:9600#1,2
  polepair serve @arm --scopes read,stop         read and stop only
  polepair serve @arm --tls --bind 0.0.0.0:7365 --name bench.example")]
pub struct Serve {
    /// Links to open
    #[arg(value_name = "URL")]
    urls: Vec<String>,
    /// Address and port to listen on; port 0 selects a free one
    #[arg(long, value_name = "ADDR:PORT", default_value_t = SocketAddr::new(LOOPBACK, PORT))]
    bind: SocketAddr,
    /// Encrypt with certificate.pem and key.pem of the state folder; the first start creates them
    #[arg(long)]
    tls: bool,
    /// Require client certificates signed by a CA in this file, in addition to tokens
    #[arg(long, value_name = "FILE", requires = "tls")]
    client_ca: Option<PathBuf>,
    /// Host name that clients may use for this server, with the port of a proxy or tunnel; repeat the option
    /// for more
    #[arg(long = "name", value_name = "HOST[:PORT]")]
    names: Vec<String>,
    /// Origin of the page behind a proxy that adds encryption, such as https://bench.example; repeatable
    #[arg(long = "origin", value_name = "URL")]
    origins: Vec<String>,
    /// Highest permissions of any client: read, stop, move, configure, raw; `raw` also needs a token with
    /// raw
    #[arg(long, value_name = "SCOPE,…", default_value = "read,stop,move,configure")]
    scopes: Scopes,
    /// Folder for tokens, certificate and journal [default: polepair's folder of your account]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Port that clients may have searched for drives, besides those that the system lists; repeatable
    #[arg(long = "search-port", value_name = "PATH")]
    search_ports: Vec<String>,
    /// Format of the log on stderr
    #[arg(long, value_name = "FORM", default_value = "text")]
    log: LogFormat,
    #[command(flatten)]
    profile: ProfileFile,
}

const LOOPBACK: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

/// Log formats.
#[derive(ValueEnum, Clone, Copy, Debug)]
enum LogFormat {
    /// Text
    Text,
    /// One JSON object for each line
    Json,
    /// No log
    Off,
}

impl Serve {
    pub fn run(self) -> Result {
        self.init_logging();
        let folder = match self.state {
            Some(folder) => folder,
            None => state_folder()?,
        };
        let connector = self.profile.connector()?;
        let options = ServerOptions {
            bind: self.bind,
            tls: self.tls,
            client_ca: self.client_ca,
            host_names: self.names,
            origins: self.origins,
            scopes: self.scopes,
            folder,
            search_ports: self.search_ports,
        };
        let server =
            GatewayServer::start(&options, &self.urls, connector).map_err(refusal_problem)?;
        let stopper = server.shutdown_handle();
        crate::interrupt::listen(move || stopper.shutdown());
        if server.truncated_bytes() > 0 {
            print_note(
                "The journal ends with an incomplete record: the previous server was killed. The \
                 journal is continued.",
            );
        }
        if let Some(fingerprint) = server.fingerprint() {
            print_note(&format!("certificate SHA-256 {fingerprint}"));
        }
        for (link, number) in server.inherited_stops() {
            print_warning(&format!(
                "axis {number} of {link} received a stop from the previous server, and its \
                 standstill was not confirmed; it is stopped as soon as it replies. Cut its \
                 supply if it turns."
            ));
        }
        for link in server.bench().snapshot().links {
            crate::remote::link_troubles(&link).iter().for_each(|line| print_note(line));
        }
        let mut out = DataOutput::stdout();
        out.write_line(&format!("ready {}", server.url()));
        out.flush()?;
        let left = server.wait();
        for axis in &left {
            print_warning(&format!(
                "{axis} received a stop, but its standstill is not confirmed: CUT ITS SUPPLY"
            ));
        }
        Ok(if left.is_empty() { Exit::Ok } else { Exit::Partial })
    }

    fn init_logging(&self) {
        let to = tracing_subscriber::fmt().with_writer(std::io::stderr);
        // One was set already only where this runs inside another program.
        let _ = match self.log {
            LogFormat::Off => return,
            LogFormat::Text => to.with_env_filter(log_filter()).try_init(),
            LogFormat::Json => to.json().with_env_filter(log_filter()).try_init(),
        };
    }
}

fn log_filter() -> EnvFilter {
    let wanted = std::env::var("POLEPAIR_LOG").unwrap_or_default();
    let usual = "warn,polepair_serve=info";
    let text = if wanted.is_empty() { usual } else { &wanted };
    EnvFilter::new(text)
}

/// Problem for an error of the server.
pub fn refusal_problem(refusal: SetupError) -> Problem {
    let SetupError { exit, code, what, why, hint } = refusal;
    Problem::new(exit, code, to_sentence(&what))
        .why(why)
        .hint_if(Some(hint).filter(|h| !h.is_empty()))
}

/// Folder of this account's server.
pub fn state_folder() -> Result<PathBuf> {
    polepair_client::state_folder().ok_or_else(|| {
        Problem::usage("E255", "the folder for tokens and journal is unknown.")
            .why("Neither HOME nor XDG_STATE_HOME is set.")
            .hint("--state DIR")
    })
}
