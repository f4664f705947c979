"""Capture files of python-can and can-utils read by us, ours by them."""

import gzip
import json
import random
import subprocess

import can
import pytest
from conftest import POLEPAIR, need

BEGIN = 1_700_000_000.25
KEEPS_DIRECTION = {"asc", "blf", "trc", "log"}


def messages(count=400):
    """Classic frames of every length, both kinds of identifier, remote requests."""
    dice = random.Random(7)
    for n in range(count):
        extended = n % 3 == 0
        remote = n % 11 == 5
        length = n % 9
        yield can.Message(
            timestamp=BEGIN + n * 0.001,
            arbitration_id=dice.randrange(1 << 29) if extended else dice.randrange(1 << 11),
            is_extended_id=extended,
            is_remote_frame=remote,
            dlc=length,
            data=None if remote else dice.randbytes(length),
            is_rx=n % 2 == 0,
            channel=0,
        )


def known(kind):
    """The messages that python-can's writer of that format knows: TRC's leaves out requests."""
    return [message for message in messages() if kind != "trc" or not message.is_remote_frame]


def run(*words, **options):
    done = subprocess.run([POLEPAIR, *words], capture_output=True, timeout=120, **options)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


def identity(message):
    return (
        message.arbitration_id,
        message.is_extended_id,
        message.is_remote_frame,
        message.dlc,
        bytes(message.data),
    )


@pytest.mark.parametrize("kind", ["log", "asc", "blf", "trc", "csv"])
@pytest.mark.parametrize("packed", ["", ".gz"])
def test_python_can_writes_and_we_read(kind, packed, tmp_path):
    sent = known(kind)
    path = tmp_path / f"bus.{kind}"
    with can.Logger(str(path)) as logger:
        for message in sent:
            logger(message)
    if packed:
        path.with_suffix(f".{kind}.gz").write_bytes(gzip.compress(path.read_bytes()))
        path = path.with_suffix(f".{kind}.gz")
    printed = run("decode", str(path), "--as", "canopen", "--format", "jsonl")
    found = [json.loads(line) for line in printed.splitlines()]
    assert len(found) == len(sent)
    for message, frame in zip(sent, found):
        assert (frame["id"], frame["extended"]) == (message.arbitration_id, message.is_extended_id)
        assert bytes.fromhex(frame["bytes"]) == bytes(message.data)
    for message, frame in zip(sent, found):
        since = frame["time"] - found[0]["time"]
        assert abs(since - (message.timestamp - sent[0].timestamp)) < 1e-5


@pytest.mark.parametrize("kind", ["log", "asc", "blf", "trc", "csv"])
def test_we_write_and_python_can_reads(kind, tmp_path):
    sent = known(kind)
    # python-can's log forgets the length of a remote request; its BLF keeps everything.
    source, path = tmp_path / "source.blf", tmp_path / f"bus.{kind}"
    with can.Logger(str(source)) as logger:
        for message in sent:
            logger(message)
    run("convert", str(source), str(path))
    with can.LogReader(str(path)) as reader:
        found = list(reader)
    assert [identity(message) for message in found] == [identity(message) for message in sent]
    if kind in KEEPS_DIRECTION:
        assert [message.is_rx for message in found] == [message.is_rx for message in sent]


def test_formats_in_a_circle_keep_every_record(tmp_path):
    source = tmp_path / "bus.log"
    with can.Logger(str(source)) as logger:
        for message in messages():
            logger(message)
    last = source
    for end in ["pcapng", "blf.zst", "asc", "pcapng.gz", "log"]:
        path = tmp_path / f"circle.{end}"
        run("convert", str(last), str(path))
        last = path
    expected = source.read_text().upper().replace("CAN0", "can0")
    assert last.read_text().splitlines() == expected.splitlines()


def test_can_utils_read_and_write_as_we_do(tmp_path):
    need("log2asc")
    log = tmp_path / "bus.log"
    with can.Logger(str(log)) as logger:
        for message in messages():
            if not message.is_remote_frame:
                logger(message)
    theirs = tmp_path / "theirs.asc"
    with theirs.open("wb") as out:
        subprocess.run(["log2asc", "-I", str(log), "can0"], stdout=out, check=True, timeout=120)
    ours = tmp_path / "ours.asc"
    run("convert", str(log), str(ours))
    back = subprocess.run(["asc2log", "-I", str(ours)], capture_output=True, check=True, timeout=120)

    def frames(text):
        return [line.split()[2].upper() for line in text.splitlines()]

    expected = frames(log.read_text())
    assert frames(run("convert", str(theirs), "-", "--to", "log")) == expected
    assert frames(back.stdout.decode()) == expected


def test_tshark_reads_what_we_write(tmp_path):
    need("tshark")
    log = tmp_path / "bus.log"
    sent = [message for message in messages() if not message.is_remote_frame]
    with can.Logger(str(log)) as logger:
        for message in sent:
            logger(message)
    for end in ["pcap", "pcapng"]:
        path = tmp_path / f"bus.{end}"
        run("convert", str(log), str(path))
        words = ["-T", "fields", "-e", "can.id", "-e", "can.len", "-e", "frame.time_epoch"]
        shown = subprocess.run(
            ["tshark", "-r", str(path), *words], capture_output=True, check=True, timeout=120
        )
        rows = [line.split("\t") for line in shown.stdout.decode().splitlines()]
        assert [int(row[0], 0) for row in rows] == [message.arbitration_id for message in sent]
        assert [int(row[1]) for row in rows] == [message.dlc for message in sent]
        back = run("convert", str(path), "-", "--to", "log")
        assert len(back.splitlines()) == len(sent)
