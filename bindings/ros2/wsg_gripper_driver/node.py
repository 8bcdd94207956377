"""The lifecycle node ``wsg_gripper``."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import traceback
from contextlib import contextmanager
from functools import partial
from itertools import count
from math import inf, nan
from typing import Any, Callable, Iterator, Optional

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from wsg_gripper import BlockedError, BusyError, Gripper, GripperError, InvalidError, NotConnectedError, SystemFlags

from . import units
from .link import Link, Reading, Requests, Source, Stream
from .motions import POLL_PERIOD, Halted, Motions, NoPart, Run, close_on, move_to

try:
    from control_msgs.action import ParallelGripperCommand as Command
except ImportError:
    try:  # Humble
        from control_msgs.action import GripperCommand as Command
    except ImportError:
        Command = None

# Threads of an executor for each node. At most five callbacks of a node wait at once: a motion, another request, a lifecycle
# transition and the stops.
THREADS = 8
# Age in s from which a request is refused and a state is not shown as current.
LATE = 1.0
# Time in s after a pause of the executor, in which it may run requests from before the pause.
CATCHING_UP = 1.0
# Polls of a motion for each feedback of the action.
FEEDBACK_POLLS = 5
# Longest wait in s for the delivery of a result at the end of the program.
RESULT_TIMEOUT = 0.5

# Parameters: name, default, range, description. Changes of the first list require a cleanup of the node.
FIXED = (
    ("address", "", None, "Address of the gripper, such as tcp://192.168.1.20; empty: none"),
    ("mode", "request", None, "request: services and ~/gripper_cmd move the fingers; stream: ~/joint_commands"),
    ("prefix", "", None, "Prefix of the joint names, as in the URDF"),
    ("joint_state_rate", 20.0, (10.0, 200.0), "Rate of joint_states, and of set-points in mode stream, in Hz"),
    ("reconnect_period", 1.0, (0.0, 60.0), "Time between two attempts to connect in s; 0: never connect again"),
)
READ_ONLY = (
    ("autostart", True, None, "Configure and activate the node at its start"),
    ("diagnostics_rate", 1.0, (0.1, 10.0), "Rate of /diagnostics in Hz"),
)
FREE = (
    ("home_on_activate", False, None, "Home at activation if the gripper is not referenced: the fingers move"),
    ("speed", 0.1, (0.001, 0.5), "Speed of the opening in m/s, unless a goal requests another one"),
    ("force", 40.0, (1.0, 700.0), "Force in N, summed over both fingers, of ~/grip and of a stream"),
    ("grip_width", 0.0, (0.0, 0.25), "Opening in m to which ~/grip closes"),
    ("release_width", 0.0, (0.0, 0.25), "Opening in m to which ~/release opens; 0: the stroke"),
    ("contact_grip", True, None, "true: grip parts of any width by contact; false: the part has the requested width"),
)


class GoalServer(ActionServer):
    """An action server that knows whether it has sent the result of its last goal."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.result_sent = threading.Event()
        self.result_sent.set()
        super().__init__(*arguments, **options)

    def _send_result_response(self, *arguments: Any) -> None:
        super()._send_result_response(*arguments)
        self.result_sent.set()


