# A `profinet-py` controller for the virtual gripper: python3 -c SCRIPT PART [NUMBER].
# `profinet-py` is GPL. Only this test program runs it, and it is never part of a delivery.
import logging
import os
import signal
import struct
import subprocess
import sys
import threading
import time

import profinet
from profinet import CyclicController, IOCRSetup, IOSlot, ProfinetDevice, dcp
from profinet.exceptions import ProfinetError
from profinet.util import ethernet_socket, get_mac

INTERFACE, NAME, ADDRESS = "eth0", "wsg-test", "192.168.7.5"
MOVE, GRIP, RELEASE, HOMING, ACK, FASTSTOP = (1 << bit for bit in range(6))
IDLE, HOLDING = 0x01, 0x10
REFERENCED, IS_FAST_STOPPED = 1 << 0, 1 << 12
E_SUCCESS = 0
BOUND = 60
SLOTS = [
    IOSlot(0, 1, 0, 0, 1, 1),
    IOSlot(0, 0x8000, 0, 0, 1, 0x8000),
    IOSlot(0, 0x8001, 0, 0, 1, 0x8001),
    IOSlot(1, 1, 12, 0, 0x10, 0x11),
    IOSlot(2, 1, 0, 8, 0x20, 0x21),
]


def until(what, value):
    """Returns the first true value within the time limit."""
    end = time.monotonic() + BOUND
    while time.monotonic() < end:
        found = value()
        if found:
            return found
        time.sleep(0.004)
    raise SystemExit(f"{what}: time-out after {BOUND} s")


def sock():
    return ethernet_socket(INTERFACE)


def set_up():
    own = get_mac(INTERFACE)
    mac = until("identify", lambda: [device.mac for device in profinet.scan(INTERFACE, timeout=1)])[0]
    assert dcp.set_param(sock(), own, mac, "name", NAME, permanent=True)
    assert dcp.set_ip(sock(), own, mac, ADDRESS, "255.255.255.0", "192.168.7.1", permanent=True)
    assert dcp.signal_device(sock(), own, mac, duration_ms=10)


def image(flags, width=20_00, speed=100_00, force=40_00):
    return struct.pack(">BBhHh", flags, 0, width, speed, force)


class Plc:
    """A controller that exchanges images."""

    def __init__(self, watchdog=200, first=0):
        self.device = until("discover", self.discover)
        self.alarms = []
        self.device.on_alarm(lambda alarm: self.alarms.append(alarm.alarm_type_name))
        # The cycle is 8 ms. The connection ends after 1.6 s of silence, which covers a busy machine.
        setup = IOCRSetup(slots=SLOTS, reduction_ratio=8, watchdog_factor=watchdog, data_hold_factor=watchdog)
        start = CyclicController.start

        def start_with_first(cyclic):
            cyclic.set_output_data(2, 1, image(first, speed=5_00))
            start(cyclic)

        CyclicController.start = start_with_first
        self.cyclic = until("connect", lambda: self.connect(setup))
        CyclicController.start = start
        until("inputs", self.read)
        # The gripper has received some images of zeros, so flags count as edges.
        time.sleep(0.1)

    @staticmethod
    def discover():
        try:
            return ProfinetDevice.discover(NAME, INTERFACE, timeout=2)
        except (ProfinetError, OSError):
            return None

    def connect(self, setup):
        try:
            return self.device.start_cyclic(setup, max_consecutive_timeouts=0)
        except (ProfinetError, RuntimeError, OSError) as error:
            print("not connected yet:", error, file=sys.stderr)
            return None

    def write(self, flags, **parameters):
        self.cyclic.set_output_data(2, 1, image(flags, **parameters))

    def read(self):
        """Returns state, system state, width and status."""
        data = self.cyclic.get_input_data(1, 1)
        if data is None:
            return None
        return data[0], *struct.unpack("<I", data[2:6]), *struct.unpack(">hxxH", data[6:12])

    def command(self, flags, is_done, **parameters):
        self.write(0, **parameters)
        time.sleep(0.05)
        self.write(flags, **parameters)
        until(f"{flags:#x} {self.read()}", lambda: is_done(*self.read()))

    def release(self):
        self.cyclic.stop()
        self.device.disconnect()
        self.device.close()

    def home(self):
        self.command(HOMING, lambda state, flags, _, status: flags & REFERENCED and state == IDLE and status == E_SUCCESS)


