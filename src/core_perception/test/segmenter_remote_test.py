# SPDX-License-Identifier: BSD-3-Clause
"""The remote segmenter against a side-car that speaks real HTTP: what it asks, and what it refuses to believe."""

import copy
import json
import math
import os
import random
import threading
import time

import numpy as np
import pytest
from fakes.fake_sidecar import FakeSidecar

from core_perception.exceptions import EndpointError, EvidenceError, PerceptionError, ServerError
from core_perception.reasoners.vlm_client import BackOff
from core_perception.segmenters.base import SegmenterFrame, check_segmentation
from core_perception.segmenters.open_names import OpenNames
from core_perception.segmenters.painting import Instance, paint_instances
from core_perception.segmenters.remote import RemoteSegmenter
from core_perception.segmenters.rle import decode_mask, encode_mask, read_runs
from core_perception.segmenters.sidecar_wire import read_reply
from core_perception.sidecar_client import SidecarClient, encode_picture, find_endpoint, read_json

COLORS = {"floor": (90, 90, 90), "traffic_cone": (230, 110, 20), "wall": (20, 40, 200)}
ASKED = ("traffic_cone", "floor", "wall", "forklift")
STAMP_NS = 1_700_000_000_123_456_789


@pytest.fixture()
def picture():
    image = np.empty((48, 64, 3), np.uint8)
    image[:] = COLORS["floor"]
    image[:16] = COLORS["wall"]
    image[24:40, 8:16] = COLORS["traffic_cone"]
    return image


REQUEST = {
    "image": encode_picture(np.zeros((4, 4, 3), np.uint8), "png", 64),
    "classes": ["floor"],
    "stamp": {"secs": 1, "nsecs": 2},
}


@pytest.fixture()
def sidecar():
    with FakeSidecar(COLORS) as sidecar:
        yield sidecar


class NoPause(BackOff):
    def failed(self):
        return 0.0


@pytest.fixture()
def connect(ontology):
    def connect(sidecar, deadline_s=5.0, back_off=None, **settings):
        endpoint = find_endpoint(sidecar.url, "", False)
        settings = {"image_format": "png", **settings}
        return RemoteSegmenter(
            SidecarClient(endpoint, deadline_s), ontology, OpenNames(ontology), back_off or NoPause("r"), **settings
        )

    return connect


def frame_of(picture, asked=ASKED, rules=(), unsafe=()):
    return SegmenterFrame(STAMP_NS, tuple(asked), frozenset(rules), frozenset(unsafe), picture)


def test_masks_come_back_at_the_size_of_the_image_with_the_names_that_were_asked(sidecar, connect, picture):
    segmentation = connect(sidecar).segment(frame_of(picture))
    check_segmentation(segmentation)
    assert segmentation.classes_evaluated == ASKED
    by_name = {mask.class_name: segmentation.labels == mask.label for mask in segmentation.masks}
    assert set(by_name) == {"floor", "traffic_cone", "wall"}
    for name, color in COLORS.items():
        assert (by_name[name] == (picture == color).all(axis=2)).all()
    assert 0.0 < segmentation.latency_s < 5.0


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_the_request_is_that_of_the_contract(sidecar, connect, picture, kind):
    connect(sidecar, image_format=kind, min_score=0.25).segment(frame_of(picture))
    (request,) = sidecar.requests
    assert set(request) == {"version", "stamp", "deadline_s", "min_score", "image", "classes"}
    assert request["stamp"] == {"secs": 1_700_000_000, "nsecs": 123_456_789}
    assert request["deadline_s"] == pytest.approx(4.5)
    assert request["min_score"] == 0.25
    assert (request["image"]["format"], request["image"]["size"]) == (kind, [48, 64])
    assert request["classes"] == list(ASKED)


def test_a_large_image_is_sent_small_and_its_labels_come_back_large(sidecar, connect, picture):
    large = np.kron(picture, np.ones((8, 8, 1), np.uint8))
    segmentation = connect(sidecar, max_image_px=64).segment(frame_of(large))
    assert sidecar.requests[0]["image"]["size"] == [48, 64]
    assert segmentation.labels.shape == (384, 512)
    cone = next(mask.label for mask in segmentation.masks if mask.class_name == "traffic_cone")
    assert ((segmentation.labels == cone) == (large == COLORS["traffic_cone"]).all(axis=2)).all()


