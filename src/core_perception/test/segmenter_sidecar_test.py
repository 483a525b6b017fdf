# SPDX-License-Identifier: BSD-3-Clause
"""The side-car's server, and the remote segmenter against it; with CORE_SIDECAR_PYTHON set, the SAM 3 side-car itself.

CORE_SIDECAR_PYTHON is a Python >= 3.11 with torch, torchvision, transformers and pillow. The weights are random: it
shows that images, names, masks and deadlines get there and back, and says nothing of how well SAM 3 segments.
"""

import base64
import contextlib
import http.client
import json
import os
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from core_perception.exceptions import ServerError
from core_perception.json_server import MAX_REQUEST_BYTES, BadRequestError
from core_perception.reasoners.vlm_client import BackOff
from core_perception.segmenters.base import SegmenterFrame, check_segmentation
from core_perception.segmenters.open_names import OpenNames
from core_perception.segmenters.remote import RemoteSegmenter
from core_perception.segmenters.sidecar_server import (
    Found,
    SidecarModel,
    SidecarServer,
    read_request,
)
from core_perception.sidecar_client import SidecarClient, find_endpoint

SCRIPT = Path(__file__).resolve().parents[1] / "scripts" / "segmenter_sidecar"
REAL_PYTHON = os.environ.get("CORE_SIDECAR_PYTHON", "")
ASKED = ("person", "floor", "wet_floor_sign")