def cycle():
    set_up()
    plc = Plc()
    plc.home()
    plc.command(GRIP, lambda state, *_: state == HOLDING)
    plc.command(RELEASE, lambda state, flags, width, status: state == IDLE and width == 50_00, width=50_00)
    plc.command(FASTSTOP, lambda state, flags, *_: flags & IS_FAST_STOPPED)
    until("alarm", lambda: plc.alarms == ["Diagnosis"])
    plc.command(ACK, lambda state, flags, *_: not flags & IS_FAST_STOPPED)
    until("end of the alarm", lambda: plc.alarms == ["Diagnosis", "DiagnosisDisappears"])
    plc.release()

    # Read and write records over a read-only connection.
    with ProfinetDevice.discover(NAME, INTERFACE, timeout=5) as device:
        im0 = device.read_im0()
        assert im0.vendor_id_high << 8 | im0.vendor_id_low == 0x02A2, im0
        assert b"4711 " in bytes(im0), im0
        slots = [(slot.slot, slot.subslot) for slot in device.discover_slots()]
        assert slots == [(slot.slot, slot.subslot) for slot in SLOTS], slots
        assert device.read_topology().interface.chassis_id == NAME
        try:
            device.write(0, 1, 0xAFF2, b"\x00\x22\x00\x12\x01\x00" + b"2026-11-23 16:00")
            raise SystemExit("a write over the read-only connection was accepted")
        except ProfinetError:
            pass

    # Connect again after a release.
    plc = Plc()
    assert plc.read()[2] == 50_00, plc.read()
    plc.release()


# I&M 1 (function and location), 2 and 3: block type and text, which includes quotation marks and an umlaut.
LABELS = {
    0xAFF1: (0x21, b"= gripper 1".ljust(32) + b"+ cell \"7\"".ljust(22)),
    0xAFF2: (0x22, b"2026-11-23 16:00"),
    0xAFF3: (0x23, "gr\u00fcn \\ links".encode("latin-1").ljust(54)),
}


def label():
    set_up()
    plc = Plc()
    for index, (kind, text) in LABELS.items():
        plc.device.write(0, 1, index, struct.pack(">HHBB", kind, len(text) + 2, 1, 0) + text)
    plc.release()


def labelled():
    """Connects to the name and address assigned before the restart."""
    device = until("discover", Plc.discover)
    assert device.ip == ADDRESS, device.ip
    with device:
        for index, (_, text) in LABELS.items():
            record = bytes(device.read(0, 1, index))
            assert record.endswith(text), (index, record)


def is_stopped(plc, flags):
    """Checks that the motion ended before its target and that no motion follows."""
    state, system, width, _ = plc.read()
    assert state == IDLE and not system & IS_FAST_STOPPED, (state, system)
    assert 20_00 < width < 110_00, width
    plc.write(flags)
    time.sleep(0.2)
    assert plc.read()[2] == width, (plc.read(), width)


def begin_to_move():
    plc = Plc()
    plc.home()
    # A motion of 90 mm at 5 mm/s.
    plc.command(MOVE, lambda state, flags, width, _: width < 109_00, speed=5_00)
    return plc


def cut():
    set_up()
    plc = begin_to_move()
    cable = lambda state: subprocess.run(["ip", "link", "set", INTERFACE, state], check=True)
    cable("down")
    plc.cyclic.stop()
    # Wait slightly longer than the gripper's time-out, which cannot be read.
    time.sleep(2.5)
    cable("up")
    subprocess.run(["ip", "address", "replace", "192.168.7.1/24", "dev", INTERFACE], check=True)
    plc = Plc()
    is_stopped(plc, 0)
    plc.release()


def killed():
    set_up()
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:
        plc = begin_to_move()
        os.write(writes, b"x")
        time.sleep(BOUND)
        os._exit(1)
    assert os.read(reads, 1) == b"x"
    os.kill(child, 9)
    os.waitpid(child, 0)
    # Connect as soon as the gripper has detected the loss.
    plc = Plc()
    is_stopped(plc, 0)
    plc.release()


