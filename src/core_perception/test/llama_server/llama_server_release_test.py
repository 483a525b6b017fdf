# SPDX-License-Identifier: BSD-3-Clause
"""A real llama-server, a model whose answer depends on the pixels, our client and our reader of replies, end to end.

Run it by CORE_RELEASE_TESTS=1 ./core.sh run python -m pytest -s src/core_perception/test/llama_server
"""

import json
import os
import random
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from llama_server.real_server import LlamaServer, ensure_server, write_model

from core_perception.endpoint import Endpoint
from core_perception.exceptions import ReplyError, ServerError
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.vlm_client import VlmClient
from core_perception.reasoners.wire import OpenAiWire
from core_perception.reply_parser import parse_reply, reply_schema

FRAMES = 200
PATIENCE_S = 60.0  # where the answer counts, not the time: other programs may use the machine
DEADLINE_SLACK_S = 0.3
SAID = json.loads(Path(__file__).with_name("tiny_replies.json").read_text())
COLOURS_RGB = {"red": (200, 40, 40), "green": (60, 180, 70), "blue": (40, 60, 190), "grey": (120, 120, 120)}
FINITE = ("red", "green", "grey")
SEED = int(os.environ.get("CORE_SEED", "0"))


@pytest.fixture(scope="module")
def home():
    return ensure_server()


