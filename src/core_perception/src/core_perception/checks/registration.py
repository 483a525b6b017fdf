# SPDX-License-Identifier: BSD-3-Clause
"""Do the edges of the depth images lie on the edges of the colour images and of the labels?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from core_perception.checks.base import CheckFrame, Finding, Level, Outcome

PICTURES = {"colour": "colour images", "labels": "label images"}
MAX_FRAMES = 10
MAX_WIDTH_PX = 640  # larger images are looked at in this size
SEARCH = 0.06  # of the width: the largest shift that is looked for
DEPTH_STEP = 0.08  # in log(depth), beyond the slope around
LEAST_EDGE_PX = 400  # over all frames
LEAST_SIGNIFICANCE = 8.0  # peak over the median of all shifts, in their robust standard deviations
SAME, NEARLY_BEST = 0.85, 0.97  # a shift whose correlation reaches this part of the peak's is as good, or as exact
LARGEST_SPREAD_PX = 6.0  # between the shifts of the left and the right half
LEAST_SHARE = 0.3  # of pixels that hold a distance
SCALE_STEP, SCALE_STEPS = 1.04, 12  # factors that are tried: 0.62 to 1.6
SCALE_WIDTH_PX, SCALE_FRAMES = 320, 3
MIRROR_RATIO = 1.15  # of the height of the peaks with and without mirroring
MIRRORINGS = {
    "left to right": (1, -1),
    "upside down": (-1, 1),
    "by half a turn": (-1, -1),
}  # steps through the rows, columns


@dataclass(frozen=True)
class Shift:
    """By how much the edges of a picture are away from those of depth.

    Attributes:
        dx_px: to the right [px].
        dy_px: down [px].
        significance: of the peak; see LEAST_SIGNIFICANCE.
        height: of the peak over all shifts, as a share of the steps in depth.
    """

    dx_px: int
    dy_px: int
    significance: float
    height: float


@dataclass(frozen=True)
class Mirroring:
    """How a picture is mirrored.

    Attributes:
        how: in words.
        height: of the peak when it is mirrored back; see Shift.
        own_height: of the peak as it is; 0 for none.
    """

    how: str
    height: float
    own_height: float


def check_registration(frames: Sequence[CheckFrame], against: str, largest_shift_px: float = 3.0) -> Outcome:
    """Find the shift at which the edges of colour images or labels meet those of depth.

    Args:
        frames: those without that picture are left out.
        against: ``colour`` or ``labels``.
        largest_shift_px: of an image 640 px wide or less, that is not worth a warning; wider images in proportion.
    """
    check = f"registration of depth and {against}"
    pairs = [(f.depth_m, f.color if against == "colour" else f.labels) for f in frames]
    pairs = [pair for pair in pairs if pair[1] is not None]
    if not pairs:
        return Outcome(check, unchecked=f"no {against} images came" if against == "colour" else "no labels came")
    if np.mean([np.isfinite(depth_m).mean() for depth_m, _ in pairs]) < LEAST_SHARE:
        return Outcome(check, unchecked="too few depth pixels to see edges")
    pairs = pairs[:: max(1, len(pairs) // MAX_FRAMES)][:MAX_FRAMES]
    edges = [_edges(fit_sizes(*pair, MAX_WIDTH_PX)) for pair in pairs]
    scale = frames[0].depth.shape[1] / edges[0][0].shape[2]
    whole = find_shift(edges, largest_shift_px)
    mirroring = find_mirroring(pairs)
    if mirroring is not None:
        return Outcome(check, (_say_mirrored(against, mirroring),), f"turned {mirroring.how}")
    if whole is None:
        factor = find_scale(pairs)
        if factor is None:
            return Outcome(check, unchecked="too few edges that depth and picture share")
        return Outcome(check, (_say_scale(against, factor),), f"scaled by {factor:.2f}")
    if whole.dx_px or whole.dy_px:
        dx, dy = round(whole.dx_px * scale), round(whole.dy_px * scale)
        return Outcome(check, (_say_shift(against, dx, dy),), f"shifted by ({dx}, {dy}) px")
    halves = [find_shift([(_part(d, h), _part(p, h)) for d, p in edges], 0.0) for h in (0, 1)]
    if all(halves) and abs(halves[1].dx_px - halves[0].dx_px) > LARGEST_SPREAD_PX:
        factor = 1.0 + (halves[1].dx_px - halves[0].dx_px) / (0.5 * edges[0][0].shape[2])
        return Outcome(check, (_say_scale(against, factor),), f"scaled by {factor:.2f}")
    return Outcome(check, (), f"edges meet within {largest_shift_px * scale:.0f} px")


def find_mirroring(pairs: Sequence[Tuple[np.ndarray, np.ndarray]]) -> Optional[Mirroring]:
    """Return how the picture is mirrored against depth; None if it is not, or if that cannot be told.

    A scene that is nearly alike on both sides has edges at the right places in a mirrored picture too: it is mirrored
    if clearly more of them meet when it is mirrored back.

    Args:
        pairs: depth [m] and picture of each frame.
    """

    def find(row_step, column_step):
        # Turned before it is made smaller: nearest pixels are not the same from the other side.
        turned = [(depth_m, picture[::row_step, ::column_step]) for depth_m, picture in pairs[:SCALE_FRAMES]]
        fitted = [fit_sizes(depth_m, np.ascontiguousarray(picture), SCALE_WIDTH_PX) for depth_m, picture in turned]
        return find_shift([_edges(pair) for pair in fitted], 1.0)

    own = find(1, 1)
    own_height = own.height if own is not None else 0.0
    best, least = None, MIRROR_RATIO * own_height
    for words, steps in MIRRORINGS.items():
        shift = find(*steps)
        if shift is not None and shift.height > least:
            best, least = Mirroring(words, shift.height, own_height), shift.height
    return best


def find_scale(pairs: Sequence[Tuple[np.ndarray, np.ndarray]]) -> Optional[float]:
    """Return by how much the picture is larger than depth about the middle of the image; None if that cannot be told.

    Args:
        pairs: depth [m] and picture of each frame.
    """
    best, best_factor = LEAST_SIGNIFICANCE, None
    pairs = [fit_sizes(*pair, SCALE_WIDTH_PX) for pair in pairs[:SCALE_FRAMES]]
    for k in range(-SCALE_STEPS, SCALE_STEPS + 1):
        factor = SCALE_STEP**k
        shift = find_shift([_edges((depth, zoom(picture, 1.0 / factor))) for depth, picture in pairs], 1.0)
        if shift is not None and shift.significance > best:
            best, best_factor = shift.significance, factor
    return best_factor


def zoom(picture: np.ndarray, factor: float) -> np.ndarray:
    """The picture enlarged about its middle, at its own size; what comes into view repeats its border."""
    height_px, width_px = picture.shape[:2]
    matrix = cv2.getRotationMatrix2D(((width_px - 1) / 2.0, (height_px - 1) / 2.0), 0.0, factor)
    way = cv2.INTER_NEAREST if picture.ndim == 2 else cv2.INTER_LINEAR
    return cv2.warpAffine(picture, matrix, (width_px, height_px), flags=way, borderMode=cv2.BORDER_REPLICATE)


def _edges(pair) -> Tuple[np.ndarray, np.ndarray]:
    return depth_edges(pair[0]), picture_edges(pair[1])


def _say_mirrored(against, mirroring) -> Finding:
    sentence = (
        f"The {PICTURES[against]} are turned {mirroring.how} against depth: turned back, {mirroring.height:.0%} of the "
        f"steps in depth meet their edges, and {mirroring.own_height:.0%} as they are. "
        "Check the flip and rotate settings of the camera's driver and of the node that makes these images."
    )
    return Finding("registration_mirrored", Level.WARNING, sentence)


def _say_shift(against, dx, dy) -> Finding:
    where = [f"{abs(dx)} px to the {'right' if dx > 0 else 'left'}"] if dx else []
    where += [f"{abs(dy)} px {'down' if dy > 0 else 'up'}"] if dy else []
    sentence = (
        f"Edges in the {PICTURES[against]} lie {' and '.join(where)} of those in depth, so regions land beside the "
        "things they belong to. Use depth that is registered to the colour camera (such as aligned_depth_to_color or "
        "depth_registered), check the extrinsics it uses, and that both images are of one instant."
    )
    return Finding("registration_shift", Level.WARNING, sentence)


def _say_scale(against, factor) -> Finding:
    sentence = (
        f"Things in the {PICTURES[against]} are {factor:.2f} times as large as in depth: the two have different fields "
        "of view. Use depth that is registered to the colour camera (such as aligned_depth_to_color, depth_registered)."
    )
    return Finding("registration_scale", Level.WARNING, sentence)


def fit_sizes(depth_m: np.ndarray, picture: np.ndarray, max_width_px: int) -> Tuple[np.ndarray, np.ndarray]:
    """Both at the size of the depth image, or smaller if that is wider; no depths are made that nothing has."""
    height_px, width_px = depth_m.shape
    scale = min(1.0, max_width_px / width_px)
    size = (round(width_px * scale), round(height_px * scale))
    if (width_px, height_px) != size:
        depth_m = cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST)
    if (picture.shape[1], picture.shape[0]) != size:
        way = cv2.INTER_NEAREST if picture.ndim == 2 else cv2.INTER_AREA
        picture = cv2.resize(picture, size, interpolation=way)
    return depth_m, picture


def depth_edges(depth_m: np.ndarray) -> np.ndarray:
    """Return (2, h, w) float32: steps between a pixel and its right (0) and lower (1) neighbour.

    A step counts as far as it exceeds the slopes beside it, so that a floor seen at a low angle has none. A gap is
    taken for what is farther of its two ends: sensors lose the background beside a near object.
    """
    return np.stack([_steps(depth_m), _steps(depth_m.T).T])


def _steps(depth_m):
    log_depth = np.log(_fill_rows(depth_m))
    change = np.abs(np.diff(log_depth, axis=1))
    beside = np.maximum(np.pad(change[:, :-1], ((0, 0), (1, 0))), np.pad(change[:, 1:], ((0, 0), (0, 1))))
    steps = np.zeros(depth_m.shape, np.float32)
    with np.errstate(invalid="ignore"):
        steps[:, :-1] = change - beside > DEPTH_STEP
    return steps


def _fill_rows(depth_m):
    """Gaps of a row take the farther of the values at their two ends; NaN where a row has none."""
    columns = np.arange(depth_m.shape[1])
    known = ~np.isnan(depth_m)
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, depth_m.shape[1])[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(depth_m, ((0, 0), (0, 1)), constant_values=np.nan)  # column -1 and the one behind the last
    rows = np.arange(depth_m.shape[0])[:, None]
    return np.fmax(padded[rows, before], padded[rows, np.minimum(after, depth_m.shape[1])])


def picture_edges(picture: np.ndarray) -> np.ndarray:
    """Return (2, h, w) float32 in [0, 1]: how much a pixel differs from its right (0) and lower (1) neighbour."""
    if picture.ndim == 2:
        right, down = picture[:, 1:] != picture[:, :-1], picture[1:] != picture[:-1]
    else:
        values = cv2.GaussianBlur(picture, (3, 3), 0).astype(np.int16)
        right, down = np.abs(np.diff(values, axis=1)).sum(axis=2), np.abs(np.diff(values, axis=0)).sum(axis=2)
    edges = np.zeros((2, *picture.shape[:2]), np.float32)
    for edge, change in ((edges[0][:, :-1], right), (edges[1][:-1], down)):
        # Strong edges count alike: a poster must not outweigh the furniture.
        cap = 1.0 if picture.ndim == 2 else max(6.0, float(np.percentile(change, 95)))
        edge[:] = np.minimum(change / cap, 1.0)
    return edges


def find_shift(edges: Sequence[Tuple[np.ndarray, np.ndarray]], free_px: float) -> Optional[Shift]:
    """Return by how much the edges of the pictures must be away from those of depth, or None if that cannot be told.

        C(d) = sum_x J(x) G(x + d) / sum_x J(x),  J steps in depth, G changes in the picture, both by direction

    Where a shift of at most free_px is as good as the best one, or the mirrored one is (masks that are too small, depth
    that is too fat), the shift is 0.

    Args:
        edges: of each frame, as from depth_edges and picture_edges.
        free_px: no finer than this.
    """
    radius = max(4, round(SEARCH * edges[0][0].shape[2]))
    total = sum(float(steps.sum()) for steps, _ in edges)
    if total < LEAST_EDGE_PX:
        return None
    surface = sum(_correlate(steps[k], changes[k], radius) for steps, changes in edges for k in (0, 1)) / total
    base = float(np.median(surface))
    spread = 1.4826 * float(np.median(np.abs(surface - base)))
    peak = float(surface.max())
    significance = (peak - base) / max(spread, 1e-9)
    if significance < LEAST_SIGNIFICANCE:
        return None
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    good, best = (surface >= base + part * (peak - base) for part in (SAME, NEARLY_BEST))
    if np.hypot(x, y)[good].min() <= free_px:
        return Shift(0, 0, significance, peak - base)
    # Along long straight edges many shifts are as good: the smallest is told.
    row, column = np.unravel_index(int(np.argmin(np.where(best, np.hypot(x, y), np.inf))), surface.shape)
    if good[row, 2 * radius - column] and abs(x[row, column]) > 1 or good[2 * radius - row, 2 * radius - column]:
        return Shift(0, 0, significance, peak - base)
    return Shift(int(x[row, column]), int(y[row, column]), significance, peak - base)


def _correlate(steps, changes, radius) -> np.ndarray:
    """(2 r + 1, 2 r + 1): sum over x of steps(x) changes(x + d), d = (row - r, column - r)."""
    padded = cv2.copyMakeBorder(changes, radius, radius, radius, radius, cv2.BORDER_REFLECT_101)
    return cv2.matchTemplate(padded, steps, cv2.TM_CCORR)


def _part(edges: np.ndarray, half: int) -> np.ndarray:
    middle = edges.shape[2] // 2
    return edges[:, :, :middle] if half == 0 else edges[:, :, middle:]
