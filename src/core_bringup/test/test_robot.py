# SPDX-License-Identifier: BSD-3-Clause
"""The robot file: the shipped one loads, and every kind of mistake is named."""

import copy
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml
from simple_world import ROBOT, ROBOT_FILE

from core_bringup.exceptions import ConfigError
from core_bringup.quadruped.kinematics import JOINT_NAMES
from core_bringup.robot import CameraMount, RobotConfig

SHIPPED = yaml.safe_load(ROBOT_FILE.read_text(encoding="utf-8"))


def changed(path, value):
    data = copy.deepcopy(SHIPPED)
    *parents, last = path.split(".")
    target = data
    for key in parents:
        target = target[key]
    target[last] = value
    return data


@pytest.mark.parametrize("path", sorted(ROBOT_FILE.parent.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_robot_loads(path):
    assert RobotConfig.load(path).name == path.stem


def test_shipped_camera_is_that_of_the_paper():
    model = ROBOT.camera.model
    assert (model.width_px, model.height_px) == (500, 320)
    assert (model.fx_px, model.fy_px, model.cx_px, model.cy_px) == (274.9, 376.7, 250.0, 160.0)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("footprint.length_m", -1.0),
        ("footprint.length_m", 0),
        ("footprint.length_m", "wide"),
        ("footprint.length_m", True),
        ("footprint.length_m", None),
        ("footprint.width_m", float("nan")),
        ("limits.yaw_radps", float("inf")),
        ("limits.sped_mps", 1.0),
        ("camera", 3),
        ("camera.model.width_px", 500.5),
        ("camera.model.near_m", 40.0),
        ("camera.mount.x_m", [1.0]),
        ("quadruped.leg.link_mass_kg", [1.0, 2.0]),
        ("quadruped.leg.link_mass_kg", [1.0, 2.0, 0.0, 1.0]),
        ("quadruped.leg.joint_lower_rad", [1.0, -0.9, -2.8]),
        ("quadruped.gait.duty", 0.5),
        ("quadruped.gait.duty", 1.0),
        ("quadruped.gait.body_height_m", 0.9),
        ("quadruped.stance.position_gains_per_s2", 25.0),
        ("name", 7),
    ],
)
def test_wrong_value_is_refused_with_its_key_and_what_is_allowed(path, value):
    with pytest.raises(ConfigError) as caught:
        RobotConfig.from_dict(changed(path, value), "a.yaml")
    assert path in caught.value.key
    assert str(caught.value).startswith("a.yaml: ")
    assert len(caught.value.allowed) > 3
    assert "\n" not in str(caught.value)


def test_missing_key_is_refused():
    data = copy.deepcopy(SHIPPED)
    del data["quadruped"]["leg"]["thigh_m"]
    with pytest.raises(ConfigError, match="quadruped.leg.thigh_m: missing"):
        RobotConfig.from_dict(data)


@pytest.mark.parametrize("text", ["", "- 1\n", "a: [", "name: x\n"])
def test_file_that_is_no_robot_is_refused(tmp_path, text):
    path = tmp_path / "r.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match="r.yaml"):
        RobotConfig.load(path)


def test_key_given_twice_is_refused_with_its_line(tmp_path):
    path, text = tmp_path / "r.yaml", ROBOT_FILE.read_text(encoding="utf-8")
    path.write_text(text + "name: another\n")
    with pytest.raises(ConfigError, match=rf"r.yaml:{len(text.splitlines()) + 1}: name: given twice"):
        RobotConfig.load(path)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="none.yaml"):
        RobotConfig.load(tmp_path / "none.yaml")


def test_optical_frame_looks_forward_and_down_by_the_pitch():
    R, p = ROBOT.camera_mount.compute_optical_pose()
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R[:, 2], [np.cos(0.25), 0.0, -np.sin(0.25)], atol=1e-12)
    np.testing.assert_allclose(R[:, 0], [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(p, [0.5, 0.0, 0.13])


def rotation_of_rpy(roll, pitch, yaw):
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ y @ x


def test_camera_frames_of_the_urdf_are_the_optical_pose_of_the_mount():
    data = changed(
        "camera.mount", {"x_m": 0.1, "y_m": -0.2, "z_m": 0.3, "roll_rad": 0.4, "pitch_rad": 0.5, "yaw_rad": -0.6}
    )
    robot = RobotConfig.from_dict(data)
    root = ElementTree.fromstring(robot.urdf_text())
    rotation, position = np.eye(3), np.zeros(3)
    for name in ("camera_joint", "camera_optical_joint"):
        origin = root.find(f"joint[@name='{name}']/origin")
        position = position + rotation @ np.array(origin.get("xyz").split(), dtype=float)
        rotation = rotation @ rotation_of_rpy(*np.array(origin.get("rpy").split(), dtype=float))
    R, p = CameraMount(**data["camera"]["mount"]).compute_optical_pose()
    np.testing.assert_allclose(rotation, R, atol=1e-8)
    np.testing.assert_allclose(position, p, atol=1e-8)


def test_urdf_names_every_joint_and_needs_no_file():
    root = ElementTree.fromstring(ROBOT.urdf_text())
    assert [j.get("name") for j in root.iter("joint") if j.get("type") == "revolute"] == list(JOINT_NAMES)
    assert {"base_link", "camera_link", "camera_color_optical_frame"} <= {
        link.get("name") for link in root.iter("link")
    }
    assert not list(root.iter("mesh"))


def test_root_of_the_description_has_no_inertia_and_the_robot_weighs_the_same():
    description, physics = (ElementTree.fromstring(text) for text in (ROBOT.urdf_text(), ROBOT.physics_urdf_text()))
    assert description.find("link[@name='base_link']/inertial") is None
    total_kg = [sum(float(mass.get("value")) for mass in root.iter("mass")) for root in (description, physics)]
    assert total_kg[0] == total_kg[1] > 30.0
