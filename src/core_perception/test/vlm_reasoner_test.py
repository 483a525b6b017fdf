# SPDX-License-Identifier: BSD-3-Clause
"""The reasoner in front of a model server: what becomes of good, malformed and missing replies, and the confidence."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from core_perception.exceptions import ServerError
from core_perception.ontology import Ontology
from core_perception.predicates import parse_predicate
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.base import Evidence
from core_perception.reasoners.vlm_reasoner import Sampling, VlmReasoner, agreement
from core_perception.reasoners.wire import ModelReply

CONFIG = Path(__file__).resolve().parent.parent / "config"
ONTOLOGY = Ontology.load(CONFIG / "ontology.yaml")
IMAGE = np.full((4, 6, 3), 128, np.uint8)


def reply(unsafe=(), safe=(), classes=(), logic="why", **options):
    fields = {
        "safety_logic": logic,
        "classes": list(classes),
        "unsafe_regions": list(unsafe),
        "safe_regions": list(safe),
    }
    return ModelReply(json.dumps(fields), latency_s=options.pop("latency_s", 0.5), **options)


class Client:
    """Gives prepared replies and keeps what it was asked."""

    def __init__(self, *replies):
        self.replies, self.asked = list(replies), []

    def ask(self, system, user, image_rgb, schema, seed=None, temperature=None):
        self.asked.append((system, user, image_rgb, schema, seed, temperature))
        answer = self.replies.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self):
        pass


class BackOff:
    def __init__(self):
        self.failures = 0

    def failed(self):
        self.failures += 1
        return 0.25 * self.failures

    def succeeded(self):
        self.failures = 0


def make(client, back_off=None, template=None, **options):
    template = template or PromptTemplate.load(CONFIG / "prompt.yaml")
    return VlmReasoner("ollama", client, template, ONTOLOGY, back_off=back_off, **options)


def test_a_reply_becomes_constraints_with_names_of_the_ontology_and_the_latency_of_the_client():
    client = Client(reply(["NEAR(cone)", "AROUND(Wet Floor Sign)"], ["ON(floor)"], ["cone", "floor"]))
    evidence = Evidence(7, image=IMAGE, guidelines=("Stay off the stairs.",))
    answer = make(client, sampling=Sampling(seed=3)).reason(evidence)
    expected = ["NEAR(traffic_cone)=unsafe", "AROUND(wet_floor_sign)=unsafe", "ON(floor)=safe"]
    assert set(answer.constraints.predicates) == {parse_predicate(text) for text in expected}
    assert answer.constraints.source == "ollama"
    assert answer.constraints.justification == "why"
    assert answer.constraints.image_stamp_ns == 7
    assert answer.latency_ns == 500_000_000
    assert math.isnan(answer.constraints.confidence)
    system, _user, image, schema, seed, _temperature = client.asked[0]
    assert "Stay off the stairs." in system
    assert image is IMAGE
    assert list(schema["properties"])[0] == "safety_logic"
    assert seed == 3


def test_a_class_nobody_knows_makes_nothing_safe_and_still_counts_as_unsafe():
    client = Client(reply(["NEAR(flumox)", "ON(glimmer)"], ["ON(quagfield)", "ON(floor)"]))
    stated = {str(p) for p in make(client).reason(Evidence(1, image=IMAGE)).constraints.predicates}
    assert stated == {"NEAR(flumox)=unsafe", "ON(glimmer)=unsafe", "ON(floor)=safe"}


def test_a_malformed_reply_is_void_and_brings_no_pause():
    back_off = BackOff()
    answer = make(Client(ModelReply("I cannot help with that.", latency_s=2.0)), back_off).reason(
        Evidence(1, image=IMAGE)
    )
    assert answer.constraints is None
    assert answer.void_cause == "not_json"
    assert answer.latency_ns == 2_000_000_000
    assert answer.retry_after_ns == 0


def test_a_reply_that_names_no_region_is_void():
    answer = make(Client(reply(logic="the " * 150))).reason(Evidence(1, image=IMAGE))
    assert (answer.constraints, answer.void_cause) == (None, "says_nothing")


def test_failures_of_the_server_are_void_and_the_pauses_grow_until_one_succeeds():
    back_off = BackOff()
    client = Client(
        ServerError("timeout", "no reply", 3.0),
        ServerError("refused", "nobody"),
        reply(["NEAR(cone)"]),
        ServerError("refused", "x"),
    )
    answers = [make(client, back_off).reason(Evidence(k, image=IMAGE)) for k in range(4)]
    assert [a.void_cause for a in answers] == ["timeout", "refused", "", "refused"]
    assert [a.retry_after_ns for a in answers] == [250_000_000, 500_000_000, 0, 250_000_000]
    assert answers[0].latency_ns == 3_000_000_000


def test_ablation_without_reasoning_asks_for_no_justification():
    client = Client(ModelReply('{"classes": [], "unsafe_regions": ["NEAR(cone)"], "safe_regions": []}'))
    template = PromptTemplate.load(CONFIG / "prompt.yaml", chain_of_thought=False)
    answer = make(client, template=template).reason(Evidence(1, image=IMAGE))
    assert answer.constraints is not None
    assert "safety_logic" not in client.asked[0][3]["properties"]


def test_confidence_by_samples_is_the_agreement_of_further_answers():
    client = Client(
        reply(["NEAR(cone)", "AROUND(person)"]),
        reply(["NEAR(cone)", "AROUND(person)"]),
        reply(["NEAR(cone)"]),
        ModelReply("garbage", latency_s=0.5),
        ServerError("timeout", "late", 0.5),
    )
    answer = make(client, sampling=Sampling("samples", 5, 10)).reason(Evidence(1, image=IMAGE))
    assert answer.constraints.confidence == pytest.approx((1.0 + 0.5 + 0.0 + 0.0) / 4)
    assert [asked[4] for asked in client.asked] == [10, 11, 12, 13, 14]
    assert [asked[5] is None for asked in client.asked] == [True, False, False, False, False]
    assert answer.latency_ns == 2_500_000_000


def test_confidence_by_log_probabilities_is_their_geometric_mean_and_unknown_without_them():
    logprobs = (math.log(0.5), math.log(0.125))
    client = Client(reply(["NEAR(cone)"], token_logprobs=logprobs), reply(["NEAR(cone)"]))
    reasoner = make(client, sampling=Sampling("logprobs"))
    assert reasoner.reason(Evidence(1, image=IMAGE)).constraints.confidence == pytest.approx(0.25)
    assert math.isnan(reasoner.reason(Evidence(2, image=IMAGE)).constraints.confidence)


def test_agreement_of_empty_answers_is_complete():
    assert agreement(frozenset(), [frozenset(), None]) == 0.5
