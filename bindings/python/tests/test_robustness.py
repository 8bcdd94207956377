"""Processes, threads, garbage and the end of the interpreter. A hang fails by the watchdog of conftest.py."""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import resource
import subprocess
import sys
import textwrap
import threading
import time
import weakref
from multiprocessing.connection import Connection

import pytest

from wsg_gripper import AsyncGripper, Gripper, NotConnectedError, StreamingGripper, SystemFlags
from wsg_gripper.sim import Simulator, VirtualGripper

pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")


def is_in_fast_stop(simulator: Simulator) -> bool:
    """Return whether a connection ended unannounced. The simulator may notice the end late."""
    time.sleep(0.1)
    return SystemFlags.FAST_STOP in simulator.observe().flags


def run_script(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", textwrap.dedent(script), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def in_fork(child: object) -> int:
    """Run a function in a forked child that ends without the interpreter's end, and return its exit status."""
    pid = os.fork()
    if pid == 0:
        try:
            assert callable(child)
            child()
            os._exit(0)
        except BaseException:
            sys.excepthook(*sys.exc_info())
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def test_forked_child_leaves_the_connection_to_its_parent(wsg_sim: Simulator) -> None:
    gripper = Gripper(wsg_sim.tcp)
    gripper.home()

    def child() -> None:
        nonlocal gripper
        with pytest.raises(NotConnectedError):
            gripper.width()
        assert not gripper.is_open
        gripper.close()
        del gripper
        gc.collect()
        with pytest.raises(NotConnectedError):
            wsg_sim.observe()
        wsg_sim.close()
        with Gripper(wsg_sim.udp) as own:
            own.width()

    assert in_fork(child) == 0
    assert not is_in_fast_stop(wsg_sim)
    gripper.move(50, speed=400)
    gripper.close()


def test_forked_child_leaves_the_subscription_to_its_parent(wsg_sim: Simulator) -> None:
    with Gripper(wsg_sim.tcp) as gripper:
        readings = gripper.subscribe()
        next(readings)

        def child() -> None:
            nonlocal readings
            with pytest.raises(NotConnectedError):
                next(readings)
            readings.close()
            del readings
            gc.collect()

        assert in_fork(child) == 0
        first = next(readings)
        assert next(readings).received > first.received
    assert not is_in_fast_stop(wsg_sim)


def test_forked_child_leaves_the_stream_to_its_parent(wsg_sim: Simulator) -> None:
    with StreamingGripper(wsg_sim.tcp) as gripper:

        def child() -> None:
            with pytest.raises(NotConnectedError):
                gripper.latest()
            assert gripper._stream is not None
            gripper._stream.close()
            gripper._stream = None
            gc.collect()

        assert in_fork(child) == 0
        gripper.set_target(90)
        end = time.monotonic() + 10
        while gripper.latest().position > 91:
            assert time.monotonic() < end
    assert not is_in_fast_stop(wsg_sim)


def spawned(address: str, results: Connection) -> None:
    with Gripper(address) as gripper:
        gripper.home()
        results.send(gripper.width())


def test_spawned_process_uses_a_gripper(wsg_sim: Simulator) -> None:
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe()
    process = context.Process(target=spawned, args=(wsg_sim.tcp, sender))
    process.start()
    assert receiver.recv() == 110
    process.join()
    assert process.exitcode == 0
    assert not is_in_fast_stop(wsg_sim)
    with Gripper(wsg_sim.tcp) as gripper, pytest.raises(TypeError, match="pickle"):
        pickle.dumps(gripper)


@pytest.mark.parametrize(
    "script",
    [
        "import sys, wsg_gripper as w; keep = w.Gripper(sys.argv[1]); keep.home(); keep.begin_move(10, 5)",
        "import sys, wsg_gripper as w; keep = w.Gripper(sys.argv[1]); keep.self = keep; sys.exit(0)",
        "import sys, wsg_gripper as w; keep = w.Gripper(sys.argv[1]); raise SystemExit",
        """
        import sys, threading, wsg_gripper as w
        keep = w.Gripper(sys.argv[1])
        keep.home()
        def move():
            try: keep.move(10, 5)
            except w.GripperError: pass
        threading.Thread(target=move, daemon=True).start()
        while w.SystemFlags.MOVING not in keep.flags(): pass
        """,
        """
        import sys, threading, wsg_gripper as w
        keep = w.Gripper(sys.argv[1])
        def query():
            while True: keep.width()
        for _ in range(8): threading.Thread(target=query, daemon=True).start()
        """,
        "import sys, wsg_gripper as w; keep = w.StreamingGripper(sys.argv[1]); keep.start(); keep.set_target(10)",
        """
        import sys, threading, wsg_gripper as w
        keep = w.Gripper(sys.argv[1])
        keep.home()
        keep.begin_move(10, 5)
        def read():
            try:
                for _ in keep.subscribe(): began.set()
            except w.NotConnectedError: pass
        began = threading.Event()
        threading.Thread(target=read, daemon=True).start()
        began.wait()
        """,
        """
        import asyncio, sys, wsg_gripper as w
        async def main():
            global keep
            keep = await w.AsyncGripper(sys.argv[1])
            await keep.home()
            asyncio.ensure_future(keep.move(10, 5))
            await asyncio.sleep(0.1)
        asyncio.run(main())
        """,
    ],
    ids=["motion", "cycle", "exit", "thread", "threads", "stream", "subscription", "asyncio"],
)
def test_end_of_the_interpreter_announces_the_end_of_the_connection(wsg_sim: Simulator, script: str) -> None:
    done = run_script(script, wsg_sim.tcp)
    assert (done.returncode, done.stderr) == (0, "")
    assert not is_in_fast_stop(wsg_sim)
    assert SystemFlags.MOVING not in wsg_sim.observe().flags


def test_killed_program_leaves_a_fast_stop(wsg_sim: Simulator) -> None:
    script = "import os, sys, wsg_gripper as w; keep = w.Gripper(sys.argv[1]); os._exit(0)"
    assert run_script(script, wsg_sim.tcp).returncode == 0
    assert is_in_fast_stop(wsg_sim)


def test_garbage_in_a_cycle_is_closed(wsg_sim: Simulator) -> None:
    class Robot:
        def __init__(self) -> None:
            self.gripper = Gripper(wsg_sim.tcp)
            self.callback = self.describe

        def describe(self) -> float:
            return self.gripper.width()

    robot = Robot()
    robot.describe()
    gone = weakref.ref(robot)
    del robot
    gc.collect()
    assert gone() is None
    assert not is_in_fast_stop(wsg_sim)


def open_things() -> tuple[int, int]:
    """Return the descriptors and native threads of this process."""
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))


