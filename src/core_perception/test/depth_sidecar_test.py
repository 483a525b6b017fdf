# SPDX-License-Identifier: BSD-3-Clause
"""Asking a depth side-car over real HTTP: what is sent, what is read, and that no fault of it gets through."""

import time

import numpy as np
import pytest
from fakes.fake_depth_sidecar import FAULTS, FakeDepthSidecar

from core_perception.depth_sidecar import Pinhole, ask_depth, encode_image, read_answer
from core_perception.endpoint import Endpoint
from core_perception.exceptions import EvidenceError, ServerError
from core_perception.sidecar_client import SidecarClient

STAMP_NS = 12_345_678_901
DEPTH = np.linspace(1.0, 4.0, 32 * 48, dtype=np.float32).reshape(32, 48)
CAMERA = Pinhole(640, 480, 500.0, 510.0, 319.5, 250.0)


def picture(height_px=64, width_px=96):
    image = np.zeros((height_px, width_px, 3), np.uint8)
    image[:, width_px // 2 :] = (255, 0, 0)
    return image


def ask(server, image=None, camera=CAMERA, deadline_s=5.0, max_image_px=640):
    client = SidecarClient(Endpoint.parse(server.url), deadline_s)
    return ask_depth(client, picture() if image is None else image, camera, STAMP_NS, max_image_px)


@pytest.mark.parametrize(("dtype", "error"), [("float32", 0.0), ("float16", 2e-3)])
def test_the_answer_comes_as_it_was_sent(dtype, error):
    with FakeDepthSidecar(DEPTH, "metric", confidence=0.5 * DEPTH, dtype=dtype) as server:
        answer = ask(server)
    assert (answer.model, answer.prediction.kind, answer.random_weights) == ("fake", "metric", False)
    assert answer.prediction.values.dtype == np.float32
    assert np.abs(answer.prediction.values - DEPTH).max() <= error
    assert np.abs(answer.prediction.confidence - 0.5 * DEPTH).max() <= error


def test_the_picture_is_sent_in_colour_with_the_intrinsics_of_its_own_size():
    with FakeDepthSidecar(DEPTH) as server:
        ask(server, picture(480, 640), max_image_px=320)
        ask(server, camera=None)
    request = server.requests[0]
    assert (request["path"], request["version"], request["image"]["size"]) == ("/v1/depth", 1, [240, 320])
    assert request["stamp"] == {"secs": 12, "nsecs": 345_678_901}
    assert 0.0 < request["deadline_s"] <= 5.0
    assert request["picture"].shape == (240, 320, 3)
    assert request["picture"][100, 300].argmax() == 2  # red, in the order of OpenCV
    camera = request["camera"]
    assert [camera[key] for key in ("fx_px", "fy_px", "cx_px", "cy_px")] == [250.0, 255.0, 159.5, 124.75]
    assert server.requests[1]["camera"] is None


@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault not in ("", "nan")])
def test_every_fault_is_an_error_within_the_deadline(fault):
    with FakeDepthSidecar(DEPTH) as server:
        server.fault = fault
        begun_s = time.monotonic()
        with pytest.raises((ServerError, EvidenceError)) as error:
            ask(server, deadline_s=1.0)
        assert time.monotonic() - begun_s < 2.0
        assert "\n" not in str(error.value)
        server.fault = ""
        ask(server)


def test_nobody_there_is_an_error_at_once():
    with FakeDepthSidecar(DEPTH) as server:
        pass
    with pytest.raises(ServerError, match="refused"):
        ask(server)


def reply(**changes):
    value = {
        "version": 1,
        "stamp": {"secs": 12, "nsecs": 345_678_901},
        "model": "m",
        "kind": "relative",
        "size": [32, 48],
        "dtype": "float32",
        "depth": encode_image(DEPTH, "float32"),
    }
    return {key: v for key, v in {**value, **changes}.items() if v is not None}


def test_a_reply_reads_back_what_encode_image_wrote():
    assert np.array_equal(read_answer(reply(), STAMP_NS).prediction.values, DEPTH)
    assert read_answer(reply(random_weights=True), STAMP_NS).random_weights
    assert read_answer(reply(unknown_key=3), STAMP_NS).prediction.confidence is None


BAD_REPLIES = [
    ("stamp", None),
    ("stamp", {"secs": 12, "nsecs": 0}),
    ("kind", "depth"),
    ("kind", None),
    ("kind", ["relative"]),
    ("model", ""),
    ("model", "two\nlines"),
    ("model", 3),
    ("model", "m" * 201),
    ("random_weights", 1),
    ("size", [48, 32.0]),
    ("size", [32]),
    ("size", [0, 48]),
    ("size", [5000, 48]),
    ("size", [True, 48]),
    ("size", "32x48"),
    ("dtype", "float64"),
    ("dtype", None),
    ("dtype", ["float32"]),
    ("depth", None),
    ("depth", 3),
    ("depth", "AAAA"),
    ("depth", "!" * 8192),
    ("depth", "\u00e4" * 8192),
    ("confidence", "AAAA"),
    ("confidence", 0.5),
]


@pytest.mark.parametrize(("key", "value"), BAD_REPLIES)
def test_a_reply_with_a_wrong_part_is_refused_by_its_name(key, value):
    with pytest.raises(EvidenceError, match=f"reply: {key}: ") as error:
        read_answer(reply(**{key: value}), STAMP_NS)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


def test_borders_of_pixels_scale_and_not_their_centres():
    scaled = Pinhole(640, 480, 500.0, 500.0, 319.5, 239.5).scaled(320, 120)
    assert scaled == Pinhole(320, 120, 250.0, 125.0, 159.5, 59.5)
