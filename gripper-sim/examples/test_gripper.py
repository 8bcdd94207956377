"""A gripper for each test: `wsg-sim` as a fixture of pytest. It needs `wsg-sim` on the path, or in the variable WSG_SIM."""

import json
import os
import socket
import struct
import subprocess
import time
import urllib.request

import pytest


class Gripper:
    """A running wsg-sim: where it serves what, by the names of its lines."""

    def __init__(self, *options):
        command = [os.environ.get("WSG_SIM", "wsg-sim"), *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.at = {}
        # The page is the last line, if --control is given.
        while "page" not in self.at:
            line = self.process.stdout.readline()
            assert line, "wsg-sim has ended"
            name, place = line.split(maxsplit=1)
            self.at[name] = place.strip()

    def connect(self, name):
        host, port = self.at[name].rsplit(":", 1)
        return socket.create_connection((host, int(port)), timeout=10)

    def control(self, path, *body):
        """What a hand beside the gripper does, by POST where there is a body; the state then."""
        data = json.dumps(*body).encode() if body else None
        with urllib.request.urlopen(self.at["page"] + path, data, timeout=10) as answer:
            return json.load(answer)

    def until(self, is_it):
        """The state as soon as it is so."""
        end = time.monotonic() + 30
        while time.monotonic() < end:
            state = self.control("state")
            if is_it(state):
                return state
        raise AssertionError(state)


@pytest.fixture
def gripper():
    served = Gripper("--modbus", "127.0.0.1:0", "--control", "127.0.0.1:0", "--part", "20", "--time-scale", "20")
    yield served
    served.process.terminate()
    served.process.wait(timeout=10)


class Plc:
    """The output image over Modbus/TCP: FC 16 to registers 0 to 3."""

    def __init__(self, stream):
        self.stream = stream

    def write(self, flags, width=20.0, speed=50.0, force=40.0):
        image = struct.pack(">BBhHh", flags, 0, round(100 * width), round(100 * speed), round(100 * force))
        pdu = struct.pack(">BHHB", 16, 0, 4, len(image)) + image
        self.stream.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
        answer = self.stream.recv(64)
        assert answer[7] == 16, answer.hex()


MOVE, GRIP, RELEASE, HOMING = 1, 2, 4, 8


def test_part_is_gripped_and_lost(gripper):
    with gripper.connect("modbus") as stream:
        plc = Plc(stream)
        plc.write(0)
        plc.write(HOMING)
        gripper.until(lambda state: "REFERENCED" in state["system_state"] and state["gripper_state"] == "IDLE")
        plc.write(0)
        plc.write(GRIP)
        held = gripper.until(lambda state: state["gripper_state"] == "HOLDING")
        assert held["force_n"] == pytest.approx(40)
        gripper.control("part", None)
        gripper.until(lambda state: state["gripper_state"] == "PART LOST")

