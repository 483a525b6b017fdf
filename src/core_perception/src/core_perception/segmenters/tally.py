# SPDX-License-Identifier: BSD-3-Clause
"""How a segmenter fares: counts by cause, and what a person should know."""

from __future__ import annotations

from collections import Counter
from typing import Dict, Tuple

from core_perception.exceptions import PerceptionError
from core_perception.segmenters.base import Segmentation, SegmenterFrame

FAILURES_WORTH_A_WARNING = 3
QUIET_REPORTS = 3
OK, WARN, ERROR = 0, 1, 2  # as diagnostic_msgs has them
MOST_NAMES = 20


class Tally:
    """Counts the frames of one segmenter; one thread at a time."""

    def __init__(self, source: str):
        """Start with none."""
        self.source = source
        self._counts: Counter = Counter()
        self._failures_in_row = 0
        self._last_failure = ""
        self._latency_s = 0.0
        self._instances = 0
        self._unknown_unsafe: Tuple[str, ...] = ()
        self._not_evaluated = 0
        self._told_frames, self._quiet_reports = -1, 0

    def answered(self, frame: SegmenterFrame, segmentation: Segmentation) -> None:
        """Count an answer."""
        self._counts["answers"] += 1
        self._failures_in_row = 0
        self._latency_s, self._instances = segmentation.latency_s, len(segmentation.masks)
        missing = segmentation.not_evaluated(frame.classes)
        self._not_evaluated = len(missing)
        self._unknown_unsafe = tuple(name for name in missing if name in frame.unsafe_classes)

    def failed(self, error: PerceptionError) -> None:
        """Count a frame without an answer."""
        self._counts[f"void_{getattr(error, 'cause', 'refused')}"] += 1
        self._failures_in_row += 1
        self._last_failure = str(error)

    def skipped(self) -> None:
        """Count a frame that a newer one has overtaken."""
        self._counts["skipped"] += 1

    def report(self, warning: str, missing: str = "") -> Tuple[int, str, Dict[str, str]]:
        """Return the level of diagnostic_msgs, a line, and key and value of every figure.

        Args:
            warning: of the segmenter; empty for none.
            missing: what a frame waits for, told when none came since the last reports; empty for nothing.
        """
        frames = sum(self._counts.values())
        self._quiet_reports = self._quiet_reports + 1 if frames == self._told_frames else 0
        self._told_frames = frames
        level, message = OK, "answering"
        if warning:
            level, message = WARN, warning
        if self._unknown_unsafe:
            level = WARN
            names = ", ".join(self._unknown_unsafe[:MOST_NAMES])
            message = f"not looked for, or not all shown, though a rule calls it unsafe: {names}"
        if self._failures_in_row >= FAILURES_WORTH_A_WARNING:
            level, message = WARN, f"{self._failures_in_row} frames in a row failed, the last: {self._last_failure}"
        if self._quiet_reports >= QUIET_REPORTS:
            level, message = WARN, f"no new frame{f': {missing}' if missing else ''}"
        if not self._counts["answers"]:
            why = self._last_failure or missing
            why = f": {why}" if why else ""
            level, message = ERROR, f"no frame has been segmented yet{why}"
        values = {
            "segmenter": self.source,
            "latency_s": f"{self._latency_s:.3f}",
            "instances": str(self._instances),
            "classes_not_evaluated": str(self._not_evaluated),
            "failures_in_row": str(self._failures_in_row),
            **{name: str(count) for name, count in sorted(self._counts.items()) if count},
        }
        return level, message, values
