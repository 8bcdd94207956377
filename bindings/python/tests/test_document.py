"""The programs of docs/python.md and docs/lerobot.md run. The tests of the plugin have those for LeRobot."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCUMENTS = Path(__file__).parents[3] / "docs"


def blocks() -> list[str]:
    text = "".join((DOCUMENTS / page).read_text() for page in ("python.md", "lerobot.md"))
    return re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("if gripper.grip(", r"19\.6 mm 40\.0 N\n"),
        ("motion.done()", r"(\d+\.\d+\n)+GripResult\.HELD 30\.\d+\n"),
        ("gripper.subscribe(", r"(\d+\.\d+ mm \d+\.\d+ N\n)+"),
        ("asyncio.run(", r"(\d+\.\d+\n)+GripResult\.HELD\n"),
        ("StreamingGripper", r"(\d+\.\d+\n)+\d+ samples\n"),
        ("WSGController", ""),
        ("FrameDecoder", r"43h Get Opening Width E_SUCCESS 0\.0 mm\n"),
    ],
)
def test_program_prints_its_result(text: str, expected: str, tmp_path: Path) -> None:
    [program] = [block for block in blocks() if text in block and "def test_" not in block]
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(expected, done.stdout), done.stdout


def test_tests_of_the_document_pass(tmp_path: Path) -> None:
    tests = [block for block in blocks() if "def test_" in block]
    file = tmp_path / "test_of_the_document.py"
    file.write_text("\n".join(tests))
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", file], capture_output=True, text=True, timeout=60)
    assert f"{len(tests)} passed" in done.stdout, done.stdout
    assert len(tests) == 2
