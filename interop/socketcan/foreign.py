"""Run in the guest by test_socketcan.py: programs and drivers of others on our CAN links."""

import os
import select
import subprocess
import sys
import threading
import time
import tty
from contextlib import contextmanager

from checks import Candump, check, run, run_all
from polepair_test_support import MAX_WAIT, wait_until

GATEWAY, POLEPAIR = sys.argv[1:3]


@contextmanager
def gateway(one, other):
    """Joins two of our links. Returns a list that holds the gateway's output once it has ended."""
    process = subprocess.Popen(
        [GATEWAY, one, other],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    told = [process.stdout.readline(), process.stdout.readline()]
    try:
        assert all(line.startswith("ready ") for line in told), told
        yield told
    finally:
        told.append(process.communicate(timeout=MAX_WAIT)[0])


def quietly(*words):
    """Starts a daemon, whose talk would only be in the way."""
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


FRAMES = ["123#DEADBEEF", "7FF#", "1F334455#1122334455667788", "00000001#00", "123#R4"]


@check
def candump_and_cansend_see_the_same_frames():
    with gateway("socketcan:vcan0", "socketcan:vcan1"):
        crossed("vcan0", "vcan1")


@check
def python_can_sees_the_same_frames():
    import can

    with gateway("socketcan:vcan0", "socketcan:vcan1") as told:
        one = can.Bus(interface="socketcan", channel="vcan0")
        other = can.Bus(interface="socketcan", channel="vcan1")
        for sender, receiver in [(one, other), (other, one)]:
            for n in range(20):
                extended = bool(n % 2)
                data = bytes(range(n % 9))
                sender.send(can.Message(arbitration_id=n, data=data, is_extended_id=extended))
                got = receiver.recv(MAX_WAIT)
                assert (got.arbitration_id, got.is_extended_id, got.data) == (n, extended, data)
        for class_bits in (0x40, 0x100):
            one.send(can.Message(arbitration_id=class_bits, is_error_frame=True, data=bytes(8)))
        assert other.recv(0.3) is None, "an error frame is none of the bus"
        one.shutdown()
        other.shutdown()
    assert "vcan0: BusOff" in told[-1] and "vcan0: Up" in told[-1], told


@check
def candump_sees_a_simulated_drive_asked_and_answering():
    """TMCL on CAN: the module has identifier 1, the host 2."""
    drive = subprocess.Popen(
        [POLEPAIR, "sim", "tmcl+can:1", "--can", "vcan0"], stdout=subprocess.PIPE, text=True
    )
    try:
        url = drive.stdout.readline().split()[1]
        with Candump("vcan0") as log:
            run("cansend", "vcan0", "001#06060000000000")
            asked, answered = log.heard(1)
            assert asked == "vcan0 001#06060000000000", asked
            assert answered.startswith("vcan0 002#016406"), answered
            told = run(POLEPAIR, "get", url, "max current", "--raw")
            value = int(answered[-8:], 16)
            assert value > 0 and str(value) in told, (value, told)
    finally:
        drive.terminate()
        drive.wait(MAX_WAIT)


@check
def the_kernels_slcan_driver_attaches_to_our_adapter():
    """With slcand's own way of setting the bit rate: `-s6` is S6."""
    with gateway("slcan-pty:/dev/adapter?500000", "socketcan:vcan0"):
        daemon = quietly("slcand", "-F", "-o", "-c", "-s6", "adapter", "slcan7")
        try:
            wait_until("the interface slcan7", lambda: os.path.exists("/sys/class/net/slcan7"))
            run("ip", "link", "set", "slcan7", "up")
            crossed("slcan7", "vcan0")
        finally:
            daemon.terminate()
            daemon.wait(MAX_WAIT)


@check
def a_bit_rate_is_read_and_compared():
    """With the driver's newer way: it opens the adapter when the interface is switched on."""
    with gateway("slcan-pty:/dev/adapter?500000", "socketcan:vcan0"):
        daemon = quietly("slcand", "-F", "adapter", "slcan8")
        try:
            wait_until("the interface slcan8", lambda: os.path.exists("/sys/class/net/slcan8"))
            off = refused("socketcan:slcan8?250000")
            assert "sudo ip link set slcan8 up type can bitrate 250000" in off, off
            run("ip", "link", "set", "slcan8", "up", "type", "can", "bitrate", "500000")
            wrong = refused("socketcan:slcan8?250000")
            assert "runs at 500000 bit/s, not at 250000" in wrong, wrong
            with gateway("socketcan:slcan8?500000", "socketcan:vcan1"):
                crossed("vcan0", "vcan1")
        finally:
            daemon.terminate()
            daemon.wait(MAX_WAIT)


@check
def our_client_attaches_to_slcanpty():
    """can-utils' adapter, at the other end of a pair of pseudo-terminals."""
    ends = [os.openpty() for _ in range(2)]
    for _, slave in ends:
        tty.setraw(slave)
    foreign, ours = (os.ttyname(slave) for _, slave in ends)
    threading.Thread(target=join, args=[master for master, _ in ends], daemon=True).start()
    daemon = quietly("slcanpty", foreign, "vcan0")
    try:
        time.sleep(0.3)
        with gateway(f"slcan:{ours}?500000", "socketcan:vcan1"):
            # It loses the length of remote frames.
            crossed("vcan0", "vcan1", [frame for frame in FRAMES if "R" not in frame])
    finally:
        daemon.kill()
        daemon.wait()


def join(one, other):
    while True:
        for ready in select.select([one, other], [], [])[0]:
            os.write(other if ready == one else one, os.read(ready, 4096))


def crossed(one, other, frames=FRAMES):
    """Whatever is sent on one bus is seen on both, once."""
    with Candump(one, other) as log:
        for frame in frames:
            run("cansend", one, frame)
            run("cansend", other, frame)
        got = log.heard(1)
        wanted = [f"{bus} {frame}" for bus in (one, other) for frame in frames for _ in range(2)]
        assert sorted(got) == sorted(wanted), got


def refused(link):
    """Why a link cannot be opened."""
    done = subprocess.run(
        [GATEWAY, link, "socketcan:vcan0"], capture_output=True, text=True, timeout=MAX_WAIT, check=False
    )
    assert done.returncode != 0, done.stdout
    return done.stderr


run_all()
