# SPDX-License-Identifier: BSD-3-Clause
"""Do the stamps of the streams fit each other and the clock, and does tf know the camera at those stamps?"""

from __future__ import annotations

from typing import List, Optional

import numpy as np

from core_perception.checks.base import Finding, Level, Outcome, PoseLookups, Stream

STAMPS, TF, FRAMES = "stamps", "tf", "frames"
LEAST_MESSAGES = 3
LARGEST_AGE_S = 0.5
LARGEST_LEAD_S = 0.05
YEAR_S = 365.25 * 86400.0
ANOTHER_CLOCK_S = 3600.0
LEAST_RATE_HZ = 5.0
LARGEST_GAP = 3.0  # of the usual period
FAILED_SHARE = 0.1


def check_stamps(depth: Stream, color: Optional[Stream] = None, slop_s: float = 0.02) -> Outcome:
    """Look at age, order, rate and gaps of both streams, and at the offset between them.

    Args:
        depth: of the depth images.
        color: of the colour images; None if none came.
        slop_s: largest difference that semantic_map accepts.
    """
    streams = [depth] + ([color] if color is not None and color.stamps_s else [])
    if any(len(stream.stamps_s) < LEAST_MESSAGES for stream in streams):
        return Outcome(STAMPS, unchecked=f"fewer than {LEAST_MESSAGES} messages of a stream")
    findings: List[Finding] = []
    for stream in streams:
        findings += _check_stream(stream)
    measured = f"{_rate_hz(depth):.1f} Hz, {_age_s(depth):.2f} s old on arrival"
    if len(streams) == 2 and not findings:
        offset_s = compute_offset_s(depth.stamps_s, color.stamps_s)
        measured += f", {offset_s * 1000.0:.0f} ms between depth and colour"
        if offset_s > slop_s:
            sentence = (
                f"Depth and colour images are stamped {offset_s * 1000.0:.0f} ms apart, more than the "
                f"{slop_s * 1000.0:.0f} ms within which they count as one frame. Have the driver synchronise them, or "
                "raise slop_s if the robot moves slowly."
            )
            findings.append(Finding("stamp_offset", Level.WARNING, sentence))
    return Outcome(STAMPS, tuple(findings), measured)


def compute_offset_s(stamps_s, others_s) -> float:
    """Median distance from a stamp to the nearest of the others [s]; without the ends, which may lack a partner."""
    others_s = np.sort(np.asarray(others_s))
    inner = [s for s in stamps_s if others_s[0] <= s <= others_s[-1]] or list(stamps_s)
    return float(np.median([np.abs(others_s - s).min() for s in inner]))


def _rate_hz(stream: Stream) -> float:
    periods_s = np.diff(stream.stamps_s)
    usual_s = float(np.median(periods_s))
    return 1.0 / usual_s if usual_s > 0.0 else 0.0


def _age_s(stream: Stream) -> float:
    return float(np.median(np.subtract(stream.received_s, stream.stamps_s)))


def _check_stream(stream: Stream) -> List[Finding]:
    stamps_s, periods_s = np.asarray(stream.stamps_s), np.diff(stream.stamps_s)
    if (stamps_s <= 0.0).any():
        sentence = (
            f"{stream.topic} carries stamps of 0, which no frame can be placed by. Have the driver stamp its images."
        )
        return [Finding("stamp_zero", Level.ERROR, sentence)]
    if (periods_s == 0.0).all():
        sentence = (
            f"Every message of {stream.topic} carries the same stamp, so only the first counts. Have the driver stamp "
            "each image."
        )
        return [Finding("stamp_stuck", Level.ERROR, sentence)]
    findings = []
    if (periods_s < 0.0).any():
        sentence = (
            f"Stamps of {stream.topic} went back by {-periods_s.min():.2f} s; the map starts anew each time. "
            "Is a recording played in a loop, or do two drivers publish there?"
        )
        findings.append(Finding("stamp_back", Level.WARNING, sentence))
    findings += _check_age(stream) + _check_rate(stream, periods_s)
    return findings


