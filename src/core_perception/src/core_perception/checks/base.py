# SPDX-License-Identifier: BSD-3-Clause
"""What the parts of the self-check are given, and what they answer."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import List, Optional, Tuple

import numpy as np


class Level(enum.IntEnum):
    """How bad a finding is."""

    NOTE = 0  # worth knowing; nothing is wrong
    WARNING = 1  # regions and obstacles may land in the wrong place
    ERROR = 2  # nothing useful comes out


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        code: one word to count and test by.
        level: how bad.
        sentence: what is wrong, by how much, and what to do; one line for a person.
    """

    code: str
    level: Level
    sentence: str


@dataclass(frozen=True)
class Outcome:
    """What one part found.

    Attributes:
        check: its name.
        findings: what is wrong; empty if nothing.
        measured: figures, in words; empty if it could not look.
        unchecked: why it could not look; empty if it could.
        height_ratio: of the part that looks at the floor: height of the camera as seen over that of tf; None if no
            floor was seen or it is tilted against tf.
    """

    check: str
    findings: Tuple[Finding, ...] = ()
    measured: str = ""
    unchecked: str = ""
    height_ratio: Optional[float] = None


@dataclass(frozen=True)
class CameraInfo:
    """What camera_info says, as it says it.

    Attributes:
        width_px, height_px: of the images it is for.
        K: nine numbers, rows of the camera matrix [px].
        D: distortion coefficients.
        distortion_model: its name.
        binning: x and y; 0 and 1 mean none.
        roi: x_offset, y_offset, width, height [px]; zeros mean the whole image.
    """

    width_px: int
    height_px: int
    K: Tuple[float, ...]
    D: Tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    binning: Tuple[int, int] = (0, 0)
    roi: Tuple[int, int, int, int] = (0, 0, 0, 0)

    @property
    def is_part(self) -> bool:
        """The images are a part of the sensor's, or binned."""
        return any(self.roi) or max(self.binning) > 1

    @property
    def image_size_px(self) -> Tuple[int, int]:
        """Width and height of the images it is for: region of interest in full resolution, then binning."""
        sizes = (self.roi[2] or self.width_px, self.roi[3] or self.height_px)
        return sizes[0] // max(self.binning[0], 1), sizes[1] // max(self.binning[1], 1)

    def matrix_at(self, width_px: int, height_px: int) -> np.ndarray:
        """(3, 3) camera matrix for an image of another size; borders of pixels scale, not their centres."""
        sx, sy = width_px / self.image_size_px[0], height_px / self.image_size_px[1]
        sx, sy = sx / max(self.binning[0], 1), sy / max(self.binning[1], 1)
        cx, cy = self.K[2] - self.roi[0], self.K[5] - self.roi[1]
        fx, fy, cx, cy = self.K[0] * sx, self.K[4] * sy, (cx + 0.5) * sx - 0.5, (cy + 0.5) * sy - 0.5
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def is_usable(self) -> bool:
        """A size and focal lengths that can be computed with."""
        numbers = len(self.K) == 9 and all(np.isfinite(self.K)) and self.K[0] > 0.0 and self.K[4] > 0.0
        return bool(numbers and self.width_px > 0 and self.height_px > 0)


@dataclass(frozen=True)
class CheckFrame:
    """One instant; what did not come is None.

    Attributes:
        depth: (h, w) uint16 [mm], 0 none, or float32 [m]; along the optical axis.
        color: (h, w, 3) uint8 rgb.
        labels: (h, w) uint16 of the segmenter.
        T_map_camera: (4, 4) optical frame in a frame whose z is up, at the stamp of the depth image, from tf [m].
    """

    depth: np.ndarray
    color: Optional[np.ndarray] = None
    labels: Optional[np.ndarray] = None
    T_map_camera: Optional[np.ndarray] = None

    @property
    def depth_m(self) -> np.ndarray:
        """(h, w) float32 [m]; NaN where there is none."""
        if self.depth.dtype == np.uint16:
            return np.where(self.depth == 0, np.nan, self.depth / 1000.0).astype(np.float32)
        valid = np.isfinite(self.depth) & (self.depth > 0.0)
        return np.where(valid, self.depth, np.nan).astype(np.float32)


@dataclass
class Stream:
    """When the messages of one topic were made and came.

    Attributes:
        topic: its name, for a person.
        frame_id: of the last message.
        stamps_s: of the messages [s].
        received_s: by the clock that stamps are compared with [s].
    """

    topic: str
    frame_id: str = ""
    stamps_s: List[float] = field(default_factory=list)
    received_s: List[float] = field(default_factory=list)


@dataclass(frozen=True)
class PoseLookups:
    """How asking tf for the camera at the stamps of the depth images went.

    Attributes:
        map_frame: the frame whose z is up.
        camera_frame: that of the images.
        asked: how often.
        failed: how often it had no answer in time.
        reason: the last failure in tf's words.
    """

    map_frame: str
    camera_frame: str
    asked: int
    failed: int
    reason: str = ""
