"""The controller of UMI (Universal Manipulation Interface) over this package.

In UMI's ``real_world/umi_env.py``, replace one import::

    from wsg_gripper.umi import WSGController

The constructor, the methods and the keys of the states match UMI's ``WSGController``. Instead of a process with
shared memory there is a thread without the interpreter lock. NumPy is required.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Optional

from ._streaming import Sample, StreamingGripper
from ._types import HomingDirection

if TYPE_CHECKING:
    from numpy import float64
    from numpy.typing import NDArray

    State = dict[str, NDArray[float64]]

__all__ = ["WSGController"]


class WSGController(StreamingGripper):
    """UMI's interface to a gripper."""

    def __init__(
        self,
        shm_manager: object,
        hostname: str,
        port: int = 1000,
        frequency: float = 30,
        home_to_open: bool = True,
        move_max_speed: float = 200.0,
        get_max_k: Optional[int] = None,
        command_queue_size: int = 1024,
        launch_timeout: float = 3,
        receive_latency: float = 0.0,
        use_meters: bool = False,
        verbose: bool = False,
    ) -> None:
        """Prepare the controller. ``move_max_speed`` is in mm/s, and at most ``command_queue_size`` waypoints wait (4096).

        With ``use_meters`` positions and speeds are in m and m/s. ``shm_manager``, ``get_max_k``, ``launch_timeout`` and
        ``verbose`` have no effect.
        """
        super().__init__(
            f"tcp://{hostname}:{port}",
            frequency,
            home=HomingDirection.OPEN if home_to_open else HomingDirection.CLOSE,
            max_speed=move_max_speed,
            queue_size=command_queue_size,
        )
        self.receive_latency = receive_latency
        self.scale = 1000.0 if use_meters else 1.0

    def schedule_waypoint(self, pos: float, target_time: float) -> None:
        """Move to a position until a time of ``time.time()``.

        Raises ``InvalidError`` for a position outside the stroke. Clamp the actions of a policy to ``0..limits.stroke``, in mm.
        """
        super().schedule_waypoint(pos * self.scale, target_time)

    def restart_put(self, start_time: float) -> None:
        """Do nothing: the thread keeps its period, and waypoints have times of their own."""

    def get_state(self, k: Optional[int] = None, out: Optional[State] = None) -> State:
        """Return the latest state, or arrays of the last ``k`` states.

        Raises ``StreamEndedError`` after the end of the stream, for example when the connection is lost. To wait for each new
        sample instead, use :meth:`subscribe`.
        """
        state = self.get_all_state()
        last = {key: values[-1] if k is None else values[-k:] for key, values in state.items()}
        if out is None:
            return last
        for key, values in last.items():
            out[key][...] = values
        return out

    def get_all_state(self) -> State:
        """Return arrays of the states of the history, oldest first. The timestamps increase strictly.

        Raises ``StreamEndedError`` after the end of the stream, when no state is current. :meth:`history` remains available.
        """
        import numpy

        self.latest()  # Fails after the end of the stream.
        rows: Any = numpy.array(self.history())
        column = {name: rows[:, index] for index, name in enumerate(Sample._fields)}
        return {
            "gripper_state": column["flags"],
            "gripper_position": column["position"] / self.scale,
            "gripper_velocity": column["speed"] / self.scale,
            "gripper_force": column["force"],
            "gripper_measure_timestamp": column["measured"],
            "gripper_receive_timestamp": column["received"],
            "gripper_timestamp": column["received"] - self.receive_latency,
        }