def test_what_the_side_car_did_not_get_done_is_not_evaluated(sidecar, connect, picture):
    sidecar.most_evaluated = 2
    segmentation = connect(sidecar).segment(frame_of(picture))
    assert segmentation.classes_evaluated == ("traffic_cone", "floor")
    assert segmentation.not_evaluated(ASKED) == ("wall", "forklift")


@pytest.mark.parametrize("limit", ["server", "parameter"])
def test_of_too_many_classes_unsafe_ones_come_first_then_those_of_rules(sidecar, connect, picture, limit):
    if limit == "server":
        sidecar.capabilities["max_classes"] = 3
    remote = connect(sidecar, max_classes=0 if limit == "server" else 3)
    segmentation = remote.segment(frame_of(picture, ASKED, rules=["wall", "forklift"], unsafe=["forklift"]))
    assert sidecar.requests[0]["classes"] == ["forklift", "wall", "traffic_cone"]
    assert segmentation.not_evaluated(ASKED) == ("floor",)


def test_a_closed_vocabulary_is_asked_by_its_own_names_and_the_rest_is_not_evaluated(sidecar, connect, picture):
    sidecar.colors["cone"] = sidecar.colors.pop("traffic_cone")
    sidecar.capabilities["classes"] = ["Cone", "wall"]
    segmentation = connect(sidecar).segment(frame_of(picture))
    assert sorted(sidecar.requests[0]["classes"]) == ["cone", "wall"]
    assert {mask.class_name for mask in segmentation.masks} == {"traffic_cone", "wall"}
    assert segmentation.not_evaluated(ASKED) == ("floor", "forklift")


def test_weak_instances_are_left_out_and_their_class_was_looked_for(sidecar, connect, picture):
    segmentation = connect(sidecar, min_score=0.95).segment(frame_of(picture))
    assert (segmentation.masks, segmentation.classes_evaluated) == ((), ASKED)


def set_in(*path):
    """Spoil a reply: the last argument becomes the value at the keys before it; DROP removes it."""

    def spoil(reply):
        reply = copy.deepcopy(reply)
        target = reply
        for key in path[:-2]:
            target = target[key]
        if path[-1] is DROP:
            del target[path[-2]]
        else:
            target[path[-2]] = path[-1]
        return reply

    return spoil


