"""`polepair.fleet` on a Ray cluster of two nodes, and with an S3 server as source and target.

The data set is, bit for bit, the one that a single thread makes; also where a node is lost in the middle.
`POLEPAIR_FLEET_CAPTURES` is the number of captures (`make soak`).
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from moto.server import ThreadedMotoServer
from polepair import fleet
from polepair_test_support import wait_until
from ray.cluster_utils import Cluster

COUNT = int(os.environ.get("POLEPAIR_FLEET_CAPTURES", "40"))


def write_captures(folder: Path) -> None:
    """CANopen nodes and TMCL modules, each capture of its own length; some of a size with others."""
    for n in range(COUNT):
        begin = 1_700_000_000 + 43_200 * (n % 9)
        lines = []
        for at in range(400 + 13 * (n % (COUNT // 2))):
            time, node = begin + n + at / 200, 1 + n % 7
            lines.append(f"({time:.6f}) can{n % 2} {0x600 + node:03X}#4064600000000000")
            lines.append(f"({time + 0.0004:.6f}) can{n % 2} {0x580 + node:03X}#43646000{at & 255:02X}{n & 255:02X}0000")
            if at % 10 == 0:
                lines.append(f"({time + 0.0008:.6f}) can{n % 2} {0x700 + node:03X}#05")
        path = folder / f"machine-{n % 5}" / f"{n:04}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")


def digests(files: dict[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())}


def content(root: Path) -> dict[str, str]:
    files = (path for path in root.rglob("*") if path.is_file())
    return digests({path.relative_to(root).as_posix(): path.read_bytes() for path in files})


def rows(files: dict[str, str]) -> dict[str, str]:
    """Without the notes about files, whose versions differ between a folder and a bucket."""
    return {name: digest for name, digest in files.items() if not name.startswith("_captures/")}


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    write_captures(folder)
    return folder


@pytest.fixture(scope="module")
def single(captures: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The data set of a single thread."""
    root = tmp_path_factory.mktemp("single") / "dataset"
    report = fleet.decode(captures, root, workers=1)
    assert (report.decoded, report.failed, report.notes) == (COUNT, (), ())
    return content(root)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """A head that takes no tasks."""
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    try:
        yield cluster
    finally:
        import ray

        ray.shutdown()
        cluster.shutdown()


def test_a_cluster_that_loses_a_node_makes_the_same_data_set(
    captures: Path, single: dict[str, str], cluster: Cluster, tmp_path: Path
) -> None:
    import ray

    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    cluster.wait_for_nodes()
    ray.init(address=cluster.address, log_to_driver=False)
    assert ray.cluster_resources()["CPU"] == 2
    lost_at = []

    def lose(now: fleet.Progress) -> None:
        if not lost_at and 0 < now.captures < COUNT:
            cluster.remove_node(nodes[1], allow_graceful=False)
            lost_at.append(now.captures)

    root = tmp_path / "dataset"
    report = fleet.decode(captures, root, ray="auto", progress=lose)
    assert lost_at and report.failed == (), report
    wait_until(
        "the head and one other node are alive",
        lambda: [node["NodeID"] for node in ray.nodes() if node["Alive"]],
        lambda nodes: len(nodes) == 2,
        interval=0.2,
    )
    # A task may have stored captures before its node was lost; then they are there when it runs again.
    assert report.decoded + report.present == COUNT
    assert content(root) == single


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An S3 server, which programs find by their environment, and a bucket there."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    try:
        yield "plant"
    finally:
        server.stop()


def test_a_bucket_is_source_and_target(captures: Path, single: dict[str, str], bucket: str) -> None:
    import fsspec

    files = fsspec.filesystem("s3")
    files.mkdir(bucket)
    files.put(f"{captures}/", f"{bucket}/captures/", recursive=True)
    command = [sys.executable, "-m", "polepair", "fleet", "decode", f"s3://{bucket}/captures", f"s3://{bucket}/dataset"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.stdout == f"{COUNT} decoded, 0 were decoded earlier, 0 failed\n", done.stderr
    root = f"{bucket}/dataset"
    files.invalidate_cache()
    stored = {path[len(root) + 1 :]: files.cat_file(path) for path in files.find(root)}
    assert rows(digests(stored)) == rows(single)
    query = "select 'files: ' || count(distinct file) as files from frames"
    ask = [sys.executable, "-m", "polepair", "fleet", "sql", f"s3://{bucket}/dataset", query]
    asked = subprocess.run(ask, capture_output=True, text=True, check=False, timeout=300)
    assert f"files: {COUNT}" in asked.stdout, asked.stderr
    # Captures that are already decoded are not read again.
    files.put_file(str(captures / "machine-0" / "0000.log"), f"{bucket}/captures/copy.log")
    again = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert again.stdout == f"0 decoded, {COUNT + 1} were decoded earlier, 0 failed\n", again.stderr
