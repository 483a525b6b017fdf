# SPDX-License-Identifier: BSD-3-Clause
"""The fake against what was measured on, or read in the source of, the servers it stands for."""

import base64
import http.client
import json
import threading
import time

import cv2
import numpy as np
import pytest
from fakes.fake_model_server import FakeModelServer, control

MODEL = "gemma3:27b"
RED = base64.b64encode(cv2.imencode(".png", np.full((8, 8, 3), (0, 0, 200), np.uint8))[1].tobytes()).decode()


@pytest.fixture
def server():
    models = {
        MODEL: {"capabilities": ("completion", "vision")},
        "thinker:8b": {"capabilities": ("completion", "vision", "thinking")},
    }
    with FakeModelServer(models=models) as running:
        yield running


def call(server, method, path, value=None, headers=None):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5.0)
    body = value if isinstance(value, (bytes, type(None))) else json.dumps(value).encode()
    connection.request(method, path, body, headers or {})
    reply = connection.getresponse()
    data = reply.read()
    connection.close()
    return reply.status, reply.getheader("Content-Type"), data


def chat(server, **changes):
    messages = [{"role": "user", "content": "What is safe?", "images": [RED]}]
    body = {"model": MODEL, "messages": messages, "stream": False, **changes}
    status, _, data = call(server, "POST", "/api/chat", {k: v for k, v in body.items() if v is not None})
    return status, json.loads(data)


def test_ollama_streams_unless_told_not_to(server):
    body = {"model": MODEL, "messages": [{"role": "user", "content": "?"}]}
    status, kind, data = call(server, "POST", "/api/chat", body)
    lines = [json.loads(line) for line in data.splitlines()]
    assert (status, kind) == (200, "application/x-ndjson")
    assert [line["done"] for line in lines] == [False] * (len(lines) - 1) + [True]
    assert "floor" in "".join(line["message"]["content"] for line in lines)
    assert lines[-1]["done_reason"] == "stop"


def test_ollama_answers_in_one_object_with_its_counts(server):
    status, reply = chat(server, logprobs=True)
    assert (status, reply["done"], reply["done_reason"]) == (200, True, "stop")
    assert {"model", "created_at", "message", "total_duration", "prompt_eval_count", "eval_count"} <= set(reply)
    assert len(reply["logprobs"]) == reply["eval_count"]
    assert "red" in reply["message"]["content"]


def test_without_a_schema_the_answer_stands_in_a_fence_and_with_one_it_is_bare(server):
    assert chat(server)[1]["message"]["content"].startswith("Here is the result:\n```json")
    schema = {"type": "object", "properties": {"unsafe_regions": {"type": "array"}, "classes": {"type": "array"}}}
    answer = json.loads(chat(server, format=schema)[1]["message"]["content"])
    assert list(answer) == ["unsafe_regions", "classes"]


@pytest.mark.parametrize(
    ("changes", "status", "words"),
    [
        ({"model": "absent"}, 404, "model 'absent' not found"),
        ({"model": ""}, 400, "model is required"),
        ({"messages": [{"role": "user", "images": ["data:image/png;base64," + RED]}]}, 400, "at input byte 4"),
        (
            {"messages": [{"role": "user", "images": [base64.b64encode(b"garbage!").decode()]}]},
            400,
            "Failed to load image",
        ),
        ({"messages": 3}, 400, "cannot unmarshal"),
        ({"think": True}, 400, '"gemma3:27b" does not support thinking'),
        ({"format": "yaml"}, 500, "invalid format"),
        ({"format": {"type": "banana"}}, 400, "grammar"),
        ({"options": {"num_ctx": "many"}}, 500, "num_ctx"),
        ({"options": {"num_ctx": 200}}, 400, "exceed_context_size_error"),
        ({"keep_alive": "-1"}, 400, "missing unit in duration"),
    ],
)
def test_ollama_refuses(server, changes, status, words):
    got, reply = chat(server, **changes)
    assert got == status
    assert words in reply["error"]


@pytest.mark.parametrize(
    "changes",
    [
        {"think": False},
        {"format": ""},
        {"format": "json"},
        {"options": {"unknown": 1}},
        {"messages": [{"role": "prophet", "content": "?"}]},
        {"keep_alive": -1},
        {"keep_alive": "1h30m"},
        {"unknown": 1},
    ],
)
def test_ollama_accepts(server, changes):
    assert chat(server, **changes)[0] == 200


def test_the_error_of_a_long_prompt_is_json_inside_a_string(server):
    error = json.loads(chat(server, options={"num_ctx": 200})[1]["error"])["error"]
    assert error["type"] == "exceed_context_size_error"
    assert error["n_prompt_tokens"] > error["n_ctx"] == 200


def test_num_predict_cuts_the_answer_and_says_so(server):
    status, reply = chat(server, format={"type": "object"}, options={"num_predict": 3})
    assert (status, reply["done_reason"], reply["eval_count"]) == (200, "length", 3)


def test_a_repeated_token_ends_in_200_with_done_false_and_no_counts(server):
    server.set_fault("unfinished")
    status, reply = chat(server)
    assert (status, reply["done"]) == (200, False)
    assert not {"done_reason", "eval_count"} & set(reply)


def test_a_thinking_model_thinks_unless_told_not_to(server):
    assert chat(server, model="thinker:8b")[1]["message"]["thinking"]
    assert "thinking" not in chat(server, model="thinker:8b", think=False)[1]["message"]


