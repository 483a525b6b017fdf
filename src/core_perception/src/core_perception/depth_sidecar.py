# SPDX-License-Identifier: BSD-3-Clause
"""The depth part of the side-car contract: a request, and a reply that is refused as a whole if a part is wrong.

Contract: docs/depth_sidecar.md, which follows docs/segmenter_sidecar.md.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any, Dict, Optional, Tuple

import numpy as np

from core_perception.exceptions import EvidenceError, quote
from core_perception.scale_fit import KINDS, Prediction
from core_perception.sidecar_client import CONTRACT_VERSION, SidecarClient, encode_picture

DEPTH_PATH = "/v1/depth"
DTYPES = {"float32": np.dtype("<f4"), "float16": np.dtype("<f2")}
LARGEST_EDGE_PX = 4096
MAX_REPLY_BYTES = 1 << 26
LONGEST_MODEL_NAME = 200
#: Share of the deadline that the server is given; the rest is for the way.
SERVER_SHARE = 0.9


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of an image of a known size [px]; pixel (u, v) is centred at the integer."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    def scaled(self, width_px: int, height_px: int) -> Pinhole:
        """The same view at another size; borders of pixels scale, not their centres."""
        sx, sy = width_px / self.width_px, height_px / self.height_px
        cx_px, cy_px = (self.cx_px + 0.5) * sx - 0.5, (self.cy_px + 0.5) * sy - 0.5
        return Pinhole(width_px, height_px, self.fx_px * sx, self.fy_px * sy, cx_px, cy_px)


@dataclass(frozen=True)
class DepthAnswer:
    """What a side-car said.

    Attributes:
        prediction: of the picture that was sent.
        model: its name.
        random_weights: the prediction means nothing; it is there to be tried out.
    """

    prediction: Prediction
    model: str
    random_weights: bool = False


def ask_depth(
    client: SidecarClient, image_rgb: np.ndarray, camera: Optional[Pinhole], stamp_ns: int, max_image_px: int
) -> DepthAnswer:
    """Ask about one picture and wait.

    Args:
        client: knows where the side-car is, and the deadline.
        image_rgb: (h, w, 3) uint8.
        camera: its intrinsics; None if not known, without which some models cannot speak of metres.
        stamp_ns: of the picture [ns].
        max_image_px: longest edge of the picture that is sent; a larger one is scaled down.

    Raises:
        ServerError: there is no answer.
        EvidenceError: an answer that does not keep to the contract, or a picture of another shape or type.
    """
    picture = encode_picture(image_rgb, "jpeg", max_image_px)
    request = compose_request(picture, camera, stamp_ns, SERVER_SHARE * client.deadline_s)
    return read_answer(client.call(DEPTH_PATH, request), stamp_ns)


def compose_request(
    picture: Dict[str, Any], camera: Optional[Pinhole], stamp_ns: int, deadline_s: float
) -> Dict[str, Any]:
    """Return the request about one picture; the intrinsics in it are those of the picture that is sent.

    Args:
        picture: as from encode_picture.
        camera: of the picture at any size; None if not known.
        stamp_ns: of the picture [ns].
        deadline_s: what the server may take [s].
    """
    height_px, width_px = picture["size"]
    at_size = None if camera is None else camera.scaled(width_px, height_px)
    return {
        "version": CONTRACT_VERSION,
        "stamp": _stamp(stamp_ns),
        "deadline_s": deadline_s,
        "image": picture,
        "camera": at_size and {key: getattr(at_size, key) for key in ("fx_px", "fy_px", "cx_px", "cy_px")},
    }


def read_answer(value: Dict[str, Any], stamp_ns: int) -> DepthAnswer:
    """Read a reply of DEPTH_PATH.

    Args:
        value: the reply, of this contract's version.
        stamp_ns: of the picture that was sent [ns].

    Raises:
        EvidenceError: any part of it is missing or wrong; nothing of it may be used.
    """
    _check(value.get("stamp") == _stamp(stamp_ns), value, "stamp", str(_stamp(stamp_ns)))
    _check(value.get("kind") in KINDS, value, "kind", "one of " + ", ".join(KINDS))
    model = value.get("model")
    named = isinstance(model, str) and model.isprintable() and 0 < len(model) <= LONGEST_MODEL_NAME
    _check(named, value, "model", "a printable name")
    is_random = value.get("random_weights", False)
    _check(isinstance(is_random, bool), value, "random_weights", "true or false")
    size = value.get("size")
    sized = isinstance(size, list) and len(size) == 2
    sized = sized and all(type(edge) is int and 0 < edge <= LARGEST_EDGE_PX for edge in size)
    _check(sized, value, "size", f"height and width, each from 1 to {LARGEST_EDGE_PX}")
    dtype = value.get("dtype")
    _check(isinstance(dtype, str) and dtype in DTYPES, value, "dtype", "one of " + ", ".join(DTYPES))
    depth = _read_image(value.get("depth"), "depth", DTYPES[dtype], tuple(size))
    confidence = value.get("confidence")
    if confidence is not None:
        confidence = _read_image(confidence, "confidence", DTYPES[dtype], tuple(size))
    return DepthAnswer(Prediction(depth, value["kind"], confidence), model, is_random)


def encode_image(image: np.ndarray, dtype: str) -> str:
    """Write (h, w) numbers as a reply has them: base64 of little-endian rows, top row first."""
    return base64.b64encode(np.ascontiguousarray(image, DTYPES[dtype]).tobytes()).decode("ascii")


def _read_image(text: Any, key: str, dtype: np.dtype, size: Tuple[int, int]) -> np.ndarray:
    wanted = size[0] * size[1] * dtype.itemsize
    try:
        data = base64.b64decode(text, validate=True) if isinstance(text, str) else b""
    except ValueError:  # binascii.Error is one
        data = b""
    if len(data) != wanted:
        raise EvidenceError(
            f"reply: {key}: allowed base64 of {wanted} bytes ({size[0]} rows of {size[1]} {dtype.name})"
        )
    return np.frombuffer(data, dtype).reshape(size).astype(np.float32)


def _check(is_right: bool, value: Dict[str, Any], key: str, allowed: str) -> None:
    if not is_right:
        raise EvidenceError(f"reply: {key}: got {quote(value.get(key))}, allowed {allowed}")


def _stamp(stamp_ns: int) -> Dict[str, int]:
    return {"secs": stamp_ns // 10**9, "nsecs": stamp_ns % 10**9}
