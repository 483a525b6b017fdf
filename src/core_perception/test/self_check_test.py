# SPDX-License-Identifier: BSD-3-Clause
"""Self-check: a healthy camera gives no finding, and every fault that is put in is found by its name."""

import math
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from depth_scenes import View, make_room, random_view, sense

from core_perception.checks.base import CameraInfo, CheckFrame, Level, PoseLookups, Stream
from core_perception.checks.intrinsics import compute_distortion_px
from core_perception.self_check import CheckLimits, Sample, check

SEEDS = range(36)
FRAMES = 3
CAMERA = "any_optical_frame"
#: Cameras of other makes: width, height, focal length.
SIZES = [(320, 240, 260.0), (480, 360, 394.0), (424, 240, 300.0), (384, 318, 274.0)]


def info_of(view, **changes):
    cx, cy = view.center_px
    info = CameraInfo(view.width_px, view.height_px, (view.fx_px, 0, cx, 0, view.fy_px, cy, 0, 0, 1), (0.0,) * 5)
    return replace(info, **changes)


def make_frames(random, view, count=FRAMES, noise=0.01):
    """A camera that is moved a little from frame to frame, over fresh rooms."""
    frames = []
    for _ in range(count):
        at = replace(
            view, pitch_rad=view.pitch_rad + random.normal(0.0, 0.01), height_m=view.height_m + random.normal(0.0, 0.01)
        )
        room = make_room(random, at)
        sensed = sense(random, room.depth_m, noise=noise, holes=0.05)
        labels = np.where(room.surface < 10, room.surface + 1, room.surface).astype(np.uint16)
        depth = np.nan_to_num(sensed * 1000.0).astype(np.uint16) if random.uniform() < 0.5 else sensed
        frames.append(CheckFrame(depth, room.color, labels, at.T_map_camera()))
    kind = frames[0].depth.dtype
    return [f if f.depth.dtype == kind else replace(f, depth=to_kind(f, kind)) for f in frames]


def to_kind(frame, kind):
    return np.nan_to_num(frame.depth_m * 1000.0).astype(np.uint16) if kind == np.uint16 else frame.depth_m


def stream(random, topic, offset_s=0.0, count=30, period_s=1 / 30, age_s=0.05):
    stamps = 1000.0 + offset_s + period_s * np.arange(count) + random.uniform(0.0, 0.002, count)
    received = stamps + age_s + random.uniform(0.0, 0.02, count)
    return Stream(topic, CAMERA, list(stamps), list(received))


def make_sample(seed, view=None):
    random = np.random.RandomState(seed)
    width_px, height_px, focal_px = SIZES[seed % len(SIZES)]
    view = view or random_view(random, width_px=width_px, height_px=height_px, fx_px=focal_px, fy_px=focal_px)
    frames = make_frames(random, view)
    depth, color = stream(random, "depth"), stream(random, "color", offset_s=random.uniform(-0.01, 0.01))
    return Sample(
        frames, info_of(view), depth, color, PoseLookups("odom", CAMERA, 30, 0), (view.width_px, view.height_px)
    )


@pytest.fixture(scope="module")
def healthy():
    """Seed -> sample, made once."""
    made = {}

    def get(seed):
        if seed not in made:
            made[seed] = make_sample(seed)
        return made[seed]

    return get


def codes(sample, limits=None):
    report = check(sample, limits)
    for finding in report.findings:
        assert "\n" not in finding.sentence
        assert 40 < len(finding.sentence) < 420
        assert any(c.isdigit() for c in finding.sentence) or finding.code.startswith(("frame_", "stamp_stuck"))
    return {finding.code for finding in report.findings if finding.level > Level.NOTE}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_healthy_camera_gives_no_finding(healthy, seed):
    report = check(healthy(seed))
    assert report.findings == ()
    assert report.is_healthy
    assert [outcome.check for outcome in report.outcomes if outcome.unchecked] == []


def change_frames(sample, change):
    return replace(sample, frames=[change(frame) for frame in sample.frames])


def with_depth(change):
    return lambda sample: change_frames(sample, lambda f: replace(f, depth=change(f)))


def moved(image, dx, dy):
    return cv2.warpAffine(
        image, np.float64([[1, 0, dx], [0, 1, dy]]), image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE
    )


def with_pose(change):
    def turn(frame):
        pose = frame.T_map_camera.copy()
        change(pose)
        return replace(frame, T_map_camera=pose)

    return lambda sample: change_frames(sample, turn)


