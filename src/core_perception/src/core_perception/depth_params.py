# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of depth_completion and self_check: frozen dataclasses that refuse a wrong or unknown key."""

from __future__ import annotations

from dataclasses import dataclass

from core_perception.checks.floor import FloorLimits
from core_perception.depth_completion import CompletionLimits
from core_perception.exceptions import ParameterError
from core_perception.param_fields import Parameters, choice, flag, number, path, text, whole
from core_perception.scale_fit import KINDS, FitLimits
from core_perception.self_check import CheckLimits


@dataclass(frozen=True)
class DepthCompletionParams(Parameters):
    """Parameters of depth_completion; README.md has the same as a table.

    Attributes:
        backend: who predicts: ``none`` nobody, ``remote`` a side-car over HTTP, ``topic`` another node.
        kind: what the topic back end's images are; a side-car says it itself.
        lockstep: every frame is asked about and waited for.
        slop_s: largest stamp difference of depth and colour, or depth and predicted depth [s].
        wait_s: how long a depth image waits for its colour image, or for its predicted depth [s].
        server_url: address of the side-car.
        allowed_hosts_file: list of other hosts that may be asked; empty means none.
        allow_remote_images: images may leave this machine.
        deadline_s: longest time of one request in all [s].
        image_max_px: longest edge of the image that is sent [px].
        fit_min_m: nearest sensor depth that is compared, and nearest that is filled [m].
        fit_max_m: farthest of both [m].
        min_returns: sensor returns a fit needs.
        min_cells: of 4 x 4 parts of the image, how many must hold returns.
        edge_step: a pixel whose neighbour differs by more in log(depth) is neither compared nor filled.
        gate: smallest gate of an inlier in |log(s p / d)|.
        rounds: refinements of the median.
        min_inlier_ratio: share of returns that must agree.
        max_mad: largest median of |log(s p / d)| over the inliers.
        scale_jump: a scale that differs by more from the median of the last ones is refused; 0.2 is 20 %.
        scale_window: how many fits that median is over.
        keep_scale_s: how long the last scale serves where a frame has none [s].
        support_radius: half the edge of the square that must vouch for a filled pixel, as a part of the width.
        support_returns: inliers it must hold.
        support_ratio: share of inliers among its returns.
        support_range: how far a filled value may lie beyond the nearest and farthest of them; 0.1 is 10 %.
    """

    backend: str = choice("none", "none", "remote", "topic")
    kind: str = choice("relative", *KINDS)
    lockstep: bool = flag(False)
    slop_s: float = number(0.02, 0.0, 1.0)
    wait_s: float = number(0.2, 0.0, 10.0)
    server_url: str = text("http://127.0.0.1:8093", "an address such as http://127.0.0.1:8093")
    allowed_hosts_file: str = path("", "the path of a list of hosts, or empty")
    allow_remote_images: bool = flag(False)
    deadline_s: float = number(0.5, 0.01, 60.0)
    image_max_px: int = whole(640, 32, 4096)
    fit_min_m: float = number(0.3, 0.0, 100.0, above=True)
    fit_max_m: float = number(8.0, 0.0, 100.0, above=True)
    min_returns: int = whole(200, 10, 1000000)
    min_cells: int = whole(4, 1, 16)
    edge_step: float = number(0.10, 0.0, 10.0, above=True)
    gate: float = number(0.10, 0.0, 1.0, above=True)
    rounds: int = whole(3, 1, 10)
    min_inlier_ratio: float = number(0.6, 0.5, 1.0)
    max_mad: float = number(0.05, 0.0, 1.0, above=True)
    scale_jump: float = number(0.2, 0.0, 10.0, above=True)
    scale_window: int = whole(9, 3, 1000)
    keep_scale_s: float = number(2.0, 0.0, 60.0)
    support_radius: float = number(0.05, 0.0, 0.5, above=True)
    support_returns: int = whole(8, 1, 100000)
    support_ratio: float = number(0.7, 0.5, 1.0)
    support_range: float = number(0.1, 0.0, 1.0)

    def check(self) -> None:
        """Check what no field can check alone; see Parameters."""
        if self.fit_max_m <= self.fit_min_m:
            raise ParameterError("fit_max_m", self.fit_max_m, f"more than fit_min_m, which is {self.fit_min_m:g}")

    @property
    def limits(self) -> CompletionLimits:
        """What fit and filled values must meet."""
        fit_names = FitLimits.__dataclass_fields__
        names = [name for name in CompletionLimits.__dataclass_fields__ if name != "fit"]
        fit = FitLimits(**{name: getattr(self, name) for name in fit_names})
        return CompletionLimits(fit, **{name: getattr(self, name) for name in names})


@dataclass(frozen=True)
class SelfCheckParams(Parameters):
    """Parameters of self_check; README.md has the same as a table.

    Attributes:
        map_frame: fixed frame, z up.
        frames: depth images that are waited for.
        images: of these, how many are looked at.
        timeout_s: how long images are waited for, on the wall clock [s].
        tf_timeout_s: how long tf is waited for at each stamp [s].
        slop_s: largest stamp difference of depth and colour [s].
        largest_shift_px: between edges of depth and of colour or labels, in an image 640 px wide or less [px].
        floor_z_m: height of the floor in map_frame [m].
        floor_height_m: largest difference of the floor's height from that [m].
        floor_tilt_deg: largest tilt of the floor against tf [degrees].
        repeat_s: pause after which it looks again [s]; 0: once.
        exit_when_done: end after the first look, with status 0 if nothing is wrong, else 1.
    """

    map_frame: str = text("odom", "the name of a frame")
    frames: int = whole(30, 3, 1000)
    images: int = whole(8, 1, 100)
    timeout_s: float = number(20.0, 0.5, 3600.0)
    tf_timeout_s: float = number(0.5, 0.0, 10.0)
    slop_s: float = number(0.02, 0.0, 1.0)
    largest_shift_px: float = number(3.0, 0.5, 100.0)
    floor_z_m: float = number(0.0)
    floor_height_m: float = number(0.05, 0.0, 10.0, above=True)
    floor_tilt_deg: float = number(2.0, 0.0, 90.0, above=True)
    repeat_s: float = number(0.0, 0.0, 86400.0)
    exit_when_done: bool = flag(False)

    def check(self) -> None:
        """Check what no field can check alone; see Parameters."""
        if not self.map_frame:
            raise ParameterError("map_frame", self.map_frame, "the name of a frame")

    @property
    def limits(self) -> CheckLimits:
        """How far things may differ."""
        floor = FloorLimits(self.floor_height_m, self.floor_tilt_deg, self.floor_z_m)
        return CheckLimits(floor, self.largest_shift_px, self.slop_s)
