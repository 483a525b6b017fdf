# SPDX-License-Identifier: BSD-3-Clause
"""A segmenter in another process or on another machine, such as SAM 3 on a GPU: docs/segmenter_sidecar.md."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Dict, Optional

import cv2

from core_perception.exceptions import EvidenceError, ServerError
from core_perception.ontology import Ontology
from core_perception.reasoners.vlm_client import BackOff
from core_perception.segmenters.base import IMAGE, Segmentation, Segmenter, SegmenterFrame
from core_perception.segmenters.open_names import OpenNames
from core_perception.segmenters.painting import paint_instances
from core_perception.segmenters.sidecar_wire import (
    CAPABILITIES_PATH,
    SEGMENT_PATH,
    Capabilities,
    compose_request,
    read_reply,
)
from core_perception.sidecar_client import SidecarClient, encode_picture

#: A server that is there says at once what it can do [s].
CAPABILITIES_LIMIT_S = 2.0
#: Share of the deadline that the server is given; the rest is for the way.
SERVER_SHARE = 0.9


class RemoteSegmenter(Segmenter):
    """Asks a side-car about one image at a time; what fails gives no answer, and a pause before the next request.

    Of more classes than the server or max_classes allows, those that rules call unsafe come first, then the others that
    rules speak of. The rest are not evaluated.
    """

    source = "remote"
    reads = frozenset((IMAGE,))
    is_slow = True

    def __init__(
        self,
        client: SidecarClient,
        ontology: Ontology,
        names: OpenNames,
        back_off: BackOff,
        min_score: float = 0.5,
        max_classes: int = 0,
        image_format: str = "jpeg",
        max_image_px: int = 1024,
    ):
        """Keep the parts; nothing is sent.

        Args:
            client: knows where the side-car is.
            ontology: which classes are surfaces.
            names: finds the side-car's own names where its vocabulary is closed.
            back_off: pauses after failures.
            min_score: weaker instances are left out, 0..1.
            max_classes: most classes of one request; 0 for as many as the side-car takes.
            image_format: ``jpeg`` or ``png``.
            max_image_px: longest edge of the image that is sent.
        """
        self._client, self._ontology, self._names, self._back_off = client, ontology, names, back_off
        self._min_score, self._max_classes = min_score, max_classes
        self._image_format, self._max_image_px = image_format, max_image_px
        self._capabilities: Optional[Capabilities] = None
        self._paused_until_s = 0.0  # monotonic
        self._last_failure = ""

    @property
    def warning(self) -> str:
        """Say so where the weights are random."""
        known = self._capabilities
        return f"{known.model} has random weights: its masks mean nothing" if known and known.random_weights else ""

    def close(self) -> None:
        """Abort the request under way."""
        self._client.close()

    def segment(self, frame: SegmenterFrame) -> Segmentation:
        """Ask about frame.image.

        Raises:
            ServerError: no answer, or a pause after a failure.
            EvidenceError: an answer that does not keep to the contract.
        """
        begun_s = time.monotonic()
        if begun_s < self._paused_until_s:
            raise ServerError("paused", f"the side-car is left alone for a moment after: {self._last_failure}")
        try:
            segmentation = self._ask(frame)
        except (ServerError, EvidenceError) as error:
            self._last_failure = str(error)
            self._capabilities = None  # another one may come up there
            self._paused_until_s = time.monotonic() + self._back_off.failed()
            raise
        self._back_off.succeeded()
        return replace(segmentation, latency_s=time.monotonic() - begun_s)

    def _ask(self, frame: SegmenterFrame) -> Segmentation:
        if self._capabilities is None:
            limit_s = min(CAPABILITIES_LIMIT_S, self._client.deadline_s)
            self._capabilities = Capabilities.read(self._client.call(CAPABILITIES_PATH, limit_s=limit_s))
        sent = self._choose(frame)
        picture = encode_picture(frame.image, self._image_format, self._max_image_px)
        size_px = tuple(picture["size"])
        deadline_s = SERVER_SHARE * self._client.deadline_s
        request = compose_request(picture, tuple(sent), frame.stamp_ns, deadline_s, self._min_score)
        value = self._client.call(SEGMENT_PATH, request)
        reply = read_reply(value, tuple(sent), frame.stamp_ns, size_px, self._min_score)
        found = [replace(one, class_name=sent[one.class_name]) for one in reply.instances]
        evaluated = [sent[name] for name in reply.classes_evaluated]
        painted = paint_instances(
            found, size_px, evaluated, frame, lambda name: self._ontology.look_up(name).is_surface
        )
        height_px, width_px = frame.image.shape[:2]
        if size_px == (height_px, width_px):
            return painted
        # To a larger size: no mask can lose its last pixel.
        labels = cv2.resize(painted.labels, (width_px, height_px), interpolation=cv2.INTER_NEAREST)
        return replace(painted, labels=labels)

    def _choose(self, frame: SegmenterFrame) -> Dict[str, str]:
        """Name to send -> the name it was asked for by, the most wanted first."""
        known = self._capabilities
        wanted = sorted(
            frame.classes, key=lambda name: (name not in frame.unsafe_classes, name not in frame.rule_classes)
        )
        sent: Dict[str, str] = {}
        for name in wanted:
            own = name if known.classes is None else self._names.find((name,), known.classes)
            if own is not None:
                sent.setdefault(own, name)
        most = min(known.max_classes or len(sent), self._max_classes or len(sent))
        return dict(list(sent.items())[:most])
