# SPDX-License-Identifier: BSD-3-Clause
"""The segmenting part of the side-car contract: a request, and a reply that is refused as a whole if a part is wrong.

Contract: docs/segmenter_sidecar.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, Optional, Tuple

from core_perception.exceptions import EvidenceError, PredicateError, quote
from core_perception.predicates import canonical_class_name
from core_perception.segmenters.painting import Instance
from core_perception.segmenters.rle import read_runs
from core_perception.sidecar_client import CONTRACT_VERSION

SEGMENT_PATH = "/v1/segment"
CAPABILITIES_PATH = "/v1/capabilities"
LONGEST_MODEL_NAME = 200
LONGEST_CLASS_LIST = 100_000
MAX_INSTANCES = 2000


@dataclass(frozen=True)
class Capabilities:
    """What a side-car says of itself.

    Attributes:
        model: its name.
        classes: canonical names it knows; None for open vocabulary.
        max_classes: most classes of one request; None for any number.
        random_weights: its masks mean nothing; it is there to be tried out.
    """

    model: str
    classes: Optional[Tuple[str, ...]] = None
    max_classes: Optional[int] = None
    random_weights: bool = False

    @classmethod
    def read(cls, value: Dict[str, Any]) -> Capabilities:
        """Read a reply of CAPABILITIES_PATH; keys it does not know are left alone.

        Raises:
            EvidenceError: a value is missing or wrong.
        """
        tasks = value.get("tasks")
        if not isinstance(tasks, list) or "segment" not in tasks:
            raise EvidenceError(f"capabilities: tasks: got {quote(tasks)}, allowed a list with 'segment'")
        classes = value.get("classes")
        if classes is not None:
            classes = _names(classes, "capabilities: classes")
        most = value.get("max_classes")
        if most is not None and (type(most) is not int or most < 1):
            raise EvidenceError(f"capabilities: max_classes: got {quote(most)}, allowed null or a whole number >= 1")
        is_random = value.get("random_weights", False)
        if not isinstance(is_random, bool):
            raise EvidenceError(f"capabilities: random_weights: got {quote(is_random)}, allowed true or false")
        return cls(_model(value), classes, most, is_random)


@dataclass(frozen=True)
class SidecarReply:
    """What a side-car found in one image.

    Attributes:
        instances: with masks of the size that was sent.
        classes_evaluated: those of the request that were looked for, in its order.
        model: who answered.
    """

    instances: Tuple[Instance, ...]
    classes_evaluated: Tuple[str, ...]
    model: str


def compose_request(
    picture: Dict[str, Any], classes: Tuple[str, ...], stamp_ns: int, deadline_s: float, min_score: float
) -> Dict[str, Any]:
    """Return the request about one image.

    Args:
        picture: as from encode_picture.
        classes: canonical names, the most wanted first.
        stamp_ns: stamp of the image [ns].
        deadline_s: what the server may take [s].
        min_score: weaker instances are not wanted, 0..1.
    """
    return {
        "version": CONTRACT_VERSION,
        "stamp": _stamp(stamp_ns),
        "deadline_s": deadline_s,
        "min_score": min_score,
        "image": picture,
        "classes": list(classes),
    }


def read_reply(
    value: Dict[str, Any], classes: Tuple[str, ...], stamp_ns: int, size_px: Tuple[int, int], min_score: float
) -> SidecarReply:
    """Read a reply of SEGMENT_PATH; instances below min_score are left out.

    Args:
        value: the reply.
        classes: as they were asked.
        stamp_ns: stamp of the image that was sent [ns].
        size_px: height and width of the image that was sent.
        min_score: as it was asked.

    Raises:
        EvidenceError: any part of it is missing or wrong; nothing of it may be used.
    """
    if value.get("stamp") != _stamp(stamp_ns):
        raise EvidenceError(f"reply: stamp: got {quote(value.get('stamp'))}, allowed {_stamp(stamp_ns)}")
    if value.get("size") != list(size_px):
        raise EvidenceError(f"reply: size: got {quote(value.get('size'))}, allowed {list(size_px)}")
    evaluated = value.get("classes_evaluated")
    if not isinstance(evaluated, list) or not all(isinstance(name, str) for name in evaluated):
        raise EvidenceError("reply: classes_evaluated: allowed a list of names")
    strange = sorted(set(evaluated) - set(classes))
    if strange:
        raise EvidenceError(f"reply: classes_evaluated: got {quote(strange[0])}, which was not asked for")
    entries = value.get("instances")
    if not isinstance(entries, list) or len(entries) > MAX_INSTANCES:
        raise EvidenceError(f"reply: instances: allowed a list of at most {MAX_INSTANCES}")
    looked_for = frozenset(evaluated)
    read = [_instance(entry, k, looked_for, size_px) for k, entry in enumerate(entries)]
    wanted = tuple(instance for instance in read if instance.score >= min_score)
    return SidecarReply(wanted, tuple(name for name in classes if name in looked_for), _model(value))


def _instance(entry, k, looked_for, size_px) -> Instance:
    where = f"reply: instances[{k}]"
    if not isinstance(entry, dict):
        raise EvidenceError(f"{where}: allowed an object with class, score and mask")
    name, score, mask = (entry.get(key) for key in ("class", "score", "mask"))
    if not isinstance(name, str) or name not in looked_for:
        raise EvidenceError(f"{where}: class: got {quote(name)}, allowed one of classes_evaluated")
    if isinstance(score, bool) or not isinstance(score, (int, float)) or not (math.isfinite(score) and 0 <= score <= 1):
        raise EvidenceError(f"{where}: score: got {quote(score)}, allowed a number from 0 to 1")
    if not isinstance(mask, dict) or mask.get("size") != list(size_px):
        got = mask.get("size") if isinstance(mask, dict) else mask
        raise EvidenceError(f"{where}: mask: got size {quote(got)}, allowed {list(size_px)}")
    try:
        return Instance(name, float(score), read_runs(mask.get("counts"), size_px))
    except ValueError as error:
        raise EvidenceError(f"{where}: mask: {error}") from None


def _model(value) -> str:
    model = value.get("model")
    if not isinstance(model, str) or not model.isprintable() or not 0 < len(model) <= LONGEST_MODEL_NAME:
        raise EvidenceError(f"model: got {quote(model)}, allowed a printable name")
    return model


def _names(values, where) -> Tuple[str, ...]:
    if not isinstance(values, list) or not 0 < len(values) <= LONGEST_CLASS_LIST:
        raise EvidenceError(f"{where}: allowed null or a list of names")
    try:
        return tuple(dict.fromkeys(canonical_class_name(value) for value in values))
    except PredicateError as error:
        raise EvidenceError(f"{where}: {error}") from None


def _stamp(stamp_ns: int) -> Dict[str, int]:
    return {"secs": stamp_ns // 10**9, "nsecs": stamp_ns % 10**9}
