# SPDX-License-Identifier: BSD-3-Clause
"""Messages <-> library types, there and back."""

import math

import numpy as np
import pytest

pytest.importorskip("rospy")
import rospy  # noqa: E402
from core_msgs.msg import InstanceArray, LabelClass, LabelInfo, SafetyGrid  # noqa: E402
from core_msgs.msg import Predicate as PredicateMsg  # noqa: E402
from fake_chain import cone_instance  # noqa: E402
from geometry_msgs.msg import Quaternion, Transform, Vector3  # noqa: E402
from hypothesis import given  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from core_perception.exceptions import EvidenceError, PredicateError  # noqa: E402
from core_perception.predicates import Constraints, parse_predicate  # noqa: E402
from core_perception.ros import conversions, operator_services  # noqa: E402

STATEMENTS = (
    "ON(floor)=safe",
    "NEAR(car)=unsafe",
    "AROUND(person, 1.2, slow)=unsafe",
    "BETWEEN(cone)=unsafe",
    "AROUND(fire)=unsafe",
)


@pytest.mark.parametrize(
    "encoding, array",
    [
        ("mono8", np.arange(12, dtype=np.uint8).reshape(3, 4)),
        ("mono16", np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000),
        ("16UC1", np.arange(12, dtype=np.uint16).reshape(3, 4)),
        ("32FC1", np.array([[1.5, np.nan], [np.inf, -np.inf]], np.float32)),
        ("rgb8", np.arange(24, dtype=np.uint8).reshape(2, 4, 3)),
        ("bgr8", np.arange(24, dtype=np.uint8).reshape(2, 4, 3)),
    ],
)
def test_images_come_back_as_they_went(encoding, array):
    msg = conversions.array_to_image(array, encoding, Header())
    back = conversions.image_to_array(msg)
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back, array)


def test_row_padding_and_big_endian_pixels_are_read():
    rows = np.zeros((2, 8), np.uint8)
    rows[:, :6] = np.array([[1, 2, 3], [4, 5, 600]], ">u2").view(np.uint8)
    msg = Image(height=2, width=3, encoding="mono16", is_bigendian=1, step=8, data=rows.tobytes())
    np.testing.assert_array_equal(conversions.image_to_array(msg), [[1, 2, 3], [4, 5, 600]])


@pytest.mark.parametrize(
    "msg",
    [
        Image(height=1, width=1, encoding="yuv422", step=2, data=b"ab"),
        Image(height=2, width=2, encoding="mono8", step=2, data=b"abc"),
        Image(height=1, width=4, encoding="mono16", step=4, data=b"abcdefgh"),
    ],
)
def test_images_of_another_kind_or_size_are_refused(msg):
    with pytest.raises(EvidenceError, match="image"):
        conversions.image_to_array(msg)


def test_depth_in_millimetres_becomes_metres_with_nan_for_none():
    msg = conversions.array_to_image(np.array([[0, 1500]], np.uint16), "16UC1", Header())
    np.testing.assert_array_equal(conversions.depth_to_m(msg), np.array([[np.nan, 1.5]], np.float32))
    with pytest.raises(EvidenceError, match="depth"):
        conversions.depth_to_m(conversions.array_to_image(np.zeros((1, 1), np.uint8), "mono8", Header()))


def test_colour_becomes_rgb():
    bgr = np.array([[[1, 2, 3]]], np.uint8)
    assert conversions.color_to_rgb(conversions.array_to_image(bgr, "bgr8", Header())).tolist() == [[[3, 2, 1]]]
    assert conversions.color_to_rgb(conversions.array_to_image(bgr[..., 0], "mono8", Header())).tolist() == [
        [[1, 1, 1]]
    ]


@pytest.mark.parametrize("size", [(0, 0, 3), (0, 4, 3), (4, 0, 3)])
def test_a_colour_image_without_a_pixel_is_refused(size):
    with pytest.raises(EvidenceError, match="colour image: got"):
        conversions.color_to_rgb(conversions.array_to_image(np.zeros(size, np.uint8), "rgb8", Header()))


