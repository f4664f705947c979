"""Logs of other programs, read by their own readers and by `polepair convert`: the same frames,
identifiers, flags and times."""

import datetime
import io
import random
import subprocess

import can
import cantools.logreader
import pytest
from conftest import POLEPAIR
from polepair_test_support import MAX_WAIT

BEGIN = 1_700_000_000
# Half a unit of the last digit that the format has.
EXACT = 1e-6


def messages(kinds, count=120):
    """Messages of all kinds in turn, a millisecond and some microseconds apart."""
    dice = random.Random(42)
    for n in range(count):
        extended = n % 3 == 0
        kind = kinds[n % len(kinds)]
        length = dice.choice([1, 12, 24, 64]) if kind == "fd" else n // 5 % 9
        yield can.Message(
            timestamp=BEGIN + round(n * 0.001_037, 6),
            arbitration_id=dice.randrange(1 << (29 if extended else 11)),
            is_extended_id=extended,
            is_remote_frame=kind == "remote",
            is_fd=kind == "fd",
            bitrate_switch=kind == "fd" and n % 2 == 0,
            dlc=length,
            data=b"" if kind == "remote" else dice.randbytes(length),
            is_rx=n % 4 != 0,
            channel="can0",
        )


def facts(message):
    """Identity of a frame without its time."""
    data = bytes(message.data) if not message.is_remote_frame else b""
    return (message.arbitration_id, message.is_extended_id, message.is_remote_frame,
            message.is_fd and message.bitrate_switch, message.dlc, data)


def ours(path, *words):
    """The frames that Polepair reads from a file, through the log format of can-utils."""
    done = subprocess.run([POLEPAIR, "convert", str(path), "-", "--to", "log", *words],
                          capture_output=True, timeout=MAX_WAIT, check=False)
    assert done.returncode == 0, done.stderr.decode()
    found = []
    for line in done.stdout.decode().splitlines():
        *time, _, frame = [word for word in line.split() if word not in ("R", "T")]
        name, data = frame.split("#", 1)
        fd = data.startswith("#")
        remote = data.startswith("R")
        octets = b"" if remote else bytes.fromhex(data[2:] if fd else data)
        length = int(data[1:] or 0) if remote else len(octets)
        found.append((float(time[0].strip("()")) if time else None, (int(name, 16), len(name) == 8, remote,
                                                fd and int(data[1], 16) & 1 == 1, length, octets)))
    return found


def compared(found, expected, tolerance):
    assert [frame for _, frame in found] == [frame for _, frame in expected]
    for (time, frame), (other, _) in zip(found, expected):
        assert time == other or abs(time - other) <= tolerance, (time, other, frame)


def since_first(frames):
    first = frames[0][0]
    return [(time - first, frame) for time, frame in frames]


# The formats, what each has room for, and the precision of its times in seconds.
PYTHON_CAN = {
    "asc": (("data", "remote", "fd"), EXACT),
    "blf": (("data", "remote", "fd"), EXACT),
    "csv": (("data", "remote"), EXACT),
    "db": (("data", "remote"), EXACT),
    "log": (("data", "fd"), EXACT),
    "trc": (("data",), 1e-4),
}


@pytest.mark.parametrize("end", PYTHON_CAN)
def test_python_cans_files_mean_what_its_readers_say(end, tmp_path):
    kinds, tolerance = PYTHON_CAN[end]
    path = tmp_path / f"bus.{end}"
    with can.Logger(str(path)) as logger:
        for message in messages(kinds):
            logger(message)
    with can.LogReader(str(path)) as reader:
        expected = [(message.timestamp, facts(message)) for message in reader]
    assert len(expected) == 120
    found = ours(path)
    # python-can's reader of ASC ignores the date.
    compared(since_first(found) if end == "asc" else found, expected, tolerance)


def test_python_cans_printed_messages(tmp_path):
    """It has no reader of them: the messages themselves are compared."""
    path = tmp_path / "printed.txt"
    sent = list(messages(("data", "remote")))
    with can.Printer(str(path)) as printer:
        for message in sent:
            printer(message)
    compared(ours(path), [(message.timestamp, facts(message)) for message in sent], EXACT)


