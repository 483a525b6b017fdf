#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""safety_reasoner with a model server, with the operator's rules and with ``auto``. Runs under rostest, or alone."""

import itertools
import json
import sys

import numpy as np
import pytest
import rospy
from core_msgs.msg import LabelClass, LabelInfo, OperatorRule
from core_msgs.srv import AddRule, ListRules, RemoveRule
from diagnostic_msgs.msg import DiagnosticArray
from fake_chain import (
    CONE_CLASSES,
    CONE_LINE_M,
    Collector,
    FakeChain,
    cone_labels,
    free_port,
    joined_graph,
    run_as_script,
    start_node,
    stop_node,
    wait_for,
)
from fakes.fake_model_server import FakeModelServer
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from core_perception.ros.conversions import array_to_image, constraints_from_msg, ns_to_stamp

ANSWER = {
    "safety_logic": "A line of cones.",
    "classes": ["cone", "floor"],
    "unsafe_regions": ["NEAR(cone)", "BETWEEN(cone)"],
    "safe_regions": ["ON(floor)"],
}
_namespaces = (f"reasoner_{k}" for k in itertools.count())


@pytest.fixture(scope="module", autouse=True)
def master():
    with joined_graph("reasoner_node_rostest"):
        yield


class Robot:
    """A chain of its own with the reasoner in it; frames are published until a condition holds."""

    def __init__(self):
        self.namespace = next(_namespaces)
        self.chain = FakeChain(self.namespace, CONE_CLASSES, cone_labels())
        self.image = rospy.Publisher(f"/{self.namespace}/camera/color/image_raw", Image, queue_size=5)
        self.diagnostics = Collector(f"/{self.namespace}/diagnostics", DiagnosticArray)
        self.processes = []

    def start(self, name="safety_reasoner", **params):
        self.processes.append(start_node(name, self.namespace, **params))
        return self.processes[-1]

    def call(self, name, kind, *arguments):
        rospy.wait_for_service(f"/{self.namespace}/{name}", 20.0)
        return rospy.ServiceProxy(f"/{self.namespace}/{name}", kind)(*arguments)

    def publish_frame(self, pixels):
        stamp_ns = rospy.Time.now().to_nsec()
        self.image.publish(array_to_image(pixels, "rgb8", Header(stamp=ns_to_stamp(stamp_ns))))
        self.chain.publish_frame(stamp_ns)
        for info in self.chain.label_info.messages[-1:]:
            self.chain.publish_instances(info.header.stamp.to_nsec(), "traffic_cone", CONE_LINE_M)
        rospy.rostime.wallsleep(0.02)

    def wait_for(self, condition, what, pixels=None):
        pixels = np.full((40, 60, 3), 90, np.uint8) if pixels is None else pixels

        def holds():
            self.publish_frame(pixels)
            return condition()

        return wait_for(holds, what)

    def newest(self):
        return self.chain.constraints.messages[-1] if self.chain.constraints.messages else None

    def stated(self):
        newest = self.newest()
        return {str(p) for p in constraints_from_msg(newest).predicates} if newest else set()

    def status(self):
        all_told = [message.status[0] for message in self.diagnostics.messages]
        newest = next((told for told in reversed(all_told) if "contextual reasoning" in told.name), None)
        return newest and {"level": newest.level, "message": newest.message, **{v.key: v.value for v in newest.values}}

    def close(self):
        for process in self.processes:
            stop_node(process)
        self.chain.close()
        self.diagnostics.close()
        self.image.unregister()


@pytest.fixture()
def robot():
    robot = Robot()
    yield robot
    robot.close()


def test_what_a_model_says_of_the_image_is_stated_with_names_of_the_ontology(robot):
    with FakeModelServer(answer=lambda chat: json.dumps(ANSWER)) as server:
        robot.start("segmenter")
        robot.start(reasoner="ollama", model="gemma3:27b", server_url=server.url, rate_hz=50.0, embedded_rules=False)
        expected = {"NEAR(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=unsafe", "ON(floor)=safe"}
        robot.wait_for(lambda: robot.stated() == expected, "the answer of the model")
        newest = robot.newest()
        assert (newest.source, newest.justification) == ("ollama", "A line of cones.")
        assert list(newest.classes) == ["traffic_cone", "floor"]
        assert 0 < newest.image_stamp.to_nsec() < newest.header.stamp.to_nsec()
        # One answer that sees nothing clears nothing, malformed ones neither; both are told.
        replies = iter([json.dumps({**ANSWER, "unsafe_regions": []})])
        server.answer = lambda chat: next(replies, "There is nothing to worry about.")
        robot.wait_for(
            lambda: (robot.status() or {}).get("void_not_json", "0") >= "3", "malformed replies to be counted"
        )
        assert expected <= robot.stated()
        assert robot.status()["level"] == 1
        assert "not_json" in robot.status()["message"]


