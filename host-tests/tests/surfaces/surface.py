"""Executes requests from standard input, each in a thread, and prints their outcomes."""

import asyncio
import math
import sys
import threading
import time

from wsg_gripper import AsyncGripper, Gripper, NotConnectedError, StoppedError, StreamEndedError, StreamingGripper
from wsg_gripper.umi import WSGController

kind, host, port = sys.argv[1:]
address = f"tcp://{host}:{port}"
lock = threading.Lock()


def blocking():
    gripper = Gripper(address)

    def grip(width, speed, force):
        return gripper.grip(width, speed=speed, force=force)

    def acknowledge():
        try:
            return gripper.acknowledge()
        except StoppedError:
            return gripper.acknowledge()

    def move(width, speed):
        return gripper.move(width, speed=speed)

    return dict(home=gripper.home, move=move, grip=grip, fast_stop=gripper.fast_stop, acknowledge=acknowledge,
                read=gripper.width)


def asynchronous():
    loop = asyncio.new_event_loop()
    threading.Thread(target=loop.run_forever, daemon=True).start()

    def wait(coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result()

    async def connect():
        return await AsyncGripper(address)

    gripper = wait(connect())

    async def observe():
        async for _ in gripper.subscribe():
            pass

    # Beside all requests, until the connection is lost.
    asyncio.run_coroutine_threadsafe(observe(), loop)

    async def acknowledge():
        try:
            return await gripper.acknowledge()
        except StoppedError:
            return await gripper.acknowledge()

    return dict(
        home=lambda: wait(gripper.home()),
        move=lambda width, speed: wait(gripper.move(width, speed=speed)),
        grip=lambda width, speed, force: wait(gripper.grip(width, speed=speed, force=force)),
        fast_stop=lambda: wait(gripper.fast_stop()),
        acknowledge=lambda: wait(acknowledge()),
        read=lambda: wait(gripper.width()),
    )


def streamed(make, move, read):
    """Return the verbs of a class that streams. ``start`` homes, so the first one is in the verb for it."""
    gripper = make()

    def acknowledge():
        try:
            gripper.acknowledge()
        except (NotConnectedError, StreamEndedError):
            gripper.stop()
            with Gripper(address) as own:
                own.acknowledge()

    def home():
        if gripper.is_ready:
            gripper.home()
        else:
            gripper.stop()
            gripper.start()

    def grip(width, speed, force):
        gripper.set_force_limit(force)
        move(gripper, width, speed)

    return dict(
        home=home,
        move=lambda width, speed: move(gripper, width, speed),
        grip=grip,
        fast_stop=lambda: gripper.fast_stop(),
        acknowledge=acknowledge,
        read=lambda: read(gripper),
    )


def streaming():
    def move(gripper, width, speed):
        gripper.set_speed_limit(speed)
        gripper.set_target(width)

    return streamed(lambda: StreamingGripper(address), move, lambda gripper: gripper.latest().position)


def umi():
    def move(gripper, width, speed):
        # Between two set-points, at this speed.
        way = abs(width - gripper.get_state()["gripper_position"])
        gripper.schedule_waypoint(width, time.time() + way / speed)

    def read(gripper):
        position = gripper.get_state()["gripper_position"]
        if math.isnan(position):
            raise ValueError("no position")
        return position

    return streamed(lambda: WSGController(None, host, int(port)), move, read)


verbs = {"Gripper": blocking, "AsyncGripper": asynchronous, "StreamingGripper": streaming, "WSGController": umi}[kind]()
print("ready", flush=True)


def act(number, verb, arguments):
    try:
        outcome = f"ok {verbs[verb](*arguments)}"
    except Exception as error:
        outcome = f"error {type(error).__name__}: {error}"
    with lock:
        print(number, outcome.replace("\n", " "), flush=True)


for line in sys.stdin:
    number, verb, *arguments = line.split()
    threading.Thread(target=act, args=(number, verb, [float(argument) for argument in arguments]), daemon=True).start()
