# SPDX-License-Identifier: BSD-3-Clause
"""What a server answered is written down and answers again: the same replies, failures and latencies, offline."""

import errno
import json
import os
import threading

import cv2
import numpy as np
import pytest
from fakes.fake_model_server import FakeModelServer

from core_perception.endpoint import Endpoint
from core_perception.exceptions import PerceptionError, ServerError
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.base import Evidence
from core_perception.reasoners.recording import RecordingClient, ReplayClient, hash_image, hash_prompt
from core_perception.reasoners.vlm_client import VlmClient
from core_perception.reasoners.vlm_reasoner import Sampling, VlmReasoner
from core_perception.reasoners.wire import ModelReply, OllamaWire

SCHEMA = {"type": "object", "properties": {"safety_logic": {}, "classes": {}}}
PROMPT = ("who you are", "what to do", SCHEMA)


def image(seed=0, shape=(24, 32, 3)):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


class ScriptedServer:
    """Stands for a client with a server: gives what the list says, in order."""

    def __init__(self, *outcomes):
        self.outcomes, self.asks, self.is_closed = list(outcomes), [], False

    def ask(self, system, user, image_rgb, schema, seed=None, temperature=None):
        self.asks.append((system, user, image_rgb, schema, seed, temperature))
        outcome = self.outcomes.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def close(self):
        self.is_closed = True


def ask(client, pixels, seed=1, temperature=None, prompt=PROMPT):
    system, user, schema = prompt
    try:
        return client.ask(system, user, pixels, schema, seed, temperature)
    except ServerError as error:
        return error.cause, str(error), error.latency_s


def lines(folder):
    return [json.loads(line) for line in (folder / "replies.jsonl").read_text().splitlines()]


def record(folder, *asks, keep_images=False):
    """Record (pixels, outcome) pairs and return what the caller got."""
    client = RecordingClient(ScriptedServer(*(a[1] for a in asks)), folder, "gemma3:27b", "ollama", keep_images)
    results = [ask(client, a[0]) for a in asks]
    client.close()
    return results


REPLY = ModelReply('{"classes": []}', "hm, \u00fcber \U0001f600 \ud800", (-0.25, -1e-9), "stop", 4.125)


def test_a_recorded_run_repeats_to_the_last_bit_without_the_server(tmp_path):
    asks = [
        (image(0), REPLY),
        (image(1), ServerError("timeout", "no reply within 20 s", 20.25)),
        (image(2), ModelReply("two", latency_s=0.1 + 0.2)),
        (None, ModelReply("no image", "", None, "stop", 1.0)),
    ]
    live = record(tmp_path, *asks)
    assert live[0] == REPLY
    assert live[1] == ("timeout", "timeout: no reply within 20 s", 20.25)
    replay = ReplayClient(tmp_path)
    assert [ask(replay, pixels) for pixels, _ in asks] == live
    assert replay.torn_lines == 0


def test_the_order_of_different_questions_does_not_matter(tmp_path):
    asks = [(image(k), ModelReply(str(k))) for k in range(5)]
    live = record(tmp_path, *asks)
    replay = ReplayClient(tmp_path)
    assert [ask(replay, pixels) for pixels, _ in reversed(asks)] == live[::-1]


def test_the_same_question_gets_its_outcomes_in_order_and_then_the_last_again(tmp_path):
    same = image(0)
    live = record(
        tmp_path,
        (same, ModelReply("first")),
        (image(1), ModelReply("other")),
        (same, ServerError("http_5xx", "status 500")),
        (same, ModelReply("third")),
    )
    replay = ReplayClient(tmp_path)
    assert [ask(replay, same) for _ in range(5)] == [live[0], live[2], live[3], live[3], live[3]]
    assert ask(replay, image(1)) == live[1]


def test_everything_asked_is_part_of_the_question(tmp_path):
    pixels = image(0)
    record(tmp_path, (pixels, REPLY))
    replay = ReplayClient(tmp_path)
    system, user, schema = PROMPT
    changed = pixels.copy()
    changed[-1, -1, -1] ^= 1
    reordered = {"type": "object", "properties": {"classes": {}, "safety_logic": {}}}
    others = [
        ask(replay, changed),
        ask(replay, pixels.reshape(32, 24, 3)),
        ask(replay, pixels.astype(np.int8)),
        ask(replay, None),
        ask(replay, pixels, seed=2),
        ask(replay, pixels, seed=None),
        ask(replay, pixels, temperature=0.0),
        ask(replay, pixels, prompt=(system + ".", user, schema)),
        ask(replay, pixels, prompt=(system, user + ".", schema)),
        ask(replay, pixels, prompt=(user, system, schema)),
        ask(replay, pixels, prompt=(system, user, None)),
        ask(replay, pixels, prompt=(system, user, reordered)),
    ]
    assert [other[0] for other in others] == ["not_recorded"] * len(others)
    assert ask(replay, pixels) == REPLY