def test_a_model_that_never_sees_the_cones_does_not_open_their_line(robot):
    blind = {**ANSWER, "classes": ["floor"], "unsafe_regions": [], "safety_logic": "An empty hall."}
    with FakeModelServer(answer=lambda chat: json.dumps(blind)) as server:
        robot.start("segmenter")
        robot.start(reasoner="ollama", model="gemma3:27b", server_url=server.url, rate_hz=50.0)
        robot.wait_for(lambda: "BETWEEN(traffic_cone)=unsafe" in robot.stated(), "the embedded rules")
        robot.wait_for(lambda: len(server.chats()) > 10, "ten answers")
        assert {"BETWEEN(traffic_cone)=unsafe", "ON(floor)=safe"} <= robot.stated()
        assert robot.newest().source == "ollama+ontology"


def test_until_a_model_names_ground_the_statement_has_no_image_stamp_and_diagnostics_say_why(robot):
    with FakeModelServer(answer=lambda chat: json.dumps({**ANSWER, "safe_regions": []})) as server:
        robot.start("segmenter")
        robot.start(reasoner="ollama", model="gemma3:27b", server_url=server.url)
        robot.wait_for(lambda: "BETWEEN(traffic_cone)=unsafe" in robot.stated(), "the answer")
        why = "no answer has named safe ground yet: the robot does not move"
        robot.wait_for(lambda: (robot.status() or {}).get("message") == why, "the reason")
        assert robot.newest().image_stamp.to_nsec() == 0
        server.answer = lambda chat: json.dumps(ANSWER)
        robot.wait_for(lambda: robot.newest().image_stamp.to_nsec() > 0, "ground to stand on")


def test_a_sentence_of_the_operator_is_told_to_the_model(robot):
    told = []

    def answer(chat):
        told.append(chat.system)
        return json.dumps(ANSWER)

    with FakeModelServer(answer=answer) as server:
        robot.start("segmenter")
        robot.start(reasoner="ollama", model="gemma3:27b", server_url=server.url)
        robot.wait_for(lambda: told, "the first question")
        assert "waxed" not in told[-1]
        added = robot.call("add_rule", AddRule, "Stay off the waxed floor.", OperatorRule.GUIDELINE, rospy.Duration(0))
        assert added.success, added.message
        robot.wait_for(lambda: "Stay off the waxed floor." in told[-1], "the sentence in the prompt")
        assert robot.call("remove_rule", RemoveRule, added.id).success
        robot.wait_for(lambda: "waxed" not in told[-1], "the sentence to be left out")


def test_a_rule_of_the_operator_holds_at_once_and_after_a_restart_until_it_is_removed(robot, tmp_path):
    params = {"rate_hz": 50.0, "operator_rules_file": str(tmp_path / "rules.yaml")}
    robot.start("segmenter")
    first = robot.start(**params)
    robot.wait_for(lambda: "NEAR(traffic_cone)=unsafe" in robot.stated(), "the cones")
    added = robot.call("add_rule", AddRule, "AROUND(cone, 2.5)", OperatorRule.PREDICATE, rospy.Duration(3600))
    assert added.success, added.message
    robot.wait_for(lambda: "AROUND(traffic_cone, 2.5)=unsafe" in robot.stated(), "the rule")
    refused = robot.call("add_rule", AddRule, "AROUND(cone, -1)", OperatorRule.PREDICATE, rospy.Duration(0))
    assert not refused.success
    assert "radius" in refused.message
    refused = robot.call("add_rule", AddRule, "Be careful.", OperatorRule.GUIDELINE, rospy.Duration(0))
    assert not refused.success
    assert "reads no sentences" in refused.message
    first.kill()
    first.wait()
    count = len(robot.chain.constraints.messages)
    robot.start(**params)
    robot.wait_for(lambda: len(robot.chain.constraints.messages) > count + 5, "statements of the new process")
    robot.wait_for(lambda: "AROUND(traffic_cone, 2.5)=unsafe" in robot.stated(), "the rule after the restart")
    rules = robot.call("list_rules", ListRules).rules
    assert [(r.id, r.text) for r in rules] == [(added.id, "AROUND(traffic_cone, 2.5)=unsafe")]
    assert robot.call("remove_rule", RemoveRule, added.id).success
    assert not robot.call("remove_rule", RemoveRule, added.id).success
    robot.wait_for(lambda: "AROUND(traffic_cone, 2.5)=unsafe" not in robot.stated(), "the rule to go")


