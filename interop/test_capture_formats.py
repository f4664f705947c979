"""Recordings of ours and captures of ours with everything a bus can have, CAN FD, remote requests of
every length and error frames, read by other programs, and theirs by us, frame for frame."""

import random
import re
import signal
import socket
import subprocess

import can
import pytest
from conftest import POLEPAIR, need
from polepair_test_support import MAX_WAIT, wait_until

GROUP = "239.74.163.2"
BEGIN = 1_700_000_000
# Without data, python-can takes an ASC line for a remote request.
FD_LENGTHS = [1, 7, 8, 12, 16, 20, 24, 32, 48, 64]


def lines(count=300, kinds=("data", "remote", "fd", "error")):
    """A log as can-utils writes it, with stamps to the nanosecond."""
    dice = random.Random(11)
    for n in range(count):
        extended = n % 3 == 0
        number = dice.randrange(1 << 29) if extended else dice.randrange(1 << 11)
        name = f"{number:08X}" if extended else f"{number:03X}"
        kind = kinds[n % len(kinds)]
        length = n // 7 % 9
        if kind == "data":
            frame = f"{name}#{dice.randbytes(length).hex().upper()}"
        elif kind == "remote":
            frame = f"{name}#R{length or ''}"
        elif kind == "fd":
            data = dice.randbytes(dice.choice(FD_LENGTHS)).hex().upper()
            frame = f"{name}##{dice.choice('013')}{data}"
        else:
            frame = "20000084#0004000000000000"
        yield f"({BEGIN}.{n * 1_000_037:09d}) can0 {frame}"


def run(*words, stdin=None):
    done = subprocess.run([POLEPAIR, *words], capture_output=True, timeout=MAX_WAIT, check=False,
                          input=stdin)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


def frames(text):
    """Frames of a log without time, link and direction."""
    return [line.split()[2].upper() for line in text.splitlines()]


def stamps(text):
    """Times of a log with all nine digits."""
    times = [line[1:].split(")")[0].split(".") for line in text]
    return [f"{seconds}.{part:0<9}" for seconds, part in times]


def written(path, text):
    path.write_text("\n".join(text) + "\n")
    return path


# Kinds of frames that each format can store: TRC of python-can has no error frames, CSV no CAN FD.
PYTHON_CAN = {
    "log": ("data", "remote", "fd"),
    "asc": ("data", "remote", "fd"),
    "blf": ("data", "remote", "fd"),
    "trc": ("data",),
    "csv": ("data", "remote"),
}


def said(message):
    name = f"{message.arbitration_id:0{8 if message.is_extended_id else 3}X}"
    if message.is_error_frame:
        return "error"
    if message.is_remote_frame:
        return f"{name}#R{message.dlc or ''}"
    data = bytes(message.data).hex().upper()
    if message.is_fd:
        flags = int(message.bitrate_switch) | int(message.error_state_indicator) << 1
        return f"{name}##{flags}{data}"
    return f"{name}#{data}"


@pytest.mark.parametrize("kind", PYTHON_CAN)
def test_python_can_reads_all_that_a_form_holds(kind, tmp_path):
    source = written(tmp_path / "source.log", lines(kinds=PYTHON_CAN[kind]))
    path = tmp_path / f"bus.{kind}"
    run("convert", str(source), str(path))
    with can.LogReader(str(path)) as reader:
        found = [said(message) for message in reader]
    assert found == frames(source.read_text())


@pytest.mark.parametrize("kind", PYTHON_CAN)
def test_we_read_all_that_python_can_writes(kind, tmp_path):
    source = written(tmp_path / "source.log", lines(kinds=PYTHON_CAN[kind]))
    # python-can's log reader forgets the length of remote requests; its reader of our BLF does not.
    exact, path = tmp_path / "source.blf", tmp_path / f"bus.{kind}"
    run("convert", str(source), str(exact))
    with can.LogReader(str(exact)) as reader, can.Logger(str(path)) as logger:
        for message in reader:
            logger(message)
    expected = frames(source.read_text())
    if kind == "log":
        expected = [re.sub(r"#R\d", "#R", frame) for frame in expected]
    assert frames(run("convert", str(path), "-", "--to", "log")) == expected


@pytest.mark.parametrize("kind", ["asc", "blf", "csv", "log"])
def test_error_frames_pass_both_ways(kind, tmp_path):
    source = written(tmp_path / "source.log", lines(kinds=("data", "error")))
    path, again = tmp_path / f"bus.{kind}", tmp_path / f"again.{kind}"
    run("convert", str(source), str(path))
    with can.LogReader(str(path)) as reader, can.Logger(str(again)) as logger:
        found = list(reader)
        for message in found:
            logger(message)
    assert [message.is_error_frame for message in found] == [n % 2 == 1 for n in range(len(found))]
    back = frames(run("convert", str(again), "-", "--to", "log"))
    assert [frame.startswith("2000") for frame in back] == [n % 2 == 1 for n in range(len(found))]


