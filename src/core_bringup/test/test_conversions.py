# SPDX-License-Identifier: BSD-3-Clause
"""Messages: round trips with NaN and infinity, through the wire format."""

import io
import math

import numpy as np
import pytest

from core_bringup.backend import RobotState
from core_bringup.camera import CameraModel
from core_bringup.ground_truth import GroundTruthState
from core_bringup.rotations import quaternion_of_matrix, quaternion_of_rpy, yaw_of_quaternion

to = pytest.importorskip("core_bringup.ros.conversions", reason="needs ROS messages")


def through_the_wire(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


def robot_state():
    rng = np.random.default_rng(0)
    q = rng.standard_normal(4)
    return RobotState(
        1.5, rng.standard_normal(3), q / np.linalg.norm(q), rng.standard_normal(3), rng.standard_normal(3),
        ("a", "b"), np.array([0.1, -0.2]), np.array([1.0, math.nan]), (True, False, True, True), True,
    )  # fmt: skip


@pytest.mark.parametrize("stamp_ns", [0, 1, 50_000_000, 999_999_999, 1_000_000_000, 12_345_678_901_234])
def test_stamps_keep_every_nanosecond(stamp_ns):
    assert to.stamp_from_msg(to.stamp_to_msg(stamp_ns)) == stamp_ns


@pytest.mark.parametrize(
    "image",
    [
        np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3),
        np.array([[0.3, np.nan], [np.inf, -np.inf], [7.0, 0.0]], dtype=np.float32),
        np.arange(0, 65532, 5461, dtype=np.uint16).reshape(4, 3),
        np.arange(48, dtype=np.uint8).reshape(4, 12)[:, ::2].reshape(4, 2, 3),
    ],
    ids=["rgb8", "32FC1", "mono16", "not contiguous"],
)
def test_images_survive(image):
    message = through_the_wire(to.image_to_msg(image, to.header_to_msg(5, "camera")))
    assert (message.height, message.width) == image.shape[:2]
    assert message.step * message.height == len(message.data)
    back = to.image_from_msg(message)
    assert back.dtype == image.dtype
    np.testing.assert_array_equal(back, image)


def test_big_endian_images_are_read():
    message = to.image_to_msg(np.array([[1, 2, 515]], dtype=np.uint16), to.header_to_msg(0, ""))
    message.data, message.is_bigendian = np.array([1, 2, 515], dtype=">u2").tobytes(), 1
    np.testing.assert_array_equal(to.image_from_msg(message), [[1, 2, 515]])


@pytest.mark.parametrize(
    "image", [np.zeros((2, 2)), np.zeros((2, 2, 4), np.uint8), np.zeros((2, 2), np.uint8), np.zeros(4, np.uint16)]
)
def test_other_images_are_refused(image):
    with pytest.raises(ValueError, match="allowed"):
        to.image_to_msg(image, to.header_to_msg(0, ""))


def test_unknown_encoding_is_refused():
    message = to.image_to_msg(np.zeros((2, 2), np.uint16), to.header_to_msg(0, ""))
    message.encoding = "bayer"
    with pytest.raises(ValueError, match="'bayer'"):
        to.image_from_msg(message)


def test_camera_info_back_projects_a_pixel():
    camera = CameraModel()
    info = through_the_wire(to.camera_info_to_msg(camera, to.header_to_msg(7, "camera")))
    assert (info.width, info.height) == (camera.width_px, camera.height_px)
    pixel = np.array(info.K).reshape(3, 3) @ np.array([0.5, -0.2, 2.0])
    np.testing.assert_allclose(pixel[:2] / pixel[2], [250 + 274.9 * 0.25, 160 - 376.7 * 0.1])
    np.testing.assert_array_equal(np.array(info.P).reshape(3, 4)[:, :3].ravel(), info.K)


def test_labels_survive():
    header = to.header_to_msg(3, "camera")
    message = through_the_wire(
        to.label_info_to_msg({30: ("traffic_cone", "pylon"), 1: ("floor",)}, ("floor", "traffic_cone", "wall"), header)
    )
    names = {1: ("floor",), 30: ("traffic_cone", "pylon")}
    assert to.label_info_from_msg(message) == (names, ("floor", "traffic_cone", "wall"))
    assert [label.id for label in message.labels] == [1, 30, 30]