DROP = object()
MUTATIONS = (b"", b"0", b"-1", b"9e9", b'"', b"]", b"null", b"{")
SPOILED = {
    "wrong size": set_in("size", [48, 63]),
    "size transposed": set_in("size", [64, 48]),
    "mask of another size": set_in("instances", 0, "mask", "size", [24, 128]),
    "no size": set_in("size", DROP),
    "unknown class": set_in("instances", 0, "class", "dragon"),
    "class that was not evaluated": set_in("classes_evaluated", ["floor", "wall"]),
    "evaluated what was not asked": set_in("classes_evaluated", [*ASKED, "dragon"]),
    "no classes_evaluated": set_in("classes_evaluated", DROP),
    "classes_evaluated of numbers": set_in("classes_evaluated", [1, 2]),
    "classes_evaluated of lists": set_in("classes_evaluated", [["floor"]]),
    "class a list": set_in("instances", 0, "class", ["floor"]),
    "score above one": set_in("instances", 0, "score", 1.5),
    "score below zero": set_in("instances", 0, "score", -0.1),
    "score true": set_in("instances", 0, "score", True),
    "score text": set_in("instances", 0, "score", "0.9"),
    "no score": set_in("instances", 0, "score", DROP),
    "score NaN": set_in("instances", 0, "score", math.nan),
    "score infinite": set_in("instances", 0, "score", math.inf),
    "counts too short": set_in("instances", 0, "mask", "counts", [48 * 64 - 1]),
    "counts too long": set_in("instances", 0, "mask", "counts", [48 * 64, 1]),
    "counts negative": set_in("instances", 0, "mask", "counts", [48 * 64 + 5, -5]),
    "counts huge": set_in("instances", 0, "mask", "counts", [2**63, 2**63]),
    "counts of floats": set_in("instances", 0, "mask", "counts", [48 * 64.0]),
    "counts of booleans": set_in("instances", 0, "mask", "counts", [True] * (48 * 64)),
    "counts empty": set_in("instances", 0, "mask", "counts", []),
    "counts text": set_in("instances", 0, "mask", "counts", "aAbB"),
    "counts with a zero within": set_in("instances", 0, "mask", "counts", [1, 0, 48 * 64 - 1]),
    "no mask": set_in("instances", 0, "mask", DROP),
    "mask null": set_in("instances", 0, "mask", None),
    "instances an object": set_in("instances", {}),
    "instance a number": set_in("instances", [1]),
    "too many instances": lambda reply: {**reply, "instances": reply["instances"][:1] * 2001},
    "NaN where nobody looks": lambda reply: {**reply, "more": math.nan},
    "a number without end where nobody looks": lambda reply: (
        json.dumps({**reply, "more": [0]}).replace("[0]", "1" * 3000).encode()
    ),
    "another stamp": set_in("stamp", {"secs": 1, "nsecs": 0}),
    "stamp a float": set_in("stamp", 1.7e9),
    "no model": set_in("model", DROP),
    "model of control characters": set_in("model", "a\x1b[31m\nb"),
    "another version": set_in("version", 2),
    "version true": set_in("version", True),
    "a list": lambda reply: [reply],
    "null": lambda reply: b"null",
    "no JSON": lambda reply: b"<html>",
    "no UTF-8": lambda reply: b'{"version": "\xff"}',
    "half of it": lambda reply: json.dumps(reply).encode()[:200],
    "nothing": lambda reply: b"",
    "too deep": lambda reply: b"[" * 100000,
    "a number without end": lambda reply: b'{"version": ' + b"1" * 100000 + b"}",
    "an overflow": lambda reply: b'{"version": 1e999}',
    "too large": lambda reply: b" " * (1 << 24),
}


@pytest.mark.parametrize("spoil", SPOILED.values(), ids=SPOILED)
def test_a_reply_that_is_wrong_anywhere_is_refused_in_one_line_and_the_next_is_read(sidecar, connect, picture, spoil):
    remote = connect(sidecar)
    sidecar.spoil = spoil
    with pytest.raises(PerceptionError) as error:
        remote.segment(frame_of(picture))
    assert str(error.value).isprintable()  # one line, and nothing that moves a terminal
    assert len(str(error.value)) < 500
    sidecar.spoil = lambda reply: reply
    assert len(remote.segment(frame_of(picture)).masks) == 3


@pytest.mark.parametrize("seed", range(int(os.environ.get("CORE_SEED", 0)), int(os.environ.get("CORE_SEED", 0)) + 3))
def test_fuzz_a_mutated_reply_is_read_or_refused_and_never_breaks(picture, seed):
    rng = random.Random(seed)
    sidecar = FakeSidecar(COLORS)
    request = {**REQUEST, "image": encode_picture(picture, "png", 64), "classes": list(ASKED)}
    body = bytearray(json.dumps(sidecar.answer(request)).encode())
    outcomes = set()
    for _ in range(400):
        spoiled = bytearray(body)
        for _ in range(rng.randint(1, 4)):
            where = rng.randrange(len(spoiled))
            spoiled[where : where + rng.randint(0, 3)] = rng.choice(
                [b"", b"0", b"-1", b"9e9", b'"', b"]", b"null", b"{"]
            )
        try:
            value = read_json(bytes(spoiled))
            reply = read_reply(value, ASKED, 1_000_000_002, (48, 64), 0.5) if isinstance(value, dict) else None
        except (EvidenceError, ValueError):
            outcomes.add("refused")
            continue
        if reply is not None:
            outcomes.add("read")
            frame = frame_of(picture)
            check_segmentation(paint_instances(reply.instances, (48, 64), reply.classes_evaluated, frame, str.isdigit))
    assert outcomes == {"refused", "read"}