@pytest.fixture(scope="module")
def models(home, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    write_model(home, folder)
    return folder


@pytest.fixture(scope="module")
def server(home, models):
    with LlamaServer(home, models) as running:
        yield running


@pytest.fixture(scope="module")
def prompt(config_dir):
    return PromptTemplate.load(config_dir / "prompt.yaml").compose(["Keep off the grass."])


class Asker:
    """Puts the shipped prompt and schema to one server."""

    def __init__(self, server, prompt, deadline_s=PATIENCE_S, **wire):
        endpoint = Endpoint.parse(server.url, (), False)
        self.client = VlmClient(OpenAiWire("tiny", **wire), endpoint, deadline_s, 30.0)
        self._prompt = prompt

    def ask(self, image, schema=None, seed=None, temperature=None):
        schema = reply_schema() if schema is None else schema or None
        return self.client.ask(self._prompt.system, self._prompt.user, image, schema, seed, temperature)


def picture(colour, noise=None, height=240, width=320):
    """An image of one mean colour, uint8 (height, width, 3), with noise of +-30 if a generator is given."""
    image = np.full((height, width, 3), COLOURS_RGB[colour], np.int16)
    if noise is not None:
        image += noise.integers(-30, 31, image.shape, dtype=np.int16)
    return image.clip(0, 255).astype(np.uint8)


def wired_reply(key):
    """What the model is wired to say about a colour, through the same reader."""
    return parse_reply(json.dumps(SAID["replies"][key]))


def cause_of(ask, *arguments, **options):
    """Cause of the failure of a call, and how long it took [s]."""
    begun_s = time.monotonic()
    with pytest.raises(ServerError) as failure:
        ask(*arguments, **options)
    return failure.value.cause, time.monotonic() - begun_s


@pytest.mark.parametrize("colour", FINITE)
def test_the_answer_is_the_one_wired_to_the_colour_of_the_picture(server, prompt, colour):
    reply = Asker(server, prompt).ask(picture(colour))
    assert json.loads(reply.text) == SAID["replies"][colour]
    assert reply.finish == "stop"
    assert parse_reply(reply.text, reply.thinking) == wired_reply(colour)


def test_red_and_blue_are_not_exchanged_on_the_way_and_every_part_of_the_picture_counts(server, prompt):
    asker = Asker(server, prompt, max_tokens=400)
    half = picture("grey")
    half[:, 160:] = picture("red")[:, 160:]
    assert json.loads(asker.ask(half).text) == SAID["replies"]["red"]
    swapped = picture("red")[..., ::-1]
    assert json.loads(asker.ask(swapped).text)["safety_logic"].startswith("The light flickers")


def test_a_question_without_a_picture_is_answered_as_such(server, prompt):
    assert json.loads(Asker(server, prompt).ask(None).text) == SAID["replies"]["none"]


def test_the_schema_reaches_the_sampler(server, prompt):
    asker = Asker(server, prompt)
    assert asker.ask(picture("red"), schema={}).text.startswith(SAID["preface"])
    assert asker.ask(picture("red")).text.startswith("{")
    without_logic = json.loads(asker.ask(picture("red"), schema=reply_schema(chain_of_thought=False)).text)
    assert list(without_logic) == ["classes", "unsafe_regions", "safe_regions"]


def test_an_answer_without_schema_is_still_read_as_meant(server, prompt):
    reply = Asker(server, prompt).ask(picture("green"), schema={})
    assert parse_reply(reply.text, reply.thinking) == wired_reply("green")


def test_a_justification_without_end_is_closed_by_the_schema(server, prompt):
    reply = Asker(server, prompt, max_tokens=768).ask(picture("blue"))
    assert 560 < len(json.loads(reply.text)["safety_logic"]) <= 600
    assert parse_reply(reply.text, reply.thinking).predicates == ()


def test_an_answer_cut_at_max_tokens_is_an_error_with_and_without_schema(server, prompt):
    asker = Asker(server, prompt, max_tokens=16)
    assert cause_of(asker.ask, picture("red"))[0] == "length"
    assert cause_of(asker.ask, picture("red"), schema={})[0] == "length"


def test_probabilities_of_the_tokens_are_read_unless_the_grammar_forced_one(server, prompt):
    asker = Asker(server, prompt, logprobs=True)
    sure = asker.ask(picture("red"), schema={}).token_logprobs
    assert len(sure) > 20
    assert all(-0.1 < value <= 0.0 for value in sure)  # the model is wired to be sure
    # The server tells the probabilities before the grammar. That of a token the model would never have chosen is 0, its
    # logarithm the smallest number there is, and nothing follows from it about the scene.
    assert asker.ask(picture("red")).token_logprobs is None


def test_a_prompt_longer_than_the_context_is_an_error_of_its_own(home, models, prompt):
    with LlamaServer(home, models, context_tokens=1024) as small:
        assert cause_of(Asker(small, prompt).ask, picture("red"))[0] == "context"


def test_a_server_that_cannot_see_refuses_the_picture(home, models, prompt):
    with LlamaServer(home, models, vision=False) as blind:
        asker = Asker(blind, prompt)
        assert cause_of(asker.ask, picture("red"))[0] == "image_refused"
        assert json.loads(asker.ask(None).text) == SAID["replies"]["none"]


def time_of_answer_s(server, prompt):
    begun_s = time.monotonic()
    assert json.loads(Asker(server, prompt).ask(picture("red")).text) == SAID["replies"]["red"]
    return time.monotonic() - begun_s


def assert_free(server, prompt, usual_s):
    """The server does not go on with the thousands of tokens that nobody waits for: they are a hundred answers long."""
    assert time_of_answer_s(server, prompt) < 10.0 * usual_s + 0.5


def test_the_deadline_holds_and_frees_the_server(server, prompt):
    usual_s = time_of_answer_s(server, prompt)
    endless = Asker(server, prompt, deadline_s=0.5, max_tokens=8000)
    cause, took_s = cause_of(endless.ask, picture("blue"), schema={})
    assert cause == "timeout"
    assert abs(took_s - 0.5) < DEADLINE_SLACK_S
    assert_free(server, prompt, usual_s)


def test_close_aborts_a_question_under_way_and_frees_the_server(server, prompt):
    usual_s = time_of_answer_s(server, prompt)
    asker = Asker(server, prompt, max_tokens=8000)
    closer = threading.Timer(0.5, asker.client.close)
    closer.start()
    cause, took_s = cause_of(asker.ask, picture("blue"), schema={})
    closer.join()
    assert cause == "closed"
    assert abs(took_s - 0.5) < DEADLINE_SLACK_S
    assert_free(server, prompt, usual_s)


def test_two_clients_at_once_get_the_answers_to_their_own_pictures(server, prompt):
    got = {"red": [], "green": []}

    def ask_often(colour):
        asker = Asker(server, prompt)
        got[colour] += [json.loads(asker.ask(picture(colour)).text) for _ in range(20)]

    threads = [threading.Thread(target=ask_often, args=(colour,)) for colour in got]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert got == {colour: [SAID["replies"][colour]] * 20 for colour in got}


def test_the_model_is_reported_as_loaded(server, prompt):
    assert Asker(server, prompt).client.preload().finish == "load"


def test_a_server_that_is_killed_is_noticed_at_once_and_used_again_when_it_is_back(home, models, prompt):
    with LlamaServer(home, models) as mortal:
        asker = Asker(mortal, prompt, max_tokens=8000)
        assert json.loads(asker.ask(picture("red")).text) == SAID["replies"]["red"]
        killer = threading.Timer(0.5, mortal.kill)
        killer.start()
        cause, took_s = cause_of(asker.ask, picture("blue"), schema={})
        killer.join()
        assert cause == "disconnected"
        assert took_s < 0.5 + DEADLINE_SLACK_S
        assert cause_of(asker.ask, picture("red"))[0] == "refused"
        load_s = mortal.start()
        assert json.loads(asker.ask(picture("green")).text) == SAID["replies"]["green"]
        print(f"\nllama-server: loaded again after a kill in {load_s:.2f} s")


def test_200_frames_in_a_row_are_answered_each_by_its_own_picture(server, prompt, record_property):
    rng, noise = random.Random(SEED), np.random.default_rng(SEED)
    asker = Asker(server, prompt, max_tokens=768)
    latencies_s, wrong, failures = [], [], []
    for frame in range(FRAMES):
        colour = rng.choice((*FINITE, "blue"))
        try:
            reply = asker.ask(picture(colour, noise), seed=frame, temperature=rng.choice((0.0, 0.7)))
            read = parse_reply(reply.text, reply.thinking)
        except (ServerError, ReplyError) as error:
            failures.append((frame, error.cause))
            continue
        latencies_s.append(reply.latency_s)
        if read.predicates != (wired_reply(colour).predicates if colour in FINITE else ()):
            wrong.append((frame, colour, reply.text))
    measured = {"frames": FRAMES, "median_s": float(np.median(latencies_s)), "slowest_s": max(latencies_s)}
    print(f"\nllama-server: {measured}")
    for name, value in measured.items():
        record_property(name, value)
    assert failures == []
    assert wrong == []
