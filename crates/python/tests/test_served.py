"""A running server as a link: the real `polepair serve`, with simulated drives behind it."""

from __future__ import annotations

import asyncio
import math
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import polepair
import pytest
from polepair_test_support import wait_until
from served import (
    Server,
    can_be_armed,
    joined_link,
    own_server,
    speed,
    wait_for_disarmed,
    wait_for_rotation,
    wait_for_standstill,
)

RACK = """
[[link]]
name = "bench"
[[link.drive]]
profile = "tmcm-171"
address = 1
name = "left"
[[link.drive]]
profile = "tmcm-171"
address = 3
"""


server, link = own_server, joined_link


def program(link: polepair.Link) -> dict[str, object]:
    """A typical program of a user, for any link."""
    axis = link.axis(1)
    axis.params["max current"] = "1.2 A"
    kept = axis.params["max current"]
    axis.params.raw["pwm limit"] = 200
    with pytest.raises(polepair.Unsupported) as range_error:
        axis.params["max current"] = 99
    with pytest.raises(polepair.Unsupported) as name_error:
        axis.params["max curent"]
    with pytest.raises(polepair.Unsupported) as unarmed:
        axis.spin(60, "rpm")
    with axis.armed() as same:
        same.move(90, "deg", velocity=(120, "rpm")).wait(timeout=120)
        where = axis.read("position")["position"]
        motion = axis.move_by(math.pi)
        early = motion.done()
        motion.wait(30)
        further = axis.read("position")["position"]
        axis.spin(100, "rpm")
        trace = axis.capture(["velocity", "position"], rate=50, seconds=1.0)
        axis.read("mode", "enabled", "velocity")
        state = axis.state()
        axis.stop()
        axis.move(0).cancel()
    with link.group(1, 3).armed() as both:
        both.move({1: 0.5, 3: -0.5}, sync=False).wait(30)
        places = [round(one.read("position")["position"], 2) for one in both.axes]
    rows = list(axis.watch("position", "velocity", period=0.05, seconds=2.0))
    info = axis.params.info("max current")
    return {
        "label": axis.label,
        "title": axis.title,
        "protocol": axis.protocol,
        "product": axis.product,
        "caution": axis.caution,
        "parameters": sorted(axis.params),
        "known": "max current" in axis.params and "nonsense" not in axis.params,
        "info": (info.name, info.symbol, info.unit, info.raw_range, info.raw_default, info.words,
                 info.section, info.persistence, info.readable, info.writable),
        "current": (float(kept), kept.unit, kept.raw, kept.word, kept.text),
        "standby": axis.params.raw["pwm limit"],
        "range": (type(range_error.value), range_error.value.code, range_error.value.executed),
        "name": (type(name_error.value), name_error.value.code, str(name_error.value)),
        "unarmed": (str(unarmed.value), unarmed.value.code, unarmed.value.hint),
        "where": round(where, 2),
        "early": early,
        "further": round(further, 2),
        "fast": max(trace["velocity"]) > 9.0,
        "sampled": len(trace) > 5,
        "places": places,
        "rows": len(rows) > 3 and set(rows[0][1]) == {"position", "velocity"} and rows[0][0] < 1.0,
        "faults": axis.faults(),
        "state": (state.armed, state.mode, state.enabled),
        "age": 0.0 <= state.readings["velocity"].age < 5.0,
        "slow": speed(axis) < 0.05,
    }


def test_one_program_runs_on_both(link: polepair.Link) -> None:
    with polepair.connect("sim:tmcl?axes=2") as own:
        local = program(own)
    served = program(link)
    assert served == local