@pytest.mark.parametrize(
    "key, value",
    [
        ("tasks", ["depth"]),
        ("tasks", None),
        ("classes", []),
        ("classes", "floor"),
        ("classes", [3]),
        ("classes", ["9lives"]),
        ("max_classes", 0),
        ("max_classes", True),
        ("max_classes", "7"),
        ("model", ""),
        ("random_weights", 1),
        ("version", 0),
    ],
)
def test_capabilities_that_are_wrong_are_refused_before_an_image_is_sent(sidecar, connect, picture, key, value):
    sidecar.capabilities[key] = value
    with pytest.raises(PerceptionError, match="tasks|classes|max_classes|model|random_weights|version"):
        connect(sidecar).segment(frame_of(picture))
    assert sidecar.requests == []


def test_random_weights_are_told(sidecar, connect, picture):
    remote = connect(sidecar)
    remote.segment(frame_of(picture))
    assert remote.warning == ""
    sidecar.capabilities["random_weights"] = True
    remote = connect(sidecar)
    remote.segment(frame_of(picture))
    assert "random weights" in remote.warning


@pytest.mark.parametrize(
    "status, cause", [(400, "http_4xx"), (403, "denied"), (302, "redirect"), (500, "http_5xx"), (503, "overloaded")]
)
def test_the_cause_of_a_failure_is_told_with_the_words_of_the_server(sidecar, connect, picture, status, cause):
    sidecar.status = status
    sidecar.spoil = lambda _: {"version": 1, "error": {"code": "busy", "message": "one at\na time"}}
    with pytest.raises(ServerError, match="one at a time") as error:
        connect(sidecar).segment(frame_of(picture))
    assert error.value.cause == cause


def test_the_deadline_holds_and_the_next_frame_is_answered(sidecar, connect, picture):
    remote = connect(sidecar, deadline_s=0.3)
    sidecar.delay_s = 1.0
    begun_s = time.monotonic()
    with pytest.raises(ServerError) as error:
        remote.segment(frame_of(picture))
    assert error.value.cause == "timeout"
    assert time.monotonic() - begun_s < 0.8
    sidecar.delay_s = 0.0
    assert len(remote.segment(frame_of(picture)).masks) == 3


def test_after_a_failure_the_side_car_is_left_alone_for_a_moment(connect, picture):
    with FakeSidecar(COLORS) as sidecar:
        remote = connect(sidecar, back_off=BackOff("robot", first_s=30.0, longest_s=60.0))
        sidecar.status = 500
        with pytest.raises(ServerError):
            remote.segment(frame_of(picture))
        with pytest.raises(ServerError) as error:
            remote.segment(frame_of(picture))
    assert error.value.cause == "paused"
    assert len(sidecar.requests) == 1


def test_nobody_there_is_told(connect, picture):
    with FakeSidecar(COLORS) as sidecar:
        pass
    with pytest.raises(ServerError) as error:
        connect(sidecar).segment(frame_of(picture))
    assert error.value.cause == "refused"


def test_after_a_failure_the_side_car_is_asked_anew_what_it_can(sidecar, connect, picture):
    remote = connect(sidecar)
    assert len(remote.segment(frame_of(picture)).masks) == 3
    sidecar.capabilities["classes"] = ["wall"]  # another model comes up there
    sidecar.status = 500
    with pytest.raises(ServerError):
        remote.segment(frame_of(picture))
    sidecar.status = 200
    assert remote.segment(frame_of(picture)).classes_evaluated == ("wall",)


def test_a_client_has_one_request_in_flight(sidecar):
    client = SidecarClient(find_endpoint(sidecar.url, "", False), 5.0)
    sidecar.delay_s = 0.5
    thread = threading.Thread(target=lambda: client.call("/v1/segment", REQUEST))
    thread.start()
    end = time.monotonic() + 5.0
    while not sidecar.in_flight and time.monotonic() < end:
        time.sleep(0.005)
    with pytest.raises(ServerError) as error:
        client.call("/v1/capabilities")
    thread.join()
    assert error.value.cause == "busy"
    assert client.call("/v1/capabilities")["model"] == "fake"


