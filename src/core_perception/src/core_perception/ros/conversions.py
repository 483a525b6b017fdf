# SPDX-License-Identifier: BSD-3-Clause
"""Messages <-> library types; the only place where both are known."""

from __future__ import annotations

import sys
from typing import Optional, Sequence, Tuple

import numpy as np
import rospy
from core_msgs.msg import LabelClass, LabelInfo, SafetyConstraints
from core_msgs.msg import Predicate as PredicateMsg
from sensor_msgs.msg import CameraInfo as CameraInfoMsg
from sensor_msgs.msg import Image

from core_perception.checks.base import CameraInfo
from core_perception.exceptions import EvidenceError, PredicateError
from core_perception.overlay import GridView
from core_perception.predicates import Constraints, Operator, Predicate, Severity, Verdict, canonical_class_name
from core_perception.reasoners.base import HeldInstance
from core_perception.segmenters.base import Segmentation

_DTYPES = {
    "mono8": (np.uint8, 1),
    "mono16": (np.uint16, 1),
    "16UC1": (np.uint16, 1),
    "32FC1": (np.float32, 1),
    "rgb8": (np.uint8, 3),
    "bgr8": (np.uint8, 3),
}


def stamp_to_ns(stamp) -> int:
    """ROS time -> whole nanoseconds."""
    return stamp.to_nsec()


