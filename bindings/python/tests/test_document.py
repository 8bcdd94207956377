"""The programs of docs/python.md run."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

DOCUMENT = Path(__file__).parents[3] / "docs" / "python.md"


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", DOCUMENT.read_text(), re.MULTILINE | re.DOTALL)


def test_first_grip_prints_width_and_force() -> None:
    first = subprocess.run([sys.executable, "-c", blocks()[0]], capture_output=True, text=True, timeout=60)
    assert re.fullmatch(r"\d+\.\d+ mm \d+\.\d+ N\n", first.stdout), first


def test_tests_of_the_document_pass(tmp_path: Path) -> None:
    tests = [block for block in blocks() if "def test_" in block]
    file = tmp_path / "test_of_the_document.py"
    file.write_text("\n".join(["from wsg_gripper import Gripper", *tests]))
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", file], capture_output=True, text=True, timeout=60)
    assert f"{len(tests)} passed" in done.stdout, done.stdout
    assert len(tests) == 2


def test_blocks_compile() -> None:
    for block in blocks():
        compile(block, str(DOCUMENT), "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
