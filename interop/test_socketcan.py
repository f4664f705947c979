"""Our links on the Linux kernel's CAN, in a guest where this machine's kernel has none."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import EXAMPLES, POLEPAIR, ROOT

HERE = Path(__file__).resolve().parent / "socketcan"
GATEWAY = EXAMPLES / "can_gateway"
SKIPPED = 77

CHECKS = [
    "candump_and_cansend_see_the_same_frames",
    "python_can_sees_the_same_frames",
    "candump_sees_a_simulated_drive_asked_and_answering",
    "the_kernels_slcan_driver_attaches_to_our_adapter",
    "a_bit_rate_is_read_and_compared",
    "our_client_attaches_to_slcanpty",
]

DRIVES = [
    "python_canopen_manages_a_node",
    "python_canopen_has_pdos_go_with_sync",
    "python_canopen_moves_and_turns_a_drive",
    "cansend_turns_the_ts_by_the_printed_speed_sequence",
    "cansend_moves_the_ts_by_the_printed_position_sequence",
    "cansend_turns_the_ts_by_torque_only_without_the_erratum",
    "cansend_homes_the_ts_by_the_printed_sequence",
    "candump_sees_the_printed_examples_answered",
    "our_host_drives_a_node_on_vcan",
    "cansend_runs_a_thruster",
    "our_search_finds_what_is_on_the_bus",
]


def guest(*words):
    """Runs a command in the guest, and returns its output."""
    done = subprocess.run(
        [HERE / "guest", *words], capture_output=True, text=True, timeout=400, check=False
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


@pytest.fixture(scope="module")
def drives():
    return guest(sys.executable, HERE / "drives.py", POLEPAIR)


@pytest.mark.parametrize("check", DRIVES)
def test_drives(drives, check):
    mine = [line for line in drives.stdout.splitlines() if check in line.split(":")[0]]
    assert mine == [f"ok {check}"], drives.stdout + drives.stderr


def test_no_check_is_forgotten(told, drives):
    for said, checks in [(told, CHECKS), (drives, DRIVES)]:
        ended = [line for line in said.stdout.splitlines() if line.startswith(("ok ", "failed "))]
        assert len(ended) == len(checks)


def test_the_links_own_checks():
    """`crates/link/tests/vcan.rs`, which has no vcan elsewhere."""
    words = ["cargo", "test", "--locked", "--workspace", "--test", "vcan", "--no-run"]
    built = subprocess.run(
        [*words, "--message-format=json"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    artifacts = [json.loads(line) for line in built.stdout.splitlines()]
    [program] = [a["executable"] for a in artifacts if a.get("target", {}).get("name") == "vcan"]
    done = guest("env", "POLEPAIR_VCAN=1", program, "--test-threads=1")
    assert done.returncode == 0 and " 0 failed" in done.stdout, done.stdout + done.stderr