def paused(pid):
    """Changes the outputs while the gateway is stopped for longer than it accepts old ones, but for less than the watchdog."""
    set_up()
    plc = Plc()
    plc.home()
    width = plc.read()[2]
    plc.write(0)
    time.sleep(0.1)
    os.kill(int(pid), signal.SIGSTOP)
    plc.write(MOVE)
    time.sleep(1.2)
    os.kill(int(pid), signal.SIGCONT)
    # The gateway has ended the connection, and sends no more inputs.
    def sees_no_inputs():
        count = plc.cyclic.stats.frames_received
        time.sleep(0.2)
        return plc.cyclic.stats.frames_received == count
    until("end of the connection", sees_no_inputs)
    plc.cyclic.stop()
    plc.device.close()
    plc = Plc(first=MOVE)
    assert plc.read()[2] == width, (plc.read(), width)
    # The gripper has lost its connection, too.
    plc.command(ACK, lambda state, flags, *_: not flags & IS_FAST_STOPPED)
    plc.command(MOVE, lambda state, flags, now, status: now == 20_00 and status == E_SUCCESS)
    plc.release()


def unmoved():
    """Checks that the device is as `cycle` left it, and still executes commands."""
    set_up()
    plc = Plc()
    state, flags, width, _ = plc.read()
    assert (state, flags & REFERENCED, flags & IS_FAST_STOPPED, width) == (IDLE, REFERENCED, 0, 50_00), plc.read()
    plc.command(GRIP, lambda state, *_: state == HOLDING)
    plc.release()


class Tampered:
    """A socket that modifies the frames of outputs."""

    def __init__(self, socket, change):
        self.socket, self.change = socket, change

    def __getattr__(self, name):
        return getattr(self.socket, name)

    def send(self, frame):
        return self.socket.send(bytes(self.change(bytearray(frame))))


def unasked():
    """Sends invalid frames that request a motion, followed by valid frames that hold the same flag."""
    set_up()
    plc = Plc()
    plc.home()
    width = plc.read()[2]
    plc.release()

    def status(bit):
        def clear(frame):
            frame[-2] &= ~bit
            return frame
        return clear

    def of_another_station(frame):
        frame[6:12] = bytes([2, 0, 0, 0, 0, 0x66])
        return frame

    def of_another_connection(frame):
        frame[19] ^= 1
        return frame

    def bad(frame):
        # The data of slot 2 is first, followed by its status.
        assert frame[28] == 0x80, frame.hex()
        frame[28] = 0
        return frame

    def stuck(counter):
        def change(frame):
            frame[-4:-2] = struct.pack(">H", counter & 0xFFFF)
            return frame
        return change

    # To the gripper the controller is silent, so it ends the connection.
    for name, change in [
        ("another station", lambda _: of_another_station),
        ("another connection", lambda _: of_another_connection),
        ("longer", lambda _: lambda frame: frame + b"\0"),
        ("not valid", lambda _: status(0x04)),
        ("a stuck counter", lambda counter: stuck(counter)),
        ("an old counter", lambda counter: stuck(counter - 256)),
    ]:
        plc = Plc(watchdog=25)
        sender = plc.cyclic._tx_sock
        plc.cyclic._tx_sock = Tampered(sender, change(plc.cyclic._cycle_counter))
        time.sleep(0.05)
        plc.write(MOVE)
        # Wait longer than the watchdog. The frames are valid again, but the connection has ended.
        time.sleep(0.5)
        plc.cyclic._tx_sock = sender
        time.sleep(0.1)
        plc.cyclic.stop()
        plc.device.close()
        plc = Plc()
        assert plc.read()[2] == width, (name, plc.read())
        plc.release()

    # The controller is connected but has no valid outputs. When they become valid, a held flag is not an edge.
    plc = Plc()
    sender = plc.cyclic._tx_sock
    for name, change in [("bad", bad), ("stopped", status(0x10)), ("a backup", status(0x01))]:
        plc.write(0)
        time.sleep(0.05)
        plc.cyclic._tx_sock = Tampered(sender, change)
        time.sleep(0.05)
        plc.write(MOVE)
        time.sleep(0.2)
        assert plc.read()[2] == width, (name, plc.read())
        plc.cyclic._tx_sock = sender
        time.sleep(0.2)
        assert plc.read()[2] == width, (name, plc.read())

    # With valid outputs, the same flag is an edge.
    plc.command(MOVE, lambda state, flags, now, _: now < width - 1_00, speed=5_00)
    # After a cut cable, the controller continues with its previous image.
    plc.cyclic._tx_sock = Tampered(sender, of_another_station)
    time.sleep(2)
    plc.cyclic.stop()
    plc.device.close()
    plc = Plc(first=MOVE)
    state, _, width, _ = plc.read()
    assert state == IDLE, state
    time.sleep(0.3)
    assert plc.read()[2] == width, (width, plc.read())
    plc.command(MOVE, lambda state, flags, now, _: now < width - 1_00, speed=5_00)
    plc.release()


