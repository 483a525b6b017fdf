#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The segmenter node with each back end. Runs under rostest (segmenter_node.test), or alone with its own master."""

import itertools
import sys
import time

import numpy as np
import pytest
import rosgraph
import rospy
from core_msgs.msg import LabelClass, LabelInfo, Predicate, SafetyConstraints
from diagnostic_msgs.msg import DiagnosticArray
from fake_chain import (
    CONE_CLASSES,
    Collector,
    FakeChain,
    cone_labels,
    joined_graph,
    run_as_script,
    start_node,
    stop_node,
    wait_for,
)
from fakes.fake_sidecar import FakeSidecar
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from core_perception.ros.conversions import array_to_image, image_to_array, ns_to_stamp

START_NS, PERIOD_NS = 1_000_000_000, 100_000_000
COLORS = {"floor": (90, 90, 90), "traffic_cone": (230, 110, 20)}
_namespaces = (f"segmenter_{k}" for k in itertools.count())


@pytest.fixture(scope="module", autouse=True)
def master():
    with joined_graph("segmenter_node_rostest"):
        yield


class Camera:
    """Inputs and outputs of one segmenter, in a namespace of its own."""

    def __init__(self):
        self.namespace = next(_namespaces)
        self.chain = FakeChain(self.namespace, CONE_CLASSES, cone_labels())
        topics = {
            "camera/color/image_raw": Image,
            "external_segmentation/labels": Image,
            "external_segmentation/label_info": LabelInfo,
            "safety/constraints": SafetyConstraints,
        }
        self.publishers = {
            topic: rospy.Publisher(f"/{self.namespace}/{topic}", kind, queue_size=20, latch=True)
            for topic, kind in topics.items()
        }
        self.diagnostics = Collector(f"/{self.namespace}/diagnostics", DiagnosticArray)
        self.processes = []

    def start(self, **params):
        self.processes.append(start_node("segmenter", self.namespace, **params))
        return self.processes[-1]

    def send(self, topic, message):
        self.publishers[topic].publish(message)

    def send_image(self, stamp_ns, pixels):
        self.send("camera/color/image_raw", array_to_image(pixels, "rgb8", Header(stamp=ns_to_stamp(stamp_ns))))

    def send_rules(self, stamp_ns, *classes):
        rules = [Predicate(class_name=name, spatial_operator=Predicate.NEAR, verdict=1) for name in classes]
        self.send("safety/constraints", SafetyConstraints(header=Header(stamp=ns_to_stamp(stamp_ns)), predicates=rules))

    def answer(self, stamp_ns):
        """Wait for the answer to a frame: class -> mask, and the label info."""
        labels = image_to_array(self.chain.labels.wait_at(stamp_ns, "labels"))
        info = self.chain.label_info.wait_at(stamp_ns, "label_info")
        return {entry.class_name: labels == entry.id for entry in info.labels}, info

    def send_until(self, send, condition, what):
        """Send frames, stamped now, until a condition holds."""

        def holds():
            send(rospy.Time.now().to_nsec())
            rospy.rostime.wallsleep(0.03)
            return condition()

        return wait_for(holds, what)

    def status(self):
        newest = self.diagnostics.messages[-1].status[0] if self.diagnostics.messages else None
        return newest and {"level": newest.level, "message": newest.message, **{v.key: v.value for v in newest.values}}

    def close(self):
        for process in self.processes:
            stop_node(process)
        for publisher in self.publishers.values():
            publisher.unregister()
        self.diagnostics.close()
        self.chain.close()


@pytest.fixture()
def camera():
    camera = Camera()
    yield camera
    camera.close()


@pytest.fixture()
def sidecar():
    with FakeSidecar(COLORS) as sidecar:
        yield sidecar


def picture(cone_column=10):
    pixels = np.empty((40, 60, 3), np.uint8)
    pixels[:] = COLORS["floor"]
    pixels[10:20, cone_column : cone_column + 8] = COLORS["traffic_cone"]
    return pixels