def test_axes_are_found_by_number_name_and_link(tmp_path: Path) -> None:
    rack = tmp_path / "rack.toml"
    rack.write_text(RACK)
    served = Server(tmp_path / "state", "sim:tmcl", drives=f"sim:{rack}")
    try:
        with served.join() as link:
            assert [axis.number for axis in link.axes] == [1, 3, 1]
            assert link["left"].name == "left" and link[3].number == 3
            assert link["1#1"].label != link["0#1"].label
            with pytest.raises(polepair.Unsupported, match="several") as several:
                link.axis(1)
            assert several.value.code == "E212" and "link" in several.value.hint
            with pytest.raises(polepair.Unsupported, match="no axis") as none:
                link["right"]
            assert "left" in none.value.hint
    finally:
        served.kill()


def test_it_shows_itself(server: Server, link: polepair.Link) -> None:
    assert repr(link) == f"<Link {server.url}: axis 1, axis 3>" and link.url == server.url
    assert "TMCM-171" in link._repr_html_() and "TMCM-171" in repr(link.axes[0])
    with link.axes[0].armed() as axis:
        assert "<td>yes</td>" in axis._repr_html_()
    for what in (link, link.axes[0]):
        with pytest.raises(TypeError, match="connection string"):
            pickle.dumps(what)
    assert "step" in dir(link.axes[0]) and link.axes[0].signals["velocity"] == "rad/s"
    with pytest.raises(ValueError, match="closed"):
        link.close()
        link.stop()


def test_another_owner_is_named_and_left_alone(server: Server, link: polepair.Link) -> None:
    with server.join() as other:
        with link.axis(1).armed() as ours:
            ours.spin(20)
            wait_for_rotation(ours)
            state = other.axis(1).state()
            assert state.armed and state.owner is not None
            refused: list[polepair.Refused] = []
            for deed in (
                lambda: other.axis(1).armed().__enter__(),
                lambda: other.group(3, 1).armed().__enter__(),
                lambda: other.axis(1).params.__setitem__("max current", 1),
                lambda: other.axis(1).disable(),
            ):
                with pytest.raises(polepair.Refused, match="controls this axis") as error:
                    deed()
                refused.append(error.value)
            assert {(error.code, error.executed) for error in refused} == {("gateway.lease", False)}
            assert speed(ours) > 10, "nobody else's refusal stops it"
            # Whoever sees it turn may stop it.
            other.axis(1).stop()
            wait_for_standstill(ours)
            with pytest.raises(polepair.Refused, match="lease") as lost:
                ours.spin(20)
            assert lost.value.executed is False
            wait_for_disarmed(ours)
            with pytest.raises(polepair.Refused):
                ours.enable()
            link.axis(3).params["max current"] = 1.0
            raised = pytest.raises(polepair.Refused, match="lease")
            with raised, ours.armed():
                other.axis(1).stop()
                wait_for_disarmed(ours)


def test_a_stop_of_all_needs_no_lease_and_locks_nothing(
    server: Server, link: polepair.Link
) -> None:
    ours = link.axis(3)
    with pytest.raises(polepair.Refused), ours.armed():
        ours.spin(20)
        wait_for_rotation(ours)
        with server.join() as other:
            other.stop()
        wait_for_standstill(ours)
        wait_for_disarmed(ours)
    with ours.armed():
        ours.move(1.0).wait(30)


def test_a_link_that_is_closed_stops_what_is_armed(
    server: Server, link: polepair.Link
) -> None:
    with server.join() as other:
        other.axis(1).armed().__enter__().spin(20)
        wait_for_rotation(link.axis(1))
    assert speed(link.axis(1)) < 0.5
    assert can_be_armed(link.axis(1))


JOGS = """
import sys, time, polepair
link = polepair.connect(sys.argv[1], token_file=sys.argv[2])
axis = link.axis(1)
with axis.armed():
    axis.spin(20)
    print("turning", flush=True)
    {wait}
"""


def jog(server: Server, wait: str = "time.sleep(600)") -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", JOGS.format(wait=wait), server.ws, str(server.tokens)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None and process.stdout.readline() == "turning\n"
    return process