def test_closing_ends_a_request_under_way(sidecar, connect, picture):
    remote = connect(sidecar, deadline_s=20.0)
    sidecar.delay_s = 3.0
    threading.Timer(0.3, remote.close).start()
    begun_s = time.monotonic()
    with pytest.raises(ServerError) as error:
        remote.segment(frame_of(picture))
    assert error.value.cause == "closed"
    assert time.monotonic() - begun_s < 2.5


def test_a_closed_segmenter_answers_no_more(sidecar, connect, picture):
    remote = connect(sidecar)
    remote.close()
    with pytest.raises(ServerError) as error:
        remote.segment(frame_of(picture))
    assert (error.value.cause, sidecar.requests) == ("closed", [])


@pytest.mark.parametrize("allowed, remote_images", [("", False), ("", True), ("gpu.local:8092", False)])
def test_images_leave_the_machine_only_to_an_allowed_host_and_if_allowed_at_all(tmp_path, allowed, remote_images):
    hosts = tmp_path / "hosts"
    hosts.write_text(allowed)
    with pytest.raises(EndpointError):
        find_endpoint("https://gpu.local:8092", str(hosts), remote_images)
    hosts.write_text("gpu.local:8092")
    assert find_endpoint("https://gpu.local:8092", str(hosts), True).host == "gpu.local"


@pytest.mark.parametrize(
    "image", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3), float), np.zeros((0, 4, 3), np.uint8)]
)
def test_an_image_of_another_kind_is_not_sent(sidecar, connect, image):
    with pytest.raises(EvidenceError):
        connect(sidecar).segment(frame_of(image))
    assert sidecar.requests == []


def box(rows, columns):
    mask = np.zeros((6, 8), bool)
    mask[rows, columns] = True
    return encode_mask(mask)


def paint(*instances, unsafe=()):
    frame = SegmenterFrame(0, ("floor", "puddle", "box"), frozenset(unsafe), frozenset(unsafe))
    instances = [Instance(name, score, runs) for name, score, runs in instances]
    painted = paint_instances(instances, (6, 8), frame.classes, frame, lambda name: name in ("floor", "puddle"))
    check_segmentation(painted)
    return painted


def test_what_a_rule_calls_unsafe_lies_on_top_then_objects_then_the_higher_score():
    everything, left = box(slice(None), slice(None)), box(slice(None), slice(0, 4))
    assert paint(("box", 0.5, left), ("floor", 0.9, everything)).labels[0, 0] == 1
    assert paint(("puddle", 0.5, left), ("box", 0.9, everything), unsafe=["puddle"]).labels[0, 0] == 1
    assert paint(("floor", 0.9, everything), ("puddle", 0.5, left)).labels[0, 0] == 1
    assert paint(("floor", 0.4, everything), ("puddle", 0.5, left)).labels[0, 0] == 2


def test_a_class_of_which_an_instance_is_covered_counts_as_not_evaluated():
    everything, left, right = box(slice(None), slice(None)), box(0, slice(0, 4)), box(1, slice(4, 8))
    painted = paint(("floor", 0.9, everything), ("box", 0.5, left), ("puddle", 0.1, left), ("puddle", 0.95, right))
    assert painted.classes_evaluated == ("floor", "box")
    assert [mask.class_name for mask in painted.masks] == ["floor", "box", "puddle"]


def test_run_lengths_are_a_round_trip_of_any_mask_and_read_row_by_row():
    assert encode_mask(np.array([[0, 1, 1], [0, 1, 1]], bool)) == [1, 2, 1, 2]
    assert encode_mask(np.array([[1, 1, 1], [0, 0, 0]], bool)) == [0, 3, 3]
    rng = np.random.default_rng(int(os.environ.get("CORE_SEED", 0)))
    for _ in range(200):
        size_px = tuple(rng.integers(1, 30, 2))
        mask = rng.random(size_px) < rng.random()
        counts = encode_mask(mask)
        assert json.loads(json.dumps(counts)) == counts
        size_px = tuple(map(int, size_px))
        assert (decode_mask(read_runs(counts, size_px), size_px) == mask).all()
