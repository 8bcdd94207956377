"""Build the stand-in for control_msgs with the wheels of this environment, and install it there.

control_msgs is not on PyPI. The stand-in is built again when one of its files changes.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

SOURCE = Path(__file__).with_name("stand_in")
PREFIX = Path(sys.prefix)
MARK = PREFIX / "control_msgs.sha256"


def digest() -> str:
    files = sorted(path for path in SOURCE.rglob("*") if path.is_file())
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def correct_paths() -> None:
    """Replace the paths of the machine that built the wheels, in the CMake files of their packages."""
    names = {"include/python3.11": sysconfig.get_path("include"), "lib/python3.11/site-packages": sysconfig.get_path("purelib")}
    for path in PREFIX.rglob("share/*/cmake/*.cmake"):
        old = text = path.read_text()
        for name, here in names.items():
            text = text.replace(f"/opt/python/cp311-cp311/{name}", here)
        if text != old:
            path.write_text(text)


def main() -> None:
    if MARK.exists() and MARK.read_text() == digest():
        return
    correct_paths()
    environment = {**os.environ, "AMENT_PREFIX_PATH": sys.prefix, "CMAKE_PREFIX_PATH": sys.prefix}
    environment["PATH"] = os.pathsep.join([str(PREFIX / "bin"), os.environ["PATH"]])
    with tempfile.TemporaryDirectory() as build:
        options = ["-DBUILD_TESTING=OFF", f"-DCMAKE_INSTALL_PREFIX={sys.prefix}", "-DCMAKE_BUILD_TYPE=None"]
        options += [f"-DPython3_EXECUTABLE={sys.executable}", "-DPython3_FIND_VIRTUALENV=ONLY"]
        for step in (
            ["cmake", "-S", str(SOURCE), "-B", build, *options],
            ["cmake", "--build", build, "--parallel", "2"],
            ["cmake", "--install", build],
        ):
            subprocess.run(step, env=environment, check=True, stdout=subprocess.DEVNULL)
    MARK.write_text(digest())


if __name__ == "__main__":
    main()
