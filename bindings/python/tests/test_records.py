"""The records of the drivers in ``logging``."""

from __future__ import annotations

import logging
import subprocess
import sys
import time
from pathlib import Path

import pytest

from wsg_gripper import Gripper, GripperError, StreamEndedError, StreamingGripper
from wsg_gripper.sim import Simulator


def wait_for(caplog: pytest.LogCaptureFixture, *expected: str) -> None:
    """Wait until these are the records, as levels and messages. A busy computer may make an answer late."""
    end = time.monotonic() + 60
    while True:
        records = [f"{it.levelname} {it.getMessage()}" for it in caplog.records if it.name == "wsg_gripper"]
        records = [record for record in records if " ms late" not in record]
        if records == list(expected):
            return
        assert time.monotonic() < end, records
        time.sleep(0.01)


def test_events_are_recorded_with_the_address_and_samples_are_not(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    with Simulator() as simulator:
        address = simulator.tcp
        gripper = Gripper(address)
        connected = f"INFO {address}: connected"
        wait_for(caplog, connected)
        gripper.fast_stop()
        gripper.acknowledge()
        stopped = f"WARNING {address}: FAST STOP requested"
        wait_for(caplog, connected, stopped)
    with pytest.raises(GripperError):
        gripper.width()
    before = [connected, stopped, f"WARNING {address}: connection lost"]
    wait_for(caplog, *before)
    script = tmp_path / "wsg_stream.lua"
    script.write_text(StreamingGripper.SCRIPT)
    with Simulator(script=script) as simulator:
        simulator.wait_for_script()
        address = simulator.tcp
        connected, announced = f"INFO {address}: connected", f"INFO {address}: disconnect announced"
        wait_for(caplog, *before, connected, announced)
        caplog.clear()
        with StreamingGripper(address, home=None) as stream:
            samples = stream.subscribe()
            assert next(samples).number < next(samples).number
            stream.fast_stop()
            with pytest.raises(StreamEndedError) as ended:
                while True:
                    next(samples)
        stopped = f"WARNING {address}: FAST STOP requested"
        end = f"WARNING {address}: {ended.value}".replace("the stream has ended", "stream ended")
        wait_for(caplog, connected, stopped, end, announced)


@pytest.mark.parametrize(
    ("setup", "expected"),
    [("pass", ""), ("logging.basicConfig(format='%(message)s')", "virtual gripper: FAST STOP requested\n")],
)
def test_records_from_the_end_of_a_program_are_passed_on_if_it_wants_them(setup: str, expected: str) -> None:
    program = f"""
from wsg_gripper.sim import VirtualGripper
import logging
{setup}
VirtualGripper().connect().fast_stop()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, expected)