def _check_age(stream: Stream) -> List[Finding]:
    age_s = _age_s(stream)
    if abs(age_s) > ANOTHER_CLOCK_S:
        how_far = f"{abs(age_s) / YEAR_S:.1f} years" if abs(age_s) > YEAR_S / 2 else f"{abs(age_s) / 3600.0:.1f} hours"
        sentence = (
            f"Stamps of {stream.topic} are {how_far} {'old' if age_s > 0 else 'ahead'}. If this is a recording, play "
            "it with --clock and set use_sim_time before any node starts; otherwise set the camera's clock."
        )
        return [Finding("stamp_clock", Level.ERROR, sentence)]
    if age_s < -LARGEST_LEAD_S:
        sentence = (
            f"Stamps of {stream.topic} are {-age_s:.2f} s ahead of this machine's clock. Synchronise the clocks "
            "(chrony) of camera, robot and this machine."
        )
        return [Finding("stamp_ahead", Level.WARNING, sentence)]
    if age_s > LARGEST_AGE_S:
        sentence = (
            f"Images of {stream.topic} are {age_s:.2f} s old on arrival. Synchronise the clocks, or lower resolution "
            "or rate if the network or the driver falls behind."
        )
        return [Finding("stamp_old", Level.WARNING, sentence)]
    return []


def _check_rate(stream: Stream, periods_s) -> List[Finding]:
    rate_hz = _rate_hz(stream)
    if 0.0 < rate_hz < LEAST_RATE_HZ:
        sentence = (
            f"{stream.topic} comes at {rate_hz:.1f} Hz, less than {LEAST_RATE_HZ:.0f} Hz: the robot must drive slowly "
            "to see what it drives into. Raise the camera's rate, or lower its resolution."
        )
        return [Finding("rate_low", Level.WARNING, sentence)]
    usual_s = float(np.median(periods_s))
    if usual_s > 0.0 and (periods_s > LARGEST_GAP * usual_s).mean() > FAILED_SHARE:
        sentence = (
            f"{stream.topic} comes at {rate_hz:.0f} Hz but with gaps of up to {periods_s.max():.2f} s. "
            "Look for a saturated network or processor."
        )
        return [Finding("rate_gaps", Level.WARNING, sentence)]
    return []


def check_frame_ids(depth_frame: str, color_frame: str) -> Outcome:
    """Depth that is registered to the colour image bears the frame of the colour camera."""
    if not depth_frame:
        sentence = (
            "The depth images have an empty frame_id, so tf cannot place them. Have the driver name its optical frame."
        )
        return Outcome(FRAMES, (Finding("frame_empty", Level.ERROR, sentence),), "no frame_id")
    if color_frame and color_frame != depth_frame:
        sentence = (
            f"Depth is in frame '{depth_frame}' and colour in '{color_frame}': depth is not registered to the colour "
            "camera, and no frame will be used. Use the driver's registered depth (aligned_depth_to_color, "
            "depth_registered)."
        )
        return Outcome(FRAMES, (Finding("frame_differs", Level.ERROR, sentence),), "two frames")
    return Outcome(FRAMES, (), f"'{depth_frame}'")


def check_tf(lookups: PoseLookups) -> Outcome:
    """Look at how often tf had the camera's pose at the stamp of an image."""
    if lookups.asked == 0:
        return Outcome(TF, unchecked="no depth image to ask about")
    share = lookups.failed / lookups.asked
    measured = (
        f"{lookups.asked - lookups.failed} of {lookups.asked} poses of '{lookups.camera_frame}' in "
        f"'{lookups.map_frame}'"
    )
    if share <= FAILED_SHARE:
        return Outcome(TF, (), measured)
    sentence = (
        f"tf has no pose of '{lookups.camera_frame}' in '{lookups.map_frame}' for {lookups.failed} of {lookups.asked} "
        f"images at their stamps ({lookups.reason or 'no answer in time'}). "
    )
    if lookups.failed == lookups.asked:
        sentence += "Start odometry and robot_state_publisher, and check map_frame and the frame_id of the images."
        return Outcome(TF, (Finding("tf_missing", Level.ERROR, sentence),), measured)
    sentence += "Odometry comes too late, too seldom or on another clock: raise its rate, or synchronise the clocks."
    return Outcome(TF, (Finding("tf_gaps", Level.WARNING, sentence),), measured)
