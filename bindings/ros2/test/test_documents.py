"""The blocks of docs/ros2.md, and the trial of README.md without ROS, are pasted into a shell."""

from __future__ import annotations

import re
import shutil
import subprocess
import textwrap
from pathlib import Path

from test_node import unused_address

PACKAGE = Path(__file__).parents[1]
BEFORE = f"""
set -e
trap 'kill $(jobs -p); wait' EXIT
PATH={PACKAGE / "test/commands"}:$PATH
rosdep() {{
  test "$*" = "install --from-paths src --ignore-src" -a -e src/*/package.xml
}}
"""
READY = "until ros2 service call /wsg_gripper/home std_srvs/srv/Trigger | grep success=True; do :; done\n"
"""The reader waits until the node has connected."""


def blocks(document: str) -> list[str]:
    """Return the blocks in order, without prompts."""
    found = re.findall(r"^ *```(console|python)\n(.*?)^ *```", (PACKAGE / document).read_text(), re.MULTILINE | re.DOTALL)
    assert all(line.strip().startswith("$ ") for kind, block in found if kind == "console" for line in block.splitlines())
    return [textwrap.dedent(block).replace("$ ", "") for _, block in found]


def paste(script: str, folder: Path) -> str:
    # colcon and pip write into the folder of the sources.
    shutil.copytree(PACKAGE, folder / "bindings/ros2")
    for old, new in (("/path/to/repository", str(folder)), ("127.0.0.1:11000", unused_address()), ("8080", "0")):
        script = script.replace(old, new)
    # On a time-out, it also ends the programs that the script has started.
    command = ["timeout", "-k", "5", "120", "bash", "-c", BEFORE + script]
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0 and "Traceback" not in done.stdout, done.stdout
    return done.stdout


def test_blocks_of_the_page_build_the_package_and_grip(tmp_path: Path) -> None:
    build, start, calls = blocks("../../docs/ros2.md")
    output = paste(build + start.replace("\n", " &\n") + READY + calls, tmp_path)
    answers = re.findall(r"Trigger_Response\((.*)\)", output)
    assert answers[-2:] == ["success=True, message='done'", "success=True, message='HOLDING'"], output
    assert (tmp_path / "install/wsg_gripper_driver/lib/wsg_gripper_driver/wsg_gripper").exists()


def test_trial_without_ros_prints_its_results(tmp_path: Path) -> None:
    found = blocks("README.md")
    at = next(at for at, block in enumerate(found) if block.startswith("python3.11 -m venv"))
    install, start, program = found[at : at + 3]
    pins = re.findall(r"ros-[a-z-]+==[0-9.]+", install)
    lines = (PACKAGE / "test/kilted/requirements.txt").read_text()
    assert len(pins) == 6 and all(f"\n{pin} " in lines for pin in pins)
    (tmp_path / "first.py").write_text(program)
    output = paste(start + READY + "python first.py", tmp_path)
    assert "home done\ngrip HOLDING\n" in output, output