class HalfAndHalf(SidecarModel):
    """Finds the first class in the upper half of every image; takes class_s for each class."""

    model = "half and half"

    def __init__(self):
        self.class_s, self.error, self.requests = 0.0, None, []

    def segment(self, request, is_time_left):
        self.requests.append(request)
        if self.error is not None:
            raise self.error
        evaluated = []
        for name in request.classes:
            if not is_time_left():
                break
            time.sleep(self.class_s)
            evaluated.append(name)
        mask = np.zeros(request.size_px, bool)
        mask[: request.size_px[0] // 2] = True
        return [Found(request.classes[0], np.float32(0.75), mask)], evaluated


@pytest.fixture()
def model():
    return HalfAndHalf()


@pytest.fixture()
def server(model):
    server = SidecarServer(model)
    thread = threading.Thread(target=server.serve, daemon=True)
    thread.start()
    yield server
    server.stop()
    thread.join(10.0)


@pytest.fixture()
def connect(ontology):
    def connect(port, deadline_s=5.0, **settings):
        client = SidecarClient(find_endpoint(f"http://127.0.0.1:{port}", "", False), deadline_s)
        return RemoteSegmenter(client, ontology, OpenNames(ontology), BackOff("r", 0.0, 0.0), **settings)

    return connect


def frame(asked=ASKED, size_px=(30, 40)):
    pixels = np.random.default_rng(1).integers(0, 255, (*size_px, 3)).astype(np.uint8)
    return SegmenterFrame(1_700_000_000_000_000_001, asked, image=pixels)


def test_image_names_and_masks_get_there_and_back(server, model, connect):
    segmentation = connect(server.port, image_format="png").segment(frame())
    check_segmentation(segmentation)
    (mask,) = segmentation.masks
    assert (mask.class_name, mask.score) == ("person", 0.75)
    assert (segmentation.labels[:15] == mask.label).all()
    assert not segmentation.labels[15:].any()
    assert segmentation.classes_evaluated == ASKED
    (request,) = model.requests
    assert (request.classes, request.size_px, request.image_format) == (ASKED, (30, 40), "png")
    assert request.file.startswith(b"\x89PNG")


def test_at_the_deadline_the_rest_is_not_evaluated_but_what_was_found_is_answered(server, model, connect):
    model.class_s = 0.25
    asked = tuple(f"thing_{k}" for k in range(20))
    segmentation = connect(server.port, deadline_s=1.5).segment(frame(asked))
    assert 2 <= len(segmentation.classes_evaluated) < 10
    assert len(segmentation.masks) == 1
    assert len(segmentation.not_evaluated(asked)) == 20 - len(segmentation.classes_evaluated)


@pytest.mark.parametrize(
    "error, cause, words",
    [
        (BadRequestError("image: data: cannot be read"), "http_4xx", "image: data"),
        (type("OutOfMemoryError", (RuntimeError,), {})("CUDA ..."), "http_5xx", "OutOfMemoryError"),
        (ZeroDivisionError("secret"), "http_5xx", "ZeroDivisionError"),
    ],
)
def test_a_failure_of_the_model_is_told_and_the_next_request_is_answered(server, model, connect, error, cause, words):
    remote = connect(server.port)
    model.error = error
    with pytest.raises(ServerError, match=words) as raised:
        remote.segment(frame())
    assert raised.value.cause == cause
    assert "secret" not in str(raised.value)
    model.error = None
    assert len(remote.segment(frame()).masks) == 1


def test_one_request_at_a_time(server, model, connect):
    model.class_s = 0.4
    first = threading.Thread(target=lambda: connect(server.port).segment(frame(("person",))))
    first.start()
    end = time.monotonic() + 5.0
    while not model.requests and time.monotonic() < end:
        time.sleep(0.01)
    with pytest.raises(ServerError, match="one request at a time") as error:
        connect(server.port).segment(frame())
    first.join()
    assert error.value.cause == "overloaded"


def request_value(**changed):
    value = {
        "version": 1,
        "stamp": {"secs": 1, "nsecs": 2},
        "deadline_s": 1.0,
        "min_score": 0.5,
        "image": {"format": "png", "size": [2, 2], "data": base64.b64encode(b"x").decode()},
        "classes": ["person"],
    }
    return {**value, **changed}


def picture(**changed):
    return {"image": {**request_value()["image"], **changed}}


WRONG_REQUESTS = [
    [],
    None,
    request_value(version=2),
    request_value(version=True),
    request_value(stamp=1.0),
    request_value(stamp={"secs": -1, "nsecs": 0}),
    request_value(stamp={"secs": 1}),
    request_value(deadline_s=0),
    request_value(deadline_s=float("nan")),
    request_value(deadline_s=1e9),
    request_value(min_score=2),
    request_value(min_score=True),
    request_value(classes=[]),
    request_value(classes="person"),
    request_value(classes=["Person"]),
    request_value(classes=["person", "person"]),
    request_value(classes=[["person"]]),
    request_value(classes=[{}]),
    request_value(classes=[f"c{k}" for k in range(2000)]),
    request_value(image=None),
    request_value(**picture(format="gif")),
    request_value(**picture(format=["png"])),
    request_value(**picture(size=[2])),
    request_value(**picture(size=[2, 10**6])),
    request_value(**picture(size=[0, 2])),
    request_value(**picture(size=[True, 2])),
    request_value(**picture(data="*")),
    request_value(**picture(data="\u00e9")),
    request_value(**picture(data=None)),
]


@pytest.mark.parametrize("value", WRONG_REQUESTS, ids=range(len(WRONG_REQUESTS)))
def test_a_request_that_breaks_the_contract_is_refused_before_the_model(server, model, value):
    with pytest.raises(BadRequestError, match="allowed"):
        read_request(value)
    status, reply = post(server.port, json.dumps(value).encode())
    assert (status, reply["error"]["code"], model.requests) == (400, "bad_request", [])


def post(port, body, path="/v1/segment", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
    with contextlib.closing(connection):
        connection.request("POST", path, body, {"Content-Type": "application/json", **headers})
        response = connection.getresponse()
        return response.status, json.loads(response.read())


@pytest.mark.parametrize(
    "body, path, headers, status",
    [
        (b"{", "/v1/segment", {}, 400),
        (b"\xff", "/v1/segment", {}, 400),
        (b"[" * 200000, "/v1/segment", {}, 400),
        (b"{}", "/v2/segment", {}, 404),
        (b"{}", "/v1/segment", {"Content-Type": "text/plain"}, 415),
        (b"{}", "/v1/segment", {"Content-Length": str(MAX_REQUEST_BYTES + 1)}, 413),
        (b"{}", "/v1/segment", {"Content-Length": "-1"}, 413),
    ],
)
def test_what_is_no_request_is_refused_in_words(server, model, body, path, headers, status):
    got, reply = post(server.port, body, path, **headers)
    assert (got, model.requests) == (status, [])
    assert reply["error"]["message"]


@pytest.fixture(scope="module")
def real_port(tmp_path_factory):
    if not REAL_PYTHON:
        pytest.skip("CORE_SIDECAR_PYTHON names no Python with torch and transformers")
    log = (tmp_path_factory.mktemp("sidecar") / "log").open("w")
    command = [REAL_PYTHON, str(SCRIPT), "--random-tiny", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
    line = process.stdout.readline()
    yield int(line.rsplit(":", 1)[1])
    process.terminate()
    process.wait(20.0)


def test_sam3_of_random_weights_answers_by_the_contract_and_says_that_they_are_random(real_port, connect):
    remote = connect(real_port, deadline_s=30.0, min_score=0.0, image_format="png")
    segmentation = remote.segment(frame(size_px=(96, 160)))
    check_segmentation(segmentation)
    assert segmentation.labels.shape == (96, 160)
    assert segmentation.masks
    assert {mask.class_name for mask in segmentation.masks} <= set(ASKED)
    assert "RANDOM" in remote.warning
    again = remote.segment(frame(size_px=(96, 160)))
    assert (again.labels == segmentation.labels).all()


def test_sam3_leaves_out_what_the_deadline_does_not_allow(real_port, connect):
    asked = tuple(f"thing_{k}" for k in range(500))
    segmentation = connect(real_port, deadline_s=4.0).segment(frame(asked))
    assert 0 < len(segmentation.classes_evaluated) < 500


@pytest.mark.parametrize("data, size", [(b"no image", [4, 4]), (None, [5, 4])])
def test_sam3_refuses_an_image_file_that_is_none_or_of_another_size(real_port, data, size):
    import cv2

    data = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes() if data is None else data
    value = request_value(**picture(data=base64.b64encode(data).decode(), size=size))
    status, reply = post(real_port, json.dumps(value).encode())
    assert (status, reply["error"]["code"]) == (400, "bad_request")


def test_sam3_without_weights_ends_with_one_line_and_status_2(tmp_path):
    if not REAL_PYTHON:
        pytest.skip("CORE_SIDECAR_PYTHON names no Python with torch and transformers")
    environment = dict(os.environ, HF_HUB_OFFLINE="1")
    done = subprocess.run(
        [REAL_PYTHON, str(SCRIPT), "--model", str(tmp_path), "--port", "0"],
        capture_output=True, text=True, check=False, env=environment, timeout=120.0,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("segmenter_sidecar: ")
