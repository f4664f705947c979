"""Clients that public generators make of the gateway's description move a simulated axis."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
import threading
import time
import urllib.request
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import POLEPAIR
from openapi_spec_validator import validate
from polepair_test_support import first_line, wait_until


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """Address of a gateway with one simulated axis, and the token that may move it."""
    state = tmp_path_factory.mktemp("state")
    process = subprocess.Popen(
        [POLEPAIR, "serve", "sim:tmcl", "--bind", "127.0.0.1:0", "--state", state, "--log", "off"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    ready = first_line("the address of the gateway", process)
    address = ready.removeprefix("ready ").split("/?")[0].strip()
    token = next(line.split()[0] for line in (state / "tokens").read_text().splitlines() if " operator" in line)
    yield address, token
    process.terminate()
    process.wait(timeout=60)


@pytest.fixture(scope="module")
def description(gateway: tuple[str, str]) -> dict:
    address, token = gateway
    request = urllib.request.Request(f"{address}/api/v1/openapi.json", headers={"Authorization": f"Bearer {token}"})
    with urllib.request.urlopen(request) as answer:
        return json.load(answer)


def test_description_is_valid(description: dict) -> None:
    validate(description)
    for path, operations in description["paths"].items():
        for method, operation in operations.items():
            assert "security" in operation, (method, path)
            names = [parameter["name"] for parameter in operation.get("parameters", [])]
            assert ("X-Polepair" in names) == (method != "get"), (method, path)


@pytest.fixture(scope="module")
def generated(description: dict, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Name of the package that openapi-python-client makes."""
    folder = tmp_path_factory.mktemp("client")
    (folder / "openapi.json").write_text(json.dumps(description))
    name = "gateway_client"
    subprocess.run(
        [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"]
        + ["--path", folder / "openapi.json", "--output-path", folder / name],
        check=True,
    )
    sys.path.insert(0, str(folder))
    yield name
    sys.path.remove(str(folder))


def test_python_client_moves_an_axis(gateway: tuple[str, str], generated: str) -> None:
    def part(name: str):
        return importlib.import_module(f"{generated}.{name}")

    models, motion = part("models"), "api.motion"
    address, token = gateway
    client = part("client").AuthenticatedClient(base_url=address, token=token)
    began = time.monotonic()
    grant = part(f"{motion}.take").sync(0, client=client, body=models.AcquireLease())
    assert isinstance(grant, models.LeaseGrant), grant
    done = threading.Event()

    def renew() -> None:
        while not done.wait(0.3):
            part(f"{motion}.renew").sync(0, client=client, body=models.LeaseEpoch(epoch=grant.epoch))

    def command(verb: str, **arguments: float) -> None:
        request = models.CommandRequest(
            epoch=grant.epoch,
            id=str(uuid.uuid4()),
            issued_ms=grant.server_ms + (time.monotonic() - began) * 1000,
            verb=verb,
            arguments=models.CommandArguments(**arguments),
        )
        outcome = part(f"{motion}.command").sync(0, client=client, body=request)
        assert isinstance(outcome, models.CommandOutcome), outcome
        assert outcome.error is None, outcome

    def position() -> float | None:
        state = part("api.axis.axis").sync(0, client=client)
        return next((one.value for one in state.signals if one.signal == "position"), None)

    renewing = threading.Thread(target=renew)
    renewing.start()
    try:
        command("arm")
        command("move-to", target=math.pi)
        wait_until("half a turn", position, lambda at: at is not None and abs(at - math.pi) < 0.01)
        command("stop")
    finally:
        done.set()
        renewing.join()
    part(f"{motion}.give_back").sync(0, client=client, body=models.LeaseEpoch(epoch=grant.epoch))
