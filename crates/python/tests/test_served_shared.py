"""A running server that others use as well, that goes away, or whose drives say nothing."""

from __future__ import annotations

import asyncio
import math
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
    POLEPAIR,
    Server,
    can_be_armed,
    joined_link,
    own_server,
    speed,
    wait_for_disarmed,
    wait_for_rotation,
)


server, link = own_server, joined_link


def take_and_turn(axis: polepair.Axis) -> polepair.Armed:
    armed = axis.armed()
    armed.__enter__()
    axis.spin(20)
    wait_for_rotation(axis)
    return armed


def test_the_end_of_a_block_stops_no_other_axis(server: Server, link: polepair.Link) -> None:
    ours = link.axis(1)
    with server.join() as other:
        theirs = other.axis(1)
        with pytest.raises(polepair.Refused, match="lease"), ours.armed():
            theirs.stop()
            wait_for_disarmed(ours)
            wait_until("the axis can be armed", lambda: can_be_armed(theirs))
            armed = take_and_turn(theirs)
            with pytest.raises(polepair.Refused, match="controls this axis"), ours.armed():
                pass
        assert speed(theirs) > 10
        armed.__exit__(None, None, None)
        with ours.armed():
            with pytest.raises(polepair.Unsupported, match="already armed"), ours.armed():
                pass
        with pytest.raises(polepair.Refused, match="lease"), link.group(1, 3).armed():
            theirs.stop()
            wait_for_disarmed(ours)
            wait_until("the axis can be armed", lambda: can_be_armed(theirs))
            armed = take_and_turn(theirs)
        assert speed(theirs) > 10
        armed.__exit__(None, None, None)


def test_a_task_cancelled_while_arming_releases_the_axis(server: Server) -> None:
    async def hold(axis: polepair.aio.Axis) -> None:
        async with axis.armed():
            await asyncio.sleep(60)

    async def main() -> None:
        async with polepair.aio.connect(server.ws, token_file=server.tokens) as link:
            axis = link.axis(1)
            for spent in (0.0, 0.0, 0.001, 0.002, 0.003, 0.005, 0.01, 0.02, 0.05):
                holds = asyncio.ensure_future(hold(axis))
                await asyncio.sleep(spent)
                await asyncio.sleep(0)
                holds.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await holds
                await asyncio.sleep(0.1)
                assert (await axis.state()).owner is None, spent

    asyncio.run(asyncio.wait_for(main(), 60))


def test_a_lease_is_given_back_whoever_looks_at_it(server: Server, link: polepair.Link) -> None:
    axis, ended = link.axis(1), threading.Event()

    def look() -> None:
        while not ended.is_set():
            axis._native.is_armed  # noqa: B018

    looks = [threading.Thread(target=look) for _ in range(6)]
    for one in looks:
        one.start()
    try:
        for _ in range(25):
            with axis.armed():
                pass
            assert axis.state().owner is None
    finally:
        ended.set()
        for one in looks:
            one.join()


def test_watched_signals_are_checked(link: polepair.Link) -> None:
    axis = link.axis(1)
    for period in (math.nan, math.inf, -1.0):
        with pytest.raises(polepair.Unsupported, match="period") as wrong:
            axis.watch("position", period=period)
        assert wrong.value.code == "E217" and wrong.value.executed is False
    with pytest.raises(polepair.Unsupported, match="no signal") as none:
        axis.watch()
    assert none.value.code == "E213"
    rows = axis.watch("position", period=0)
    assert [len(next(rows)[1]) for _ in range(5)] == [1] * 5
    rows.close()


def test_another_server_in_its_place_is_reported(tmp_path: Path) -> None:
    served = Server(tmp_path)
    port = served.url.rsplit(":", 1)[1].rstrip("/")
    with served.join() as link:
        axis = link.axis(1)
        with axis.armed():
            axis.spin(1)
        served.kill()
        served = Server(tmp_path, bind=f"127.0.0.1:{port}")
        try:
            wait_until("the axis replies again", lambda: reaches(axis))
            with axis.armed():
                axis.spin(1)
            served.kill()
            served = Server(tmp_path, drives="sim:tmcl?axes=3", bind=f"127.0.0.1:{port}")
            wait_until("the axis replies again", lambda: reaches(axis))
            for deed in (
                lambda: axis.armed().__enter__(),
                lambda: axis.params.__setitem__("max current", 1),
                axis.stop,
            ):
                with pytest.raises(polepair.PolepairError, match="other drives") as other:
                    deed()
                assert other.value.code == "E313" and other.value.executed is False
                assert "connect again" in other.value.hint.lower()
        finally:
            served.kill()


