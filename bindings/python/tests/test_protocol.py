"""Frames and commands without a connection."""

from __future__ import annotations

import struct

import pytest

from wsg_gripper import InvalidError, Status
from wsg_gripper.protocol import (
    COMMANDS,
    Counters,
    Frame,
    FrameDecoder,
    Reply,
    decode_reply,
    describe,
    encode,
    encode_command,
)

# Acknowledge with its key.
ACKNOWLEDGE = bytes([0xAA, 0xAA, 0xAA, 0x24, 0x03, 0x00, 0x61, 0x63, 0x6B, 0xDC, 0xB9])
HOMED = bytes([0xAA, 0xAA, 0xAA, 0x20, 0x02, 0x00, 0x00, 0x00, 0xB3, 0xFD])


def test_commands_have_the_bytes_of_the_manual() -> None:
    assert encode_command("Acknowledge FAST STOP") == ACKNOWLEDGE
    assert encode(Frame(0x24, b"ack")) == ACKNOWLEDGE
    grip = encode_command("Grip Part", 20, 50)
    (frame,) = FrameDecoder().feed(grip)
    assert describe(frame, is_reply=False) == "25h Grip Part 20.0 mm 50.0 mm/s"
    assert COMMANDS["Grip Part"] == 0x25


@pytest.mark.parametrize(
    ("name", "parameters", "text"),
    [
        ("Homing", [1], "20h Homing positive direction"),
        ("Pre-position Fingers", [20, 50, 2], "21h Pre-position Fingers STOP_ON_BLOCK 20.0 mm 50.0 mm/s"),
        ("Stop", [], "22h Stop"),
        ("Issue FAST STOP", [], "23h Issue FAST STOP"),
        ("Release Part", [60, 100], "26h Release Part 60.0 mm 100.0 mm/s"),
        ("Set Force Limit", [40], "32h Set Force Limit 40.0 N"),
        ("Get Force", [], "45h Get Force once"),
        ("Get Force", [20], "45h Get Force every 20 ms"),
    ],
)
def test_parameters_are_those_of_the_manual(name: str, parameters: list[float], text: str) -> None:
    (frame,) = FrameDecoder().feed(encode_command(name, *parameters))
    assert describe(frame, is_reply=False) == text


def test_decoder_finds_frames_among_noise_in_any_pieces() -> None:
    damaged = ACKNOWLEDGE[:-1] + b"\x00"
    stream = b"noise" + HOMED + damaged + ACKNOWLEDGE + HOMED
    whole = FrameDecoder()
    assert whole.feed(stream) == [Frame(0x20, b"\0\0"), Frame(0x24, b"ack"), Frame(0x20, b"\0\0")]
    assert whole.counters == Counters(dropped=5 + len(damaged), bad_checksum=1, oversize=0)
    pieces = FrameDecoder()
    found = [frame for byte in stream for frame in pieces.feed(bytes([byte]))]
    assert found == whole.feed(stream)


def test_replies_have_a_status_and_a_value() -> None:
    assert decode_reply(Frame(0x20, b"\x1a\0")) == Reply(Status.E_CMD_PENDING, None)
    assert decode_reply(Frame(0x43, b"\0\0\0\0\xa0\x41")) == Reply(Status.E_SUCCESS, 20)
    assert decode_reply(Frame(0x41, b"\0\0\x04")) == Reply(Status.E_SUCCESS, 4)
    with pytest.raises(InvalidError, match="short"):
        decode_reply(Frame(0x43, b"\0\0\0"))


def test_wrong_commands_are_refused() -> None:
    with pytest.raises(InvalidError, match="expected one of Loop"):
        encode_command("Grip")
    with pytest.raises(InvalidError, match="parameters"):
        encode_command("Grip Part", 20)
    with pytest.raises(InvalidError):
        encode_command("Grip Part", 20, float("nan"))


@pytest.mark.parametrize("value", [19.6, 0.1, -0.3, 109.99, 1e-7, 16777216.0])
def test_number_is_the_decimal_that_the_gripper_means(value: float) -> None:
    payload = bytes(2) + struct.pack("<f", value)
    assert decode_reply(Frame(0x43, payload)) == Reply(Status.E_SUCCESS, value)
