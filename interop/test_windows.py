"""The program and the Python package for Windows under Wine, against simulated drives of this machine over TCP, serial ports, slcan and
socketcand. `make windows` builds them.

Wine is not Windows: what passes here was tried under Wine alone.
"""

import os
import shutil
import subprocess
import urllib.request
from pathlib import Path

import pytest

from conftest import ROOT, TARGET, end, polepair, start
from polepair_test_support import wait_until

PROGRAM = ROOT / "target" / "x86_64-pc-windows-gnu" / TARGET.name / "polepair.exe"
SOURCES = Path(__file__).resolve().parent / "windows"
PREFIX = ROOT / "target" / "wine"
ENVIRONMENT = {
    **os.environ, "WINEPREFIX": str(PREFIX), "WINEDEBUG": "-all", "POLEPAIR_TIMEOUT_SCALE": "3",
}
WHEELS = ROOT / "target" / "windows-wheel"
CAPTURE = "(1700000000.000000) can0 123#0102\n"

pytestmark = pytest.mark.skipif(
    not PROGRAM.exists() or shutil.which("wine") is None,
    reason="there is no program for Windows, or no Wine: make windows",
)


def mingw(source, target, *options):
    command = ["x86_64-w64-mingw32-gcc", "-O1", "-Wall", "-Wextra", "-o", str(target)]
    subprocess.run([*command, str(SOURCES / source), *options], check=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Program and libraries in one folder, and a Wine of their own."""
    folder = tmp_path_factory.mktemp("windows")
    os.link(PROGRAM, folder / "polepair.exe") if os.stat(PROGRAM).st_dev == os.stat(
        folder
    ).st_dev else shutil.copy(PROGRAM, folder)
    mingw("prng.c", folder / "bcryptprimitives.dll", "-shared", "-ladvapi32")
    mingw("console.c", folder / "console.exe")
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    # It would keep the pipes of the first program that starts it.
    subprocess.run(["wine", "wineboot", "-i"], env=ENVIRONMENT, check=True, timeout=300, **quiet)
    # Wine forgets volatile keys of the registry, such as its ports, some seconds after its last program has ended.
    open_program = subprocess.Popen(
        ["wine", "cmd.exe"], env=ENVIRONMENT, **{**quiet, "stdin": subprocess.PIPE}
    )
    yield folder
    open_program.communicate()
    subprocess.run(["wineserver", "-k"], env=ENVIRONMENT, check=False, **quiet)


@pytest.fixture(scope="module")
def wine(folder):
    """A function that runs the program."""

    def run(*words, check=True):
        done = subprocess.run(
            ["wine", "polepair.exe", *words], cwd=folder, env=ENVIRONMENT, capture_output=True,
            text=True, timeout=120, check=False, stdin=subprocess.DEVNULL,
        )
        if check:
            assert done.returncode == 0, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done

    return run


@pytest.fixture
def served():
    """A function that starts drives on this machine, and gives their URL."""
    running = []

    def drives(*words):
        process, url = start(*words)
        running.append(process)
        return url

    yield drives
    for process in running:
        end(process)


@pytest.fixture
def com_port(sim, tmp_path):
    """A function that gives drives on a serial port of Wine's."""
    numbers = iter(range(20, 60))

    def port(words):
        number = next(numbers)
        link = PREFIX / "dosdevices" / f"com{number}"
        link.unlink(missing_ok=True)
        link.symlink_to(Path(sim(words)).resolve())
        return f"COM{number}"

    return port


@pytest.fixture(scope="module")
def python(folder):
    """CPython for Windows with the package installed from its wheel: a function that gives its command line."""
    home = PREFIX.parent / "windows-python"
    fetched = subprocess.run(
        [SOURCES / "python", home], capture_output=True, text=True, check=False, timeout=900
    )
    if fetched.returncode != 0:
        pytest.skip(fetched.stderr.strip())
    wheel = next(WHEELS.glob("polepair-*-win_amd64.whl"))
    site = folder / "site"
    run_python(home, "-m", "pip", "install", "--no-index", "--no-deps", "--target", str(site), str(wheel))
    shutil.copy(folder / "bcryptprimitives.dll", home)

    def command(*words):
        return ["wine", str(home / "python.exe"), *words]

    command.environment = {**ENVIRONMENT, "PYTHONPATH": f"Z:{site}"}
    return command


def run_python(home, *words):
    # Python for Windows needs an input: Wine has no handle for /dev/null.
    done = subprocess.run(
        ["wine", str(home / "python.exe"), *words], env=ENVIRONMENT, input="", capture_output=True, text=True,
        timeout=300, check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def speed(url):
    text = polepair("get", url, "actual velocity", "--raw").stdout
    return abs(int(text.rsplit("=", 1)[1]))


def test_it_describes_itself_and_lists_ports(wine):
    assert wine("--version").stdout.startswith("polepair ")
    assert "COM" in wine("ports").stdout


def test_a_simulated_drive_turns_in_the_program_itself(wine):
    assert "Trinamic TMCM-171" in wine("info", "sim:tmcl").stdout
    assert wine("move", "sim:tmcl", "90deg").stdout == "position = 90 deg\n"


def test_tcp_and_every_can_link_reach_drives(wine, served):
    tcp = served("tmcl", "--tcp", "127.0.0.1:0")
    assert wine("get", tcp, "max current").stdout == "max current = 10 A\n"
    wine("spin", tcp, "300rpm", "--for", "500ms")
    tml = served("tml", "--tcp", "127.0.0.1:0")
    assert wine("move", tml, "90deg", "--timeout", "60s").stdout.endswith(" turn\n")
    slcan = served("tmcl+can", "--tcp", "127.0.0.1:0")
    assert wine("get", slcan, "max current").stdout == "max current = 10 A\n"
    socketcand = served("canopen:5", "--socketcand", "127.0.0.1:0")
    assert "vendor id" in wine("get", socketcand, "0x1018:1").stdout
    udp = served("canopen:5", "--udp", "239.74.163.2:43217")
    assert "vendor id" in wine("get", udp, "0x1018:1").stdout
    assert wine("scan", tcp.split("#")[0]).stdout.count("tmcm-171") == 1


def test_a_linux_only_function_is_refused_with_an_alternative(wine):
    done = wine("info", "canopen+socketcan://can0#5", check=False)
    assert done.returncode == 2 and "SocketCAN is a part of Linux" in done.stderr, done.stderr
    assert "slcan" in done.stderr and "socketcand" in done.stderr, done.stderr
    done = wine("sim", "tmcl", "--pty", "drive", check=False)
    assert done.returncode != 0 and "--tcp" in done.stderr, done.stderr


def test_a_serial_port_reaches_tmcl_and_tml(wine, com_port):
    tmcl = f"tmcl+serial://{com_port('tmcl')}#1"
    assert wine("get", tmcl, "max current").stdout == "max current = 10 A\n"
    wine("spin", tmcl, "300rpm", "--for", "500ms")
    # A pseudo-terminal has no baud rate, which the program cannot know here.
    tml = f"tml+serial://{com_port('tml')}?timing=off#1"
    assert "Technosoft" in wine("info", tml).stdout
    moved = wine("move", tml, "90deg", "--timeout", "60s").stdout
    assert moved.endswith(" turn\n") and abs(float(moved.split()[2]) - 0.25) < 0.01, moved


def test_a_missing_port_is_reported_with_those_that_exist(wine):
    done = wine("info", "tmcl+serial://COM99#1", check=False)
    assert done.returncode == 3, done.stderr
    assert "error[E311]" in done.stderr and "Ports that exist: COM" in done.stderr, done.stderr


def test_a_drive_that_goes_away_ends_a_motion(wine, folder, served):
    process, url = start("tmcl", "--tcp", "127.0.0.1:0")
    spin = subprocess.Popen(
        ["wine", "polepair.exe", "spin", url, "300rpm"], cwd=folder, env=ENVIRONMENT,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )
    # One client at a time: its own words say that the motor turns.
    for line in spin.stderr:
        if "running; Ctrl-C stops it" in line:
            break
    process.kill()
    process.wait()
    error = spin.stderr.read()
    assert spin.wait(timeout=120) == 3, error
    assert "The motor may still turn: cut its supply." in error, error


def test_the_driver_of_a_port_is_listed(wine, com_port):
    """Drives with a USB connector have `usbser`: it has no baud rate."""
    port = com_port("tml")
    entry = [r"HKLM\HARDWARE\DEVICEMAP\SERIALCOMM", "/v", r"\Device\USBSER007", "/f"]

    def reg(verb, *words):
        quiet = {"capture_output": True, "check": False, "timeout": 120}
        return subprocess.run(["wine", "reg", verb, *entry, *words], env=ENVIRONMENT, **quiet).returncode

    reg("delete")
    assert "usbser" not in wine("ports").stdout
    assert reg("add", "/d", port) == 0
    lines = wine("ports").stdout.splitlines()
    assert any(line.startswith(f"{port} ") and "usbser" in line for line in lines), lines
    assert reg("delete") == 0


@pytest.mark.parametrize("event", ["ctrl-c", "ctrl-break", "close", "logoff"])
def test_every_signal_of_the_console_stops_the_motor(folder, served, event):
    url = served("tmcl", "--tcp", "127.0.0.1:0")
    spin = subprocess.Popen(
        ["wine", "console.exe", event, f"polepair.exe spin {url} 300rpm"], cwd=folder,
        env=ENVIRONMENT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    for line in spin.stderr:
        if "running; Ctrl-C stops it" in line:
            break
    out, error = spin.communicate("\n", timeout=120)
    assert "ended with 130 " in out, out + error
    assert "interrupted: the motion was stopped" in error, error
    wait_until("the motor stands still", lambda: speed(url), lambda now: now < 2)


def test_a_simulation_serves_this_machine(folder):
    sim = subprocess.Popen(
        ["wine", "polepair.exe", "sim", "tmcl"], cwd=folder, env=ENVIRONMENT, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )
    url = sim.stdout.readline().split()[1]
    assert url.startswith("tmcl+tcp://127.0.0.1:"), url
    assert polepair("get", url, "max current").stdout == "max current = 10 A\n"
    polepair("move", url, "90deg", "--timeout", "60s")
    sim.terminate()
    sim.wait(timeout=120)


def test_captures_are_decoded(wine, folder):
    (folder / "bus.log").write_text(CAPTURE)
    assert "123" in wine("decode", "bus.log").stdout


def test_the_server_answers_a_client_of_this_machine(folder):
    server = subprocess.Popen(
        ["wine", "polepair.exe", "serve", "sim:tmcl", "--bind", "127.0.0.1:0", "--state", "state"],
        cwd=folder, env=ENVIRONMENT, text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    url = server.stdout.readline().split()[1].split("?")[0]
    token = next(
        line.split()[0] for line in (folder / "state" / "tokens").read_text().splitlines()
        if line and not line.startswith("#")
    )
    request = urllib.request.Request(
        f"{url.rstrip('/')}/api/v1/bench", headers={"Authorization": f"Bearer {token}"}
    )
    with urllib.request.urlopen(request, timeout=120) as reply:
        assert b"tmcm-171" in reply.read()
    server.terminate()
    server.wait(timeout=120)


def test_programs_in_c_print_what_those_of_rust_print(folder):
    """The library for Windows, called by programs that mingw-w64 has built."""
    shutil.copy(PROGRAM.parent / "polepair_ffi.dll", folder)
    for line in (ROOT / "examples" / "expected.txt").read_text().splitlines():
        name, parts = line.split(": ", 1)
        subprocess.run(
            ["x86_64-w64-mingw32-gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-I",
             ROOT / "crates" / "ffi" / "include", ROOT / "examples" / "c" / f"{name}.c",
             "-o", folder / f"{name}.exe", folder / "polepair_ffi.dll"], check=True, timeout=120,
        )
        done = subprocess.run(
            ["wine", f"{name}.exe"], cwd=folder, env=ENVIRONMENT, stdin=subprocess.DEVNULL, capture_output=True,
            text=True, timeout=120, check=False,
        )
        assert done.returncode == 0, f"{name}: {done.stdout}{done.stderr}"
        at = 0
        for part in parts.split(" | "):
            at = done.stdout.find(part, at)
            assert at >= 0, f"{name} does not print {part}: {done.stdout}"


TML_PROGRAM = """
import ctypes, sys
tml = ctypes.WinDLL("./TML_lib.dll")
tml.TS_GetLastErrorText.restype = ctypes.c_char_p
number = ctypes.c_double

def check(done):
    assert done, tml.TS_GetLastErrorText()

check(tml.TS_OpenChannel(sys.argv[1].encode(), 0, 1, 115200) >= 0)
check(tml.TS_SetupAxis(1, tml.TS_LoadSetup(b"setup.t.zip")))
check(tml.TS_SelectAxis(1))
check(tml.TS_DriveInitialisation())
check(tml.TS_Power(1))
status = ctypes.c_uint16()
while not status.value & 1 << 15:
    check(tml.TS_ReadStatus(3, ctypes.byref(status)))
check(tml.TS_MoveRelative(-2000, number(20), number(0.5), 0, 1, 1))
check(tml.TS_SetEventOnMotionComplete(1, 0))
position = ctypes.c_long()
check(tml.TS_GetLongVariable(b"TPOS", ctypes.byref(position)))
check(tml.TS_Stop() and tml.TS_Power(0))
tml.TS_CloseChannel(-1)
print("at", position.value)
"""


def test_programs_for_tml_lib_move_a_motor(python, folder, com_port):
    """TML_lib.dll, called by ctypes of a Python for Windows as programs call the vendor's."""
    shutil.copy(PROGRAM.parent / "TML_lib.dll", folder)
    polepair("params", "technosoft-f514l", "--write-setup", str(folder / "setup.t.zip"))
    (folder / "tml.py").write_text(TML_PROGRAM)
    device = f"tml+serial://{com_port('tml:1')}:115200?timing=off&through=1"
    done = subprocess.run(
        python("tml.py", device), cwd=folder, env=ENVIRONMENT, input="", capture_output=True, text=True, timeout=180,
        check=False,
    )
    assert done.stdout.strip() == "at -2000", done.stdout + done.stderr


HOLD = """
import sys, time, polepair
with polepair.connect(sys.argv[1]) as link:
    axis = link.axes[0]
    with axis.armed():
        axis.spin("300 rpm")
        print("running", flush=True)
        while True:
            time.sleep(0.1)
"""


def test_the_python_package_turns_a_motor(python, folder, served, com_port):
    shutil.copy(ROOT / "examples" / "python" / "spin.py", folder)
    serial = f"tmcl+serial://{com_port('tmcl')}#1"
    for url in [served("tmcl", "--tcp", "127.0.0.1:0"), serial, "sim:tmcl"]:
        done = subprocess.run(
            python("spin.py", url, "120 rpm", "0.5"), cwd=folder, env=python.environment, input="", capture_output=True,
            text=True, timeout=120, check=False,
        )
        assert done.returncode == 0 and "120.0 rpm" in done.stdout, done.stdout + done.stderr
    version = subprocess.run(
        python("-m", "polepair", "--version"), cwd=folder, env=python.environment, input="",
        capture_output=True, text=True, timeout=120, check=False,
    )
    assert version.stdout.startswith("polepair "), version.stderr


@pytest.mark.parametrize("event", ["ctrl-c", "ctrl-break", "close", "logoff"])
def test_every_signal_of_the_console_stops_the_motor_of_a_python_program(python, folder, served, event):
    url = served("tmcl", "--tcp", "127.0.0.1:0")
    (folder / "hold.py").write_text(HOLD)
    program = subprocess.list2cmdline(python("hold.py", url)[1:])
    hold = subprocess.Popen(
        ["wine", "console.exe", event, program], cwd=folder, env=python.environment, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )
    try:
        assert hold.stdout.readline() == "running\n"
        out, error = hold.communicate("\n", timeout=120)
    finally:
        hold.kill()
    assert "ended with " in out, out + error
    assert ("KeyboardInterrupt" in error) == (event == "ctrl-c"), error
    wait_until("the motor stands still", lambda: speed(url), lambda now: now < 2)