@pytest.mark.parametrize("end", ["pcap", "pcapng"])
def test_tshark_and_editcap_agree_to_the_nanosecond(end, tmp_path):
    need("tshark")
    need("editcap")
    source = written(tmp_path / "source.log", lines())
    path = tmp_path / f"bus.{end}"
    run("convert", str(source), str(path))
    words = ["-T", "fields", "-e", "frame.time_epoch", "-e", "can.id", "-e", "can.len",
             "-e", "can.flags.rtr", "-e", "can.flags.err", "-e", "canfd.flags.brs"]
    shown = subprocess.run(["tshark", "-r", str(path), *words], capture_output=True, check=True,
                           timeout=MAX_WAIT).stdout.decode()
    rows = [line.split("\t") for line in shown.splitlines()]
    expected = source.read_text().splitlines()
    assert [row[0] for row in rows] == stamps(expected)
    for row, line in zip(rows, expected):
        name, rest = line.split()[2].split("#", 1)
        if not name.startswith("2000"):
            assert int(row[1], 0) == int(name, 16), line
        assert row[3] in ("", "0", "False") or rest.startswith("R"), (row, line)
        if rest.startswith("R"):
            assert int(row[2]) == int(rest[1:] or 0), (row, line)
    # A file that Wireshark's own tool converted is read as the original.
    for form in ["pcapng", "nsecpcap"]:
        theirs = tmp_path / f"theirs.{form}"
        subprocess.run(["editcap", "-F", form, str(path), str(theirs)], check=True, timeout=MAX_WAIT)
        back = run("convert", str(theirs), "-", "--to", "log").splitlines()
        assert frames("\n".join(back)) == frames("\n".join(expected))
        assert stamps(back) == stamps(expected)


@pytest.mark.parametrize("kinds", [("data",), ("data", "remote"), ("fd",)])
def test_can_utils_read_what_we_write_and_we_what_they_write(kinds, tmp_path):
    """canplayer needs a socket of the kernel; log2asc and asc2log share its reader of logs."""
    need("log2asc")
    source = written(tmp_path / "source.log", lines(kinds=kinds))
    ours = tmp_path / "ours.log"
    run("convert", str(source), str(ours))
    theirs = tmp_path / "theirs.asc"
    with theirs.open("wb") as out:
        subprocess.run(["log2asc", "-I", str(ours), "can0"], stdout=out, check=True, timeout=MAX_WAIT)
    expected = frames(source.read_text())
    assert frames(run("convert", str(theirs), "-", "--to", "log")) == expected
    mine = tmp_path / "ours.asc"
    run("convert", str(source), str(mine))
    back = subprocess.run(["asc2log", "-I", str(mine)], capture_output=True, check=True,
                          timeout=MAX_WAIT).stdout.decode()
    assert frames(back) == expected


def test_a_recording_of_ours_is_read_by_the_others(tmp_path):
    """python-can sends, `polepair record` keeps, in every form; remote requests and all."""
    need("tshark")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    forms = ["log", "asc", "blf", "csv", "pcapng"]
    paths = {form: tmp_path / f"bus.{form}" for form in forms}
    recorders = []
    for path in paths.values():
        words = [POLEPAIR, "record", f"canopen+udp://{GROUP}:{port}", "-o", str(path)]
        recorder = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        assert recorder.stderr.readline().startswith("recording to")
        recorders.append(recorder)
    source = written(tmp_path / "source.log", lines(count=100, kinds=("data", "remote")))
    exact = tmp_path / "source.blf"
    run("convert", str(source), str(exact))
    with can.Bus(interface="udp_multicast", channel=GROUP, port=port) as bus:
        with can.LogReader(str(exact)) as reader:
            for message in reader:
                bus.send(message)
    wait_until("100 frames are in the file", lambda: paths["log"].read_text().count("\n"), lambda count: count == 100)
    for recorder in recorders:
        recorder.send_signal(signal.SIGINT)
        assert " 0 dropped" in recorder.communicate(timeout=MAX_WAIT)[1]
    expected = frames(source.read_text())
    for form, path in paths.items():
        assert frames(run("convert", str(path), "-", "--to", "log")) == expected
        if form in ("asc", "blf", "csv"):
            with can.LogReader(str(path)) as reader:
                assert [said(message) for message in reader] == expected, form
    shown = subprocess.run(["tshark", "-r", str(paths["pcapng"])], capture_output=True, check=True,
                           timeout=MAX_WAIT)
    assert len(shown.stdout.splitlines()) == 100