def test_no_message_loads_and_keep_alive_zero_unloads(server):
    assert chat(server, messages=[])[1]["done_reason"] == "load"
    assert json.loads(call(server, "GET", "/api/ps")[2])["models"][0]["name"] == MODEL
    assert chat(server, messages=[], keep_alive=0)[1]["done_reason"] == "unload"
    assert json.loads(call(server, "GET", "/api/ps")[2])["models"] == []


def test_a_model_is_dropped_after_keep_alive(server):
    chat(server, keep_alive=0.05)
    time.sleep(0.1)
    chat(server)
    assert server.models.loads == 2


def test_small_pages(server):
    assert call(server, "GET", "/")[::2] == (200, b"Ollama is running")
    assert call(server, "HEAD", "/")[::2] == (200, b"")
    assert "version" in json.loads(call(server, "GET", "/api/version")[2])
    assert call(server, "GET", "/api/nothing")[::2] == (404, b"404 page not found")
    assert call(server, "GET", "/api/chat")[0] == 405
    assert json.loads(call(server, "GET", "/health")[2]) == {"status": "ok"}
    assert call(server, "POST", "/api/chat", b"")[::2] == (400, b'{"error": "missing request body"}')
    assert call(server, "POST", "/api/chat", b"{")[0] == 400
    tags = json.loads(call(server, "GET", "/api/tags")[2])["models"]
    assert [entry["name"] for entry in tags] == [MODEL, "thinker:8b"]
    assert "vision" in json.loads(call(server, "POST", "/api/show", {"model": MODEL})[2])["capabilities"]
    assert call(server, "POST", "/api/show", {"model": "absent"})[0] == 404


@pytest.mark.parametrize(
    ("host", "status"), [("127.0.0.1:1", 200), ("localhost", 200), ("x.local:1", 200), ("example.org", 403)]
)
def test_a_foreign_name_in_the_host_header_is_refused(server, host, status):
    assert call(server, "GET", "/", headers={"Host": host})[0] == status


def test_requests_are_served_in_the_order_they_came(server):
    server.latency_s = 0.1
    threads = []
    for k in range(5):
        arguments = {"messages": [{"role": "user", "content": str(k)}]}
        threads.append(threading.Thread(target=chat, args=(server,), kwargs=arguments))
        threads[-1].start()
        time.sleep(0.03)
    for thread in threads:
        thread.join()
    # The server notes the end of a call after its client has the answer.
    deadline_s = time.monotonic() + 10.0
    while any("ended_s" not in entry for entry in server.chats()) and time.monotonic() < deadline_s:
        time.sleep(0.01)
    ended = sorted(server.chats(), key=lambda entry: entry["ended_s"])
    assert [entry["user"] for entry in ended] == list("01234")
    gaps_s = np.diff([entry["ended_s"] for entry in ended])
    assert gaps_s.min() > 0.08


def openai(server, **changes):
    url = {"type": "image_url", "image_url": {"url": "data:image/png;base64," + RED}}
    messages = [{"role": "user", "content": [url, {"type": "text", "text": "?"}]}]
    status, kind, data = call(server, "POST", "/v1/chat/completions", {"model": "any", "messages": messages, **changes})
    return status, kind, data


SCHEMA = {"type": "json_schema", "json_schema": {"name": "x", "schema": {"type": "object"}}}


def test_llama_server_answers_in_one_object_unless_told_to_stream(server):
    status, _, data = openai(server, response_format=SCHEMA)
    choice = json.loads(data)["choices"][0]
    assert (status, choice["finish_reason"]) == (200, "stop")
    assert "red" in choice["message"]["content"]
    _, kind, data = openai(server, stream=True)
    assert kind == "text/event-stream"
    assert data.endswith(b"data: [DONE]\n\n")


def test_llama_server_gives_500_for_an_answer_cut_under_a_schema_and_length_without(server):
    status, _, data = openai(server, response_format=SCHEMA, max_tokens=3)
    assert status == 500
    assert "peg-native" in json.loads(data)["error"]["message"]
    status, _, data = openai(server, max_tokens=3)
    assert (status, json.loads(data)["choices"][0]["finish_reason"]) == (200, "length")


@pytest.mark.parametrize("url", [RED, "data:image/png;base64," + base64.b64encode(b"garbage!").decode()])
def test_llama_server_refuses_a_picture_it_cannot_read(server, url):
    messages = [{"role": "user", "content": [{"type": "image_url", "image_url": {"url": url}}]}]
    status, _, data = openai(server, messages=messages)
    assert status == 400
    assert set(json.loads(data)["error"]) == {"code", "message", "type"}


def test_controls_work_over_http_and_the_log_tells_what_was_asked(server):
    control(server.url, "/_answer", {"text": "{}"})
    control(server.url, "/_latency", {"seconds": 0.1})
    control(server.url, "/_fault", {"kind": "500", "count": 1})
    assert [chat(server)[0] for _ in range(2)] == [500, 200]
    refused, answered = control(server.url, "/_log")
    assert refused["outcome"] == "refused 500"
    assert (answered["outcome"], answered["user"], answered["images"][0]["shape"]) == (
        "answered",
        "What is safe?",
        [8, 8, 3],
    )
    assert answered["ended_s"] - answered["begun_s"] >= 0.1
    control(server.url, "/_reset", {})
    assert control(server.url, "/_log") == []
    assert "red" in chat(server)[1]["message"]["content"]
    assert call(server, "POST", "/_fault", {"kind": "absurd"})[0] == 400
