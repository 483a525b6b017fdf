#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The Python nodes against fakes. Runs under rostest (python_nodes.test), or alone with a master of its own."""

import itertools
import sys

import numpy as np
import pytest
import rospy
from core_msgs.msg import Predicate
from fake_chain import (
    CONE_CLASSES,
    CONE_LINE_M,
    FakeCamera,
    FakeChain,
    cone_labels,
    joined_graph,
    run_as_script,
    start_node,
    stop_node,
    wait_for,
)

from core_perception.ros.conversions import constraints_from_msg, image_to_array

START_NS, PERIOD_NS = 1_000_000_000, 100_000_000
_namespaces = (f"test_{k}" for k in itertools.count())


@pytest.fixture(scope="module", autouse=True)
def master():
    with joined_graph("python_nodes_rostest"):
        yield


@pytest.fixture()
def chain():
    namespace = next(_namespaces)
    chain, processes = FakeChain(namespace, CONE_CLASSES, cone_labels()), []

    def start(name, **params):
        processes.append(start_node(name, namespace, **params))
        return processes[-1]

    chain.start, chain.namespace = start, namespace
    yield chain
    for process in processes:
        stop_node(process)
    chain.close()


def frame(k):
    return START_NS + k * PERIOD_NS


def statements(msg):
    return {str(p) for p in constraints_from_msg(msg).predicates}


def run_frame(chain, k, places_m=CONE_LINE_M):
    """One frame of a lock-step chain; the fake memory answers when the segmenter has."""
    chain.publish_frame(frame(k))
    chain.publish_tick(k, frame(k))
    constraints = chain.constraints.wait_at(frame(k), f"constraints of frame {k}")
    info = chain.label_info.wait_at(frame(k), f"label_info of frame {k}")
    chain.labels.wait_at(frame(k), f"labels of frame {k}")
    chain.publish_instances(frame(k), "traffic_cone", places_m)
    return constraints, info


def test_lockstep_chain_states_the_cone_line_one_frame_later(chain):
    chain.start("safety_reasoner", lockstep=True)
    chain.start("segmenter", lockstep=True)
    first, info = run_frame(chain, 0)
    assert (first.image_stamp.to_nsec(), first.predicates, first.source) == (0, [], "ontology")
    assert {label.class_name for label in info.labels} == {"floor", "wall", "traffic_cone"}
    assert len(info.labels) == 7
    assert "forklift" in info.classes_evaluated

    second, info = run_frame(chain, 1)
    assert second.image_stamp.to_nsec() == frame(0)
    assert second.latency.to_nsec() == PERIOD_NS
    assert statements(second) == {
        "ON(floor)=safe",
        "NEAR(wall)=unsafe",
        "NEAR(traffic_cone)=unsafe",
        "BETWEEN(traffic_cone)=unsafe",
    }
    assert "line" in second.justification
    labels = image_to_array(chain.labels.at(frame(1)))
    by_name = {label.id: label.class_name for label in info.labels}
    assert by_name[labels[22, 6]] == "traffic_cone"
    assert by_name[labels[35, 30]] == "floor"
    third, _ = run_frame(chain, 2)
    assert third.image_stamp.to_nsec() == frame(1)
    assert [m.header.stamp.to_nsec() for m in chain.constraints.messages] == [frame(0), frame(1), frame(2)]


def test_lockstep_statement_waits_for_the_evidence_of_its_frame(chain):
    chain.start("safety_reasoner", lockstep=True)
    chain.start("segmenter", lockstep=True)
    run_frame(chain, 0)
    chain.constraints.wait_at(frame(0), "constraints")
    run_frame(chain, 1)
    # The evidence of frame 1 is complete; that of frame 2 is held back until the tick of frame 3 is out.
    chain.publish_frame(frame(2))
    chain.publish_tick(2, frame(2))
    chain.label_info.wait_at(frame(2), "label_info of frame 2")
    chain.publish_frame(frame(3))
    chain.publish_tick(3, frame(3))
    chain.publish_instances(frame(2), "traffic_cone", CONE_LINE_M[:1])
    fourth = chain.constraints.wait_at(frame(3), "constraints of frame 3")
    assert fourth.image_stamp.to_nsec() == frame(2)