def test_a_killed_program_leaves_no_motor_turning(server: Server, link: polepair.Link) -> None:
    process = jog(server)
    wait_for_rotation(link.axis(1))
    process.kill()
    process.communicate()
    wait_for_standstill(link.axis(1))
    wait_until("the axis can be armed", lambda: can_be_armed(link.axis(1)))


def test_a_program_that_hangs_loses_its_lease(server: Server, link: polepair.Link) -> None:
    process = jog(server)
    wait_for_rotation(link.axis(1))
    process.send_signal(signal.SIGSTOP)
    wait_for_standstill(link.axis(1))
    process.kill()
    process.communicate()


@pytest.mark.parametrize(
    "wait",
    ["axis.move(1e6).wait(600)", "link.sleep(600)", "list(axis.watch('fault', period=60))"],
)
def test_ctrl_c_ends_a_wait_and_stops(server: Server, link: polepair.Link, wait: str) -> None:
    process = jog(server, wait)
    wait_for_rotation(link.axis(1), 1.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert "KeyboardInterrupt" in errors
    assert speed(link.axis(1)) < 0.5


def test_a_killed_server_ends_every_wait(server: Server) -> None:
    link = server.join()
    axis = link.axis(1)
    rows = axis.watch("position", period=0.01)
    assert next(rows)[0] == 0
    failed: dict[str, BaseException] = {}

    def kill_soon() -> None:
        time.sleep(0.5)
        server.kill()

    with pytest.raises(polepair.PolepairError) as left, axis.armed():
        motion = axis.move(1e5)
        threading.Thread(target=kill_soon).start()
        try:
            motion.wait(60)
        except polepair.PolepairError as error:
            failed["wait"] = error
            raise
    assert failed["wait"] is left.value
    assert left.value.code == "E313" and left.value.executed is None
    assert "may have been executed" in str(left.value)
    assert "could not be stopped" in left.value.__notes__[-1]
    with pytest.raises(polepair.PolepairError) as told:
        list(rows)
    assert told.value.code == "E313"
    with pytest.raises(polepair.PolepairError) as nobody:
        axis.params["max current"]
    assert nobody.value.code in ("E313", "E314") and nobody.value.executed is False


def test_threads_share_one_server(link: polepair.Link) -> None:
    failed: list[BaseException] = []

    def work(axis: polepair.Axis, current: float) -> None:
        try:
            for _ in range(15):
                axis.read("position", "velocity")
                axis.params["max current"]
            with axis.armed():
                axis.move(current).wait(60)
            assert abs(axis.read("position")["position"] - current) < 0.05
        except BaseException as error:  # noqa: BLE001
            failed.append(error)

    def look(axis: polepair.Axis) -> None:
        try:
            for _ in range(30):
                axis.params["max current"], axis.faults()
        except BaseException as error:  # noqa: BLE001
            failed.append(error)

    jobs = [threading.Thread(target=work, args=(axis, 2.0)) for axis in link.axes]
    jobs += [threading.Thread(target=look, args=(link.axes[n % 2],)) for n in range(6)]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join(120)
    assert not failed and not any(job.is_alive() for job in jobs)


def test_the_interpreter_goes_on_while_it_waits(link: polepair.Link) -> None:
    axis = link.axis(1)
    count = 0
    with axis.armed():
        motion = axis.move(1e4)
        began = time.monotonic()
        waits = threading.Thread(
            target=lambda: pytest.raises(polepair.PolepairError, motion.wait, 1.0)
        )
        waits.start()
        while waits.is_alive():
            count += 1
        spent = time.monotonic() - began
    assert 0.9 < spent < 60 and count > 1000


def test_an_event_loop_joins(server: Server) -> None:
    async def main() -> tuple[list[float], list[float], int]:
        async with polepair.aio.connect(server.ws, token_file=server.tokens) as link:
            left, right = link.axes
            await asyncio.gather(*(axis.params.set("max current", 1.2) for axis in link.axes))
            read = await asyncio.gather(*(left.params.get("max current") for _ in range(100)))
            async with left.armed(), right.armed():
                moves = await asyncio.gather(left.move(90, "deg"), right.move(-1.0))
                await asyncio.gather(*moves)
                places = [
                    round((await axis.read("position"))["position"], 2) for axis in link.axes
                ]
                rows = 0
                watch = left.watch("position", "velocity", period=0.02)
                async for _time, row in watch:
                    rows += set(row) == {"position", "velocity"}
                    if rows == 5:
                        break
                assert watch.lost == 0
                await watch.aclose()
            moving = asyncio.ensure_future(hold(left))
            await asyncio.sleep(0.5)
            moving.cancel()
            with pytest.raises(asyncio.CancelledError):
                await moving
            assert abs((await left.read("velocity"))["velocity"]) < 0.5
            return [float(one) for one in read], places, rows

    async def hold(axis: polepair.aio.Axis) -> None:
        async with axis.armed():
            await axis.spin(20)
            await asyncio.sleep(60)

    read, places, rows = asyncio.run(main())
    assert read == pytest.approx([1.2] * 100) and places == [1.57, -1.0] and rows == 5


def test_an_event_loop_hears_that_the_server_is_gone(server: Server) -> None:
    async def main() -> None:
        link = await polepair.aio.connect(server.ws, token_file=server.tokens)
        axis = link.axes[0]
        watch = axis.watch("position", period=0.05)
        await anext(watch)
        with pytest.raises(polepair.PolepairError) as gone:
            async with axis.armed():
                motion = await axis.move(1e5)
                asyncio.get_running_loop().call_later(0.3, server.kill)
                await motion
        assert gone.value.code == "E313"
        with pytest.raises(polepair.PolepairError) as told:
            async for _row in watch:
                pass
        assert told.value.code == "E313"

    asyncio.run(asyncio.wait_for(main(), 60))


def test_whoever_may_not_is_refused(tmp_path: Path, server: Server) -> None:
    wrong = tmp_path / "another"
    wrong.write_text("0" * 64)
    wrong.chmod(0o600)
    with pytest.raises(polepair.Refused) as unknown:
        polepair.connect(server.ws, token_file=wrong)
    assert (unknown.value.code, unknown.value.executed) == ("gateway.token", False)
    wrong.chmod(0o644)
    with pytest.raises(polepair.PolepairError, match="others may read") as open_to_all:
        polepair.connect(server.ws, token_file=wrong)
    assert open_to_all.value.code == "E305" and "chmod" in open_to_all.value.hint
    with pytest.raises(polepair.Unsupported) as readable:
        polepair.connect("ws://192.0.2.1:7365", token_file=server.tokens)
    assert readable.value.code == "E252"
    for arguments in ({"profile": "x.toml"}, {"trace": True}, {"axes": [1]}):
        with pytest.raises(TypeError):
            polepair.connect(server.ws, token_file=server.tokens, **arguments)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="server's URL"):
        polepair.connect("sim:tmcl", token_file=server.tokens)
    assert "0" * 64 not in repr(unknown.value)


