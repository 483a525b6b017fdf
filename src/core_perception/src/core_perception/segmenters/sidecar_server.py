# SPDX-License-Identifier: BSD-3-Clause
"""The server's half of the side-car contract: requests checked, one worked on at a time, replies written.

Contract: docs/segmenter_sidecar.md. It needs neither ROS nor OpenCV: it runs in a Python of its own, beside a model.
"""

from __future__ import annotations

import abc
import base64
import binascii
import math
import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, Optional, Sequence, Tuple

import numpy as np

from core_perception.exceptions import PredicateError
from core_perception.json_server import CONTRACT_VERSION, BadRequestError, JsonServer
from core_perception.predicates import canonical_class_name
from core_perception.segmenters.rle import encode_mask

MAX_EDGE_PX = 8192
MAX_CLASSES = 1000
MAX_DEADLINE_S = 600.0


@dataclass(frozen=True)
class SegmentRequest:
    """One request.

    Attributes:
        file: bytes of the image file.
        image_format: ``jpeg`` or ``png``.
        size_px: its height and width.
        classes: canonical names, the most wanted first.
        min_score: weaker instances are not wanted.
        deadline_s: time to answer in [s].
        stamp: of the image, to be given back.
    """

    file: bytes
    image_format: str
    size_px: Tuple[int, int]
    classes: Tuple[str, ...]
    min_score: float
    deadline_s: float
    stamp: Dict[str, int]


@dataclass(frozen=True)
class Found:
    """One instance: class as it was asked, score in 0..1, mask (h, w) bool of the size of the image."""

    class_name: str
    score: float
    mask: np.ndarray


class SidecarModel(abc.ABC):
    """What a side-car is put before; one call at a time."""

    #: Its name.
    model: str = ""
    #: Its masks mean nothing.
    random_weights: bool = False
    #: Most classes of one request; None for any number.
    max_classes: Optional[int] = None

    @abc.abstractmethod
    def segment(
        self, request: SegmentRequest, is_time_left: Callable[[], bool]
    ) -> Tuple[Sequence[Found], Sequence[str]]:
        """Return what was found, and the classes that were looked for, which may be fewer than were asked.

        Args:
            request: has been checked, but for the content of the image file.
            is_time_left: asked before each class.

        Raises:
            BadRequestError: the image file cannot be read, or has another size than it says.
        """


class SidecarServer(JsonServer):
    """Serves one model until stop()."""

    def __init__(self, model: SidecarModel, host: str = "127.0.0.1", port: int = 0):
        """Listen; see JsonServer.

        Raises:
            OSError: the address is taken or not of this machine.
        """
        capabilities = {
            "model": model.model,
            "tasks": ["segment"],
            "classes": None,
            "max_classes": model.max_classes or MAX_CLASSES,
            "random_weights": model.random_weights,
        }

        def answer(request, begun_s):
            return _answer(model, request, begun_s)

        super().__init__("/v1/segment", capabilities, read_request, answer, host, port)


def read_request(value: Any) -> SegmentRequest:
    """Check a request.

    Raises:
        BadRequestError: a part is missing or wrong; the message names it and what is allowed.
    """
    _check(isinstance(value, dict), "the body: allowed a JSON object")
    _check(type(value.get("version")) is int and value["version"] == CONTRACT_VERSION, "version: allowed 1")
    image, stamp, classes = value.get("image"), value.get("stamp"), value.get("classes")
    keys = isinstance(stamp, dict) and set(stamp) == {"secs", "nsecs"}
    _check(keys and all(type(part) is int and part >= 0 for part in stamp.values()), "stamp: allowed secs and nsecs")
    _check(_is_number(value.get("min_score")) and 0 <= value["min_score"] <= 1, "min_score: allowed 0..1")
    deadline_s = value.get("deadline_s")
    _check(_is_number(deadline_s) and 0 < deadline_s <= MAX_DEADLINE_S, f"deadline_s: allowed up to {MAX_DEADLINE_S}")
    named = (
        isinstance(classes, list) and 0 < len(classes) <= MAX_CLASSES and len(set(map(str, classes))) == len(classes)
    )
    _check(named and all(map(_is_class, classes)), f"classes: allowed up to {MAX_CLASSES} names, each once")
    _check(isinstance(image, dict) and image.get("format") in ("jpeg", "png"), "image: format: allowed jpeg, png")
    size_px, data = image.get("size"), image.get("data")
    is_size = isinstance(size_px, list) and len(size_px) == 2 and all(type(edge) is int for edge in size_px)
    _check(is_size and all(0 < edge <= MAX_EDGE_PX for edge in size_px), f"image: size: allowed 1..{MAX_EDGE_PX}")
    try:
        file = base64.b64decode(data, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise BadRequestError("image: data: allowed base64") from None
    return SegmentRequest(
        file, image["format"], tuple(size_px), tuple(classes), float(value["min_score"]), float(deadline_s), stamp
    )


class _TimeLeft:
    """Whether one more step ends before a time, if it takes no longer than the longest so far; ask before each step."""

    def __init__(self, end_s: float):
        self._end_s, self._asked_s, self._longest_s = end_s, math.inf, 0.0

    def __call__(self) -> bool:
        now_s = time.monotonic()
        self._longest_s = max(self._longest_s, now_s - self._asked_s)
        self._asked_s = now_s
        return now_s + self._longest_s < self._end_s


def _answer(model: SidecarModel, request: SegmentRequest, begun_s: float) -> Dict[str, Any]:
    found, evaluated = model.segment(request, _TimeLeft(begun_s + request.deadline_s))
    instances = [
        {
            "class": one.class_name,
            "score": float(one.score),
            "mask": {"size": list(request.size_px), "counts": encode_mask(one.mask)},
        }
        for one in found
    ]
    return {
        "model": model.model,
        "stamp": request.stamp,
        "size": list(request.size_px),
        "classes_evaluated": list(evaluated),
        "instances": instances,
    }


def _is_class(name) -> bool:
    try:
        return isinstance(name, str) and canonical_class_name(name) == name
    except PredicateError:
        return False


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _check(is_right: bool, problem: str) -> None:
    if not is_right:
        raise BadRequestError(problem)