def test_remote_answers_every_frame_of_a_lockstep_world_with_the_classes_of_its_rules(camera, sidecar):
    camera.start(segmenter="remote", server_url=sidecar.url, image_format="png", lockstep=True)
    for k in range(3):
        stamp_ns = START_NS + k * PERIOD_NS
        camera.send_image(stamp_ns, picture(10 + k))
        camera.send_rules(stamp_ns, "floor", "dragon")
        found, info = camera.answer(stamp_ns)
        assert set(found) == set(COLORS)
        assert found["traffic_cone"].sum() == 80
        assert found["traffic_cone"][10:20, 10 + k : 18 + k].all()
        assert {"dragon", "forklift"} <= set(info.classes_evaluated)
        assert sidecar.requests[k]["classes"][:2] == ["floor", "dragon"]


def test_a_wrong_reply_publishes_nothing_is_told_and_the_next_good_one_is_published(camera, sidecar):
    sidecar.spoil = lambda reply: {**reply, "size": [60, 40]}
    camera.start(segmenter="remote", server_url=sidecar.url, image_format="png")

    def send(stamp_ns):
        camera.send_image(stamp_ns, picture())

    camera.send_until(send, lambda: camera.status() and "void_refused" in camera.status(), "a refusal")
    status = camera.status()
    assert status["level"] == 2
    assert "reply: size: got [60, 40], allowed [40, 60]" in status["message"]
    assert camera.chain.labels.messages == camera.chain.label_info.messages == []
    sidecar.spoil = lambda reply: reply
    camera.send_until(send, lambda: camera.chain.labels.messages, "labels")
    camera.send_until(send, lambda: camera.status()["level"] == 0, "all well")


def test_a_slow_side_car_has_one_request_in_flight_and_gets_the_newest_frame(camera, sidecar):
    sidecar.delay_s = 0.3
    camera.start(segmenter="remote", server_url=sidecar.url, image_format="png")
    sent = []

    def send(stamp_ns):
        sent.append(stamp_ns)
        camera.send_image(stamp_ns, picture())

    camera.send_until(send, lambda: len(camera.chain.labels.messages) >= 3, "three answers")
    stamps = [m.header.stamp.to_nsec() for m in camera.chain.labels.messages]
    assert stamps == sorted(stamps)
    positions = [sent.index(stamp) for stamp in stamps]
    assert min(np.diff(positions)) >= 4  # of ten frames that came meanwhile the last one was taken
    assert sidecar.most_in_flight == 1
    camera.send_until(send, lambda: int((camera.status() or {}).get("skipped", 0)) > 4, "skipped frames are counted")


def test_an_unsafe_class_that_was_not_looked_for_is_told_and_not_called_evaluated(camera, sidecar):
    sidecar.capabilities["classes"] = ["floor"]
    camera.start(segmenter="remote", server_url=sidecar.url, image_format="png", lockstep=True)
    camera.send_image(START_NS, picture())
    camera.send_rules(START_NS, "dragon")
    _, info = camera.answer(START_NS)
    assert info.classes_evaluated == ["floor"]
    status = wait_for(lambda: (camera.status() or {}).get("answers") and camera.status(), "diagnostics")
    assert (status["level"], "dragon" in status["message"]) == (1, True)


def test_a_recorded_run_is_repeated_bit_for_bit_without_the_side_car(camera, sidecar, tmp_path):
    recorder = camera.start(
        segmenter="remote", server_url=sidecar.url, image_format="png", lockstep=True, record_dir=str(tmp_path)
    )
    stamps = [START_NS + k * PERIOD_NS for k in range(3)]
    first = []
    for k, stamp_ns in enumerate(stamps):
        camera.send_image(stamp_ns, picture(10 + k))
        camera.send_rules(stamp_ns, "floor")
        camera.answer(stamp_ns)
        first.append((camera.chain.labels.at(stamp_ns), camera.chain.label_info.at(stamp_ns)))
    stop_node(recorder)
    again = Camera()
    try:
        again.start(segmenter="replay", replay_dir=str(tmp_path), lockstep=True)
        for k, stamp_ns in enumerate(stamps):
            again.send_image(stamp_ns, picture(10 + k))
            again.send_rules(stamp_ns)  # asked otherwise: it tells what was asked then
            again.answer(stamp_ns)
            labels, info = again.chain.labels.at(stamp_ns), again.chain.label_info.at(stamp_ns)
            assert (labels.data, labels.encoding, info.labels, info.classes_evaluated) == (
                first[k][0].data,
                first[k][0].encoding,
                first[k][1].labels,
                first[k][1].classes_evaluated,
            )
        again.send_image(stamps[-1] + PERIOD_NS, picture())
        again.send_rules(stamps[-1] + PERIOD_NS)
        wait_for(lambda: "void_not_recorded" in (again.status() or {}), "what was not recorded is told")
        assert len(again.chain.labels.messages) == 3
    finally:
        again.close()