def test_a_viewer_sees_and_stops(tmp_path: Path) -> None:
    tokens = tmp_path / "tokens"
    tokens.write_text(f"{'12' * 32} read,stop viewer\n")
    tokens.chmod(0o600)
    served = Server(tmp_path)
    try:
        with served.join() as link:
            axis = link.axis(1)
            axis.read("position"), axis.params["max current"], axis.faults()
            axis.stop()
            link.stop()
            for deed in (
                lambda: axis.armed().__enter__(),
                lambda: axis.params.__setitem__("max current", 1),
                axis.clear,
            ):
                with pytest.raises(polepair.Refused) as scope:
                    deed()
                assert (scope.value.code, scope.value.executed) == ("gateway.scope", False)
    finally:
        served.kill()


def test_the_environments_token_lets_in(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = server.tokens.read_text().splitlines()
    token = next(line.split()[0] for line in lines if line and not line.startswith("#"))
    monkeypatch.setenv("POLEPAIR_TOKEN", token)
    with polepair.connect(server.url) as link:
        assert token not in repr(link)
        with pytest.raises(polepair.Refused) as raw:
            link.axis(1).raw("GAP 6, 0")
    assert raw.value.code == "gateway.scope" and raw.value.executed is False


def test_raw_is_for_who_may(tmp_path: Path) -> None:
    tokens = tmp_path / "tokens"
    tokens.write_text(f"{'ab' * 32} read,stop,move,configure,raw ann\n")
    tokens.chmod(0o600)
    served = Server(tmp_path, "--scopes", "read,stop,move,configure,raw")
    try:
        with served.join() as link:
            axis = link.axis(1)
            assert axis.raw("GAP 6, 0") == axis.params.raw["max current"]
            with axis.armed():
                assert axis.raw("GAP 1, 0") == 0
            with pytest.raises(polepair.Unsupported) as text:
                axis.raw("FLY 1")
            assert text.value.code == "E221"
            with pytest.raises(polepair.Unsupported) as told:
                axis.raw(b"\x01\x06\x06\x00\x00\x00\x00\x00\x0d")
            assert told.value.code == "E257" and "text" in told.value.hint
    finally:
        served.kill()


def openssl(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")
def test_a_server_that_wants_a_clients_certificate_is_shown_it(tmp_path: Path) -> None:
    new = ("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-noenc")
    openssl(tmp_path, *new, "-x509", "-subj", "/CN=ours", "-keyout", "ca.key", "-out", "ca.pem")
    openssl(tmp_path, *new, "-subj", "/CN=robot", "-keyout", "own.key", "-out", "own.csr")
    (tmp_path / "own.ext").write_text("subjectAltName=DNS:robot\n")
    signs = ("x509", "-req", "-in", "own.csr", "-CA", "ca.pem", "-CAkey", "ca.key")
    openssl(tmp_path, *signs, "-extfile", "own.ext", "-out", "own.pem")
    own, key = tmp_path / "own.pem", tmp_path / "own.key"
    key.chmod(0o600)
    served = Server(tmp_path, "--tls", "--client-ca", str(tmp_path / "ca.pem"))
    certificate = tmp_path / "certificate.pem"

    def join(cert: Path | None, key: Path | None) -> polepair.Link:
        return polepair.connect(
            served.ws,
            token_file=served.tokens,
            certificate=certificate,
            client_cert=cert,
            client_key=key,
        )

    try:
        with join(own, key) as link:
            assert link.axis(1).read("position")["position"] == 0
        both = tmp_path / "both.pem"
        both.touch(0o600)
        both.write_text(own.read_text() + key.read_text())
        with join(both, None) as link:
            assert len(link.axes) == 2
        with pytest.raises(polepair.PolepairError) as none:
            join(None, None)
        assert none.value.code == "E256" and none.value.executed is False

        async def visit() -> int:
            opened = polepair.aio.connect(
                served.ws,
                token_file=served.tokens,
                certificate=certificate,
                client_cert=own,
                client_key=key,
            )
            async with opened as link:
                return len(link.axes)

        assert asyncio.run(visit()) == 2
    finally:
        served.kill()


def test_known_facts_of_parameters_are_not_queried_in_the_loop(server: Server) -> None:
    async def look() -> float:
        async with polepair.aio.connect(server.ws, token_file=server.tokens) as link:
            params = link.axis(1).params
            # Whoever asks a server that says nothing waits.
            server.child.send_signal(signal.SIGSTOP)
            try:
                since = time.monotonic()
                assert params.info("max current").unit == "A"
                assert "max current" in params and "AP 6" in params and "fuel" not in params
                assert len(list(params)) == len(params) > 50
                return time.monotonic() - since
            finally:
                server.child.send_signal(signal.SIGCONT)

    assert asyncio.run(look()) < 0.5


def test_units_of_unknown_signals_are_refused_as_on_a_link(link: polepair.Link) -> None:
    with polepair.connect("sim:tmcl?time=virtual") as own:
        for axis in (link.axis(1), own.axes[0]):
            with pytest.raises(polepair.Unsupported, match="no signal `speed`") as wrong:
                axis._native.signal_units(["velocity", "speed"])
            assert wrong.value.code == "E213"
            assert axis._native.signal_units(["velocity", "fault"]) == ["rad/s", ""]


def test_an_encrypted_server_is_joined_by_its_certificate(tmp_path: Path) -> None:
    served = Server(tmp_path, "--tls")
    try:
        certificate = tmp_path / "certificate.pem"
        with polepair.connect(
            served.ws, token_file=served.tokens, certificate=certificate
        ) as link, link.axis(1).armed() as axis:
            axis.move(1.0).wait(30)
        with pytest.raises(polepair.PolepairError) as other:
            polepair.connect(served.ws, token_file=served.tokens, certificate="AB" * 32)
        assert other.value.code == "E321"
    finally:
        served.kill()


def test_a_resource_that_a_server_does_not_lend_is_refused(link: polepair.Link) -> None:
    axis = link.axis(1)
    for what in (
        lambda: link.simulation, link.events, axis.events, link.losses, link.trace,
    ):
        with pytest.raises(polepair.Unsupported) as error:
            what()
        assert error.value.code == "E257" and error.value.hint
    with link.group().armed() as both:
        with pytest.raises(polepair.Unsupported) as together:
            both.move([1.0, 1.0])
        assert "sync=False" in together.value.hint
    with pytest.raises(polepair.Unsupported) as fuel:
        axis.read("fuel")
    assert fuel.value.code == "E213" and "velocity" in fuel.value.hint


def test_asking_whether_it_arrived_does_not_pile_up(link: polepair.Link) -> None:
    axis = link.axis(1)
    with axis.armed():
        motion = axis.move(40.0)
        asked = 0
        while not motion.done():
            asked += 1
        assert asked > 3
        assert abs(axis.read("position")["position"] - 40.0) < 0.05


def test_a_forks_child_gets_an_error(link: polepair.Link) -> None:
    axis = link.axis(1)
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:
        said = []
        for use in (lambda: axis.params["max current"], link.stop, axis.enable, axis.faults):
            try:
                use()
                said.append("nothing")
            except polepair.Unsupported as error:
                said.append(error.code)
        os.write(writes, " ".join(said).encode())
        os._exit(0)
    os.close(writes)
    with os.fdopen(reads) as pipe:
        said = pipe.read()
    assert os.waitpid(child, 0)[1] == 0
    assert said == "E224 E224 E224 E224"
    assert axis.params["max current"] > 0


def test_a_server_reads_by_address(link: polepair.Link) -> None:
    axis = link.axis(1)
    assert axis.params.raw["AP 6:u32"] == axis.params.raw["max current"]
    assert axis.read("AP 6:u32") == {"AP 6:u32": axis.params.raw["AP 6:u32"]}
    axis.params["GP 0.2"] = 41
    assert axis.params["GP 0.2"] == 41
    axis.params["AP 6"] = "12"
    assert axis.params["max current"] == pytest.approx(1.2) and axis.params.raw["AP 6"] == 12
    with pytest.raises(polepair.Unsupported, match="own number, or 1"):
        axis.params["AP 6"] = 12
    with pytest.raises(polepair.PolepairError, match="may move the motor"):
        axis.params["AP 0:u32"] = 1
    with pytest.raises(polepair.PolepairError, match="is a number"):
        axis.read_bytes("AP 6:u32")
