# SPDX-License-Identifier: BSD-3-Clause
"""Start-up self-check: looks at the first frames of a camera and says in plain words what is wrong, and what to do.

It measures; it changes nothing, and nothing depends on it. What it cannot measure it says, instead of passing it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import List, Optional, Sequence, Tuple

from core_perception.checks.base import CameraInfo, CheckFrame, Finding, Level, Outcome, PoseLookups, Stream
from core_perception.checks.depth_values import check_depth_values
from core_perception.checks.floor import FloorLimits, check_floor
from core_perception.checks.intrinsics import check_intrinsics
from core_perception.checks.registration import check_registration
from core_perception.checks.timing import check_frame_ids, check_stamps, check_tf

TOPICS_NAMED = 6


@dataclass
class Sample:
    """What was seen of one camera.

    Attributes:
        frames: a few instants.
        info: camera_info of the colour camera; None if none came.
        depth: stamps of the depth images.
        color: those of the colour images.
        lookups: how asking tf went; None if it was not asked.
        color_size_px: width and height of the colour images; None if none came.
        image_topics: on which images are published at all.
        unreadable: ``depth``, ``colour`` or ``labels``, and why its images could not be read.
    """

    frames: List[CheckFrame]
    info: Optional[CameraInfo]
    depth: Stream
    color: Stream
    lookups: Optional[PoseLookups] = None
    color_size_px: Optional[Tuple[int, int]] = None
    image_topics: Tuple[str, ...] = ()
    unreadable: Tuple[Tuple[str, str], ...] = ()


@dataclass(frozen=True)
class CheckLimits:
    """See SelfCheckParams, which has the same names."""

    floor: FloorLimits = field(default_factory=FloorLimits)
    largest_shift_px: float = 3.0
    slop_s: float = 0.02


@dataclass(frozen=True)
class Report:
    """What all parts found."""

    outcomes: Tuple[Outcome, ...]

    @property
    def findings(self) -> Tuple[Finding, ...]:
        """Everything found, the worst first."""
        every = [finding for outcome in self.outcomes for finding in outcome.findings]
        return tuple(sorted(every, key=lambda finding: -finding.level))

    @property
    def is_healthy(self) -> bool:
        """No finding is worse than a note."""
        return all(finding.level == Level.NOTE for finding in self.findings)

    @property
    def summary(self) -> str:
        """One line."""
        unchecked = [outcome.check for outcome in self.outcomes if outcome.unchecked]
        found = sum(1 for finding in self.findings if finding.level > Level.NOTE)
        words = f"{found} thing{'s' if found > 1 else ''} to put right" if found else "nothing wrong found"
        return words + (f"; not checked: {', '.join(unchecked)}" if unchecked else "")


def check(sample: Sample, limits: Optional[CheckLimits] = None) -> Report:
    """Run every part.

    Args:
        sample: what was seen; without frames the absence itself is reported.
        limits: how far things may differ.
    """
    limits = limits or CheckLimits()
    if not sample.frames:
        if sample.unreadable:
            return Report(tuple(report_unreadable(*one) for one in sample.unreadable))
        return Report((report_missing(sample.depth, "depth", Level.ERROR, sample.image_topics),))
    parts = [
        check_depth_values(sample.frames),
        check_frame_ids(sample.depth.frame_id, sample.color.frame_id),
        check_stamps(sample.depth, sample.color, limits.slop_s),
    ]
    if sample.lookups is not None:
        parts.append(check_tf(sample.lookups))
    if not sample.color.stamps_s:
        parts.append(report_missing(sample.color, "colour", Level.WARNING, sample.image_topics))
    parts += [report_unreadable(*one) for one in sample.unreadable]
    return Report(tuple(parts + _check_geometry(sample, limits, is_depth_broken(parts[0]))))


def is_depth_broken(values: Outcome) -> bool:
    """Whether the depth values are such that whatever is computed from them only repeats the finding."""
    return any(finding.level == Level.ERROR for finding in values.findings)


def _check_geometry(sample: Sample, limits: CheckLimits, is_broken: bool) -> List[Outcome]:
    height_px, width_px = sample.frames[0].depth.shape
    size_px = (width_px, height_px)
    intrinsics = check_intrinsics(sample.info, size_px, sample.color_size_px)
    if is_broken:
        names = ("floor", "registration of depth and colour", "registration of depth and labels")
        return [intrinsics, *(Outcome(name, unchecked="the depth values are wrong") for name in names)]
    if any(finding.level == Level.ERROR for finding in intrinsics.findings):
        floor = Outcome("floor", unchecked="the intrinsics are wrong")
    else:
        floor = check_floor(sample.frames, sample.info, limits.floor)
        intrinsics = check_intrinsics(sample.info, size_px, sample.color_size_px, floor.height_ratio)
    against = [check_registration(sample.frames, name, limits.largest_shift_px) for name in ("colour", "labels")]
    return [intrinsics, floor, *against]


def report_missing(stream: Stream, what: str, level: Level, elsewhere: Sequence[str] = ()) -> Outcome:
    """Say that nothing came on a topic, and where images are published instead.

    Args:
        stream: of the topic.
        what: ``depth`` or ``colour``.
        level: how bad that is.
        elsewhere: topics on which images are published.
    """
    found = f"images are published on {', '.join(elsewhere[:TOPICS_NAMED])}" if elsewhere else "no topic carries images"
    sentence = (
        f"No {what} image came, 0 messages on {stream.topic}; {found}. Start the camera's driver, or remap this topic "
        "to the right one of those."
    )
    return Outcome(what, (Finding(f"{what}_missing", level, sentence),), "nothing came")


def report_unreadable(what: str, reason: str) -> Outcome:
    """Say that images came which nobody here can read."""
    sentence = f"The {what} images cannot be read ({reason}). Have the driver publish one of the encodings named."
    return Outcome(f"{what} encoding", (Finding("encoding", Level.ERROR, sentence),), "unreadable")