def reaches(axis: polepair.Axis) -> bool:
    try:
        axis.state()
        return True
    except polepair.PolepairError:
        return False


def test_a_query_of_the_arrival_blocks_no_other_caller(server: Server) -> None:
    async def main() -> None:
        async with polepair.aio.connect(server.ws, token_file=server.tokens) as link:
            axis = link.axis(1)
            async with axis.armed():
                motion = await axis.move(30.0)
                waits = asyncio.ensure_future(motion.wait(60))
                while not await motion.done():
                    await asyncio.sleep(0.02)
                await asyncio.wait_for(waits, 2)

    asyncio.run(asyncio.wait_for(main(), 60))


def test_a_query_takes_the_axis_from_no_other_client(server: Server, link: polepair.Link) -> None:
    axis = link.axis(1)
    assert isinstance(axis.reached(0.05), bool) and axis.state().owner is None
    with server.join() as other, other.axis(1).armed() as theirs:
        motion = theirs.move(20.0)
        assert not axis.reached(0.05)
        assert axis.reached(60)
        motion.wait(1)


def test_a_stop_waits_behind_no_other_call(server: Server) -> None:
    async def main() -> None:
        async with polepair.aio.connect(server.ws, token_file=server.tokens) as link:
            axis = link.axis(1)
            async with axis.armed():
                await axis.spin(20)
                loop = asyncio.get_running_loop()
                free = threading.Event()
                waits = [loop.run_in_executor(None, free.wait) for _ in range(64)]
                try:
                    # Every thread of the loop's is taken, and none of them ends before this.
                    await asyncio.wait_for(axis.stop(), 60)
                finally:
                    free.set()
                await asyncio.gather(*waits)

    asyncio.run(main())


def test_a_drive_that_is_silent_ends_what_watches_it(tmp_path: Path) -> None:
    drive = subprocess.Popen(
        [str(POLEPAIR), "sim", "tmcl", "--tcp", "127.0.0.1:0"], stdout=subprocess.PIPE, text=True
    )
    assert drive.stdout is not None
    served = Server(tmp_path, drives=drive.stdout.readline().split()[1])
    try:
        with served.join() as link:
            axis = link.axis(1)
            rows = axis.watch("position", period=0.05)
            next(rows)
            few = axis.watch("velocity", period=0.05, seconds=1.0)
            next(few)
            drive.send_signal(signal.SIGSTOP)
            list(few)  # ends when its time limit is over, as it would with a drive that answers
            with pytest.raises(polepair.NoReply, match="axis 1: nothing came") as silent:
                list(rows)
            assert silent.value.code == "E401"

            async def watch() -> None:
                async with polepair.aio.connect(served.ws, token_file=served.tokens) as link:
                    async for _row in link.axis(1).watch("position", period=0.05):
                        pass

            with pytest.raises(polepair.NoReply):
                asyncio.run(asyncio.wait_for(watch(), 20))
    finally:
        served.kill()
        drive.kill()
        drive.communicate()


ASKS = """
import signal, sys, polepair
# Whoever is started in the background of a script inherits an ignored SIGINT.
signal.signal(signal.SIGINT, signal.default_int_handler)
link = polepair.connect(sys.argv[1], token_file=sys.argv[2])
print("joined", flush=True)
sys.stdin.readline()
print("asks", flush=True)
link.axis(1).params.info("max current")
"""


def test_ctrl_c_ends_a_question(server: Server) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", ASKS, server.ws, str(server.tokens)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None and process.stdin is not None
    assert process.stdout.readline() == "joined\n"
    server.child.send_signal(signal.SIGSTOP)
    process.stdin.write("\n")
    process.stdin.flush()
    assert process.stdout.readline() == "asks\n"
    time.sleep(0.5)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    # The question alone waits 30 s for its answer.
    assert "KeyboardInterrupt" in errors and time.monotonic() - began < 25


def test_no_answer_is_not_taken_for_no_such_parameter(server: Server) -> None:
    params = server.join().axis(1).params
    server.kill()
    with pytest.raises(polepair.PolepairError) as gone:
        assert "max current" in params
    assert gone.value.code in ("E313", "E314")
