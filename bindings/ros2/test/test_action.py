"""The action ~/gripper_cmd, with the stand-in for control_msgs (build_stand_in.py)."""

from __future__ import annotations

from typing import Any, Callable

import pytest
from action_msgs.msg import GoalStatus
from conftest import Client, is_moving, wait_for, wait_until
from sensor_msgs.msg import JointState
from wsg_gripper.sim import Simulator

actions = pytest.importorskip("control_msgs.action")
from rclpy.action import ActionClient  # noqa: E402

LEFT = "wsg_finger_left_joint"


class Goals:
    """A client of the action. Positions in m, velocities in m/s and efforts in N of one finger."""

    def __init__(self, client: Client) -> None:
        self.client = ActionClient(client.node, actions.ParallelGripperCommand, f"/{client.name}/gripper/gripper_cmd")
        assert self.client.wait_for_server(60)
        self.feedback: list[Any] = []

    def send(self, position: list[float], velocity: list[float] = [], effort: list[float] = [], name: list[str] = []) -> Any:
        goal = actions.ParallelGripperCommand.Goal()
        goal.command = JointState(name=name, position=position, velocity=velocity, effort=effort)
        return wait_for(self.client.send_goal_async(goal, lambda it: self.feedback.append(it.feedback)))

    def run(self, *arguments: Any, **options: Any) -> tuple[int, Any]:
        handle = self.send(*arguments, **options)
        assert handle.accepted
        return self.outcome(handle)

    def outcome(self, handle: Any) -> tuple[int, Any]:
        response = wait_for(handle.get_result_async())
        return response.status, response.result


@pytest.fixture
def goals(gripper: Client) -> Goals:
    return Goals(gripper)


def test_goal_grips_a_part_of_unknown_width_and_releases_it(goals: Goals, simulator: Simulator) -> None:
    status, result = goals.run([0.0], [0.1], [15.0], [LEFT])
    assert (status, result.stalled, result.reached_goal) == (GoalStatus.STATUS_SUCCEEDED, True, False)
    assert list(result.state.position) == pytest.approx([0.0098] * 2, abs=3e-4)
    assert simulator.observe().force == pytest.approx(30, abs=1), "the effort of both fingers"
    assert goals.feedback and 0.01 < goals.feedback[0].state.position[0] <= 0.055
    status, result = goals.run([0.0], effort=[20.0])
    assert (status, result.stalled) == (GoalStatus.STATUS_SUCCEEDED, True), "a held part with another effort"
    assert simulator.observe().force == pytest.approx(40, abs=1)
    assert goals.run([0.005])[0] == GoalStatus.STATUS_ABORTED, "a held part is in the way"
    status, result = goals.run([0.04, 0.04], name=[LEFT, "wsg_finger_right_joint"])
    assert (status, result.stalled, result.reached_goal) == (GoalStatus.STATUS_SUCCEEDED, False, True)
    assert simulator.observe().width == pytest.approx(80, abs=0.1)


def test_obstacle_aborts_a_goal_without_effort(goals: Goals, simulator: Simulator) -> None:
    status, result = goals.run([0.0], [0.1])
    assert (status, result.stalled, result.reached_goal) == (GoalStatus.STATUS_ABORTED, True, False)
    simulator.set_part(None)
    status, result = goals.run([0.0], [0.1], [15.0])
    assert (status, result.stalled, result.reached_goal) == (GoalStatus.STATUS_SUCCEEDED, False, True), "without contact"


def test_cancelled_goal_stops_the_fingers(goals: Goals, simulator: Simulator) -> None:
    handle = goals.send([0.0], [0.01])
    wait_until(lambda: is_moving(simulator))
    assert not goals.send([0.03]).accepted, "one goal at a time"
    wait_for(handle.cancel_goal_async())
    assert goals.outcome(handle)[0] == GoalStatus.STATUS_CANCELED
    assert not is_moving(simulator) and simulator.observe().width > 50


@pytest.mark.parametrize("end", ["stop", "fast_stop", "deactivate"])
def test_goal_is_aborted_with_the_reason(goals: Goals, gripper: Client, simulator: Simulator, end: str) -> None:
    handle = goals.send([0.0], [0.01], [10.0])
    wait_until(lambda: is_moving(simulator))
    if end == "deactivate":
        assert gripper.change(end)
    else:
        gripper.ok(end)
    assert goals.outcome(handle)[0] == GoalStatus.STATUS_ABORTED
    assert not is_moving(simulator) and simulator.observe().width > 50
    reason = "the node was deactivated" if end == "deactivate" else f"stopped by ~/{end}"
    gripper.wait_for_diagnosed("last error", f"aborted the goal: Halted: {reason}")
    assert goals.send([0.03]).accepted == (end != "deactivate")


def test_goals_outside_the_limits_are_refused(goals: Goals, simulator: Simulator) -> None:
    nan = float("nan")
    for refused in (
        ([0.056],),
        ([-0.001],),
        ([nan],),
        ([],),
        ([0.03], [0.3]),
        ([0.03], [0.001]),
        ([0.03], [], [70.0]),
        ([0.03], [], [nan]),
        ([0.03], [], [], ["elbow"]),
        ([0.03, 0.02], [], [], [LEFT, "wsg_finger_right_joint"]),
    ):
        assert not goals.send(*refused).accepted, refused
    assert simulator.observe().width == pytest.approx(110, abs=0.1)


def test_gripper_command_of_humble(monkeypatch: Any, grippers: Callable[..., Client], simulator: Simulator) -> None:
    monkeypatch.setattr("wsg_gripper_driver.node.Command", actions.GripperCommand)
    client = grippers(address=simulator.tcp, home_on_activate=True)
    client.wait_until_active()
    server = ActionClient(client.node, actions.GripperCommand, f"/{client.name}/gripper/gripper_cmd")
    assert server.wait_for_server(60)
    goal = actions.GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = 0.0, 15.0
    result = wait_for(wait_for(server.send_goal_async(goal)).get_result_async()).result
    assert (result.stalled, result.reached_goal) == (True, False)
    assert (result.position, result.effort) == (pytest.approx(0.0098, abs=3e-4), pytest.approx(15, abs=0.5))


def test_known_width_and_lost_connection(grippers: Callable[..., Client], simulator: Simulator) -> None:
    client = grippers(address=simulator.tcp, contact_grip=False, home_on_activate=True)
    client.wait_until_active()
    goals = Goals(client)
    assert goals.run([0.01], effort=[15.0])[1].stalled, "the width of the part"
    goals.run([0.05])
    assert goals.run([0.002], effort=[15.0])[0] == GoalStatus.STATUS_ABORTED, "another width"
    goals.run([0.05])
    handle = goals.send([0.0], [0.01])
    wait_until(lambda: is_moving(simulator))
    simulator.close()
    status, result = goals.outcome(handle)
    assert (status, list(result.state.position)) == (GoalStatus.STATUS_ABORTED, []), "no old value"
