use std::fs;
use std::path::{Path, PathBuf};

use super::{Port, PortKind, UsbInfo};
use crate::error::{Cause, LinkError};

/// Levels of its device tree in which a port's USB device is searched.
const PARENTS_MAX: usize = 8;
/// Processes and their open files that are looked through for who holds a port.
const PROCESSES_MAX: usize = 65_536;
const FILES_MAX: usize = 1_024;

pub(super) fn ports() -> Vec<Port> {
    entries("/sys/class/tty").filter_map(|class| port(&class)).collect()
}

/// The name of the driver behind a port: `ftdi_sio`, `cdc_acm`.
pub(super) fn driver_name(path: &str) -> Option<String> {
    let real = fs::canonicalize(path).ok()?;
    driver_name_of(&Path::new("/sys/class/tty").join(real.file_name()?))
}

/// Behind USB the port's device has a driver of usb-serial's, `ftdi_sio` as `ftdi_sio`; of CDC it is
/// the interface's.
fn driver_name_of(class: &Path) -> Option<String> {
    let driver = fs::canonicalize(class.join("device/driver")).ok()?;
    Some(driver.file_name()?.to_str()?.to_owned())
}

pub(super) fn stable_name(path: &str) -> Option<String> {
    let real = fs::canonicalize(path).ok()?;
    entries("/dev/serial/by-id")
        .find(|link| fs::canonicalize(link).is_ok_and(|to| to == real))
        .map(|link| link.to_string_lossy().into_owned())
}

/// Name and number of the process that has locked `path`. Others may have it open: who serves a
/// pseudo-terminal does.
pub(super) fn lock_holder(path: &str) -> Option<(String, u32)> {
    use std::os::unix::fs::MetadataExt as _;
    let file = fs::metadata(path).ok()?;
    let (device, inode) = (file.dev(), file.ino());
    let location =
        format!("{:02x}:{:02x}:{inode}", rustix::fs::major(device), rustix::fs::minor(device));
    let locks = fs::read_to_string("/proc/locks").ok()?;
    // `1: FLOCK  ADVISORY  WRITE 4711 00:1a:5 0 EOF`; a process that may not be seen is 0.
    let pid = locks.lines().find_map(|line| {
        let mut words = line.split_ascii_whitespace().skip(4);
        let pid: u32 = words.next()?.parse().ok()?;
        (words.next()? == location && pid != 0).then_some(pid)
    })?;
    Some((read_text(&Path::new("/proc").join(pid.to_string()), "comm"), pid))
}

/// Name and number of a process that has `path` open, as far as this user may see.
pub(super) fn open_holder(path: &str) -> Option<(String, u32)> {
    let real = fs::canonicalize(path).ok()?;
    let ours = std::process::id();
    entries("/proc").take(PROCESSES_MAX).find_map(|process| {
        let pid: u32 = process.file_name()?.to_str()?.parse().ok()?;
        let held = entries(process.join("fd"))
            .take(FILES_MAX)
            .any(|fd| fs::read_link(fd).is_ok_and(|to| to == real));
        (held && (pid != ours)).then(|| (read_text(&process, "comm"), pid))
    })
}

/// Returns whether a process was suspended: by SIGSTOP, by Ctrl-Z, or in the background by its terminal.
pub(super) fn is_suspended(pid: u32) -> bool {
    let stat = read_text(&Path::new("/proc").join(pid.to_string()), "stat");
    // `4711 (name) T 1 …`; a name may have brackets.
    stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('T'))
}

fn port(class: &Path) -> Option<Port> {
    // Without a device behind it, it is a console or a virtual terminal.
    let device = fs::canonicalize(class.join("device")).ok()?;
    // 0: the motherboard's driver reserves names for ports that are not there.
    if read_text(class, "type") == "0" {
        return None;
    }
    let path = format!("/dev/{}", class.file_name()?.to_str()?);
    Some(Port {
        kind: PortKind::Bytes,
        stable_name: stable_name(&path),
        usb: usb(&device),
        driver: driver_name_of(class),
        error: check_access(&path),
        path,
    })
}

fn usb(device: &Path) -> Option<UsbInfo> {
    let parent = device.ancestors().take(PARENTS_MAX).find(|p| p.join("idVendor").exists())?;
    Some(UsbInfo {
        vendor_id: usb_id("idVendor", parent),
        product_id: usb_id("idProduct", parent),
        vendor: read_text(parent, "manufacturer"),
        product: read_text(parent, "product"),
        serial: read_text(parent, "serial"),
    })
}

fn usb_id(name: &str, parent: &Path) -> u16 {
    u16::from_str_radix(&read_text(parent, name), 16).unwrap_or(0)
}

/// Looks without opening: opening raises DTR, which resets some boards.
fn check_access(path: &str) -> Option<LinkError> {
    use rustix::fs::{Access, access};
    if let Err(errno) = access(path, Access::READ_OK | Access::WRITE_OK) {
        return Some(LinkError::from_io(path, &errno.into()));
    }
    open_holder(path)?;
    Some(LinkError::new(path, Cause::Busy).with_hint(&super::holder_sentence(path)))
}

fn entries(folder: impl AsRef<Path>) -> impl Iterator<Item = PathBuf> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

fn read_text(folder: &Path, name: &str) -> String {
    fs::read_to_string(folder.join(name)).unwrap_or_default().trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::{driver_name_of, fs};

    #[test]
    fn a_driver_is_known_by_its_name() {
        let folder = std::env::temp_dir().join(format!("polepair-driver-{}", std::process::id()));
        let (class, driver) = (folder.join("ttyACM0"), folder.join("drivers/cdc_acm"));
        fs::create_dir_all(class.join("device")).expect("a folder");
        fs::create_dir_all(&driver).expect("a folder");
        std::os::unix::fs::symlink(&driver, class.join("device/driver")).expect("a link");
        assert_eq!(driver_name_of(&class).as_deref(), Some("cdc_acm"));
        assert_eq!(driver_name_of(&folder.join("ttyS0")), None);
        fs::remove_dir_all(&folder).expect("ours");
    }
}
