"""Frames and commands of the binary protocol without a connection, for programs that own the socket.

Build a request::

    socket.send(encode_command("Grip Part", 20, 100))

Decode a capture::

    for frame in FrameDecoder().feed(data):
        print(describe(frame, is_reply=True))

The text protocol (GCL) consists of lines and needs no decoder.
"""

from __future__ import annotations

from typing import NamedTuple, Optional

from . import _native
from ._errors import InvalidError
from ._types import Status

__all__ = ["COMMANDS", "Counters", "Frame", "FrameDecoder", "Reply", "decode_reply", "describe", "encode", "encode_command"]

COMMANDS: dict[str, int] = {name: number for number, name, _ in _native.commands()}
"""Ids of the commands by the names of the manual (command set, chapter 3)."""


class Frame(NamedTuple):
    """A frame with an intact checksum (command set, 1.2)."""

    command: int
    """Id of the command."""
    payload: bytes


class Counters(NamedTuple):
    """Counts of unusable input. Each stops at 65535."""

    dropped: int
    """Bytes that were not part of an intact frame."""
    bad_checksum: int
    """Frames with a wrong checksum."""
    oversize: int
    """Frames longer than 1024 bytes of payload."""


class Reply(NamedTuple):
    """The content of a reply."""

    status: Status
    """Status code (command set, appendix A). After E_CMD_PENDING another reply follows."""
    value: Optional[float]
    """Width in mm, speed in mm/s, force in N, acceleration in mm/s², or the number of a state or of flags; otherwise None."""


class FrameDecoder:
    """Finds frames in a byte stream. Bytes may arrive in pieces of any length."""

    def __init__(self) -> None:
        self._decoder = _native.Decoder()

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes and return the frames that they complete. Noise and damaged frames are skipped and counted."""
        return [Frame(*frame) for frame in self._decoder.feed(data)]

    @property
    def counters(self) -> Counters:
        """Counts of unusable input."""
        return Counters(*self._decoder.counters())


def encode(frame: Frame) -> bytes:
    """Return the bytes of a frame, with preamble, length and checksum (command set, 1.2)."""
    return _native.encode_frame(frame.command, frame.payload)


def encode_command(name: str, *parameters: float) -> bytes:
    """Return the bytes of a command with its parameters, in the order of the manual.

    - ``"Homing"``: direction, 0 to 2 (3.2.1)
    - ``"Pre-position Fingers"``: width in mm, speed in mm/s, flags: 1 for relative, 2 for stop on block (3.2.2)
    - ``"Stop"``, ``"Issue FAST STOP"``, ``"Acknowledge FAST STOP"`` (3.2.3 to 3.2.5)
    - ``"Grip Part"``, ``"Release Part"``: width in mm, speed in mm/s (3.2.6, 3.2.7)
    - ``"Set Acceleration"``: mm/s² (3.3.1); ``"Set Force Limit"``: N (3.3.3)
    - ``"Get System State"``, ``"Get Gripper State"``, ``"Get Opening Width"``, ``"Get Speed"``, ``"Get Force"``: nothing, or a
      period in ms for automatic updates (3.4)

    Use :func:`encode` for others. Raises ``InvalidError`` for an unknown name or wrong parameters.
    """
    command = COMMANDS.get(name)
    if command is None:
        raise InvalidError(f"unknown command {name!r}; expected one of {', '.join(COMMANDS)}")
    return _native.encode_command(command, parameters)


def decode_reply(frame: Frame) -> Reply:
    """Return status and value of a reply. Raises ``InvalidError`` if the payload violates the manual."""
    status, value = _native.decode_reply(frame.command, frame.payload)
    return Reply(Status(status), value)


def describe(frame: Frame, *, is_reply: bool) -> str:
    """Return a frame as text for a log, such as ``25h Grip Part 20.0 mm 50.0 mm/s``."""
    return _native.describe(frame.command, frame.payload, is_reply)
