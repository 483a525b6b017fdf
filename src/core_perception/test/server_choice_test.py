# SPDX-License-Identifier: BSD-3-Clause
import time

import pytest
from fakes.fake_model_server import FakeModelServer

from core_perception.endpoint import Endpoint
from core_perception.reasoners.server_choice import choose_server

SEES, READS = {"capabilities": ("completion", "vision")}, {"capabilities": ("completion",)}
PASSED_ON = {**SEES, "remote_host": "https://models.example.org", "remote_model": "x"}


def choose(models, model="", allow_remote_images=False, fault=None, **options):
    with FakeModelServer(models=models) as server:
        if fault:
            server.set_fault(fault, scope="all", **options)
        return choose_server(Endpoint.parse(server.url, (), allow_remote_images), model)


@pytest.mark.parametrize(
    ("models", "model", "taken"),
    [
        ({"gemma3:27b": SEES}, "", "gemma3:27b"),
        ({"llama3": READS, "gemma3:4b": SEES, "gemma3:27b": SEES}, "", "gemma3:4b"),
        ({"gemma3:4b": SEES, "gemma3:27b": SEES}, "gemma3:27b", "gemma3:27b"),
        ({"gemma3:latest": SEES}, "gemma3", "gemma3:latest"),
        ({"gemma3:latest": SEES}, "Gemma3:latest", "gemma3:latest"),
        ({"big:cloud": SEES, "alias:1": PASSED_ON, "gemma3:4b": SEES}, "", "gemma3:4b"),
        ({"old:1": {"show_capabilities": ("vision",)}}, "", "old:1"),
    ],
)
def test_ollama_is_taken_where_it_has_a_model_that_sees(models, model, taken):
    choice = choose(models, model)
    assert (choice.reasoner, choice.model) == ("ollama", taken)
    assert taken in choice.reason


@pytest.mark.parametrize(
    ("models", "model", "reason"),
    [
        ({}, "", "does not have any model"),
        ({"gemma3:4b": SEES}, "gemma3:27b", "does not have model gemma3:27b"),
        ({"gemma3:4b": SEES}, "gemma3", "does not have model gemma3"),
        ({"llama3:8b": READS}, "", "llama3:8b reads no images"),
        ({"llama3:8b": READS, "gemma3:4b": SEES}, "llama3:8b", "llama3:8b reads no images"),
        ({"old:1": {}}, "", "does not say whether"),
        ({"old:1": {"show_capabilities": ("completion",)}}, "", "old:1 reads no images"),
        ({"alias:1": PASSED_ON}, "", "alias:1 runs on another machine"),
        ({"big:27b-cloud": SEES}, "big:27b-cloud", "runs on another machine"),
        ({"m%d:1" % k: READS for k in range(9)}, "", "and 6 more"),
        ({"m" * 300: SEES, "two\nlines": SEES, " ": SEES}, "", "does not have any model"),
    ],
)
def test_the_ontology_is_taken_otherwise_and_the_reason_is_told(models, model, reason):
    choice = choose(models, model)
    assert (choice.reasoner, choice.model) == ("ontology", "")
    assert reason in choice.reason
    assert "\n" not in choice.reason


def test_a_model_that_runs_elsewhere_is_taken_where_images_may_leave():
    assert choose({"alias:1": PASSED_ON}, allow_remote_images=True).model == "alias:1"


def test_without_a_server_the_ontology_is_taken_at_once():
    begun_s = time.monotonic()
    choice = choose_server(Endpoint.parse("http://127.0.0.1:9"))
    assert time.monotonic() - begun_s < 0.3
    assert choice.reasoner == "ontology"
    assert "no Ollama answers at http://127.0.0.1:9" in choice.reason


@pytest.mark.parametrize("fault", ["500", "garbage", "nothing", "close", "redirect", "overloaded"])
def test_a_server_that_is_no_ollama_is_not_taken(fault):
    choice = choose({"gemma3:27b": SEES}, fault=fault)
    assert choice.reasoner == "ontology"
    assert "no Ollama answers" in choice.reason


@pytest.mark.parametrize("fault", ["hang", "drip_headers"])
def test_the_decision_takes_two_seconds_at_most(fault):
    begun_s = time.monotonic()
    choice = choose({"gemma3:27b": SEES}, fault=fault, bytes_per_s=100)
    assert 2.0 <= time.monotonic() - begun_s < 2.3
    assert choice.reasoner == "ontology"


def test_questions_about_many_models_share_the_limit():
    with FakeModelServer(models={"old%d:1" % k: {} for k in range(40)}) as server:
        begun_s = time.monotonic()
        handler = server.RequestHandlerClass
        slow = type("Slow", (handler,), {"_show": lambda self, body: time.sleep(0.2) or handler._show(self, body)})
        server.RequestHandlerClass = slow
        choice = choose_server(Endpoint.parse(server.url), limit_s=1.0)
        assert time.monotonic() - begun_s < 1.3
        assert choice.reasoner == "ontology"