def test_reset_of_the_world_forgets_the_arrangement(chain):
    chain.start("safety_reasoner", lockstep=True)
    chain.start("segmenter", lockstep=True)
    for k in (5, 6, 7):
        last, _ = run_frame(chain, k)
    assert "BETWEEN(traffic_cone)=unsafe" in statements(last)
    again, info = run_frame(chain, 0, CONE_LINE_M[:2])
    assert again.predicates == []
    assert again.image_stamp.to_nsec() == 0
    assert info.header.stamp.to_nsec() == frame(0)
    after, _ = run_frame(chain, 1)
    assert "NEAR(traffic_cone)=unsafe" in statements(after)
    assert "BETWEEN(traffic_cone)=unsafe" not in statements(after)


def test_without_lockstep_constraints_come_at_the_rate_with_new_stamps(chain):
    chain.start("safety_reasoner", rate_hz=50.0)
    chain.start("segmenter")
    early = wait_for(lambda: chain.constraints.messages[-1:], "a statement before any evidence")[0]
    assert (early.image_stamp.to_nsec(), early.predicates) == (0, [])

    def stated():  # frame after frame, as camera and memory give them
        chain.publish_frame(rospy.Time.now().to_nsec())
        for info in chain.label_info.messages[-1:]:
            chain.publish_instances(info.header.stamp.to_nsec(), "traffic_cone", CONE_LINE_M)
        return [m for m in chain.constraints.messages if m.predicates]

    first = wait_for(stated, "a statement about the cones")[0]
    assert first.image_stamp in [info.header.stamp for info in chain.label_info.messages]
    assert "BETWEEN(traffic_cone)=unsafe" in statements(first)
    count = len(chain.constraints.messages)
    wait_for(lambda: len(chain.constraints.messages) >= count + 5, "five statements without a new frame")
    stamps = [m.header.stamp.to_nsec() for m in chain.constraints.messages]
    assert stamps == sorted(set(stamps))
    last_two = chain.constraints.messages[-2:]
    assert last_two[0].image_stamp == last_two[1].image_stamp
    assert last_two[0].predicates == last_two[1].predicates


@pytest.mark.parametrize("reasoner", ["oracle", "static"])
def test_fixed_rules_hold_from_every_frame_on_without_evidence(chain, reasoner):
    params = {"predicates": ["ON(floor)=safe", "AROUND(unicorn, 1.25)"]} if reasoner == "oracle" else {}
    chain.start("safety_reasoner", lockstep=True, reasoner=reasoner, **params)
    chain.start("segmenter", lockstep=True)
    for k in range(3):
        constraints, info = run_frame(chain, k)
        assert constraints.image_stamp.to_nsec() == frame(k)
        assert constraints.source == reasoner
        assert "ON(floor)=safe" in statements(constraints)
    if reasoner == "oracle":
        assert statements(constraints) == {"ON(floor)=safe", "AROUND(unicorn, 1.25)=unsafe"}
        assert constraints.predicates[1].spatial_operator == Predicate.AROUND
        assert "unicorn" in info.classes_evaluated


BAD_PARAMETERS = [
    ("safety_reasoner", {"rate_hz": -1}, "safety_reasoner: rate_hz: got -1, allowed a number"),
    ("safety_reasoner", {"reasoner": "oracle"}, "safety_reasoner: predicates: got [], allowed at least one"),
    ("safety_reasoner", {"ontology_file": "/nonexistent.yaml"}, "safety_reasoner: /nonexistent.yaml: cannot be read"),
    ("segmenter", {"mis_rate": 0.1}, "segmenter: mis_rate: got 0.1, allowed only"),
    ("safety_overlay", {"scale": 0}, "safety_overlay: scale: got 0, allowed a whole number"),
]


@pytest.mark.parametrize("name, params, message", BAD_PARAMETERS)
def test_bad_parameter_ends_the_node_with_one_line_and_status_2(chain, name, params, message):
    process = chain.start(name, **params)
    _, stderr = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert len(stderr.splitlines()) == 1
    assert stderr.startswith(f"{chain.namespace}/{message}")
    assert chain.constraints.messages == []


def test_overlay_tints_safe_ground_green_and_obstacles_red(chain):
    camera = FakeCamera(chain.namespace)
    chain.start("safety_overlay", scale=1, rate_hz=100.0, floor_z_m=camera.floor_z_m)
    picture = image_to_array(camera.publish_until_drawn(rospy.Time.now()))
    assert picture.shape == (camera.height_px, camera.width_px, 3)
    red, green, _ = np.moveaxis(picture.astype(int), 2, 0)
    assert (green > red + 20)[-10:].all()  # the ground ahead, safe in the grid
    assert (red > green + 20)[camera.box_rows, camera.box_columns].mean() > 0.95
    camera.close()


if __name__ == "__main__":
    sys.exit(run_as_script(__file__, sys.argv[1:]))
