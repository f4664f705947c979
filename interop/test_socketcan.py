"""Our links on the Linux kernel's CAN, in a guest where this machine's kernel has none."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import POLEPAIR, ROOT

HERE = Path(__file__).resolve().parent / "socketcan"
GATEWAY = ROOT / "target" / "release" / "examples" / "can_gateway"
SKIPPED = 77

CHECKS = [
    "candump_and_cansend_see_the_same_frames",
    "python_can_sees_the_same_frames",
    "candump_sees_a_simulated_drive_asked_and_answering",
    "the_kernels_slcan_driver_attaches_to_our_adapter",
    "a_bit_rate_is_read_and_compared",
    "our_client_attaches_to_slcanpty",
]


def guest(*words):
    """What a command says in the guest."""
    done = subprocess.run(
        [HERE / "guest", *words], capture_output=True, text=True, timeout=180, check=False
    )
    if done.returncode == SKIPPED:
        pytest.skip(done.stderr.strip().splitlines()[-1])
    return done


@pytest.fixture(scope="module")
def told():
    return guest(sys.executable, HERE / "foreign.py", GATEWAY, POLEPAIR)


@pytest.mark.parametrize("check", CHECKS)
def test_foreign(told, check):
    mine = [line for line in told.stdout.splitlines() if check in line.split(":")[0]]
    assert mine == [f"ok {check}"], told.stdout + told.stderr


def test_no_check_is_forgotten(told):
    ended = [line for line in told.stdout.splitlines() if line.startswith(("ok ", "failed "))]
    assert len(ended) == len(CHECKS)


def test_the_links_own_checks():
    """`crates/link/tests/vcan.rs`, which has no vcan elsewhere."""
    words = ["cargo", "test", "--locked", "-p", "polepair-link", "--test", "vcan", "--no-run"]
    built = subprocess.run(
        [*words, "--message-format=json"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    artifacts = [json.loads(line) for line in built.stdout.splitlines()]
    [program] = [a["executable"] for a in artifacts if a.get("target", {}).get("name") == "vcan"]
    done = guest("env", "POLEPAIR_VCAN=1", program, "--test-threads=1")
    assert done.returncode == 0 and " 0 failed" in done.stdout, done.stdout + done.stderr