@pytest.mark.parametrize("clearance_m", [1.25, -0.5, math.inf])
def test_truth_survives(clearance_m):
    truth = GroundTruthState(clearance_m < 0, False, clearance_m, "behind", "closed", 0.75)
    message = through_the_wire(to.violation_to_msg(truth, True, to.header_to_msg(9, "odom")))
    assert to.violation_from_msg(message) == (truth, True)


@pytest.mark.parametrize("command", [(0.5, -0.25, 0.8), (math.nan, math.inf, -0.0)])
def test_commands_survive_bit_for_bit(command):
    back = to.command_from_msg(through_the_wire(to.command_to_msg(command)))
    assert np.array(back).tobytes() == np.array(command).tobytes()


def test_odometry_has_the_twist_in_the_child_frame():
    state = robot_state()
    message = through_the_wire(to.odometry_to_msg(state, to.header_to_msg(1, "odom"), "base_link"))
    pose, twist = message.pose.pose, message.twist.twist
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    np.testing.assert_array_equal([pose.position.x, pose.position.y, pose.position.z], state.p_world_base)
    q = pose.orientation
    np.testing.assert_array_equal([q.x, q.y, q.z, q.w], state.q_world_base)
    np.testing.assert_array_equal([twist.linear.x, twist.linear.y, twist.linear.z], state.v_base)
    np.testing.assert_array_equal([twist.angular.x, twist.angular.y, twist.angular.z], state.w_base)


def test_joints_and_feet_keep_their_order():
    state = robot_state()
    joints = through_the_wire(to.joint_state_to_msg(state, to.header_to_msg(1, "")))
    assert (joints.name, list(joints.position)) == (["a", "b"], [0.1, -0.2])
    assert math.isnan(joints.velocity[1])
    assert list(through_the_wire(to.foot_contacts_to_msg(state)).data) == [1, 0, 1, 1]


def test_tick_carries_both_stamps():
    message = through_the_wire(to.tick_to_msg(7, 350_000_000, 50_000_000, 300_000_000))
    assert (message.tick, message.period_s) == (7, 0.05)
    assert (to.stamp_from_msg(message.header.stamp), to.stamp_from_msg(message.frame_stamp)) == (
        350_000_000,
        300_000_000,
    )


def test_quaternions_of_angles():
    rng = np.random.default_rng(3)
    for roll, pitch, yaw in rng.uniform(-1.4, 1.4, (50, 3)):
        q = quaternion_of_rpy(roll, pitch, yaw)
        assert np.linalg.norm(q) == pytest.approx(1.0)
        assert yaw_of_quaternion(q) == pytest.approx(yaw)
    optical = rotate(quaternion_of_rpy(-math.pi / 2, 0.0, -math.pi / 2), np.eye(3))
    np.testing.assert_allclose(optical, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)


def rotate(q, columns):
    """Columns turned by the quaternion: v + 2 w (u x v) + 2 u x (u x v)."""
    u, w = np.array(q[:3]), q[3]
    cross = np.cross(u, columns.T)
    return (columns.T + 2 * w * cross + 2 * np.cross(u, cross)).T


def test_quaternions_survive_the_matrix_half_turns_too():
    random = np.random.RandomState(3)
    quaternions = [q / np.linalg.norm(q) for q in random.normal(size=(200, 4))]
    quaternions += [np.eye(4)[i] for i in range(4)] + [np.array([0.6, 0.8, 0.0, 0.0]), np.array([0.0, 0.6, -0.8, 1e-9])]
    for q in quaternions:
        x, y, z, w = q
        R = np.eye(3) + 2.0 * w * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) + 2.0 * (
            np.outer(q[:3], q[:3]) - np.eye(3) * (q[:3] @ q[:3])
        )  # fmt: skip
        found = np.array(quaternion_of_matrix(R))
        assert found[3] >= 0.0
        np.testing.assert_allclose(abs(found @ q), 1.0, atol=1e-12)