def test_an_unknown_question_says_whether_the_image_or_the_prompt_is_new(tmp_path):
    record(tmp_path, (image(0), REPLY))
    replay = ReplayClient(tmp_path)
    assert "that image is recorded with other prompts or seeds only" in ask(replay, image(0), seed=9)[1]
    assert "that image is recorded nowhere" in ask(replay, image(9))[1]
    assert hash_image(image(9))[:12] in ask(replay, image(9))[1]
    assert ask(replay, None)[1].startswith("not_recorded: no image with prompt")


def test_pixels_count_not_their_layout_in_memory():
    pixels = image(0)
    padded = np.zeros((24, 64, 3), np.uint8)
    padded[:, :32] = pixels
    assert hash_image(padded[:, :32]) == hash_image(pixels) == hash_image(np.asfortranarray(pixels))
    assert hash_image(None) is None


def test_a_whole_number_as_temperature_is_the_same_question():
    assert hash_prompt("s", "u", None, 1, 0) == hash_prompt("s", "u", None, 1, 0.0)
    assert hash_prompt("s", "u", None, 1, 0) != hash_prompt("s", "u", None, 1, None)


def test_what_is_system_text_and_what_is_user_text_counts():
    assert hash_prompt("ab", "c", None, 1, 0) != hash_prompt("a", "bc", None, 1, 0)


def test_the_client_is_asked_with_exactly_what_was_given(tmp_path):
    server = ScriptedServer(REPLY, REPLY)
    client = RecordingClient(server, tmp_path, "m", "openai")
    pixels = image(0)
    client.ask("s", "u", pixels, SCHEMA, 5, 0.7)
    client.ask("s", "u", pixels, SCHEMA)
    assert server.asks[0][:2] == ("s", "u")
    assert server.asks[0][2] is pixels
    assert server.asks[0][3:] == (SCHEMA, 5, 0.7)
    assert server.asks[1][4:] == (None, None)
    client.close()
    assert server.is_closed
    assert len(lines(tmp_path)) == 2


def test_a_line_holds_the_documented_keys_and_neither_prompt_nor_pixels(tmp_path):
    record(tmp_path, (image(0), REPLY), (None, ServerError("refused", "nobody listens", 0.5)))
    reply, failure = lines(tmp_path)
    assert reply == {
        "format_version": 1,
        "image_sha256": hash_image(image(0)),
        "prompt_sha256": hash_prompt(*PROMPT[:2], SCHEMA, 1, None),
        "model": "gemma3:27b",
        "wire": "ollama",
        "latency_s": 4.125,
        "text": REPLY.text,
        "thinking": REPLY.thinking,
        "finish": "stop",
        "token_logprobs": [-0.25, -1e-9],
    }
    assert (failure["error_cause"], failure["error_detail"]) == ("refused", "nobody listens")
    assert failure["image_sha256"] is None
    assert "text" not in failure
    assert "what to do" not in (tmp_path / "replies.jsonl").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["replies.jsonl"]


def test_every_reply_is_on_disk_before_it_is_handed_on(tmp_path):
    client = RecordingClient(ScriptedServer(REPLY, ServerError("timeout", "late")), tmp_path, "m", "ollama")
    ask(client, image(0))
    assert len(lines(tmp_path)) == 1
    ask(client, image(0))
    assert len(lines(tmp_path)) == 2
    client.close()


def test_images_are_kept_only_when_asked_and_without_loss(tmp_path):
    record(tmp_path, (image(0), REPLY), (image(0), REPLY), (image(1), REPLY), (None, REPLY), keep_images=True)
    kept = sorted((tmp_path / "images").iterdir())
    assert [path.stem for path in kept] == sorted(hash_image(image(k)) for k in range(2))
    for path in kept:
        pixels = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
        assert hash_image(pixels) == path.stem