def soak(seconds):
    set_up()
    plc = Plc()
    plc.cyclic.stats.reset()
    end = time.monotonic() + seconds
    plc.home()
    while time.monotonic() < end:
        plc.command(GRIP, lambda state, *_: state == HOLDING)
        plc.command(RELEASE, lambda state, flags, width, status: state == IDLE and width == 50_00, width=50_00)
    stats = plc.cyclic.stats
    print(stats)
    assert stats.frames_received > 0.9 * 125 * seconds, stats
    assert stats.frames_missed <= 0.001 * stats.frames_received, stats
    assert stats.frames_invalid == stats.frames_out_of_order == 0, stats
    plc.release()


def exchange(seconds):
    """Exchanges images with the watchdog of the documents. Prints the number of received frames, 1 if the watchdog expired or 0, and
    the longest time between two frames in ms."""
    set_up()
    plc = Plc(watchdog=25)
    frames, last, longest = 0, time.monotonic(), 0
    expired = threading.Event()

    def note(*_):
        nonlocal frames, last, longest
        now = time.monotonic()
        frames, last, longest = frames + 1, now, max(longest, now - last)

    # The statistics count cycles that the gateway skips as expiries.
    plc.cyclic.on_timeout(expired.set)
    plc.cyclic.on_input(note)
    time.sleep(seconds)
    print(frames, int(expired.is_set()), 1000 * longest)
    plc.release()


# The time limit for an answer, as for a PLC program that waits for its edge.
ANSWER_TIME = 1
# Cycles from new outputs to their effect on the inputs: the next frame of each direction, and frames that are under way.
CYCLES = 5


class Images:
    """Exchanges images for a test program, which sends `NUMBER read` or `NUMBER write IMAGE` and receives `NUMBER ok IMAGE`
    or `NUMBER error REASON`, with images in hexadecimal digits."""

    def __init__(self):
        # The tests lose frames on purpose.
        logging.disable()
        set_up()
        # A controller that returns still holds its last flag.
        self.plc = Plc(first=MOVE)
        self.lost = threading.Event()
        self.lock = threading.Lock()
        self.plc.cyclic.on_timeout(self.lost.set)
        threading.Thread(target=self.end, daemon=True).start()

    def end(self):
        """Ends the exchange when the gripper is silent for the watchdog time or has not answered, which `profinet-py` does not."""
        self.lost.wait()
        self.plc.cyclic.stop()

    def read(self):
        data = None if self.lost.is_set() else self.plc.cyclic.get_input_data(1, 1)
        if data is None:
            raise ProfinetError("the gripper provides no inputs")
        return data.hex()

    def write(self, data):
        """Returns the inputs after the gripper has received the outputs."""
        self.plc.cyclic.set_output_data(2, 1, bytes.fromhex(data))
        stats = self.plc.cyclic.stats
        for frames in ["frames_sent", "frames_received"]:
            count, end = getattr(stats, frames) + CYCLES, time.monotonic() + ANSWER_TIME
            while getattr(stats, frames) < count:
                if time.monotonic() > end:
                    self.lost.set()
                    raise ProfinetError("the gripper does not answer")
                time.sleep(0.004)
        return self.read()

    def answer(self, number, verb, *arguments):
        try:
            answer = "ok", getattr(self, verb)(*arguments)
        except (ProfinetError, RuntimeError) as error:
            answer = "error", error
        with self.lock:
            print(number, *answer, flush=True)


def images():
    exchange = Images()
    print("ready", flush=True)
    for line in sys.stdin:
        # A thread for each request, so that none waits for another.
        threading.Thread(target=exchange.answer, args=line.split(), daemon=True).start()


part, *arguments = sys.argv[1:]
{"cycle": cycle, "label": label, "labelled": labelled, "unasked": unasked, "unmoved": unmoved, "cut": cut, "paused": paused, "killed": killed, "soak": soak, "exchange": exchange, "images": images}[part](*map(float, arguments))