def external(stamp_ns, entries, evaluated=(), labels=None, encoding="mono16"):
    header = Header(stamp=ns_to_stamp(stamp_ns), frame_id="camera_color_optical_frame")
    labels = cone_labels() if labels is None else labels
    info = LabelInfo(header, [LabelClass(label, name, 0.75) for label, name in entries], list(evaluated))
    return array_to_image(labels, encoding, header), info


def test_label_images_of_another_node_are_joined_by_stamp_checked_and_named_as_asked(camera):
    camera.start(segmenter="topic", lockstep=True)
    entries = [(k, "pylon" if k >= 30 else name) for k, name in CONE_CLASSES.items()]
    for k, wrong in enumerate((False, True, False)):
        stamp_ns = START_NS + k * PERIOD_NS
        image, info = external(stamp_ns, entries[:-1] if wrong else entries, ["person"])
        camera.send("external_segmentation/label_info", info)
        camera.send_rules(stamp_ns, "traffic_cone")
        camera.send("external_segmentation/labels", image)
        if wrong:
            wait_for(lambda: "void_refused" in (camera.status() or {}), "a refusal")
            continue
        found, out = camera.answer(stamp_ns)
        assert set(found) == {"floor", "wall", "traffic_cone"}
        assert [entry.score for entry in out.labels] == [0.75] * 7
        assert set(out.classes_evaluated) == {"floor", "wall", "traffic_cone", "person"}
        assert (image_to_array(camera.chain.labels.at(stamp_ns)) == cone_labels()).all()
    assert [m.header.stamp.to_nsec() for m in camera.chain.labels.messages] == [START_NS, START_NS + 2 * PERIOD_NS]


@pytest.mark.parametrize("wrong", [(0, "floor"), (77, "9lives"), (77, "")])
def test_a_label_info_that_is_none_is_refused(camera, wrong):
    camera.start(segmenter="topic", lockstep=True)
    image, info = external(START_NS, [*CONE_CLASSES.items(), wrong])
    camera.send("external_segmentation/label_info", info)
    camera.send_rules(START_NS)
    camera.send("external_segmentation/labels", image)
    wait_for(lambda: "void_refused" in (camera.status() or {}), "a refusal")
    assert camera.chain.labels.messages == []


def test_labels_that_never_meet_their_meaning_are_told(camera):
    camera.start(segmenter="topic")
    wait_for(lambda: "no label_info and no labels came" in (camera.status() or {}).get("message", ""), "both missing")
    topic = f"/{camera.namespace}/external_segmentation/labels"
    assert topic in camera.status()["message"]
    for k in range(3):
        image, _ = external(START_NS + k * PERIOD_NS, [])
        _, info = external(START_NS + k * PERIOD_NS + 1000, [(1, "floor")])
        camera.send("external_segmentation/labels", image)
        camera.send("external_segmentation/label_info", info)
    wait_for(lambda: "come, but not with one stamp" in camera.status()["message"], "different stamps are told")


def test_images_of_class_ids_need_no_label_info(camera):
    camera.start(segmenter="topic", lockstep=True, class_map=["0=floor", "11=traffic_cone", "255=none"])
    values = np.zeros((40, 60), np.uint8)
    values[20:26, 5:9] = values[20:26, 30:34] = 11
    image, _ = external(START_NS, [], labels=values, encoding="mono8")
    camera.send("external_segmentation/labels", image)
    camera.send_rules(START_NS)
    _, info = camera.answer(START_NS)
    assert sorted(entry.class_name for entry in info.labels) == ["floor", "traffic_cone", "traffic_cone"]


def test_an_alias_of_the_world_is_found_by_a_rule_about_it(camera):
    camera.start(lockstep=True)
    header = Header(stamp=ns_to_stamp(START_NS))
    entries = [LabelClass(k, name, 1.0) for k, name in CONE_CLASSES.items()]
    aliases = [LabelClass(2, "mural", 1.0), LabelClass(2, "painted_wall", 1.0)]
    camera.chain.publishers["ground_truth/label_info"].publish(LabelInfo(header, entries + aliases, []))
    camera.chain.publishers["ground_truth/labels"].publish(array_to_image(cone_labels(), "mono16", header))
    camera.send_rules(START_NS, "Murals")
    found, _ = camera.answer(START_NS)
    assert (found["murals"] == (cone_labels() == 2)).all()