def test_a_torn_last_line_is_ignored_and_counted_wherever_it_broke_off(tmp_path):
    record(tmp_path, (image(0), ModelReply("kept")), (image(1), REPLY))
    path = tmp_path / "replies.jsonl"
    content = path.read_bytes()
    first = content.index(b"\n") + 1
    for end in (first + 1, first + 40, len(content) - 1):
        path.write_bytes(content[:end])
        replay = ReplayClient(tmp_path)
        assert replay.torn_lines == 1
        assert ask(replay, image(0)).text == "kept"
        assert ask(replay, image(1))[0] == "not_recorded"
    for end, torn in ((first, 0), (0, 0), (5, 1)):
        path.write_bytes(content[:end])
        assert ReplayClient(tmp_path).torn_lines == torn


def test_recording_goes_on_after_a_torn_line(tmp_path):
    record(tmp_path, (image(0), ModelReply("before")), (image(1), ModelReply("torn")))
    path = tmp_path / "replies.jsonl"
    path.write_bytes(path.read_bytes()[:-7])
    record(tmp_path, (image(2), ModelReply("after")))
    replay = ReplayClient(tmp_path)
    assert replay.torn_lines == 0
    assert [ask(replay, image(k))[0] if k == 1 else ask(replay, image(k)).text for k in range(3)] == [
        "before",
        "not_recorded",
        "after",
    ]


GOOD_LINE = {
    "format_version": 1,
    "image_sha256": None,
    "prompt_sha256": "ab",
    "model": "m",
    "wire": "ollama",
    "latency_s": 1.0,
    "text": "x",
    "thinking": "",
    "finish": "stop",
    "token_logprobs": None,
}


@pytest.mark.parametrize(
    "change, message",
    [
        ({"format_version": 2}, "format_version: got 2, allowed 1"),
        ({"text": 5}, "text: got 5"),
        ({"prompt_sha256": None}, "prompt_sha256: got None"),
        ({"image_sha256": 5}, "image_sha256: got 5"),
        ({"latency_s": -1.0}, "latency_s: got -1.0"),
        ({"latency_s": float("nan")}, "latency_s: got nan"),
        ({"latency_s": True}, "latency_s: got True"),
        ({"token_logprobs": [-1.0, "x"]}, "token_logprobs"),
        ({"token_logprobs": 3}, "token_logprobs"),
        ({"extra": 1}, "allowed exactly"),
        ({"error_cause": "timeout"}, "allowed exactly"),
    ],
)
def test_a_damaged_line_is_refused_with_its_number_for_replay_and_for_recording(tmp_path, change, message):
    path = tmp_path / "replies.jsonl"
    path.write_text("".join(json.dumps(entry) + "\n" for entry in (GOOD_LINE, {**GOOD_LINE, **change}, GOOD_LINE)))
    before = path.read_bytes()
    for build in (lambda: ReplayClient(tmp_path), lambda: RecordingClient(ScriptedServer(), tmp_path, "m", "ollama")):
        with pytest.raises(PerceptionError) as refused:
            build()
        assert str(refused.value).startswith(f"{path}:2: ")
        assert message in str(refused.value)
    assert path.read_bytes() == before


@pytest.mark.parametrize("damaged", [b"{}", b"[1]", b"null", b"", b"garbage", b"\xff\xfe", b"[" * 100_000])
def test_bytes_that_are_no_line_are_refused(tmp_path, damaged):
    (tmp_path / "replies.jsonl").write_bytes(damaged + b"\n" + json.dumps(GOOD_LINE).encode() + b"\n")
    with pytest.raises(PerceptionError, match=r"replies.jsonl:1: "):
        ReplayClient(tmp_path)


def test_fuzz_of_bytes_changed_in_a_recording_never_raises_anything_else(tmp_path):
    record(tmp_path, *((image(k), REPLY) for k in range(3)))
    path = tmp_path / "replies.jsonl"
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(int(os.environ.get("CORE_SEED", "0")))
    outcomes = set()
    for _ in range(500):
        changed = bytearray(content)
        for place in rng.integers(0, len(content), 3):
            changed[place] = rng.integers(0, 256)
        path.write_bytes(changed)
        try:
            ask(ReplayClient(tmp_path), image(0))
            outcomes.add("read")
        except PerceptionError:
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}


def test_a_folder_without_a_recording_is_refused(tmp_path):
    with pytest.raises(PerceptionError, match="replies.jsonl: cannot be read: No such file"):
        ReplayClient(tmp_path)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PerceptionError, match="cannot be written: (Not a directory|File exists)"):
        RecordingClient(ScriptedServer(), tmp_path / "file" / "deeper", "m", "ollama")