class WsgGripper(LifecycleNode):
    """A gripper as a lifecycle node. It needs an executor with ``THREADS`` threads.

    Nothing moves and nothing is acknowledged without a request, except by the parameter ``home_on_activate``.
    """

    def __init__(self, name: str = "wsg_gripper", **options: Any) -> None:
        self._link: Optional[Link] = None
        self._motions = Motions()
        self._goals: Optional[GoalServer] = None
        self._is_active = False
        self._joints: list[str] = []
        self._reading: Optional[Reading] = None
        # No request waits for another one, to run late: it runs at once or is refused.
        self._group = ReentrantCallbackGroup()
        self._requesting = threading.Lock()
        self._fast_stops = 0
        # Halts before the stream began. Another one ends it.
        self._halts_of_stream = -1
        self._is_starting = False
        # Times of the last call by the executor, and of the last pause.
        self._ticked, self._paused = inf, -inf
        # The reason why there is no connection, and the last error.
        self._loss, self._last_error = "not configured", ""
        self._published_state = ""
        super().__init__(name, **options)
        for parameter, default, limits, text in FIXED + READ_ONLY + FREE:
            ranges = [FloatingPointRange(from_value=limits[0], to_value=limits[1])] if limits else []
            is_read_only = parameter in (it[0] for it in READ_ONLY)
            descriptor = ParameterDescriptor(description=text, read_only=is_read_only, floating_point_range=ranges)
            self.declare_parameter(parameter, default, descriptor)
        self.add_on_set_parameters_callback(self._check_parameters)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        stop, fast_stop, set_points, health, tick = (MutuallyExclusiveCallbackGroup() for _ in range(5))
        self._joint_states = self.create_publisher(JointState, "joint_states", 10)
        self._states = self.create_publisher(String, "~/state", latched)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        for act in (self._home, self._grip, self._release, self._acknowledge, self._tare):
            self.create_service(Trigger, f"~/{act.__name__[1:]}", self._answering(act))
        for service, is_fast, group in (("~/stop", False, stop), ("~/fast_stop", True, fast_stop)):
            halt = self._answering(partial(self._halt, service, is_fast))
            self.create_service(Trigger, service, halt, callback_group=group)
        self.create_subscription(JointState, "~/joint_commands", self._follow, latest, callback_group=set_points)
        if Command is None:
            self.get_logger().warning("control_msgs is not installed: ~/gripper_cmd does not exist")
        else:
            self._goals = GoalServer(
                self,
                Command,
                "~/gripper_cmd",
                self._execute,
                goal_callback=self._accept,
                handle_accepted_callback=self._admit,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
            )
        self._publish_state("NO_CONNECTION")
        # Simulated time may stand still.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1 / self._value("diagnostics_rate"), self._publish_health, callback_group=health, clock=clock)
        self.create_timer(0.1, self._tick, callback_group=tick, clock=clock)
        if self._value("autostart"):
            self._start = self.create_timer(0, self._autostart, clock=clock)

    @property
    def default_callback_group(self) -> ReentrantCallbackGroup:
        return self._group

    def _tick(self) -> None:
        now = time.monotonic()
        if now - self._ticked > LATE:
            self._paused = now
        self._ticked = now

    def _check_age(self) -> None:
        """Refuse requests that may have waited in a paused or busy executor. A request has no time that all clients set."""
        now = time.monotonic()
        if now - self._ticked > LATE or now - self._paused < CATCHING_UP:
            raise GripperError(f"the program paused for more than {LATE} s, and the request may be old: repeat it")

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _check_parameters(self, parameters: list[Any]) -> SetParametersResult:
        fixed = self._link is not None and {it.name for it in parameters} & {name for name, *_ in FIXED}
        return SetParametersResult(successful=not fixed, reason=f"cleanup of the node first: {fixed}" if fixed else "")

    # Lifecycle

    def _autostart(self) -> None:
        self._start.cancel()
        halts = self._motions.halts
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            if self._motions.halts != halts:
                self._fail(f"not activated: {self._motions.reason}")
                return
            self._is_starting = True
            self.trigger_activate()
            self._is_starting = False

    def _fail(self, text: str) -> TransitionCallbackReturn:
        self._last_error = text
        self.get_logger().error(text)
        return TransitionCallbackReturn.FAILURE

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        address, mode, rate, period = map(self._value, ("address", "mode", "joint_state_rate", "reconnect_period"))
        if not address:
            return self._fail("the parameter address is empty; expected an address such as tcp://192.168.1.20")
        if mode not in ("request", "stream"):
            return self._fail(f"the parameter mode is {mode}; expected request or stream")
        self._joints = units.joint_names(self._value("prefix"))
        self._link = Link(address, rate, period, self._opened, self._publish_reading, self._lost)
        self._link.start()
        try:
            self._link.wait()
        except Exception as error:
            if isinstance(error, InvalidError) or period == 0:
                self._end_link()
                return self._fail(units.description(error))
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            if not self._is_starting:
                self._check_age()
            with self._motions.run() as run:
                if self._value("home_on_activate"):
                    gripper = self._connected().gripper()
                    if SystemFlags.REFERENCED not in gripper.flags():
                        run.wait(gripper, gripper.begin_home)
                if self._value("mode") == "stream":
                    self._open_stream(run.halts)
                run.check()
                self._is_active = True
        except Exception as error:
            return self._fail(f"cannot activate: {units.description(error)}")
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._rest("the node was deactivated")
        try:
            if self._value("mode") == "stream":
                self._connected().stream(None)
        except Exception as error:
            self._note(error)
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._end_link()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.end("the node was shut down, or a transition failed")
        return TransitionCallbackReturn.SUCCESS

    on_error = on_shutdown

    def _rest(self, reason: str) -> None:
        """Stop a running motion. A held part stays held."""
        self._is_active = False
        self._motions.halt_and_wait(reason)

    def end(self, reason: str) -> None:
        """Stop the fingers, abort a running goal, and announce the end of the connection."""
        self._rest(reason)
        self._end_link()

    def _end_link(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()
            self._set_loss("not configured")

    def destroy_node(self) -> None:
        self.end("the node was destroyed")
        super().destroy_node()

    # Connection

    def _connected(self) -> Link:
        link = self._link
        if link is None:
            raise NotConnectedError("the node is not configured")
        return link

    def _opened(self, source: Source) -> None:
        self._loss = ""
        if isinstance(source, Requests):
            self.get_logger().info(f"connected to {source.device}: {units.health(source.first.flags)[1]}")
            self._publish_reading(source.first)
            self._publish_health()

    def _lost(self, error: Exception) -> None:
        if self._set_loss(units.description(error)):
            self._note(error)

    def _set_loss(self, text: str) -> bool:
        """Publish the reason why there is no connection. Return whether it is a new one."""
        is_new, self._reading, self._loss = text != self._loss, None, text
        if is_new:
            self._publish_state("NO_CONNECTION")
            self._publish_health()
        return is_new

    def _note(self, error: Exception, what: str = "") -> None:
        self._last_error = what + units.description(error)
        self.get_logger().warning(self._last_error)

    # Publications

    def _joint_state(self, reading: Reading) -> JointState:
        message = JointState(name=self._joints)
        age = int(max(0.0, time.monotonic() - reading.at) * 1e9)
        message.header.stamp = Time(nanoseconds=max(0, self.get_clock().now().nanoseconds - age)).to_msg()
        values = (reading.width / 1000, reading.speed / 1000, reading.force)
        message.position, message.velocity, message.effort = ([value / units.FINGERS] * 2 for value in values)
        return message

    def _publish_reading(self, reading: Reading) -> None:
        self._reading = reading
        self._publish_state(reading.state)
        # Without a reference, positions have no meaning.
        if SystemFlags.REFERENCED in reading.flags:
            self._joint_states.publish(self._joint_state(reading))

    def _publish_state(self, state: str) -> None:
        if state != self._published_state:
            self._published_state = state
            self._states.publish(String(data=state))

    def _publish_health(self) -> None:
        reading, loss = self._reading, self._loss
        values = {"state": self._published_state, "mode": self._value("mode"), "last error": self._last_error}
        level, text = units.STALE, loss or "connecting"
        if reading is not None and not loss:
            level, text = units.health(reading.flags)
            if time.monotonic() - reading.at > LATE:
                level, text = units.STALE, f"no state for {time.monotonic() - reading.at:.1f} s"
            values["flags"] = " ".join(flag.name or "" for flag in SystemFlags if flag in reading.flags)
            if reading.temperature is not None:
                values["temperature"] = f"{reading.temperature:.1f} °C"
        status = DiagnosticStatus(level=bytes([level]), message=text, hardware_id=self._value("address"))
        status.name = f"{self.get_fully_qualified_name()[1:]}: gripper"
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    # Services

    def _answering(self, act: Callable[[], Optional[str]]) -> Callable[[Any, Any], Any]:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message, response.success = act() or "done", True
            except Exception as error:
                self._note(error)
                response.message = units.description(error)
            return response

        return answer

    def _halt(self, service: str, fast: bool) -> None:
        self._fast_stops += fast
        self._motions.halt(f"stopped by {service}")
        self._connected().halt(fast)

    @contextmanager
    def _requests(self) -> Iterator[Gripper]:
        """Yield the driver for requests. A running stream is suspended, and stays ended if the request fails."""
        self._check_age()
        if not self._requesting.acquire(blocking=False):
            raise BusyError("another request is running")
        try:
            link, halts = self._connected(), self._motions.halts
            is_streaming = link.is_streaming
            if is_streaming:
                link.stream(None)
            yield link.gripper()
            if is_streaming:
                self._open_stream(halts)
        finally:
            self._requesting.release()

    @contextmanager
    def _motion(self, halts: Optional[int] = None) -> Iterator[Run]:
        self._check_age()
        with self._motions.run(halts) as run:
            if not self._is_active:
                raise GripperError("the node is not active: a motion requires the lifecycle state active")
            yield run

    def _home(self) -> None:
        with self._motion() as run, self._requests() as gripper:
            run.wait(gripper, gripper.begin_home)

    def _acknowledge(self) -> None:
        stops = self._fast_stops
        with self._requests() as gripper:
            if self._fast_stops == stops:
                gripper.acknowledge()
            if self._fast_stops != stops:
                # It must lock the fingers although the acknowledgement may have passed it.
                gripper.fast_stop()
                raise Halted(self._motions.reason)

    def _tare(self) -> None:
        with self._requests() as gripper:
            gripper.tare()

    def _grip(self) -> str:
        speed, force, width, is_contact = map(self._value, ("speed", "force", "grip_width", "contact_grip"))
        with self._motion() as run:
            gripper = self._connected().gripper()
            if not close_on(run, gripper, width * 1000, speed * 1000, force, not is_contact):
                raise NoPart("NO_PART: the fingers met no part")
        return "HOLDING"

    def _release(self) -> None:
        with self._motion() as run:
            link = self._connected()
            width = self._value("release_width") * 1000 or link.source.limits.stroke
            move_to(run, link.gripper(), width, self._value("speed") * 1000)

    # Set-points

    def _open_stream(self, halts: int) -> None:
        """Begin to stream, unless there was another halt since."""
        address, rate, speed, force = map(self._value, ("address", "joint_state_rate", "speed", "force"))
        link = self._connected()
        link.gripper().flags()  # Without a connection, a stream that opens later would be a surprise.
        self._halts_of_stream = halts
        link.stream(lambda: Stream(address, rate, speed * 1000, force))
        if self._motions.halts != halts:
            link.stream(None)
            raise Halted(self._motions.reason)

    def _follow(self, command: JointState) -> None:
        link = self._link
        try:
            self._check_age()
            is_halted = self._motions.halts != self._halts_of_stream
            if not self._is_active or is_halted or link is None or not isinstance(source := link.source, Stream):
                raise GripperError("no stream runs: it begins with the activation in mode stream, and a stop ends it")
            target = units.target(command.name, command.position, [], [], self._joints, source.limits)
            source.gripper.set_target(target.width)
        except (ValueError, GripperError) as error:
            text = f"refused a set-point of ~/joint_commands: {units.description(error)}"
            self.get_logger().warning(text, throttle_duration_sec=1.0)

    # Goals

    def _target(self, goal: Any) -> units.Target:
        """Convert a goal. Raises ``ValueError`` or ``GripperError`` with the reason for a refusal."""
        link, command = self._connected(), goal.command
        limits = link.source.limits
        if isinstance(command, JointState):
            values = (command.name, command.position, command.velocity, command.effort)
        else:
            values = ([], [command.position], [], [command.max_effort])
        return units.target(*values, self._joints, limits)

    def _accept(self, goal: Any) -> GoalResponse:
        try:
            self._check_age()
            if not self._is_active or self._motions.is_running:
                raise GripperError("another motion is running" if self._is_active else "the node is not active")
            self._connected().gripper()
            self._target(goal)
        except (ValueError, GripperError) as error:
            self._note(error, "refused a goal: ")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _admit(self, handle: Any) -> None:
        """Let the executor run an accepted goal, unless it is halted before."""
        halts = self._motions.halts
        self._goals.result_sent.clear()
        handle.execute(partial(self._execute, halts))

    def _execute(self, halts: int, handle: Any) -> Any:
        outcome, polls = {"stalled": False, "reached_goal": False}, count(1)

        def tick() -> None:
            if next(polls) % FEEDBACK_POLLS == 0:
                handle.publish_feedback(self._filled(Command.Feedback(), self._reading, {}))
            time.sleep(POLL_PERIOD)

        try:
            with self._motion(halts) as run:
                run.is_cancelled, run.tick = lambda: handle.is_cancel_requested, tick
                target, gripper = self._target(handle.request), self._connected().gripper()
                speed = target.speed or self._value("speed") * 1000
                if target.force is not None and target.width < gripper.width() + units.TOLERANCE:
                    is_known = not self._value("contact_grip")
                    outcome["stalled"] = close_on(run, gripper, target.width, speed, target.force, is_known)
                else:
                    move_to(run, gripper, target.width, speed)
                outcome["reached_goal"] = not outcome["stalled"]
            handle.succeed()
        except Exception as error:
            outcome["stalled"] = isinstance(error, BlockedError)
            if isinstance(error, Halted) and handle.is_cancel_requested:
                handle.canceled()
            else:
                self._note(error, "aborted the goal: ")
                handle.abort()
        return self._filled(Command.Result(), self._reading_since(time.monotonic()), outcome)

    def _reading_since(self, begin: float) -> Optional[Reading]:
        """Wait for values that arrived after a time of ``time.monotonic()``. Return ``None`` without a connection."""
        end = time.monotonic() + LATE
        while (reading := self._reading) is None or reading.at < begin:
            if self._loss or time.monotonic() > end:
                return None
            time.sleep(POLL_PERIOD)
        return reading

    def _filled(self, message: Any, reading: Optional[Reading], outcome: dict[str, bool]) -> Any:
        """Fill a result or a feedback with a state. Without one, it has no values, or NaN."""
        state = JointState() if reading is None else self._joint_state(reading)
        if hasattr(message, "state"):
            message.state = state
        else:
            message.position, message.effort = ([*it, nan][0] for it in (state.position, state.effort))
        for name, value in outcome.items():
            setattr(message, name, value)
        return message

    def wait_for_result(self) -> None:
        """Wait until the result of the last goal has been sent. The executor must run."""
        if self._goals is not None:
            self._goals.result_sent.wait(RESULT_TIMEOUT)


def main(args: Optional[list[str]] = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    ends = {signal.SIGINT, signal.SIGTERM}
    for number in ends:
        # A shell starts background jobs with SIGINT ignored.
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_BLOCK, ends)
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = WsgGripper()
    except Exception as error:  # A parameter with a wrong type or outside its range.
        print(f"error: {error}", file=sys.stderr)
        rclpy.shutdown()
        return 1
    executor = MultiThreadedExecutor(THREADS)
    executor.add_node(node)
    is_ending, failures = threading.Event(), []

    def spin() -> None:
        try:
            while not is_ending.is_set():
                executor.spin_once()
        except BaseException:
            failures.append(traceback.format_exc())
            os.kill(os.getpid(), signal.SIGTERM)

    spinning = threading.Thread(target=spin, name="executor", daemon=True)
    spinning.start()
    number = signal.sigwait(ends)
    node.end(f"{signal.Signals(number).name} was received")
    node.wait_for_result()
    is_ending.set()
    # A callback ends the wait of the executor, which `wake` does not.
    executor.create_task(lambda: None)
    spinning.join()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    print(*failures, sep="", end="", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
