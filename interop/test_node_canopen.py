"""npm's CANopen stack from both ends: it reads and writes our node, and our host its node."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import BUILD, end, need, polepair, start
from polepair_test_support import MAX_WAIT
from test_can_links import GROUP, free_port, gateway, socket  # noqa: F401

HERE = Path(__file__).resolve().parent
PACKAGE = "canopen@6.2.1"
NODE = 5


@pytest.fixture(scope="module")
def program():
    """The words that start the client or the node."""
    need("node")
    need("npm")
    folder = BUILD / "npm"
    if not (folder / "node_modules" / "canopen").exists():
        folder.mkdir(parents=True, exist_ok=True)
        # Without its addons, which want compilers.
        words = ["npm", "install", "--prefix", str(folder), "--ignore-scripts", "--omit=optional"]
        done = subprocess.run(
            [*words, "--no-audit", "--no-fund", PACKAGE], capture_output=True, text=True, timeout=300
        )
        if done.returncode:
            pytest.skip(f"npm cannot install {PACKAGE}: {done.stderr.strip()[-200:]}")
    environment = {**os.environ, "NODE_PATH": str(folder / "node_modules")}
    return [shutil.which("node"), str(HERE / "node_canopen.js")], environment


def test_it_reads_and_writes_our_node(program):
    words, environment = program
    sheet = str(HERE / "sheets" / "motor.eds")
    process, url = start(f"canopen:{NODE}", "--eds", sheet, "--socketcand", "127.0.0.1:0")
    try:
        host, port = url.split("://")[1].split("/")[0].rsplit(":", 1)
        done = subprocess.run(
            [*words, "client", host, port, str(NODE)],
            capture_output=True,
            text=True,
            timeout=2 * MAX_WAIT,
            env=environment,
        )
        assert done.returncode == 0, done.stderr
        did = json.loads(done.stdout)
    finally:
        end(process)
    assert (did["trim"], did["trimmed"], did["place"]) == (-5, 9, "hall 7, left"), did
    assert did["segments"] and did["blocks"], did
    assert did["refusals"] == [0x06020000, 0x06010001, 0x06090031], did


def test_our_host_reads_and_writes_its_node(program, gateway):  # noqa: F811
    words, environment = program
    sheet = HERE / "sheets" / "inputs.eds"
    server, _ = gateway("socketcand-listen:0/can0", f"udp:{GROUP}:{free_port(socket.SOCK_DGRAM)}")
    host, port = server.rsplit(":", 1)
    node = subprocess.Popen(
        [*words, "server", host, port, str(NODE), str(sheet)],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    try:
        assert node.stdout.readline() == "ready\n"
        url = f"canopen+socketcand://{server}/can0?timeout=5000&eds={sheet}#{NODE}"
        assert "Terminal 8" in polepair("info", url).stdout
        assert polepair("get", url, "6000h:1", "--raw").stdout.split()[-1] == "129"
        polepair("set", url, "6200h:2=90", "--arm")
        assert polepair("get", url, "6200h:2", "--raw").stdout.split()[-1] == "90"
        plain = url.replace(f"&eds={sheet}", "")
        assert "2748" in polepair("get", plain, "vendor id", "--raw").stdout
    finally:
        node.terminate()
        node.wait(MAX_WAIT)


def test_our_lss_master_gives_its_device_a_node_id(program, gateway):  # noqa: F811
    """The library replies to no 4Ch, no selection and no inquiry of its node-ID; to inquiries of its
    identity it sends the lowest bytes alone."""
    words, environment = program
    server, _ = gateway("socketcand-listen:0/can0", f"udp:{GROUP}:{free_port(socket.SOCK_DGRAM)}")
    host, port = server.rsplit(":", 1)
    device = subprocess.Popen(
        [*words, "lss", host, port, "0"], stdout=subprocess.PIPE, text=True, env=environment
    )
    identity = {"vendor": 0x22, "product": 0x33, "revision": 0x44, "serial": 0x55}
    url = f"canopen+socketcand://{server}/can0?timeout=1000"

    def lss(*words, check=True):
        return polepair("lss", url, *words, silence=True, check=check)

    try:
        assert device.stdout.readline() == "ready\n"
        # Each of the scan's 136 questions waits 50 ms, which a busy machine may need for a reply.
        for _ in range(20):
            found = lss("--format", "jsonl", check=False)
            devices = [json.loads(line) for line in found.stdout.splitlines()]
            if devices == [{"node": "none", **identity}]:
                break
        assert devices == [{"node": "none", **identity}], found.stderr
        numbers = ["--identity", "0x22,0x33,68,0x55", "--format", "jsonl"]
        assert json.loads(lss(*numbers).stdout) == {"node": None, **identity}
        assert json.loads(lss(*numbers, "--node", "9").stdout)["node"] == 9
        assert device.stdout.readline() == "9\n"
        refused = lss(*numbers, "--store", check=False)
        assert refused.returncode == 6 and "refused with error 1" in refused.stderr
    finally:
        device.terminate()
        device.wait(MAX_WAIT)