def ns_to_stamp(stamp_ns: int) -> rospy.Time:
    """Whole nanoseconds, >= 0 -> ROS time."""
    return rospy.Time(stamp_ns // 10**9, stamp_ns % 10**9)


def image_to_array(msg: Image) -> np.ndarray:
    """Return the pixels without row padding: (h, w) uint8, uint16, float32, or (h, w, 3) uint8 in the encoding's order.

    Raises:
        EvidenceError: another encoding, or fewer bytes than the size needs.
    """
    if msg.encoding not in _DTYPES:
        raise EvidenceError(f"image: got encoding {msg.encoding!r}, allowed {', '.join(_DTYPES)}")
    dtype, channels = _DTYPES[msg.encoding]
    dtype = np.dtype(dtype).newbyteorder(">" if msg.is_bigendian else "<")
    row_bytes = msg.width * channels * dtype.itemsize
    if msg.step < row_bytes or len(msg.data) < msg.step * msg.height:
        raise EvidenceError(
            f"image: got {len(msg.data)} bytes in rows of {msg.step}, allowed {msg.height} rows of >= {row_bytes}"
        )
    rows = np.frombuffer(msg.data, np.uint8, msg.step * msg.height).reshape(msg.height, msg.step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(dtype).reshape(msg.height, msg.width, channels)
    return (pixels[:, :, 0] if channels == 1 else pixels).astype(dtype.newbyteorder("="), copy=False)


def array_to_image(array: np.ndarray, encoding: str, header) -> Image:
    """Return an image message of an (h, w) or (h, w, 3) array; the encoding must be one of image_to_array's.

    Raises:
        EvidenceError: the array does not have the type of the encoding.
    """
    dtype, channels = _DTYPES[encoding]
    if array.dtype != dtype or array.ndim != (2 if channels == 1 else 3):
        raise EvidenceError(f"image: got {array.dtype} {array.shape} for {encoding}")
    msg = Image(header=header, height=array.shape[0], width=array.shape[1], encoding=encoding)
    msg.is_bigendian = int(sys.byteorder == "big")
    msg.step = array.shape[1] * channels * array.dtype.itemsize
    msg.data = array.tobytes()
    return msg


def predicate_to_msg(predicate: Predicate, exempt_instances: Sequence[int] = ()) -> PredicateMsg:
    """Library predicate, and the instances it does not speak of -> message; a radius of None becomes 0."""
    return PredicateMsg(
        exempt_instances=list(exempt_instances),
        spatial_operator=int(predicate.operator),
        class_name=predicate.class_name,
        verdict=int(predicate.verdict),
        severity=int(predicate.severity),
        radius_m=predicate.radius_m or 0.0,
    )


def predicate_from_msg(msg: PredicateMsg) -> Predicate:
    """Message -> library predicate; the radius keeps the six digits that a float32 carries.

    Raises:
        PredicateError: a number that stands for no operator, verdict or severity, or a predicate outside the grammar.
    """
    try:
        operator, verdict, severity = Operator(msg.spatial_operator), Verdict(msg.verdict), Severity(msg.severity)
    except ValueError as error:
        raise PredicateError(f"predicate message: {error}") from error
    return Predicate(
        operator, msg.class_name, verdict, float(f"{msg.radius_m:.6g}") if msg.radius_m else None, severity
    )


def constraints_to_msg(constraints: Constraints, stamp_ns: int) -> SafetyConstraints:
    """Constraints -> the statement that holds from stamp_ns on."""
    msg = SafetyConstraints(
        source=constraints.source, justification=constraints.justification, confidence=constraints.confidence
    )
    msg.header.stamp = ns_to_stamp(stamp_ns)
    msg.image_stamp = ns_to_stamp(constraints.image_stamp_ns or 0)
    msg.latency = rospy.Duration(constraints.latency_ns // 10**9, constraints.latency_ns % 10**9)
    msg.predicates = [predicate_to_msg(p, constraints.exempt.get(p, ())) for p in constraints.predicates]
    msg.instances_history_start = ns_to_stamp(constraints.instances_history_start_ns or 0)
    msg.classes = list(constraints.classes)
    return msg


def constraints_from_msg(msg: SafetyConstraints) -> Constraints:
    """Message -> constraints.

    Raises:
        PredicateError: see predicate_from_msg.
    """
    predicates = tuple(predicate_from_msg(p) for p in msg.predicates)
    exempt = {p: tuple(m.exempt_instances) for p, m in zip(predicates, msg.predicates) if m.exempt_instances}
    return Constraints(
        predicates,
        tuple(msg.classes),
        msg.justification,
        msg.source,
        stamp_to_ns(msg.image_stamp) if msg.image_stamp or msg.predicates else None,
        msg.latency.to_nsec(),
        msg.confidence,
        exempt,
        stamp_to_ns(msg.instances_history_start) if msg.instances_history_start else None,
    )


def _class_name_or_none(text: str):
    try:
        return canonical_class_name(text)
    except PredicateError:
        return None


def classes_seen(msg: LabelInfo) -> Tuple[str, ...]:
    """Canonical class names of the frame's labels, sorted; what no rule could name is left out."""
    return tuple(sorted({_class_name_or_none(label.class_name) for label in msg.labels} - {None}))


def held_instances(msg) -> Tuple[HeldInstance, ...]:
    """InstanceArray -> instances, each at the middle of its footprint; without footprint or name it is left out."""
    held = []
    for instance in msg.instances:
        name = _class_name_or_none(instance.class_name)
        if instance.footprint and name is not None:
            corners = np.array([[p.x, p.y] for p in instance.footprint])
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
            held.append(HeldInstance(instance.id, name, tuple(middle), instance.cluster, instance.in_view))
    return tuple(held)


def history_start_ns(msg) -> Optional[int]:
    """Return the history that the instances of an InstanceArray are counted by; None while the map has none."""
    return stamp_to_ns(msg.history_start) if msg.history_start else None


def segmentation_to_label_info(segmentation: Segmentation, header) -> LabelInfo:
    """Masks of a segmentation -> message."""
    labels = [LabelClass(mask.label, mask.class_name, mask.score) for mask in segmentation.masks]
    return LabelInfo(header, labels, list(segmentation.classes_evaluated))


def grid_view(msg) -> GridView:
    """SafetyGrid -> what the overlay needs of it.

    Raises:
        EvidenceError: the number of cells differs from width times height.
    """
    states = (
        np.frombuffer(msg.state, np.uint8)
        if isinstance(msg.state, (bytes, bytearray))
        else np.array(msg.state, np.uint8)
    )
    if states.size != msg.width * msg.height:
        raise EvidenceError(f"safety_grid: got {states.size} cells, allowed {msg.width} x {msg.height}")
    return GridView(
        states.reshape(msg.height, msg.width), msg.resolution_m, msg.origin_x_m, msg.origin_y_m, msg.unknown_is_unsafe
    )


def color_to_rgb(msg: Image) -> np.ndarray:
    """Colour image -> (h, w, 3) uint8 rgb.

    Raises:
        EvidenceError: an encoding other than rgb8, bgr8 or mono8, or no pixel.
    """
    pixels = image_to_array(msg)
    if pixels.size == 0:
        raise EvidenceError(f"colour image: got {msg.width} x {msg.height} pixels, allowed at least one")
    if pixels.dtype != np.uint8:
        raise EvidenceError(f"colour image: got encoding {msg.encoding!r}, allowed rgb8, bgr8, mono8")
    if pixels.ndim == 2:
        return np.repeat(pixels[:, :, None], 3, axis=2)
    return pixels[:, :, ::-1].copy() if msg.encoding == "bgr8" else pixels


def depth_to_m(msg: Image) -> np.ndarray:
    """Depth image -> (h, w) float32 [m]; NaN where a 16UC1 image (millimetres; some drivers say mono16) holds 0.

    Raises:
        EvidenceError: an encoding other than 32FC1, 16UC1 or mono16.
    """
    pixels = image_to_array(msg)
    if msg.encoding == "32FC1":
        return pixels
    if msg.encoding not in ("16UC1", "mono16"):
        raise EvidenceError(f"depth image: got encoding {msg.encoding!r}, allowed 32FC1, 16UC1")
    return np.where(pixels == 0, np.nan, pixels / 1000.0).astype(np.float32)


def transform_to_matrix(transform) -> np.ndarray:
    """geometry_msgs/Transform -> (4, 4) homogeneous matrix [m]; the quaternion is normalised.

    Raises:
        EvidenceError: a quaternion of length 0.
    """
    q, t = transform.rotation, transform.translation
    x, y, z, w = np.array([q.x, q.y, q.z, q.w])
    length = np.sqrt(x * x + y * y + z * z + w * w)
    if not length > 0.0:
        raise EvidenceError("transform: got a quaternion of length 0")
    x, y, z, w = np.array([x, y, z, w]) / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = [t.x, t.y, t.z]
    return matrix


def camera_info_from_msg(msg: CameraInfoMsg) -> CameraInfo:
    """Message -> library type."""
    roi = (msg.roi.x_offset, msg.roi.y_offset, msg.roi.width, msg.roi.height)
    binning = (msg.binning_x, msg.binning_y)
    return CameraInfo(msg.width, msg.height, tuple(msg.K), tuple(msg.D), msg.distortion_model, binning, roi)
