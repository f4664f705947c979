//! Joins a real server: its replies, its refusals, and the end of motion when it is gone.

use crate::{authority, cut};
use polepair_test_support::{WAIT_MAX, wait_until};

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use authority::{authority, vouched_by};
use cut::Cut;
use polepair::Connector;
use polepair_client::message::{CommandArguments, ParameterInput, StopRequest, WriteParameters};
use polepair_client::{Gateway, GatewayError, GatewayOptions};
use polepair_serve::GatewayServer;

/// Two modules at addresses 1 and 3.
const DRIVES: &str = "sim:tmcl?axes=2";

/// A server of its own for each test, on a free port.
pub struct Site {
    server: GatewayServer,
    folder: PathBuf,
}

impl Site {
    pub fn new() -> Self {
        Self::with(|_| polepair_serve::ServerOptions::in_folder(PathBuf::new()))
    }

    fn encrypted() -> Self {
        let plain = polepair_serve::ServerOptions::in_folder(PathBuf::new());
        Self::with(|_| polepair_serve::ServerOptions { tls: true, ..plain })
    }

    /// A server that allows everything, raw requests too.
    pub fn with_raw_requests() -> Self {
        Self::with(|folder| {
            let tokens = folder.join("tokens");
            let token = "5a".repeat(32);
            std::fs::write(&tokens, format!("{token} read,stop,move,configure,raw all\n")).unwrap();
            let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
            std::fs::set_permissions(&tokens, private).unwrap();
            let scopes = "read,stop,move,configure,raw".parse().unwrap();
            let plain = polepair_serve::ServerOptions::in_folder(PathBuf::new());
            polepair_serve::ServerOptions { scopes, ..plain }
        })
    }

    /// A server of such options, made in its folder.
    fn with(options: impl FnOnce(&Path) -> polepair_serve::ServerOptions) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let n = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("polepair-client-{}-{n}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let bind = "127.0.0.1:0".parse().unwrap();
        let options =
            polepair_serve::ServerOptions { bind, folder: folder.clone(), ..options(&folder) };
        let server =
            GatewayServer::start(&options, &[DRIVES.into()], Connector::default()).unwrap();
        Self { server, folder }
    }

    pub fn port(&self) -> u16 {
        self.server.address().port()
    }

    /// Options of a client that has the server's folder.
    pub fn options(&self, scheme: &str) -> GatewayOptions {
        GatewayOptions {
            url: format!("{scheme}://127.0.0.1:{}", self.port()),
            token_file: Some(self.folder.join("tokens")),
            certificate: Some(self.folder.join("certificate.pem").display().to_string()),
            ..GatewayOptions::default()
        }
    }

    fn join(&self) -> Gateway {
        Gateway::new(&self.options("http")).unwrap()
    }

