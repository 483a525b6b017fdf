# SPDX-License-Identifier: BSD-3-Clause
"""Messages of one frame -> what a segmenter is given."""

from __future__ import annotations

import math
from typing import Dict, Optional

from core_msgs.msg import LabelInfo, SafetyConstraints

from core_perception.exceptions import EvidenceError
from core_perception.predicates import Verdict, canonical_class_name
from core_perception.ros.conversions import color_to_rgb, image_to_array, stamp_to_ns
from core_perception.segmenters.base import IMAGE, LABEL_INFO, LABELS, GivenLabel, SegmenterFrame


def given_labels(msg: LabelInfo) -> Dict[int, GivenLabel]:
    """Meaning of the labels of somebody else's LabelInfo; further entries of a label are further names of it.

    Raises:
        EvidenceError: label 0, a score outside 0..1, or one that differs between entries of a label.
        PredicateError: what is no class name.
    """
    given: Dict[int, GivenLabel] = {}
    for entry in msg.labels:
        if entry.id == 0 or not (math.isfinite(entry.score) and 0.0 <= entry.score <= 1.0):
            raise EvidenceError(f"label_info: got id {entry.id} with score {entry.score}, allowed 1..65535 and 0..1")
        known = given.get(entry.id, GivenLabel((), entry.score))
        if known.score != entry.score:
            raise EvidenceError(f"label_info: got two scores of label {entry.id}")
        names = (*known.names, canonical_class_name(entry.class_name))
        given[entry.id] = GivenLabel(tuple(dict.fromkeys(names)), entry.score)
    return given


def segmenter_frame(messages: dict, constraints: Optional[SafetyConstraints], vocabulary, header) -> SegmenterFrame:
    """Messages of one frame -> what a segmenter is given.

    Args:
        messages: by IMAGE, LABELS, LABEL_INFO; only those that the segmenter reads.
        constraints: in force; None for none.
        vocabulary: canonical names that are always asked for.
        header: of the frame.

    Raises:
        EvidenceError: an image or a label that cannot be read.
        PredicateError: a class name that is none.
    """
    predicates = constraints.predicates if constraints is not None else []
    rules = [(canonical_class_name(p.class_name), p.verdict) for p in predicates]
    spoken_of = [name for name, _ in rules]
    info = messages.get(LABEL_INFO)
    return SegmenterFrame(
        stamp_to_ns(header.stamp),
        tuple(dict.fromkeys([*spoken_of, *vocabulary])),
        frozenset(spoken_of),
        frozenset(name for name, verdict in rules if verdict == Verdict.UNSAFE),
        color_to_rgb(messages[IMAGE]) if IMAGE in messages else None,
        image_to_array(messages[LABELS]) if LABELS in messages else None,
        given_labels(info) if info is not None else None,
        tuple(canonical_class_name(name) for name in info.classes_evaluated) if info is not None else (),
    )