@pytest.mark.parametrize("text", STATEMENTS)
def test_predicates_come_back_as_they_went(text):
    msg = conversions.predicate_to_msg(parse_predicate(text))
    msg.radius_m = float(np.float32(msg.radius_m))  # what the wire keeps
    assert str(conversions.predicate_from_msg(msg)) == text


@pytest.mark.parametrize(
    "field, value",
    [("spatial_operator", 9), ("verdict", 2), ("severity", 5), ("class_name", "Big Box"), ("radius_m", math.nan)],
)
def test_predicate_messages_outside_the_grammar_are_refused(field, value):
    msg = PredicateMsg(spatial_operator=PredicateMsg.AROUND, class_name="car", verdict=PredicateMsg.UNSAFE)
    setattr(msg, field, value)
    with pytest.raises(PredicateError):
        conversions.predicate_from_msg(msg)


@given(st.integers(0, 2**32 * 10**9 - 1))
def test_stamps_come_back_as_they_went(stamp_ns):
    assert conversions.stamp_to_ns(conversions.ns_to_stamp(stamp_ns)) == stamp_ns


@pytest.mark.parametrize("image_stamp_ns", [None, 0, 1_500_000_001])
def test_constraints_come_back_as_they_went(image_stamp_ns):
    predicates = () if image_stamp_ns is None else tuple(map(parse_predicate, STATEMENTS))
    constraints = Constraints(predicates, ("floor",), "because", "ontology", image_stamp_ns, 100_000_000)
    msg = conversions.constraints_to_msg(constraints, 2_000_000_000)
    assert msg.header.stamp.to_nsec() == 2_000_000_000
    assert math.isnan(msg.confidence)
    assert conversions.constraints_from_msg(msg) == constraints


def test_classes_seen_are_canonical_and_leave_out_what_is_no_name():
    labels = [
        LabelClass(1, "Traffic Cone", 1.0),
        LabelClass(2, "traffic_cone", 1.0),
        LabelClass(3, "???", 1.0),
        LabelClass(4, "floor", 1.0),
    ]
    assert conversions.classes_seen(LabelInfo(labels=labels)) == ("floor", "traffic_cone")


def test_held_instances_stand_in_the_middle_of_their_footprint():
    msg = InstanceArray(instances=[cone_instance(4, "traffic_cone", 2.0, -1.0), cone_instance(5, "", 0.0, 0.0)])
    (held,) = conversions.held_instances(msg)
    assert (held.id, held.class_name, held.in_view) == (4, "traffic_cone", True)
    assert held.position_m == pytest.approx((2.0, -1.0), abs=1e-6)


def test_grid_views_are_row_major_and_checked():
    msg = SafetyGrid(width=3, height=2, resolution_m=0.1, state=bytes([0, 1, 2, 2, 1, 0]))
    assert conversions.grid_view(msg).state.tolist() == [[0, 1, 2], [2, 1, 0]]
    msg.width = 4
    with pytest.raises(EvidenceError, match="safety_grid"):
        conversions.grid_view(msg)


def test_transforms_become_matrices():
    half = math.sqrt(0.5)
    matrix = conversions.transform_to_matrix(
        Transform(Vector3(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 2.0 * half, 2.0 * half))
    )
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 0.0, 1.0], [1.0, 3.0, 3.0, 1.0], atol=1e-12)
    with pytest.raises(EvidenceError, match="quaternion"):
        conversions.transform_to_matrix(Transform())


@pytest.mark.parametrize("now, expected_s", [(rospy.Time(0), None), (rospy.Time(12, 500_000_000), 12.5)])
def test_a_simulated_clock_that_has_not_begun_tells_no_time(monkeypatch, now, expected_s):
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: now))
    assert operator_services._now_s() == expected_s