def turned(axis, degrees):
    """Turn the camera of tf about an axis of its own."""
    vector = np.zeros(3)
    vector[axis] = math.radians(degrees)
    rotation = cv2.Rodrigues(vector)[0]

    def change(pose):
        pose[:3, :3] = pose[:3, :3] @ rotation

    return with_pose(change)


def raised(metres):
    def change(pose):
        pose[2, 3] += metres

    return with_pose(change)


def with_info(**changes):
    return lambda sample: replace(sample, info=replace(sample.info, **changes))


def with_k(fx=1.0, fy=1.0, cx=0.0, cy=0.0):
    """Focal lengths times a factor, principal point off by a part of the image."""

    def change(sample):
        k, i = list(sample.info.K), sample.info
        k[0], k[4], k[2], k[5] = k[0] * fx, k[4] * fy, k[2] + cx * i.width_px, k[5] + cy * i.height_px
        return replace(sample, info=replace(i, K=tuple(k)))

    return change


def with_stream(name, change):
    def apply(sample):
        old = getattr(sample, name)
        new = Stream(old.topic, old.frame_id, list(old.stamps_s), list(old.received_s))
        change(new)
        return replace(sample, **{name: new})

    return apply


def shift_stamps(seconds):
    def change(s):
        s.stamps_s = [t + seconds for t in s.stamps_s]

    return change


def received_later(seconds):
    def change(s):
        s.received_s = [t + seconds for t in s.received_s]

    return change