def test_an_answer_with_a_latency_carries_the_stamp_of_its_image_and_comes_later_in_sim_time(camera):
    clock = rospy.Publisher("/clock", Clock, queue_size=50, latch=True)
    rospy.set_param("/use_sim_time", True)
    try:
        camera.start(latency_s=0.5)
        came_ns = {}
        now_ns = START_NS
        end = time.monotonic() + 30.0
        while len(came_ns) < 3 and time.monotonic() < end:
            now_ns += 20_000_000
            clock.publish(Clock(ns_to_stamp(now_ns)))
            if now_ns % PERIOD_NS == 0:
                camera.chain.publish_frame(now_ns)
            rospy.rostime.wallsleep(0.02)
            for message in camera.chain.labels.messages:
                came_ns.setdefault(message.header.stamp.to_nsec(), now_ns)
    finally:
        rospy.delete_param("/use_sim_time")
        clock.unregister()
    delays_s = [(came - stamp) * 1e-9 for stamp, came in came_ns.items()]
    assert len(delays_s) == 3
    assert all(0.5 <= delay_s < 0.75 for delay_s in delays_s)
    stamps = sorted(came_ns)
    assert min(np.diff(stamps)) >= 0.4e9  # one frame at a time


def subscriptions_of(node):
    """Topics that a node is subscribed to, as the master has it."""
    _, subscribers, _ = rosgraph.Master("/segmenter_node_rostest").getSystemState()
    return {topic for topic, nodes in subscribers if node in nodes}


def test_no_back_end_but_the_simulated_one_is_connected_to_ground_truth(camera, sidecar, tmp_path):
    line = b'{"format_version": 1, "stamp_ns": 1, "image_sha256": null, "source": "remote", "latency_s": 0.0, '
    (tmp_path / "segmentations.jsonl").write_bytes(line + b'"error_cause": "refused", "error_detail": ""}\n')
    settings = {
        "remote": {"server_url": sidecar.url},
        "replay": {"replay_dir": str(tmp_path)},
        "topic": {},
        "simulated": {},
    }
    for back_end, options in settings.items():
        process = camera.start(segmenter=back_end, **options)
        since = len(camera.diagnostics.messages)
        wait_for(lambda: len(camera.diagnostics.messages) > since, f"diagnostics of {back_end}")  # noqa: B023
        topics = subscriptions_of(f"/{camera.namespace}/segmenter")
        assert f"/{camera.namespace}/safety/constraints" in topics
        assert any("ground_truth" in topic for topic in topics) == (back_end == "simulated"), topics
        stop_node(process)
        rospy.delete_param(f"/{camera.namespace}/segmenter")


BAD_PARAMETERS = [
    ({"segmenter": "sam3"}, "segmenter: got 'sam3', allowed one of simulated, remote, topic, replay"),
    ({"lockstep": True, "latency_s": 0.5}, "latency_s: got 0.5, allowed 0 with lockstep"),
    ({"segmenter": "replay"}, "replay_dir: got '', allowed the path of a recording"),
    ({"segmenter": "replay", "replay_dir": "/nonexistent"}, "/nonexistent/segmentations.jsonl: cannot be read"),
    ({"segmenter": "remote", "server_url": "http://gpu.local:8092"}, "http://gpu.local:8092 is not on this machine"),
    ({"segmenter": "topic", "class_map": ["person"]}, "class_map: got ['person'], allowed a list such as"),
    ({"record_dir": "/proc/none"}, "/proc/none/segmentations.jsonl: cannot be written"),
]


@pytest.mark.parametrize("params, message", BAD_PARAMETERS)
def test_a_bad_parameter_ends_the_node_with_one_line_and_status_2(camera, params, message):
    process = camera.start(**params)
    _, stderr = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert len(stderr.splitlines()) == 1
    assert stderr.startswith(f"{camera.namespace}/segmenter: {message}")


if __name__ == "__main__":
    sys.exit(run_as_script(__file__, sys.argv[1:]))
