# SPDX-License-Identifier: BSD-3-Clause
"""Decodes the images of image_transport's compressed topics, for which Debian packages no plugin."""

from __future__ import annotations

import struct
from typing import Tuple

import cv2
import numpy as np

from core_perception.exceptions import EvidenceError

# compressed_depth_image_transport's ConfigHeader: int32 format, float32 quantisation A and B.
_HEADER = struct.Struct("<i2f")
_ENCODINGS = {("uint8", 2): "mono8", ("uint16", 2): "16UC1"}


def decode_image(data: bytes, kind: str) -> Tuple[np.ndarray, str]:
    """Decode one image of a compressed topic.

        depth_m = A / (value - B),   value 0: no distance        (compressedDepth of 32FC1)

    Args:
        data: the file, JPEG or PNG; of compressedDepth a header and a PNG.
        kind: the ``format`` of sensor_msgs/CompressedImage, such as ``rgb8; jpeg compressed bgr8``, ``png`` or
            ``16UC1; compressedDepth png``.

    Returns:
        (h, w) uint8, uint16 or float32 [m], or (h, w, 3) uint8, and its encoding: mono8, 16UC1, 32FC1, bgr8 or rgb8.

    Raises:
        EvidenceError: bytes that are no such image, or a compression that is not known (RVL).

    Source: compressed_image_transport and compressed_depth_image_transport of ros-perception/image_transport_plugins.
    """
    encoding, _, compression = kind.partition(";")
    if "compressedDepth" in compression:
        return _decode_depth(data, encoding.strip(), compression)
    pixels = _decode_file(data, kind)
    if pixels.ndim == 3:
        # Where the writer does not say that it made bgr8 of it first, red and blue lie in the file as in the image.
        is_swapped = bool(compression) and "compressed bgr8" not in compression
        return np.ascontiguousarray(pixels[:, :, :3]), "rgb8" if is_swapped else "bgr8"
    return pixels, _ENCODINGS[pixels.dtype.name, 2]


def _decode_depth(data, encoding, compression):
    if "rvl" in compression:
        raise EvidenceError("compressed depth: got RVL, allowed PNG; set the driver's compressedDepth/format to png")
    if len(data) <= _HEADER.size:
        raise EvidenceError(f"compressed depth: got {len(data)} bytes, allowed a header of {_HEADER.size} and a PNG")
    _, a, b = _HEADER.unpack_from(data)
    values = _decode_file(data[_HEADER.size :], "compressedDepth")
    if encoding not in ("16UC1", "mono16", "32FC1") or values.dtype != np.uint16 or values.ndim != 2:
        raise EvidenceError(f"compressed depth: got {encoding!r} in {values.dtype}, allowed 16UC1 or 32FC1 in uint16")
    if encoding != "32FC1":
        return values, "16UC1"
    with np.errstate(divide="ignore"):
        depth_m = np.where(values == 0, np.nan, a / (values.astype(np.float64) - b))
    return depth_m.astype(np.float32), "32FC1"


def _decode_file(data, kind) -> np.ndarray:
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error as error:
        raise EvidenceError(f"compressed image: {error.err or error}") from error
    is_known = pixels is not None and (
        (pixels.dtype.name, pixels.ndim) in _ENCODINGS
        or (pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[2] in (3, 4))
    )
    if not is_known:
        what = "no image" if pixels is None else f"{pixels.dtype} {pixels.shape}"
        raise EvidenceError(f"compressed image: got {what} in {len(data)} bytes of {kind!r}, allowed JPEG or PNG")
    if data[:2] == b"\xff\xd8" and data.rstrip(b"\0")[-2:] != b"\xff\xd9":
        raise EvidenceError(f"compressed image: a JPEG of {len(data)} bytes that is cut off")
    return pixels
