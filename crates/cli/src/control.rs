//! The control socket of a running `polepair sim`, which runs acts on its drives. On Windows it is a TCP port
//! of this machine, and a file has its number.
//!
//! A request is one line with tab-separated fields: link, drive, act. The reply is `ok`, `elsewhere` (the
//! simulation has no such link), or `error` with a reason.

use polepair::url::without_axes;
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use polepair::simulate::{DriveLine, RackDescription, SimulatedMotor, parse_act};

#[cfg(windows)]
use std::net::{Ipv4Addr, TcpListener, TcpStream};
#[cfg(unix)]
use std::os::unix::fs::{DirBuilderExt as _, FileTypeExt as _};
#[cfg(unix)]
use std::os::unix::net::{UnixListener, UnixStream};

/// A connection to a control socket.
#[cfg(unix)]
type ControlStream = UnixStream;
#[cfg(windows)]
type ControlStream = TcpStream;

/// Longest time that a request or its reply takes.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Reply of a simulation without such a link.
const ELSEWHERE: &str = "elsewhere";

/// The drives of a simulation that is served.
#[derive(Clone)]
pub struct ServedDrives {
    pub description: RackDescription,
    pub lines: Vec<DriveLine>,
    /// Place of each link: `serial:///dev/pts/3`.
    pub locations: Vec<String>,
}

impl ServedDrives {
    /// Carries a request out.
    fn answer(&self, request: &str) -> String {
        let mut fields = request.trim_end_matches('\n').splitn(3, '\t');
        let (Some(location), Some(drive), Some(act)) =
            (fields.next(), fields.next(), fields.next())
        else {
            return "error\tthis is not a request".to_owned();
        };
        let wanted = comparable(location);
        let is_meant =
            |(_, known): &(usize, &String)| location.is_empty() || comparable(known) == wanted;
        let links: Vec<usize> =
            self.locations.iter().enumerate().filter(is_meant).map(|(link, _)| link).collect();
        if links.is_empty() {
            return ELSEWHERE.to_owned();
        }
        let found = links.iter().find_map(|link| self.description.find_motor(*link, drive));
        let Some(SimulatedMotor { link, drive: at, motor }) = found else {
            return match drive {
                "" => "error\tthere are several drives: name one after #".to_owned(),
                _ => format!("error\tthe simulation has no drive `{drive}` there"),
            };
        };
        match parse_act(act) {
            Err(error) => format!("error\t{error}"),
            Ok(done) if self.lines.get(link).is_some_and(|line| line.act(at, motor, done)) => {
                "ok".to_owned()
            }
            Ok(_) => format!("error\tthis drive has nothing for `{act}`"),
        }
    }
}

/// A location as two that are one look the same: links to a pseudo-terminal are followed.
fn comparable(location: &str) -> String {
    let plain = location.split(['?', '#']).next().unwrap_or(location);
    match plain.split_once(":///") {
        Some((kind, path)) => {
            let path = Path::new("/").join(path);
            let path = path.canonicalize().unwrap_or(path);
            format!("{kind}://{}", path.display())
        }
        None => plain.to_owned(),
    }
}

/// The folder of control sockets of this user.
fn socket_folder() -> PathBuf {
    match std::env::var_os("XDG_RUNTIME_DIR").filter(|folder| Path::new(folder).is_dir()) {
        Some(folder) => Path::new(&folder).join("polepair"),
        None => user_name(),
    }
}

fn user_name() -> PathBuf {
    let name = std::env::var_os(if cfg!(windows) { "USERNAME" } else { "USER" });
    let name = name.unwrap_or_default();
    std::env::temp_dir().join(format!("polepair-{}", name.to_string_lossy()))
}

/// Listens until it is dropped.
#[derive(Debug)]
pub struct ControlServer {
    path: PathBuf,
}

impl Drop for ControlServer {
    fn drop(&mut self) {
        // A client that finds it without a server removes it, too.
        let _ = std::fs::remove_file(&self.path);
    }
}

