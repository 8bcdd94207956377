"""A gripper for LeRobot: one axis, the opening width in mm. An action is a set-point of the stream."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lerobot.robots import Robot
from lerobot.utils.decorators import check_if_already_connected
from lerobot.utils.errors import DeviceNotConnectedError
from wsg_gripper import NotConnectedError, Sample, StreamEndedError, StreamingGripper, SystemFlags

from .config_wsg import WsgConfig, WsgGripperConfig

MAX_AGE = 0.1
"""Greatest age of an observation in s. For an older one, the next sample is awaited."""


@contextmanager
def _reports_loss() -> Iterator[None]:
    try:
        yield
    except (NotConnectedError, StreamEndedError) as error:
        raise DeviceNotConnectedError(str(error)) from error


class WsgGripper:
    """A gripper as a part of a robot, which merges its features, observations and actions.

    All keys begin with the prefix. Every method but ``connect``, ``calibrate`` and ``disconnect`` returns at once, unless an answer
    of the gripper is late. ``DeviceNotConnectedError`` means that the stream has ended: the connection is lost, the gripper is in
    FAST STOP, or another client stopped it. Nothing resumes by itself.
    """

    def __init__(self, config: WsgGripperConfig, prefix: str = "gripper") -> None:
        self.config = config
        self._keys = {f"{prefix}.pos": "position", f"{prefix}.vel": "speed", f"{prefix}.force": "force"}
        self._action = f"{prefix}.pos"
        self._stream: StreamingGripper | None = None

    @property
    def observation_features(self) -> dict[str, type]:
        """Opening width in mm, finger speed in mm/s (closing is negative), and force in N, summed over both fingers."""
        return dict.fromkeys(self._keys, float)

    @property
    def action_features(self) -> dict[str, type]:
        """Opening width in mm."""
        return {self._action: float}

    @property
    def is_connected(self) -> bool:
        """Whether the stream runs."""
        return self._stream is not None and self._stream.is_ready

    @property
    def is_calibrated(self) -> bool:
        """Whether the gripper is referenced. False without a connection."""
        return self.is_connected and SystemFlags.REFERENCED in self._latest().flags

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Connect. With ``calibrate``, require a referenced gripper, and home it only if the configuration has ``home_on_connect``.

        Nothing else moves the fingers or acknowledges a FAST STOP. Raises ``DeviceNotConnectedError`` without a connection and in
        FAST STOP, and ``InvalidError`` (a ``ValueError``) for values outside the limits of the gripper.
        """
        self.disconnect()
        config = self.config
        stream = StreamingGripper(
            config.address, config.frequency, home=None, max_speed=config.max_speed, force=config.force
        )
        with _reports_loss():
            stream.start()
        self._stream = stream
        try:
            is_referenced = SystemFlags.REFERENCED in self._latest().flags
            if calibrate and not is_referenced and config.home_on_connect:
                self.calibrate()
            elif calibrate:
                self._require_reference(is_referenced)
        except BaseException:
            self.disconnect()
            raise

    def calibrate(self) -> None:
        """Home the gripper, which moves the fingers to an end stop."""
        with _reports_loss():
            self._running().home(self.config.homing_direction)

    def get_observation(self) -> dict[str, Any]:
        """Return the state. It is not older than 0.1 s, or two periods if they are longer, plus the delay of the line."""
        with _reports_loss():
            sample = self._latest()
            if sample.age > max(MAX_AGE, 2 / self.config.frequency):
                with self._running().subscribe() as samples:
                    sample = next(samples)
        self._require_reference(SystemFlags.REFERENCED in sample.flags)
        return {key: getattr(sample, name) for key, name in self._keys.items()}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Move to the width at the speed limit, and return the action sent. It replaces the one before, also during its motion.

        Other keys of ``action`` are ignored. Raises ``InvalidError`` (a ``ValueError``) for a width outside the stroke: nothing is
        clipped, and the fingers continue to the width before.
        """
        width = float(action[self._action])
        self._require_reference(SystemFlags.REFERENCED in self._latest().flags)
        with _reports_loss():
            self._running().set_target(width)
        return {self._action: width}

    def disconnect(self) -> None:
        """Stop the fingers, which releases a held part, and end the connection. It has no effect without one."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.stop()

    def _running(self) -> StreamingGripper:
        if self._stream is None:
            raise DeviceNotConnectedError
        return self._stream

    def _latest(self) -> Sample:
        with _reports_loss():
            return self._running().latest()

    def _require_reference(self, is_referenced: bool) -> None:
        if not is_referenced:
            text = "is not referenced; make sure that the fingers may move, and run lerobot-calibrate or set home_on_connect"
            raise RuntimeError(f"the gripper at {self.config.address} {text}")


class Wsg(Robot):
    """A gripper as a robot; see :class:`WsgGripper` for all methods."""

    config_class = WsgConfig
    name = "wsg"

    def __init__(self, config: WsgConfig) -> None:
        super().__init__(config)
        self.config = config
        self.gripper = WsgGripper(config)

    @property
    def observation_features(self) -> dict[str, type]:
        return self.gripper.observation_features

    @property
    def action_features(self) -> dict[str, type]:
        return self.gripper.action_features

    @property
    def is_connected(self) -> bool:
        return self.gripper.is_connected

    def connect(self, calibrate: bool = True) -> None:
        self.gripper.connect(calibrate)

    @property
    def is_calibrated(self) -> bool:
        return self.gripper.is_calibrated

    def calibrate(self) -> None:
        self.gripper.calibrate()

    def configure(self) -> None:
        """Do nothing: ``connect`` sets the limits of speed and force."""

    def get_observation(self) -> dict[str, Any]:
        return self.gripper.get_observation()

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        return self.gripper.send_action(action)

    def disconnect(self) -> None:
        self.gripper.disconnect()