def test_a_damaged_file_of_rules_ends_the_node_with_one_line_and_status_2(robot, tmp_path):
    path = tmp_path / "rules.yaml"
    path.write_text("rules: [")
    process = robot.start(operator_rules_file=str(path))
    _, stderr = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert len(stderr.splitlines()) == 1
    assert str(path) in stderr


def test_reset_context_forgets_the_answers_and_keeps_the_rules(robot):
    with FakeModelServer(answer=lambda chat: json.dumps(ANSWER)) as server:
        robot.start("segmenter")
        robot.start(reasoner="ollama", model="gemma3:27b", server_url=server.url, rate_hz=50.0)
        robot.call("add_rule", AddRule, "NEAR(ladder)", OperatorRule.PREDICATE, rospy.Duration(0))
        robot.wait_for(lambda: "BETWEEN(traffic_cone)=unsafe" in robot.stated(), "the answer")
        server.set_fault("hang")
        assert robot.call("safety_reasoner/reset_context", Trigger).success
        wait_for(lambda: robot.stated() == {"NEAR(ladder)=unsafe"}, "the rule alone")
        assert robot.newest().image_stamp.to_nsec() == 0


def test_stamps_of_different_sensors_that_match_in_turns_forget_no_arrangement(robot):
    labels = rospy.Publisher(f"/{robot.namespace}/segmentation/label_info", LabelInfo, queue_size=5, latch=True)
    robot.start(rate_hz=50.0, slop_s=0.06)
    begun_ns = rospy.Time.now().to_nsec()

    def see(offset_ms):
        header = Header(stamp=ns_to_stamp(begun_ns + offset_ms * 10**6))
        labels.publish(LabelInfo(header, [LabelClass(1, "traffic_cone", 1.0)], []))

    def hold(offset_ms):
        robot.chain.publish_instances(begun_ns + offset_ms * 10**6, "traffic_cone", CONE_LINE_M)

    def stated_of(offset_ms):
        return lambda: robot.newest() and robot.newest().image_stamp.to_nsec() == begun_ns + offset_ms * 10**6

    hold(0)
    see(49)  # a frame of labels between the two was lost
    wait_for(stated_of(49), "the first statement")
    see(82)
    hold(33)
    wait_for(stated_of(82), "the second statement")
    labels.unregister()


def test_auto_takes_ollama_when_it_answers_and_says_so(robot):
    with FakeModelServer(answer=lambda chat: json.dumps(ANSWER)) as server:
        robot.start("segmenter")
        robot.start(reasoner="auto", server_url=server.url)
        robot.wait_for(lambda: robot.stated() and robot.newest().source == "ollama+ontology", "the answer of the model")
        status = robot.wait_for(robot.status, "diagnostics")
        assert "auto chose ollama" in status["reasoner"]
        assert "gemma3:27b" in status["reasoner"]


def test_auto_takes_the_ontology_when_nobody_answers_and_says_so(robot):
    robot.start("segmenter")
    robot.start(reasoner="auto", server_url=f"http://127.0.0.1:{free_port()}")
    robot.wait_for(lambda: "BETWEEN(traffic_cone)=unsafe" in robot.stated(), "the ontology's answer")
    assert robot.newest().source == "ontology"
    status = robot.wait_for(robot.status, "diagnostics")
    assert "auto chose ontology: no Ollama answers" in status["reasoner"]


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"reasoner": "ollama"}, "model: got ''"),
        ({"reasoner": "replay"}, "replay_dir: got ''"),
        ({"reasoner": "emulated"}, "predicates: got []"),
        ({"reasoner": "emulated", "predicates": ["NEAR(x)"], "emulated_row": "gpt"}, "emulated_row: got 'gpt'"),
        ({"reasoner": "ollama", "model": "m", "server_url": "http://192.0.2.1:11434"}, "not on this machine"),
        ({"reasoner": "openai", "server_url": "ftp://127.0.0.1"}, "http(s)://host"),
        ({"reasoner": "openai", "api_key_env": "CORE_NO_SUCH_KEY"}, "api_key_env: got 'CORE_NO_SUCH_KEY'"),
    ],
)
def test_a_bad_setting_of_a_server_ends_the_node_with_one_line_and_status_2(robot, params, message):
    process = robot.start(**params)
    _, stderr = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert len(stderr.splitlines()) == 1
    assert message in stderr


if __name__ == "__main__":
    sys.exit(run_as_script(__file__, sys.argv[1:]))