def candump(message, time):
    data = "remote request" if message.is_remote_frame else message.data.hex(" ").upper()
    name = f"{message.arbitration_id:0{8 if message.is_extended_id else 3}X}"
    return f" {time} can0  {name}   [{message.dlc}]  {data}"


def stamped(message):
    return datetime.datetime.fromtimestamp(message.timestamp, datetime.timezone.utc)


def trace(version):
    """PEAK's trace files, by their published description."""
    def line(n, message):
        ms = (message.timestamp - BEGIN) * 1000
        name = f"{message.arbitration_id:0{8 if message.is_extended_id else 4}X}"
        data = message.data.hex(" ").upper()
        return {
            "1.0": f"{n:6}) {ms:11.0f} {name:>8}  {message.dlc}  {data} ",
            "1.1": f"{n:6}) {ms:11.1f}  Rx    {name:>8}  {message.dlc}    {data} ",
            "1.2": f"{n:6}) {ms:11.3f} 1  Rx    {name:>8}  {message.dlc}    {data} ",
            "1.3": f"{n:6}) {ms:11.3f} 1  Rx    {name:>8} -  {message.dlc}    {data} ",
            "2.0": f"{n:7} {ms:13.3f} DT {name:>8} Rx {message.dlc}  {data} ",
            "2.1": f"{n:7} {ms:13.3f} DT 1 {name:>8} Rx -  {message.dlc}    {data} ",
        }[version]

    return line


# A form, how its lines look, its header, and the precision of its times in seconds.
LOGS = {
    "candump": (lambda _, m: candump(m, ""), "", 0),
    "candump -ta": (lambda _, m: candump(m, f"({m.timestamp:.6f}) "), "", EXACT),
    "candump -tz": (lambda _, m: candump(m, f"({m.timestamp - BEGIN:010.6f}) "), "", EXACT),
    "candump -tA": (lambda _, m: candump(m, f"({stamped(m):%Y-%m-%d %H:%M:%S.%f}) "), "", EXACT),
    "candump -ta -a": (lambda _, m: candump(m, f"({m.timestamp:.6f}) ") + "   '........'", "", EXACT),
    "TRC 1.0": (trace("1.0"), "", EXACT),
    "TRC 1.1": (trace("1.1"), ";$FILEVERSION=1.1\n;$STARTTIME=0\n", EXACT),
    "TRC 1.2": (trace("1.2"), ";$FILEVERSION=1.2\n;$STARTTIME=0\n", EXACT),
    "TRC 1.3": (trace("1.3"), ";$FILEVERSION=1.3\n;$STARTTIME=0\n", EXACT),
    "TRC 2.0": (trace("2.0"), ";$FILEVERSION=2.0\n;$STARTTIME=0\n;$COLUMNS=N,O,T,I,d,l,D\n", EXACT),
    "TRC 2.1": (trace("2.1"), ";$FILEVERSION=2.1\n;$STARTTIME=0\n;$COLUMNS=N,O,T,B,I,d,R,l,D\n", EXACT),
}


@pytest.mark.parametrize("form", LOGS)
def test_cantools_reads_the_same_frames(form, tmp_path):
    line, header, tolerance = LOGS[form]
    kinds = ("data",) if form.startswith("TRC") else ("data", "remote")
    text = header + "".join(f"{line(n, m)}\n" for n, m in enumerate(messages(kinds), 1))
    path = tmp_path / "bus.log"
    path.write_text(text)
    expected = []
    for frame in cantools.logreader.Parser(io.StringIO(text), tz=datetime.timezone.utc):
        time = frame.timestamp
        if isinstance(time, datetime.datetime):
            time = time.replace(tzinfo=datetime.timezone.utc).timestamp()
        elif isinstance(time, datetime.timedelta):
            time = time.total_seconds()
        expected.append((time, (frame.frame_id, frame.is_extended_frame, frame.is_remote_frame,
                                False, len(frame.data), frame.data)))
    assert len(expected) == 120
    # cantools does not read the length of remote requests.
    found = [(time, (*frame[:4], 0 if frame[2] else frame[4], frame[5])) for time, frame in ours(path)]
    if form.startswith("TRC"):
        found, expected = since_first(found), since_first(expected)
    compared(found, expected, tolerance)