    fn moving(&self, axis: u16) -> bool {
        let state = self.server.bench().axis_state(axis).unwrap();
        let velocity = state.signals.iter().find(|s| s.signal == "velocity");
        velocity.and_then(|s| s.value).is_some_and(|velocity| velocity.abs() > 0.5)
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn to(target: f64) -> CommandArguments {
    CommandArguments { target: Some(target), ..CommandArguments::default() }
}

fn at(velocity: f64) -> CommandArguments {
    CommandArguments { velocity: Some(velocity), ..CommandArguments::default() }
}

fn current(text: &str) -> WriteParameters {
    WriteParameters {
        values: [("max current".to_owned(), ParameterInput::Text(text.to_owned()))].into(),
        keep: false,
        dry_run: true,
        raw: false,
        epoch: 0,
    }
}

#[test]
fn an_axis_is_taken_moved_and_given_back() {
    let site = Site::new();
    let gateway = site.join();
    let bench = gateway.bench().unwrap();
    assert_eq!(bench.axes.iter().map(|axis| axis.number).collect::<Vec<_>>(), [1, 3]);
    let lease = gateway.live().unwrap().acquire_lease(1).unwrap();
    for verb in ["arm", "enable"] {
        lease.run(verb, CommandArguments::default(), WAIT_MAX).unwrap();
    }
    lease.run("move-to", to(1.0), WAIT_MAX).unwrap();
    lease.run("reached", CommandArguments::default(), WAIT_MAX).unwrap();
    let position = || {
        let signals = gateway.axis_state(1).unwrap().signals;
        signals.iter().find(|s| s.signal == "position").and_then(|s| s.value).unwrap_or(0.0)
    };
    wait_until("it is where it was sent", || (position() - 1.0).abs() < 0.05);
    lease.check().unwrap();
    lease.release().unwrap();
    assert_eq!(gateway.axis_state(1).unwrap().lease, None);
    assert!(!gateway.axis_state(1).unwrap().armed, "nothing moves before it is armed anew");
}

#[test]
fn parameters_are_planned_written_and_read() {
    let site = Site::new();
    let gateway = site.join();
    assert!(gateway.parameters(0).unwrap().iter().any(|p| p.name == "max current"));
    let plan = gateway.write_parameters(0, &current("1.2 A")).unwrap();
    assert!(plan.len() == 1 && (plan[0].to - 1.2).abs() < 1e-9 && plan[0].changed, "{plan:?}");
    let before = gateway.parameter(0, "max current").unwrap();
    assert_eq!(before.value, plan[0].from, "a dry run writes nothing");
    let real = WriteParameters { dry_run: false, ..current("1.2 A") };
    let refused = gateway.write_parameters(0, &real).unwrap_err();
    assert_eq!((&*refused.code, refused.executed), ("gateway.lease", Some(false)));
    let live = gateway.live().unwrap();
    let lease = live.acquire_lease(0).unwrap();
    gateway.write_parameters(0, &WriteParameters { epoch: lease.epoch(), ..real }).unwrap();
    assert_eq!(gateway.parameter(0, "max current").unwrap().raw, Some(12));
    assert_eq!(gateway.write_parameters(0, &current("99 A")).unwrap_err().code, "E216");
    assert_eq!(gateway.parameter(0, "max curent").unwrap_err().exit() as u8, 2);
}

#[test]
fn the_second_of_two_clients_gets_the_name_of_the_first() {
    let site = Site::new();
    let (ann, bob) = (site.join().live().unwrap(), site.join().live().unwrap());
    assert_ne!(ann.session(), bob.session(), "one token, two clients");
    let lease = ann.acquire_lease(0).unwrap();
    let refused = bob.acquire_lease(0).unwrap_err();
    assert_eq!((&*refused.code, refused.executed), ("gateway.lease", Some(false)));
    assert!(refused.message.contains(ann.session()), "{refused}");
    bob.acquire_lease(1).unwrap();
    drop(lease);
    wait_until("what is dropped is free", || bob.acquire_lease(0).is_ok());
}

#[test]
fn whoever_stops_an_axis_ends_its_lease() {
    let site = Site::new();
    let gateway = site.join();
    let lease = gateway.live().unwrap().acquire_lease(0).unwrap();
    for verb in ["arm", "enable"] {
        lease.run(verb, CommandArguments::default(), WAIT_MAX).unwrap();
    }
    lease.run("velocity", at(30.0), WAIT_MAX).unwrap();
    wait_until("it turns", || site.moving(0));
    let request =
        StopRequest { axes: Some(vec![0]), reason: "a test".into(), ..StopRequest::default() };
    let stopped = site.join().stop(&request).unwrap();
    assert_eq!(stopped.axes.len(), 1);
    assert!(stopped.axes[0].error.is_none(), "{stopped:?}");
    assert_eq!(lease.run("velocity", at(30.0), WAIT_MAX).unwrap_err().executed, Some(false));
    wait_until("it hears of that", || lease.check().is_err());
    assert_eq!(lease.check().unwrap_err().code, "gateway.lease");
}

/// The wire between client and server falls silent in the middle of a motion: neither end gets a notice.
#[test]
fn a_lost_server_stops_the_axis_and_leaves_the_outcome_unknown() {
    let site = Site::new();
    let cut = Cut::before(site.port());
    let url = format!("http://127.0.0.1:{}", cut.port());
    let gateway = Gateway::new(&GatewayOptions { url, ..site.options("http") }).unwrap();
    let lease = gateway.live().unwrap().acquire_lease(0).unwrap();
    for verb in ["arm", "enable"] {
        lease.run(verb, CommandArguments::default(), WAIT_MAX).unwrap();
    }
    lease.run("velocity", at(30.0), WAIT_MAX).unwrap();
    wait_until("it turns", || site.moving(0));
    cut.pull();
    let mut pending = lease.start("velocity", at(60.0)).unwrap();
    wait_until("the lease is over", || site.server.bench().axis_state(0).unwrap().lease.is_none());
    wait_until("it stands", || !site.moving(0));
    assert!(!site.server.bench().axis_state(0).unwrap().armed);
    let unknown = pending.wait(WAIT_MAX).unwrap_err();
    assert_eq!((&*unknown.code, unknown.executed), ("E313", None), "{unknown}");
    assert_eq!(lease.check().unwrap_err().code, "E313");
    let nothing = lease.start("stop", CommandArguments::default()).unwrap_err();
    assert_eq!(nothing.executed, Some(false), "it was not even sent: {nothing}");
    let journal = std::fs::read_to_string(site.folder.join("journal.jsonl")).unwrap();
    assert_eq!(journal.matches(r#""verb":"velocity""#).count(), 1, "{journal}");
}

#[test]
fn watched_signals_come_as_samples() {
    let site = Site::new();
    let live = site.join().live().unwrap();
    let watched = live.subscribe(0, Some("position"), None, 50.0).unwrap();
    assert_eq!(watched.unit(), "rad");
    wait_until("samples come", || watched.drain().unwrap().0.len() > 1);
    assert!(watched.last(Duration::MAX).unwrap().is_some());
    // More than a client may have at once: what is dropped is watched no more.
    for _ in 0..100 {
        live.subscribe(0, Some("velocity"), None, 50.0).unwrap();
    }
    let refused = live.subscribe(0, Some("fuel"), None, 50.0).unwrap_err();
    assert_eq!(refused.executed, Some(false), "{refused}");
}

#[test]
fn only_the_pinned_certificate_is_the_servers() {
    let site = Site::encrypted();
    let right = site.options("https");
    assert_eq!(Gateway::new(&right).unwrap().bench().unwrap().axes.len(), 2);
    let printed = site.server.fingerprint().unwrap().to_owned();
    let by_print = GatewayOptions { certificate: Some(printed.clone()), ..right.clone() };
    let live = Gateway::new(&by_print).unwrap().live().unwrap();
    live.acquire_lease(0).unwrap();
    let other = if printed.starts_with('0') { "1" } else { "0" };
    let wrong = GatewayOptions { certificate: Some(format!("{other}{}", &printed[1..])), ..right };
    assert_eq!(Gateway::new(&wrong).unwrap().bench().unwrap_err().code, "E321");
    let plain = Gateway::new(&site.options("http")).unwrap().bench().unwrap_err();
    assert_eq!(plain.exit() as u8, 3, "{plain}");
}

#[test]
fn where_clients_show_certificates_ours_is_shown() {
    let mut signers = Vec::new();
    let site = Site::with(|folder| {
        signers = ["ours", "others"].map(|name| authority(&folder.join(name))).into();
        let clients = Some(folder.join("ours"));
        polepair_serve::ServerOptions {
            tls: true,
            client_ca: clients,
            ..polepair_serve::ServerOptions::in_folder(PathBuf::new())
        }
    });
    let own = site.folder.join("robot.pem");
    let (certificate, key) = vouched_by(&signers[0]);
    private(&own, &format!("{certificate}{key}"));
    let right = GatewayOptions { client_cert: Some(own.clone()), ..site.options("https") };
    let gateway = Gateway::new(&right).unwrap();
    assert_eq!(gateway.bench().unwrap().axes.len(), 2);
    gateway.live().unwrap().acquire_lease(0).unwrap();
    let apart = [site.folder.join("robot.crt"), site.folder.join("robot.key")];
    std::fs::write(&apart[0], &certificate).unwrap();
    private(&apart[1], &key);
    let [client_cert, client_key] = apart.clone().map(Some);
    let apart_too = GatewayOptions { client_cert, client_key, ..right.clone() };
    assert_eq!(Gateway::new(&apart_too).unwrap().bench().unwrap().axes.len(), 2);
    let none = Gateway::new(&site.options("https")).unwrap();
    for refused in [none.bench().unwrap_err(), none.live().unwrap_err()] {
        assert_eq!((&*refused.code, refused.executed), ("E256", Some(false)), "{refused}");
        assert!(refused.hint.contains("--client-cert"), "{refused:?}");
    }
    let (certificate, key) = vouched_by(&signers[1]);
    private(&own, &format!("{certificate}{key}"));
    // The server closes the connection, and its last message may be lost on the way.
    let stranger = Gateway::new(&right).unwrap();
    let refused = stranger.bench().unwrap_err();
    assert!(["E256", "E313"].contains(&&*refused.code), "{refused}");
    let keyless = GatewayOptions { client_key: Some(apart[0].clone()), ..right.clone() };
    assert!(["E256", "E305"].contains(&&*Gateway::new(&keyless).unwrap_err().code));
    let foreign = GatewayOptions { client_key: Some(apart[1].clone()), ..right };
    assert_eq!(Gateway::new(&foreign).unwrap_err().code, "E256", "another certificate's key");
}

/// A server that is started anew, without `--client-ca` now, lets in who asked the one before it.
#[test]
fn a_limit_of_one_server_does_not_apply_to_the_next() {
    let site = Site::with(|folder| {
        authority(&folder.join("ours"));
        polepair_serve::ServerOptions {
            tls: true,
            client_ca: Some(folder.join("ours")),
            ..polepair_serve::ServerOptions::in_folder(PathBuf::new())
        }
    });
    let (bind, folder) = (site.server.address(), site.folder.with_extension("again"));
    let gateway = Gateway::new(&site.options("https")).unwrap();
    assert_eq!(gateway.bench().unwrap_err().code, "E256");
    std::fs::create_dir_all(&folder).unwrap();
    for name in ["tokens", "certificate.pem", "key.pem"] {
        std::fs::copy(site.folder.join(name), folder.join(name)).unwrap();
    }
    drop(site);
    let plain = polepair_serve::ServerOptions::in_folder(folder.clone());
    let options = polepair_serve::ServerOptions { bind, tls: true, ..plain };
    let server = GatewayServer::start(&options, &[DRIVES.into()], Connector::default()).unwrap();
    let _site = Site { server, folder };
    assert_eq!(gateway.bench().unwrap().axes.len(), 2);
}

fn private(path: &Path, text: &str) {
    std::fs::write(path, text).unwrap();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)).unwrap();
    }
}

#[test]
fn without_a_token_nothing_is_revealed() {
    let site = Site::new();
    let file = site.folder.join("another");
    private(&file, &"0".repeat(64));
    let options = GatewayOptions { token_file: Some(file), ..site.options("http") };
    let gateway = Gateway::new(&options).unwrap();
    let refused: [GatewayError; 2] = [gateway.bench().unwrap_err(), gateway.live().unwrap_err()];
    refused.iter().for_each(|refused| assert_eq!(refused.code, "gateway.token"));
}

#[test]
fn a_missing_server_is_reported() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = free.local_addr().unwrap().port();
    drop(free);
    let site = Site::new();
    let options =
        GatewayOptions { url: format!("http://127.0.0.1:{port}"), ..site.options("http") };
    let gateway = Gateway::new(&options).unwrap();
    let refused = gateway.bench().unwrap_err();
    assert_eq!((&*refused.code, refused.executed), ("E314", Some(false)));
    let refused = gateway.stop(&StopRequest::default()).unwrap_err();
    assert!(refused.hint.contains("cut the supply"), "{refused:?}");
}
