# SPDX-License-Identifier: BSD-3-Clause
"""The robot file: the shipped one loads, and every kind of mistake is named."""

import copy
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml
from simple_world import ROBOT, ROBOT_FILE

from core_bringup.base_config import BaseConfig
from core_bringup.describe import main as describe
from core_bringup.exceptions import ConfigError
from core_bringup.quadruped.kinematics import JOINT_NAMES
from core_bringup.robot import CameraMount, RobotConfig
from core_control.params import FilterParams

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
def test_every_shipped_robot_loads_and_the_filter_takes_it(path):
    assert BaseConfig.load(path).name == path.stem
    params = FilterParams.from_dict(BaseConfig.load(path).make_filter_parameters())
    assert params.kinematics == "holonomic" or params.look_ahead_m > params.max_vx_mps / params.alpha_per_s
    if "quadruped" in path.read_text(encoding="utf-8"):
        assert RobotConfig.load(path).name == path.stem


WHEELED = {
    "name": "cart",
    "footprint": {"length_m": 0.8, "width_m": 0.6, "center_x_m": 0.2},
    "limits": {"forward_mps": 0.4, "yaw_radps": 1.0},
    "kinematics": {"kind": "ackermann", "look_ahead_m": 0.3, "min_turning_radius_m": 1.1},
}


def test_a_wheeled_base_gives_the_parameters_of_the_filter():
    params = FilterParams.from_dict(BaseConfig.from_dict(WHEELED).make_filter_parameters())
    assert (params.kinematics, params.look_ahead_m, params.min_turning_radius_m) == ("ackermann", 0.3, 1.1)
    np.testing.assert_array_equal(params.limits, [0.4, 0.0, 0.4 / 1.1])
    assert params.disc_array[:, 0].mean() == pytest.approx(0.2)


def test_the_simulator_refuses_a_robot_without_legs():
    with pytest.raises(ConfigError, match="cart.yaml: camera: missing"):
        RobotConfig.from_dict(WHEELED, "cart.yaml")


@pytest.mark.parametrize(
    ("section", "values", "message"),
    [
        ("kinematics", {"kind": "tracks"}, "kinematics.kind: got 'tracks'; allowed: holonomic, diff"),
        ("kinematics", {"kind": 3}, "kinematics.kind: got 3; allowed: a text"),
        ("kinematics", {"kind": "holonomic"}, "limits.sideways_mps: missing"),
        ("kinematics", {"kind": "differential"}, "kinematics.look_ahead_m: missing"),
        ("kinematics", {"kind": "ackermann", "look_ahead_m": 0.3}, "kinematics.min_turning_radius_m: missing"),
        ("kinematics", {**WHEELED["kinematics"], "kind": "differential"}, "min_turning_radius_m: got 1.1; allowed: no"),
        ("kinematics", {**WHEELED["kinematics"], "look_ahead_m": -1.0}, "look_ahead_m: got -1.0; allowed: a finite"),
        ("limits", {**WHEELED["limits"], "sideways_mps": 0.1}, "limits.sideways_mps: got 0.1; allowed: nothing for"),
        ("footprint", {**WHEELED["footprint"], "center_x_m": "ahead"}, "footprint.center_x_m: got 'ahead'"),
    ],
)
def test_wrong_kinematics_are_refused_in_one_line(section, values, message):
    with pytest.raises(ConfigError) as caught:
        BaseConfig.from_dict({**WHEELED, section: values}, "cart.yaml")
    text = str(caught.value)
    assert message in text and text.startswith("cart.yaml: ") and "\n" not in text


@pytest.mark.parametrize("path", ["kinematics.kind", "footprint.center_x_m"])
def test_legs_are_holonomic_and_centred(path):
    value = "differential" if path.endswith("kind") else 0.1
    data = changed(path, value)
    if path.endswith("kind"):
        data["kinematics"]["look_ahead_m"] = 0.3
        del data["limits"]["sideways_mps"]
    with pytest.raises(ConfigError, match=f"{path}: got .* with legs"):
        RobotConfig.from_dict(data)


def test_describe_prints_one_parameter_of_the_filter(capsys):
    path = str(ROBOT_FILE.parent / "waffle_like.yaml")
    assert describe(["filter", path, "kinematics"]) == 0
    assert describe(["filter", path, "footprint/center_x_m"]) == 0
    assert capsys.readouterr().out == "differential\n-0.064\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["filter", str(ROBOT_FILE), "lag_s"], "describe: arguments: KEY: got 'lag_s'; allowed: camera_fov_rad"),
        (["filter", "none.yaml", "kinematics"], "describe: none.yaml: "),
    ],
)
def test_describe_refuses_bad_input_with_one_line_and_two(words, message, capsys):
    assert describe(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(message) and err.count("\n") == 1


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


def test_camera_opening_is_what_both_sides_of_the_axis_show():
    assert ROBOT.camera.model.compute_horizontal_fov() == pytest.approx(1.474, abs=1e-3)
    off_centre = RobotConfig.from_dict(changed("camera.model.cx_px", 100.0)).camera.model
    assert off_centre.compute_horizontal_fov() == pytest.approx(2.0 * np.arctan(100.5 / 274.9))


def test_facts_of_the_camera_are_printed(capsys):
    assert [describe(["filter", str(ROBOT_FILE), key]) for key in ("camera_fov_rad", "camera_yaw_rad")] == [0, 0]
    fov, yaw = capsys.readouterr().out.split()
    assert (float(fov), float(yaw)) == (ROBOT.camera.model.compute_horizontal_fov(), ROBOT.camera.mount.yaw_rad)


def test_a_robot_file_without_a_camera_sees_every_heading(capsys):
    wheels = ROBOT_FILE.parent / "waffle_like.yaml"
    assert [describe(["filter", str(wheels), key]) for key in ("camera_fov_rad", "camera_yaw_rad")] == [0, 0]
    assert capsys.readouterr().out.split() == ["6.2832", "0.0"]