def are_more_than(before: tuple[int, int]) -> bool:
    # A thread of an earlier test may have ended meanwhile.
    return any(now > then for now, then in zip(open_things(), before))


def test_thousand_creations_leave_nothing(wsg_sim: Simulator) -> None:
    def create(number: int) -> None:
        with Gripper(wsg_sim.tcp) as gripper:
            gripper.width()
            if number % 10 == 0:
                # The first width would wait for new flags, because the fingers are not referenced.
                next(gripper.subscribe(width=False))

    for number in range(50):
        create(number)
    before = open_things()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in range(1000):
        create(number)
    gc.collect()
    end = time.monotonic() + 5
    # The simulator closes its end of the last connection on its own.
    while are_more_than(before) and time.monotonic() < end:
        time.sleep(0.01)
    assert not are_more_than(before)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 4_000, "KiB"


def test_virtual_grippers_and_simulators_leave_nothing() -> None:
    def create() -> None:
        virtual = VirtualGripper()
        virtual.connect()
        Simulator()

    create()
    before = open_things()
    for _ in range(20):
        create()
    gc.collect()
    assert not are_more_than(before)


def test_many_threads_share_a_gripper(wsg_sim: Simulator) -> None:
    with Gripper(wsg_sim.tcp) as gripper:
        gripper.home()
        failures: list[BaseException] = []

        def query() -> None:
            try:
                for _ in range(100):
                    assert gripper.width() == pytest.approx(110)
            except BaseException as failure:
                failures.append(failure)

        threads = [threading.Thread(target=query) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not failures


def test_import_takes_less_than_50_ms() -> None:
    # Processor time, so that other programs of the computer have no effect.
    script = "import time; begin = time.process_time(); import wsg_gripper; print(time.process_time() - begin)"
    times = [float(run_script(script).stdout) for _ in range(7)]
    assert min(times) < 0.05


def test_package_needs_no_other_package() -> None:
    script = "import sys, wsg_gripper, wsg_gripper.sim, wsg_gripper.protocol, wsg_gripper.umi; print(*sys.modules)"
    modules = run_script(script).stdout.split()
    assert not {"asyncio", "numpy", "pytest"} & set(modules)


def test_unused_async_gripper_opens_nothing() -> None:
    assert not AsyncGripper("tcp://192.0.2.1").is_open
