"""The robot: one axis, the opening width in mm. An action is a set-point of the stream."""

from __future__ import annotations

from typing import Any

from lerobot.robots import Robot
from wsg_gripper import HomingDirection, StreamingGripper

from .config_wsg import WsgConfig


class Wsg(Robot):
    """A WSG gripper."""

    config_class = WsgConfig
    name = "wsg"

    def __init__(self, config: WsgConfig) -> None:
        super().__init__(config)
        self._gripper = StreamingGripper(
            config.address,
            config.frequency,
            home=HomingDirection.OPEN,
            max_speed=config.max_speed,
            force=config.force,
        )

    @property
    def observation_features(self) -> dict[str, type]:
        return {"gripper.pos": float, "gripper.vel": float, "gripper.force": float}

    @property
    def action_features(self) -> dict[str, type]:
        return {"gripper.pos": float}

    @property
    def is_connected(self) -> bool:
        return self._gripper.is_ready

    def connect(self, calibrate: bool = True) -> None:
        """Connect, and reference the fingers at the outer end stop."""
        self._gripper.start()

    @property
    def is_calibrated(self) -> bool:
        """The gripper measures its width in mm: there is nothing to calibrate."""
        return True

    def calibrate(self) -> None:
        pass

    def configure(self) -> None:
        pass

    def get_observation(self) -> dict[str, Any]:
        """Return the latest state, without waiting for the gripper."""
        sample = self._gripper.latest()
        return {"gripper.pos": sample.position, "gripper.vel": sample.speed, "gripper.force": sample.force}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Move to the width at the speed limit. It replaces the action before, also during its motion.

        The gripper refuses a width outside its stroke, so it is clipped. The result has the width that was sent.
        """
        width = min(max(float(action["gripper.pos"]), 0.0), self._gripper.limits.stroke)
        self._gripper.set_target(width)
        return {"gripper.pos": width}

    def disconnect(self) -> None:
        """Stop the fingers and end the connection."""
        self._gripper.stop()
