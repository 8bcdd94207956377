"""The files of the package: URDF, package.xml, parameters, launch."""

from __future__ import annotations

import os
from pathlib import Path

os.environ["MUJOCO_GL"] = "disable"

import mujoco
import pytest
import xacro
import yaml
import yourdfpy
from catkin_pkg.package import parse_package
from wsg_gripper_driver import node, units

PACKAGE = Path(__file__).parents[1]


def test_urdf_opens_110_mm_with_the_joints_of_the_node(tmp_path: Path) -> None:
    text = xacro.process(str(PACKAGE / "urdf/gripper.urdf.xacro"), mappings={"prefix": "left_", "finger_length": "0.1"})
    file = tmp_path / "gripper.urdf"
    file.write_text(text)
    robot = yourdfpy.URDF.load(str(file))
    left, right = units.joint_names("left_")
    assert robot.validate() and robot.actuated_joint_names == [left]
    assert (robot.joint_map[right].mimic.joint, robot.joint_map[left].limit.upper) == (left, 0.055)
    for position, gap in ((0.0, 0.0), (0.055, 0.11)):
        robot.update_cfg({left: position})
        places = [robot.get_transform(f"left_wsg_finger_{it}_link", "left_mount")[:3, 3] for it in ("left", "right")]
        assert (places[1] - places[0]).tolist() == pytest.approx([gap, 0, 0])
    assert robot.get_transform("left_wsg_tcp", "left_mount")[2, 3] == pytest.approx(0.0719 + 0.024 + 0.1)
    model = mujoco.MjModel.from_xml_string(text)
    assert (model.njnt, model.neq) == (2, 1), "mimic is an equality constraint"


def test_package_and_parameter_file_match_the_node() -> None:
    package = parse_package(str(PACKAGE))
    assert (package.name, package.package_format) == ("wsg_gripper_driver", 3)
    shown = yaml.safe_load((PACKAGE / "config/gripper.yaml").read_text())["/**"]["ros__parameters"]
    defaults = {name: default for name, default, *_ in node.FIXED + node.READ_ONLY + node.FREE}
    assert {**shown, "address": "", "prefix": ""} == defaults
    launch = PACKAGE / "launch/gripper.launch.py"
    compile(launch.read_text(), launch, "exec")
