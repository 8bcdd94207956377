"""The metadata of the Python packages: each names the same authors and source as the workspace."""

from __future__ import annotations

import re
from importlib.metadata import metadata
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_packages_have_the_metadata_of_the_workspace() -> None:
    workspace = (ROOT / "Cargo.toml").read_text()
    found = re.search(r'^repository = "(.*)"\nauthors = \["(.*) <(.*)>"\]$', workspace, re.MULTILINE)
    assert found
    source, author, email = found.groups()
    for file in ("lerobot/pyproject.toml", "ros2/setup.py", "ros2/package.xml"):
        text = (ROOT / "bindings" / file).read_text()
        assert author in text and email in text, file
        assert source in text or file.endswith(".xml"), file
    wheel = metadata("wsg-gripper")
    assert wheel["Author-email"] == f"{author} <{email}>"
    assert wheel.get_all("Project-URL") == [f"Source Code, {source}"]
    classifiers = wheel.get_all("Classifier") or []
    for classifier in ("Development Status :: 4 - Beta", "Framework :: Pytest", "Programming Language :: Python :: 3.9"):
        assert classifier in classifiers