impl ControlServer {
    /// Listens at `path`, or at a place where `polepair act` finds it by the URL of a link.
    ///
    /// # Errors
    /// The system's, where it cannot listen there.
    pub fn start(path: Option<&Path>, drives: ServedDrives) -> io::Result<Self> {
        let path = match path {
            Some(path) => path.to_owned(),
            None => {
                let folder = socket_folder();
                create_folder(&folder)?;
                folder.join(format!("sim-{}.sock", std::process::id()))
            }
        };
        let listener = listen_at(&path)?;
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                // One that breaks off got its answer or never asked.
                let _ = serve_request(&stream, &drives);
            }
        });
        Ok(Self { path })
    }
}

#[cfg(unix)]
fn create_folder(folder: &Path) -> io::Result<()> {
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
}

/// A folder in the user's own, which others cannot read.
#[cfg(windows)]
fn create_folder(folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)
}

#[cfg(unix)]
fn listen_at(path: &Path) -> io::Result<UnixListener> {
    UnixListener::bind(path)
}

#[cfg(windows)]
fn listen_at(path: &Path) -> io::Result<TcpListener> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let mut file = std::fs::File::create_new(path)?;
    writeln!(file, "{}", listener.local_addr()?.port())?;
    Ok(listener)
}

#[cfg(unix)]
fn connect_to(path: &Path) -> io::Result<UnixStream> {
    UnixStream::connect(path)
}

#[cfg(windows)]
fn connect_to(path: &Path) -> io::Result<TcpStream> {
    let port = read_port(path).ok_or(io::ErrorKind::ConnectionRefused)?;
    TcpStream::connect((Ipv4Addr::LOCALHOST, port))
}

/// The port in the file of a control socket.
#[cfg(windows)]
fn read_port(path: &Path) -> Option<u16> {
    std::fs::read_to_string(path).ok()?.trim().parse().ok()
}

fn serve_request(stream: &ControlStream, drives: &ServedDrives) -> io::Result<()> {
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.set_write_timeout(Some(TIMEOUT))?;
    let mut request = String::new();
    BufReader::new(stream).read_line(&mut request)?;
    let mut reply = drives.answer(&request);
    reply.push('\n');
    let mut out = stream;
    out.write_all(reply.as_bytes())
}

/// Result of a request.
#[derive(Debug, PartialEq, Eq)]
pub enum ActReply {
    /// The act was done.
    Done,
    /// No simulation that runs has this link.
    NoSimulation,
    /// The request was refused, with the reason.
    Refused(String),
}

/// Returns whether a text is the path of a control socket, behind which a drive may be named.
#[cfg(unix)]
pub fn is_socket(target: &str) -> bool {
    let path = without_axes(target);
    std::fs::metadata(path).is_ok_and(|found| found.file_type().is_socket())
}

/// Returns whether it is such a file, which has the number of a port.
#[cfg(windows)]
pub fn is_socket(target: &str) -> bool {
    read_port(Path::new(without_axes(target))).is_some()
}

/// Has an act done to a drive of a simulation that runs on this machine.
///
/// # Errors
/// The system's, where the socket of a path cannot be reached.
pub fn request_act(target: &str, act: &str) -> io::Result<ActReply> {
    let (place, drive) = target.split_once('#').unwrap_or((target, ""));
    if is_socket(place) {
        return ask(Path::new(place), "", drive, act);
    }
    let location = place.split_once('+').map_or(place, |(_, location)| location);
    let Ok(entries) = std::fs::read_dir(socket_folder()) else {
        return Ok(ActReply::NoSimulation);
    };
    for entry in entries.flatten() {
        match ask(&entry.path(), location, drive, act) {
            Ok(ActReply::NoSimulation) => {}
            Ok(reply) => return Ok(reply),
            // The simulation was killed.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                let _ = std::fs::remove_file(entry.path());
            }
            Err(_) => {}
        }
    }
    Ok(ActReply::NoSimulation)
}

fn ask(path: &Path, location: &str, drive: &str, act: &str) -> io::Result<ActReply> {
    let mut stream = connect_to(path)?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.set_write_timeout(Some(TIMEOUT))?;
    stream.write_all(format!("{location}\t{drive}\t{act}\n").as_bytes())?;
    let mut reply = String::new();
    BufReader::new(&stream).read_line(&mut reply)?;
    Ok(match reply.trim_end().split_once('\t') {
        None if reply.trim_end() == "ok" => ActReply::Done,
        Some(("error", why)) => ActReply::Refused(why.to_owned()),
        _ => ActReply::NoSimulation,
    })
}