def at_rate(hz, gaps=False):
    def change(s):
        s.stamps_s = [1000.0 + k / hz + (0.5 * (k // 5) if gaps else 0.0) for k in range(30)]
        s.received_s = [t + 0.05 for t in s.stamps_s]

    return change


def stamped(value):
    def change(s):
        s.stamps_s = [value] * len(s.stamps_s)

    return change


def with_both(change):
    return lambda sample: with_stream("depth", change)(with_stream("color", change)(sample))


def stretched(sample):
    """Colour of the whole view of a wider camera beside depth that was not warped into it."""

    def zoom(f):
        height_px, width_px = f.color.shape[:2]
        matrix = cv2.getRotationMatrix2D((width_px / 2, height_px / 2), 0.0, 0.92)
        return replace(f, color=cv2.warpAffine(f.color, matrix, (width_px, height_px)), labels=None)

    return change_frames(sample, zoom)


FAULTS = {
    "metres in 16UC1": (with_depth(lambda f: np.nan_to_num(f.depth_m).astype(np.uint16)), "depth_unit"),
    "8 bit in 16UC1": (
        with_depth(lambda f: np.nan_to_num(f.depth_m * 25.0).clip(0, 255).astype(np.uint16)),
        "depth_unit",
    ),
    "millimetres in 32FC1": (with_depth(lambda f: f.depth_m * np.float32(1000.0)), "depth_unit"),
    "centimetres in 32FC1": (with_depth(lambda f: f.depth_m * np.float32(100.0)), "depth_unit"),
    "five thousand to the metre": (
        with_depth(lambda f: np.nan_to_num(f.depth_m * 5000).astype(np.uint16)),
        "floor_height",
    ),
    "all zero": (with_depth(lambda f: np.zeros_like(f.depth)), "depth_empty"),
    "all NaN": (with_depth(lambda f: np.full(f.depth.shape, np.nan, np.float32)), "depth_empty"),
    "constant": (with_depth(lambda f: np.full(f.depth.shape, 2.0, np.float32)), "depth_constant"),
    "hardly any": (
        with_depth(lambda f: np.where(np.arange(f.depth.size).reshape(f.depth.shape) % 40 == 0, f.depth_m, np.nan)),
        "depth_sparse",
    ),
    "negative": (with_depth(lambda f: np.where(f.depth_m < 1.5, -f.depth_m, f.depth_m)), "depth_negative"),
    "colour 6 px right": (
        lambda s: change_frames(s, lambda f: replace(f, color=moved(f.color, 6, 0))),
        "registration_shift",
    ),
    "colour 8 px up": (
        lambda s: change_frames(s, lambda f: replace(f, color=moved(f.color, 0, -8))),
        "registration_shift",
    ),
    "labels 7 px left": (
        lambda s: change_frames(s, lambda f: replace(f, labels=moved(f.labels, -7, 0))),
        "registration_shift",
    ),
    "depth 5 px both ways": (with_depth(lambda f: moved(f.depth, 5, 5)), "registration_shift"),
    "another field of view": (stretched, "registration_scale"),
    "labels mirrored": (
        lambda s: change_frames(s, lambda f: replace(f, labels=np.ascontiguousarray(f.labels[:, ::-1]))),
        "registration_mirrored",
    ),
    "colour turned by half a turn": (
        lambda s: change_frames(s, lambda f: replace(f, color=np.ascontiguousarray(f.color[::-1, ::-1]))),
        "registration_mirrored",
    ),
    "depth upside down": (
        lambda s: change_frames(s, lambda f: replace(f, depth=np.ascontiguousarray(f.depth[::-1]), T_map_camera=None)),
        "registration_mirrored",
    ),
    "tf 0.12 m low": (raised(-0.12), "floor_height"),
    "tf 0.08 m high": (raised(0.08), "floor_height"),
    "tf pitch 4 degrees": (turned(0, 4.0), "floor_tilt"),
    "tf pitch -3 degrees": (turned(0, -3.0), "floor_tilt"),
    "tf roll 4 degrees": (turned(2, 4.0), "floor_tilt"),
    "body frame for optical": (with_pose(lambda pose: pose.__setitem__((slice(3), slice(3)), np.eye(3))), "floor_axes"),
    "upside down": (turned(2, 180.0), "floor_axes"),
    "no calibration": (with_info(K=(0.0,) * 9), "intrinsics_missing"),
    "NaN calibration": (with_info(K=(math.nan,) * 9), "intrinsics_missing"),
    "centre of a larger image": (with_k(cx=0.5, cy=0.5), "center_off"),
    "centre of a smaller image": (with_k(cx=-0.25, cy=-0.25), "center_off"),
    "focal length of a far larger image": (with_k(10.0, 10.0), "fov"),
    "focal length of a far smaller image": (with_k(0.1, 0.1), "fov"),
    "fx mistyped": (with_k(fx=1.7), "focal_ratio"),
    "fy of another shape": (with_k(fy=0.75), "focal_ratio"),
    "distortion": (with_info(D=(0.1, -0.2, 0.0, 0.0, 0.0)), "distortion"),
    "fisheye": (with_info(D=(0.01, 0.0, 0.0, 0.0), distortion_model="equidistant"), "distortion"),
    "camera_info of another shape": (
        lambda s: with_info(width_px=s.info.width_px * 2, height_px=s.info.height_px * 3)(s),
        "size_shape",
    ),
    "region of interest": (with_info(roi=(10, 0, 300, 200)), "size_shape"),
    "binning": (with_info(binning=(2, 2)), "size_shape"),
    "colour of another shape": (lambda s: replace(s, color_size_px=(1920, 800)), "size_shape"),
    "old stamps": (with_both(shift_stamps(-2.0)), "stamp_old"),
    "clock ahead": (with_both(shift_stamps(0.4)), "stamp_ahead"),
    "recording without its clock": (with_both(received_later(3e8)), "stamp_clock"),
    "stamps of 0": (with_stream("depth", stamped(0.0)), "stamp_zero"),
    "one stamp": (with_stream("depth", stamped(1000.0)), "stamp_stuck"),
    "colour 50 ms late": (
        lambda s: with_stream("color", shift_stamps(0.05))(with_both(at_rate(10.0))(s)),
        "stamp_offset",
    ),
    "2 Hz": (with_both(at_rate(2.0)), "rate_low"),
    "gaps": (with_both(at_rate(30.0, gaps=True)), "rate_gaps"),
    "loop": (with_stream("depth", lambda s: s.stamps_s.__setitem__(slice(15, None), s.stamps_s[:15])), "stamp_back"),
    "another frame": (with_stream("color", lambda s: setattr(s, "frame_id", "other")), "frame_differs"),
    "no frame": (with_both(lambda s: setattr(s, "frame_id", "")), "frame_empty"),
    "no tf": (lambda s: replace(s, lookups=replace(s.lookups, failed=30, reason="no path")), "tf_missing"),
    "late tf": (lambda s: replace(s, lookups=replace(s.lookups, failed=9)), "tf_gaps"),
    "nothing comes": (lambda s: replace(s, frames=[]), "depth_missing"),
}
#: Faults that rightly show in more than one place.
ALSO = {
    "five thousand to the metre": {"depth_unit", "floor_tilt"},
    "depth 5 px both ways": {"floor_height", "floor_tilt"},
    "focal length of a far smaller image": {"floor_height", "floor_tilt", "floor_axes"},
    "focal length of a far larger image": {"floor_height", "floor_tilt", "floor_axes"},
    "fy of another shape": {"floor_height", "floor_tilt"},
    "centre of a larger image": {"floor_height", "floor_tilt", "floor_axes"},
    "centre of a smaller image": {"floor_height", "floor_tilt", "floor_axes"},
}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", sorted(FAULTS))
def test_a_fault_is_found_by_its_name_and_nothing_else_is(healthy, name, seed):
    put_in, code = FAULTS[name]
    found = codes(put_in(healthy(seed)))
    assert code in found
    assert found - {code} <= ALSO.get(name, set())


def sentence_of(sample, code):
    return next(f.sentence for f in check(sample).findings if f.code == code)


@pytest.mark.parametrize("seed", range(3))
def test_numbers_in_the_sentences_are_right(healthy, seed):
    sample = healthy(seed)
    for metres, where in ((-0.12, "below"), (0.09, "above")):
        words = sentence_of(raised(metres)(sample), "floor_height")
        assert float(re.search(rf"lies ([\d.]+) m {where} where tf", words).group(1)) == pytest.approx(
            abs(metres), abs=0.015
        )
    words = sentence_of(turned(0, 5.0)(sample), "floor_tilt")
    assert float(re.search(r"is tilted ([\d.]+) degrees", words).group(1)) == pytest.approx(5.0, abs=0.3)
    moved_right = change_frames(sample, lambda f: replace(f, color=moved(f.color, 7, 0)))
    words = sentence_of(moved_right, "registration_shift")
    assert abs(int(re.search(r"lie (\d+) px to the right", words).group(1)) - 7) <= 1


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("degrees", [5.0, -5.0])
def test_direction_of_a_wrong_pitch_is_told(healthy, seed, degrees):
    """tf is turned about the camera's x axis (right): by a positive angle it looks up, and the camera further down."""
    words = sentence_of(turned(0, degrees)(healthy(seed)), "floor_tilt")
    assert ("further down" if degrees > 0 else "further up") in words
    assert "rolled" not in words
    words = sentence_of(turned(2, degrees)(healthy(seed)), "floor_tilt")  # tf is rolled to the right, the camera is not
    assert ("further to the left" if degrees > 0 else "further to the right") in words
    assert "looks" not in words


def test_pixels_that_are_not_square_are_a_note_where_the_floor_bears_them_out():
    view = View(500, 320, 274.9, 376.7)
    report = check(make_sample(1, view))
    assert [(f.code, f.level) for f in report.findings] == [("focal_ratio", Level.NOTE)]
    assert report.is_healthy
    blind = make_sample(1, view)
    assert codes(change_frames(blind, lambda f: replace(f, T_map_camera=None))) == {"focal_ratio"}


def test_half_the_size_is_a_note():
    sample = make_sample(0)
    k = tuple(2.0 * n if n > 1 else n for n in sample.info.K)
    doubled = replace(sample, info=replace(sample.info, K=k, width_px=640, height_px=480))
    assert {f.code for f in check(doubled).findings} == {"size_scaled"}
    assert check(doubled).is_healthy


def alike_on_both_sides(f):
    """The left half twice, and one box at the right that the left does not have."""
    middle = f.depth.shape[1] // 2
    depth, labels = (np.concatenate([x[:, :middle], x[:, :middle][:, ::-1]], axis=1) for x in (f.depth_m, f.labels))
    height_px, width_px = depth.shape
    where = np.s_[round(0.4 * height_px) : round(0.7 * height_px), round(0.7 * width_px) : round(0.85 * width_px)]
    depth[where], labels[where] = 1.2, 999
    return replace(f, depth=depth, labels=labels, color=None)


@pytest.mark.parametrize("seed", range(4))
def test_mirrored_labels_are_told_in_a_scene_that_is_nearly_alike_on_both_sides(healthy, seed):
    whole = change_frames(healthy(seed), alike_on_both_sides)
    assert not codes(whole) & {"registration_shift", "registration_mirrored", "registration_scale"}
    mirrored = change_frames(whole, lambda f: replace(f, labels=np.ascontiguousarray(f.labels[:, ::-1])))
    assert "The label images are turned left to right" in sentence_of(mirrored, "registration_mirrored")


@pytest.mark.parametrize("seed", range(2))
def test_a_region_of_interest_and_binning_are_followed(healthy, seed):
    def part(f, rows, columns):
        depth, color, labels = (np.ascontiguousarray(x[rows, columns]) for x in (f.depth, f.color, f.labels))
        return replace(f, depth=depth, color=color, labels=labels)

    sample = healthy(seed)
    info, left, top = sample.info, 30, 20
    roi = (left, top, info.width_px - 2 * left, info.height_px - top)
    cropped = change_frames(sample, lambda f: part(f, slice(top, None), slice(left, -left)))
    cropped = replace(cropped, color_size_px=roi[2:], info=replace(info, roi=roi))
    binned = change_frames(sample, lambda f: part(f, slice(None, None, 2), slice(None, None, 2)))
    binned = replace(
        binned, color_size_px=(info.width_px // 2, info.height_px // 2), info=replace(info, binning=(2, 2))
    )
    for seen in (cropped, binned):
        assert codes(seen) == set()
        assert check(seen).is_healthy


@pytest.mark.parametrize("seed", range(4))
def test_masks_that_are_too_small_are_no_shift(healthy, seed):
    kernel = np.ones((13, 13), np.uint8)

    def erode(f):
        kept = np.zeros_like(f.labels)
        for label in np.unique(f.labels):
            kept[cv2.erode((f.labels == label).astype(np.uint8), kernel) > 0] = label
        return replace(f, labels=kept)

    assert codes(change_frames(healthy(seed), erode)) == set()


@pytest.mark.parametrize("seed", range(3))
def test_what_cannot_be_seen_is_not_checked_instead_of_passed(healthy, seed):
    random = np.random.RandomState(seed)
    wall = (1.5 + 0.01 * random.normal(size=(240, 320))).astype(np.float32)
    noise = random.randint(0, 255, (240, 320, 3)).astype(np.uint8)
    sample = replace(healthy(0), frames=[CheckFrame(wall, noise, None, View().T_map_camera())] * 3)
    report = check(sample)
    assert {f.code for f in report.findings} == set()
    unchecked = {outcome.check for outcome in report.outcomes if outcome.unchecked}
    assert unchecked == {"floor", "registration of depth and colour", "registration of depth and labels"}
    assert "not checked: floor" in report.summary


@pytest.mark.parametrize("seed", range(6))
def test_a_picture_that_has_nothing_to_do_with_depth_gives_no_shift(healthy, seed):
    sample, other = healthy(4), make_sample(100 + 4 * seed)
    strangers = [replace(a, color=b.color, labels=None) for a, b in zip(sample.frames, other.frames)]
    assert codes(replace(sample, frames=strangers)) == set()


@pytest.mark.parametrize("seed", range(3))
def test_a_table_in_view_is_not_taken_for_the_floor(seed):
    random = np.random.RandomState(seed)
    view = View(height_m=1.4, pitch_rad=0.5)
    sample = make_sample(0)
    frames = make_frames(random, view, 3)
    info = info_of(view)
    K, pose = info.matrix_at(320, 240), view.T_map_camera()
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1) @ pose[:3, :3].T
    table_m = (0.75 - view.height_m) / rays[..., 2]
    on_table = (table_m > 0) & (u > 110)
    lifted = [
        replace(f, depth=np.where(on_table, np.fmin(table_m, f.depth_m), f.depth_m).astype(np.float32)) for f in frames
    ]
    lifted = [replace(f, T_map_camera=pose, color=None, labels=None) for f in lifted]
    found = codes(replace(sample, frames=lifted, info=info, color_size_px=None))
    assert found == set()


def test_distortion_is_told_in_pixels_at_the_corner():
    info = CameraInfo(640, 480, (500.0, 0, 319.5, 0, 500.0, 239.5, 0, 0, 1), (0.1, 0.0, 0.0, 0.0, 0.0))
    r = math.hypot(319.5, 239.5) / 500.0
    assert compute_distortion_px(info) == pytest.approx(500.0 * 0.1 * r**3)
    assert compute_distortion_px(replace(info, D=(0.1,))) == pytest.approx(500.0 * 0.1 * r**3)
    assert compute_distortion_px(replace(info, D=())) == 0.0


def test_limits_are_heeded(healthy):
    sample = raised(0.08)(healthy(2))
    assert codes(sample) == {"floor_height"}
    assert codes(sample, CheckLimits(replace(CheckLimits().floor, height_m=0.15))) == set()
    assert codes(sample, CheckLimits(replace(CheckLimits().floor, floor_z_m=0.08))) == set()


def test_the_worst_comes_first_and_the_summary_counts():
    sample = FAULTS["no frame"][0](FAULTS["2 Hz"][0](make_sample(1)))
    report = check(sample)
    assert [f.level for f in report.findings] == sorted((f.level for f in report.findings), reverse=True)
    assert not report.is_healthy
    assert report.summary.startswith("3 things to put right")
