"""Nodes, clients and a simulator in one process, on a ROS domain of the test run."""

from __future__ import annotations

import faulthandler
import os
import random
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Callable

os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(1, 100)))
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

sys.path.append(str(Path(__file__).parents[2] / "python/tests"))

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetState
from pauses import pytest_runtest_protocol  # noqa: F401
from rcl_interfaces.srv import SetParameters
from rclpy.executors import MultiThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from wsg_gripper import GripperState
from wsg_gripper.sim import Simulator

faulthandler.dump_traceback_later(600, exit=True)

def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--set-points", type=float, metavar="SECONDS", help="compare set-points for this time")


BOUND = 60
"""Longest wait in s. The machine may pause a process."""


def wait_until(condition: Callable[[], Any], what: str = "condition") -> Any:
    end = time.monotonic() + BOUND
    while not (value := condition()):
        assert time.monotonic() < end, f"{what} did not become true in {BOUND} s"
        time.sleep(0.005)
    return value


def is_moving(simulator: Simulator) -> bool:
    return abs(simulator.observe().speed) > 1


def stamp_of(message: JointState) -> float:
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


class Client:
    """A client of one gripper node: calls its services, and records its topics."""

    def __init__(self, node: Any, name: str) -> None:
        self.node, self.name = node, name
        self.joint_states: list[JointState] = []
        self.states: list[str] = []
        self.health: list[Any] = []
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(JointState, f"/{name}/joint_states", self.joint_states.append, 10)
        node.create_subscription(String, f"/{name}/gripper/state", lambda it: self.states.append(it.data), latched)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, 10)
        self.set_points = node.create_publisher(JointState, f"/{name}/gripper/joint_commands", 10)
        self.clients: dict[str, Any] = {}

    def _diagnosed(self, message: DiagnosticArray) -> None:
        self.health += [it for it in message.status if it.name == f"{self.name}/gripper: gripper"]

    def request(self, kind: Any, service: str, request: Any) -> Any:
        """Send a request and return its future."""
        if service not in self.clients:
            self.clients[service] = self.node.create_client(kind, f"/{self.name}/gripper/{service}")
        assert self.clients[service].wait_for_service(BOUND)
        return self.clients[service].call_async(request)

    def begin(self, service: str) -> Any:
        return self.request(Trigger, service, Trigger.Request())

    def call(self, service: str) -> tuple[bool, str]:
        response = wait_for(self.begin(service))
        return response.success, response.message

    def ok(self, service: str) -> str:
        success, message = self.call(service)
        while "may be old" in message:  # The machine paused the program.
            success, message = self.call(service)
        assert success, message
        return message

    def set(self, name: str, value: Any) -> Any:
        """Set a parameter."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return wait_for(self.request(SetParameters, "set_parameters", request)).results[0]

    def set_point(self, position: float, name: str = "wsg_finger_left_joint") -> None:
        self.set_points.publish(JointState(name=[name], position=[position]))

    def change(self, transition: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = transition
        return wait_for(self.request(ChangeState, "change_state", request)).success

    def lifecycle(self) -> str:
        return wait_for(self.request(GetState, "get_state", GetState.Request())).current_state.label

    def wait_until_active(self) -> None:
        """Wait for a position, and for the end of the activation that homes the gripper."""
        wait_until(lambda: self.joint_states and self.lifecycle() == "active")

    def state(self) -> str:
        return self.states[-1] if self.states else ""

    def wait_for_state(self, state: str) -> None:
        wait_until(lambda: self.state() == state, f"state {state}, now {self.states[-3:]}")

    def wait_for_diagnosed(self, key: str, value: str) -> None:
        wait_until(lambda: self.health and {it.key: it.value for it in self.health[-1].values}[key] == value, value)

    def wait_for_health(self, text: str) -> Any:
        begin = len(self.health)
        return wait_until(lambda: next((it for it in self.health[begin:] if text in it.message), None), text)


def wait_for(future: Any) -> Any:
    wait_until(future.done, "answer")
    return future.result()


def spin(executor: MultiThreadedExecutor) -> None:
    """Let an executor run until its shutdown, although rclpy raises errors of entities that are destroyed meanwhile."""
    while not executor._is_shutdown:
        try:
            executor.spin()
        except Exception:
            traceback.print_exc()


@pytest.fixture(scope="session")
def client_node() -> Iterator[Any]:
    rclpy.init()
    node = rclpy.create_node("client")
    executor = MultiThreadedExecutor(2)
    executor.add_node(node)
    threading.Thread(target=spin, args=[executor], daemon=True).start()
    yield node
    executor.shutdown()
    rclpy.shutdown()


@pytest.fixture
def grippers(client_node: Any) -> Iterator[Callable[..., Client]]:
    """A function that starts a node with parameters in this process, all in one executor."""
    from wsg_gripper_driver import node as module
    from wsg_gripper_driver.node import THREADS, WsgGripper

    # The machine may pause the tests. test_process.py judges the limit of users.
    module.LATE = 5
    executor = MultiThreadedExecutor(2 * THREADS)
    nodes = []
    threading.Thread(target=spin, args=[executor], daemon=True).start()

    def start(**parameters: Any) -> Client:
        name = f"g{random.randrange(1 << 30)}"
        overrides = [Parameter(key, value=value) for key, value in parameters.items()]
        client = Client(client_node, name)
        node = WsgGripper("gripper", namespace=name, parameter_overrides=overrides)
        nodes.append(node)
        executor.add_node(node)
        client.driver = node
        return client

    yield start
    for node in nodes:
        node.end("end of the test")
    executor.shutdown()
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    with Simulator(part=20, homing_speed=400) as simulator:
        yield simulator


@pytest.fixture
def gripper(grippers: Callable[..., Client], simulator: Simulator) -> Client:
    """An active, homed gripper."""
    client = grippers(address=simulator.tcp)
    wait_until(lambda: client.lifecycle() == "active")
    for _ in range(20):
        success, message = client.call("home")
        if not any(text in message for text in ("may be old", "the outcome of the request is unknown")):
            break
        # The machine paused a program, perhaps for so long that the connection ended: the gripper then enters FAST STOP.
        client.call("acknowledge")
    assert success, message
    return client