def test_two_recorders_of_one_folder_are_refused_until_the_first_is_closed(tmp_path):
    first = RecordingClient(ScriptedServer(), tmp_path, "m", "ollama")
    with pytest.raises(PerceptionError, match="another process is recording into it"):
        RecordingClient(ScriptedServer(), tmp_path, "m", "ollama")
    first.close()
    RecordingClient(ScriptedServer(), tmp_path, "m", "ollama").close()


def test_a_reply_that_cannot_be_written_is_a_failure_and_leaves_no_half_line(tmp_path, monkeypatch):
    server = ScriptedServer(ModelReply("a"), ModelReply("b", latency_s=2.0), ModelReply("c"))
    client = RecordingClient(server, tmp_path, "m", "ollama")
    assert ask(client, image(0)).text == "a"
    real_write, calls = os.write, []

    def half_then_full(file, data):
        calls.append(len(data))
        if len(calls) == 1:
            return real_write(file, data[:20])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", half_then_full)
    cause, text, latency_s = ask(client, image(1))
    monkeypatch.undo()
    assert (cause, latency_s) == ("record_failed", 2.0)
    assert "No space left on device" in text
    assert ask(client, image(2)).text == "c"
    client.close()
    assert [entry["text"] for entry in lines(tmp_path)] == ["a", "c"]


@pytest.mark.parametrize("reply", [ModelReply("x", latency_s=float("nan")), ModelReply("x", "", (float("-inf"),))])
def test_a_reply_that_could_not_be_read_again_is_not_written(tmp_path, reply):
    assert record(tmp_path, (image(0), reply))[0][0] == "record_failed"
    assert lines(tmp_path) == []


def test_an_image_that_cannot_be_kept_is_a_failure(tmp_path):
    flat = np.zeros((4, 4), np.uint8)
    assert record(tmp_path, (flat, REPLY), keep_images=True)[0][0] == "record_failed"
    assert lines(tmp_path) == []


def test_an_ask_that_was_aborted_by_closing_is_not_recorded(tmp_path):
    asked, closed = threading.Event(), threading.Event()

    class Hanging(ScriptedServer):
        def ask(self, *_arguments):
            asked.set()
            assert closed.wait(5.0)
            raise ServerError("closed", "the client was closed", 0.1)

        def close(self):
            closed.set()

    client = RecordingClient(Hanging(), tmp_path, "m", "ollama")
    results = []
    thread = threading.Thread(target=lambda: results.append(ask(client, image(0))))
    thread.start()
    assert asked.wait(5.0)
    client.close()
    thread.join(5.0)
    assert results == [("closed", "closed: the client was closed", 0.1)]
    assert lines(tmp_path) == []
    client.close()


def test_a_replay_needs_nothing_else_and_never_waits(tmp_path):
    record(tmp_path, (image(0), ModelReply("slow", latency_s=300.0)))
    replay = ReplayClient(tmp_path)
    assert ask(replay, image(0)).latency_s == 300.0
    replay.close()
    assert ask(replay, image(0)).latency_s == 300.0


def test_a_reasoner_gives_the_same_answers_and_failures_from_the_recording_as_from_the_server(
    tmp_path, config_dir, ontology
):
    template = PromptTemplate.load(config_dir / "prompt.yaml")
    evidences = [Evidence(100 * k, image=image(k % 4), guidelines=("Keep off.",) * (k % 2)) for k in range(16)]

    def answers(client):
        reasoner = VlmReasoner("vlm", client, template, ontology, Sampling("samples", 2, 3), is_slow=False)
        for k, evidence in enumerate(evidences):
            yield k, reasoner.reason(evidence)

    with FakeModelServer() as server:
        inner = VlmClient(OllamaWire("gemma3:27b"), Endpoint.parse(server.url), 5.0, 5.0)
        client = RecordingClient(inner, tmp_path, "gemma3:27b", "ollama")
        live = []
        for k, answer in answers(client):
            live.append(answer)
            server.set_fault(["ok", "500", "garbage", "close", "other_schema", "length"][(k + 1) % 6])
        client.close()
    assert {a.void_cause for a in live} >= {"", "http_5xx", "length"}
    assert sum(a.constraints is not None for a in live) >= 3
    replayed = [answer for _, answer in answers(ReplayClient(tmp_path))]
    assert replayed == live
    assert [a.constraints and a.constraints.confidence for a in replayed] == [
        a.constraints and a.constraints.confidence for a in live
    ]
