"""The Python types: they match the native tables, and the stub matches the native module."""

from __future__ import annotations

import importlib.metadata
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import wsg_gripper
from wsg_gripper import _native

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.parametrize(("name", "table"), _native.tables().items())
def test_enumerations_match_the_tables_of_the_protocol(name: str, table: dict[str, int]) -> None:
    assert {it.name: it.value for it in getattr(wsg_gripper, name)} == table


def test_stub_matches_the_native_module() -> None:
    stubtest = [sys.executable, "-m", "mypy.stubtest", "wsg_gripper._native"]
    done = subprocess.run(stubtest, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("target", [["-p", "wsg_gripper"], [str(EXAMPLES)], [str(Path(__file__).parent)]])
def test_mypy_accepts_package_examples_and_tests(target: list[str]) -> None:
    mypy = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary"]
    done = subprocess.run([*mypy, *target], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_pyright_accepts_examples() -> None:
    # basedpyright is pyright with its JavaScript in the wheel, so the test needs no network.
    done = subprocess.run([sys.executable, "-m", "basedpyright"], capture_output=True, text=True, cwd=EXAMPLES.parent)
    assert done.returncode == 0, done.stdout + done.stderr


def test_wheel_has_the_licences_of_its_parts() -> None:
    [licences] = [it for it in importlib.metadata.files("wsg-gripper") or [] if it.name == "LICENCES.txt"]
    parts, *texts = licences.read_text().split("=" * 80)
    for part in ("pyo3", "lua-src", "tokio"):
        [named] = re.findall(rf"^  ({part} [0-9.]+\S*): ", parts, re.MULTILINE)
        assert any(named in text for text in texts), named


def public(thing: object) -> list[tuple[str, object]]:
    return [(name, it) for name, it in vars(thing).items() if not name.startswith("_")]


def test_every_public_class_and_method_is_documented() -> None:
    for name in wsg_gripper.__all__:
        thing = getattr(wsg_gripper, name)
        assert thing.__doc__, name
        for method, function in public(thing):
            if inspect.isfunction(function):
                assert function.__doc__, f"{name}.{method}"
