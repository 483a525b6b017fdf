# SPDX-License-Identifier: BSD-3-Clause
import base64
import json
import math
import re
from pathlib import Path

import pytest

from core_perception.exceptions import ParameterError, ServerError
from core_perception.reasoners.ollama_models import is_passed_on, read_show, read_tags, show_request, tags_request
from core_perception.reasoners.server_words import CAUSES_BY_STATUS, CAUSES_BY_WORDS
from core_perception.reasoners.vlm_client import SERVER_CAUSES
from core_perception.reasoners.wire import OllamaWire, OpenAiWire, Question

OLLAMA, OPENAI = OllamaWire("gemma3:27b"), OpenAiWire("gemma")
JPEG, PNG = b"\xff\xd8\xff\xe0 picture", b"\x89PNG\r\n\x1a\n picture"
SCHEMA = {"type": "object", "properties": {"safety_logic": {"type": "string"}, "classes": {"type": "array"}}}
SECRET_PROMPT = "The vault in corridor seven is guarded by nobody at night."
ASKED = Question(SECRET_PROMPT, "What is safe here?", JPEG, SCHEMA, seed=5, temperature=0.7)


def body_of(request):
    return json.loads(request.body.decode())


def ollama_answer(**changes):
    reply = {"model": "gemma3:27b", "message": {"role": "assistant", "content": "{}"}, "done": True}
    return {**reply, "done_reason": "stop", **changes}


def openai_answer(message=None, **changes):
    choice = {"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": "{}"}}
    return {"choices": [{**choice, **({"message": message} if message else {}), **changes}]}


def read(wire, reply, status=200, question=ASKED):
    data = reply if isinstance(reply, bytes) else json.dumps(reply).encode()
    return wire.read_chat(status, data, wire.chat(question))


def cause_of(wire, reply, status=200, question=ASKED):
    with pytest.raises(ServerError) as caught:
        read(wire, reply, status, question)
    assert caught.value.cause in SERVER_CAUSES
    assert "\n" not in str(caught.value)
    return caught.value.cause


# ---- what is sent


def test_ollama_gets_raw_base64_and_the_schema_as_format():
    body = body_of(OLLAMA.chat(ASKED))
    assert OLLAMA.chat(ASKED).path == "/api/chat"
    assert [message["role"] for message in body["messages"]] == ["system", "user"]
    assert base64.b64decode(body["messages"][1]["images"][0], validate=True) == JPEG
    assert body["format"] == SCHEMA
    assert body["options"]["seed"] == 5
    assert body["options"]["temperature"] == 0.7


def test_openai_gets_a_data_url_and_the_schema_as_response_format():
    body = body_of(OPENAI.chat(ASKED))
    picture, text = body["messages"][1]["content"]
    assert OPENAI.chat(ASKED).path == "/v1/chat/completions"
    assert picture["image_url"]["url"] == "data:image/jpeg;base64," + base64.b64encode(JPEG).decode()
    assert text == {"type": "text", "text": ASKED.user}
    assert body["response_format"]["json_schema"]["schema"] == SCHEMA
    assert (body["seed"], body["temperature"]) == (5, 0.7)


def test_the_data_url_names_the_format_of_the_picture():
    url = body_of(OPENAI.chat(Question("s", "u", PNG)))["messages"][1]["content"][0]["image_url"]["url"]
    assert url.startswith("data:image/png;base64,")


@pytest.mark.parametrize("wire", [OLLAMA, OPENAI])
def test_properties_of_the_schema_keep_their_order(wire):
    text = wire.chat(ASKED).body.decode()
    assert text.index('"safety_logic"') < text.index('"classes"')


def test_streaming_and_thinking_are_switched_off_since_servers_default_to_on():
    body = body_of(OLLAMA.chat(ASKED))
    assert body["stream"] is False
    assert body["think"] is False
    assert body_of(OPENAI.chat(ASKED))["stream"] is False


def test_a_question_without_picture_schema_and_seed_sends_none():
    question = Question("s", "u")
    body = body_of(OLLAMA.chat(question))
    assert "format" not in body
    assert "images" not in body["messages"][1]
    assert "seed" not in body["options"]
    body = body_of(OPENAI.chat(question))
    assert "response_format" not in body
    assert "seed" not in body
    assert [part["type"] for part in body["messages"][1]["content"]] == ["text"]


def test_every_request_of_ollama_has_the_same_options_that_load_a_model():
    questions = [ASKED, Question("s", "u"), Question("", "", PNG, None, 9, 0.0)]
    bodies = [body_of(OLLAMA.chat(question)) for question in questions] + [body_of(OLLAMA.preload())]
    seen = {(b["model"], b["keep_alive"], b["options"]["num_ctx"], b["options"]["num_predict"]) for b in bodies}
    assert len(seen) == 1
    assert bodies[-1]["messages"] == []
    assert None not in next(iter(seen))


@pytest.mark.parametrize(("keep_alive", "sent"), [("30m", "30m"), ("-1", -1), ("600", 600), ("1h30m", "1h30m")])
def test_keep_alive_without_a_unit_is_sent_as_a_number(keep_alive, sent):
    assert body_of(OllamaWire("m", keep_alive=keep_alive).preload())["keep_alive"] == sent


@pytest.mark.parametrize(
    ("wire", "changes"),
    [
        (OllamaWire, {"model": ""}),
        (OllamaWire, {"model": " m"}),
        (OllamaWire, {"model": "m\nn"}),
        (OllamaWire, {"keep_alive": "soon"}),
        (OllamaWire, {"keep_alive": "5 m"}),
        (OllamaWire, {"max_tokens": 0}),
        (OllamaWire, {"context_tokens": 512, "max_tokens": 512}),
        (OllamaWire, {"temperature": math.nan}),
        (OllamaWire, {"temperature": -0.1}),
        (OpenAiWire, {"model": "m" * 300}),
        (OpenAiWire, {"max_tokens": -1}),
        (OpenAiWire, {"temperature": math.inf}),
    ],
)
def test_a_bad_setting_is_refused(wire, changes):
    with pytest.raises(ParameterError):
        wire(**{"model": "m", **changes})


def test_logprobs_are_asked_for_only_if_wanted():
    assert "logprobs" not in body_of(OLLAMA.chat(ASKED))
    assert body_of(OllamaWire("m", logprobs=True).chat(ASKED))["logprobs"] is True
    assert "logprobs" not in body_of(OPENAI.chat(ASKED))
    assert body_of(OpenAiWire("m", logprobs=True).chat(ASKED))["logprobs"] is True


def test_a_half_of_a_surrogate_pair_in_the_prompt_can_be_sent():
    assert body_of(OLLAMA.chat(Question("sign: \ud83d", "u")))["messages"][0]["content"] == "sign: ?"


# ---- the key


def test_the_key_comes_from_the_environment_and_is_never_shown(monkeypatch):
    monkeypatch.setenv("CORE_TEST_KEY", "sk-7h15-15-53cr37")
    wire = OpenAiWire("m", "CORE_TEST_KEY")
    request = wire.chat(ASKED)
    assert request.headers["Authorization"] == "Bearer sk-7h15-15-53cr37"
    assert wire.preload().headers["Authorization"] == "Bearer sk-7h15-15-53cr37"
    assert "53cr37" not in repr(wire) + repr(request) + str(request)
    assert "Authorization" not in OPENAI.chat(ASKED).headers


@pytest.mark.parametrize("value", [None, "", "two words", "new\nline", "cl\u00e9"])
def test_an_unusable_key_is_refused_without_showing_it(monkeypatch, value):
    monkeypatch.delenv("CORE_TEST_KEY", raising=False)
    if value is not None:
        monkeypatch.setenv("CORE_TEST_KEY", value)
    with pytest.raises(ParameterError) as caught:
        OpenAiWire("m", "CORE_TEST_KEY")
    assert not value or value not in str(caught.value)


@pytest.mark.parametrize("key", ["sk-7h15-15-53cr37", "abc53cr37"])
def test_a_key_in_place_of_the_name_of_its_variable_is_refused_without_showing_it(key):
    with pytest.raises(ParameterError) as caught:
        OpenAiWire("m", key)
    assert "53cr37" not in str(caught.value)


def test_texts_for_a_person_hold_nothing_of_the_question():
    shown = repr(ASKED) + repr(OLLAMA.chat(ASKED)) + repr(OPENAI.chat(ASKED))
    assert "vault" not in shown
    assert "picture" not in shown


# ---- what is read


@pytest.mark.parametrize(("wire", "answer"), [(OLLAMA, ollama_answer()), (OPENAI, openai_answer())])
def test_a_whole_answer_is_read(wire, answer):
    reply = read(wire, answer)
    assert (reply.text, reply.thinking, reply.finish, reply.token_logprobs) == ("{}", "", "stop", None)


def test_thinking_is_kept_apart_and_may_hold_all():
    message = {"role": "assistant", "content": "", "thinking": '{"a": 1}'}
    assert read(OLLAMA, ollama_answer(message=message)).thinking == '{"a": 1}'
    assert read(OPENAI, openai_answer({"content": None, "reasoning_content": "x"})).thinking == "x"
    assert read(OPENAI, openai_answer({"content": None, "reasoning": "y"})).thinking == "y"
    assert read(OPENAI, openai_answer({"content": None, "reasoning": "y"})).text == ""


def test_logprobs_are_read_and_odd_ones_are_left_out():
    tokens = [{"token": "a", "logprob": -0.5}, {"token": "b", "logprob": 0}]
    assert read(OLLAMA, ollama_answer(logprobs=tokens)).token_logprobs == (-0.5, 0.0)
    assert read(OPENAI, openai_answer(logprobs={"content": tokens})).token_logprobs == (-0.5, 0.0)
    for odd in (
        [],
        {},
        [1],
        [{"logprob": 0.1}],
        [{"logprob": None}],
        [{"logprob": math.nan}],
        [{"logprob": -math.inf}],
    ):
        assert read(OLLAMA, ollama_answer(logprobs=odd)).token_logprobs is None


def test_text_that_cannot_be_encoded_is_made_encodable():
    data = b'{"message":{"content":"a\\ud800b"},"done":true,"done_reason":"stop"}'
    assert read(OLLAMA, data).text == "a?b"


@pytest.mark.parametrize(
    ("wire", "answer", "cause"),
    [
        (OLLAMA, ollama_answer(done=False), "unfinished"),
        (OLLAMA, {k: v for k, v in ollama_answer().items() if k != "done"}, "unfinished"),
        (OLLAMA, ollama_answer(done="true"), "unfinished"),
        (OLLAMA, ollama_answer(done_reason="length"), "length"),
        (OLLAMA, ollama_answer(done_reason="load"), "unfinished"),
        (OLLAMA, ollama_answer(message=None), "bad_reply"),
        (OLLAMA, ollama_answer(message="{}"), "bad_reply"),
        (OLLAMA, ollama_answer(message={"content": ["{}"]}), "bad_reply"),
        (OLLAMA, ollama_answer(message={"content": "", "thinking": 3}), "bad_reply"),
        (OLLAMA, {"error": "an error in the middle of a stream"}, "http_5xx"),
        (OPENAI, openai_answer(finish_reason="length"), "length"),
        (OPENAI, openai_answer(finish_reason="content_filter"), "unfinished"),
        (OPENAI, openai_answer(finish_reason=None), "unfinished"),
        (OPENAI, {"choices": []}, "bad_reply"),
        (OPENAI, {"choices": {}}, "bad_reply"),
        (OPENAI, {"choices": [3]}, "bad_reply"),
        (OPENAI, {"choices": [{"finish_reason": "stop"}]}, "bad_reply"),
        (OPENAI, {"data": []}, "bad_reply"),
    ],
)
def test_an_answer_that_is_not_whole_is_an_error(wire, answer, cause):
    assert cause_of(wire, answer) == cause


CONTEXT = {"code": 400, "message": "request (9000 tokens) exceeds the available context size (4096 tokens)"}
PEG = "The model produced output that does not match the expected peg-native format"


@pytest.mark.parametrize(
    ("status", "reply", "cause"),
    [
        (404, {"error": "model 'gemma3:27b' not found"}, "model_missing"),
        (404, b"404 page not found", "http_4xx"),
        (400, {"error": json.dumps({"error": {**CONTEXT, "type": "exceed_context_size_error"}})}, "context"),
        (400, {"error": {**CONTEXT, "type": "exceed_context_size_error"}}, "context"),
        (400, {"error": {"message": "This model's maximum context length is 4096 tokens."}}, "context"),
        (400, {"error": "illegal base64 data at input byte 4"}, "image_refused"),
        (400, {"error": json.dumps({"error": {"message": "Failed to load image or audio file"}})}, "image_refused"),
        (400, {"error": '"gemma3:27b" does not support thinking'}, "http_4xx"),
        (400, {"error": {"message": ["not", "a", "string"], "type": 3}}, "http_4xx"),
        (400, {"error": None}, "http_4xx"),
        (401, {"error": {"message": "Invalid API Key"}}, "denied"),
        (403, b"", "denied"),
        (429, {"error": {"message": "slow down"}}, "overloaded"),
        (503, {"error": {"message": "Loading model", "code": 503}}, "overloaded"),
        (500, {"error": {"code": 500, "message": PEG, "type": "server_error"}}, "length"),
        (500, {"error": "an error was encountered while running the model: unexpected EOF"}, "http_5xx"),
        (502, b"<html>Bad Gateway</html>", "http_5xx"),
        (302, b"", "redirect"),
        (307, {"error": "moved"}, "redirect"),
        (204, b"", "bad_reply"),
    ],
)
@pytest.mark.parametrize("wire", [OLLAMA, OPENAI])
def test_an_error_of_the_server_has_its_cause(wire, status, reply, cause):
    assert cause_of(wire, reply, status) == cause


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"null",
        b"[]",
        b'"text"',
        b"7",
        b"{",
        b"\xff\xfe",
        bytes(range(256)),
        b"[" * 1_000_000,
        b'{"a":' * 100_000,
        b'{"done":' + b"9" * 1_000_000 + b"}",
        json.dumps(ollama_answer(eval_count=10**30)).encode(),
        json.dumps({**openai_answer(), "created": -(10**30)}).encode(),
        b'{"done":true}\n{"done":true}',
    ],
)
@pytest.mark.parametrize("wire", [OLLAMA, OPENAI])
def test_bytes_that_are_no_object_are_a_bad_reply(wire, data):
    assert cause_of(wire, data) == "bad_reply"


def test_the_words_of_the_server_are_passed_on_in_one_short_line():
    with pytest.raises(ServerError, match="status 500, the server says: CUDA out of memory") as caught:
        read(OLLAMA, {"error": "CUDA\nout of\x00 memory " + "again " * 1000}, 500)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    "words",
    [
        "cannot read: " + SECRET_PROMPT,
        "bad input 'corridor seven is guarded'",
        "image " + base64.b64encode(JPEG).decode(),
        "Incorrect API key provided: sk-7h15-15-53cr37",
        "Incorrect API key provided: sk-7h1***",
        "token abcde is unknown",
    ],
)
def test_words_that_repeat_the_key_the_prompt_or_the_picture_are_withheld(monkeypatch, words):
    monkeypatch.setenv("CORE_TEST_KEY", "abcde" if "abcde" in words else "sk-7h15-15-53cr37")
    with pytest.raises(ServerError, match="withheld") as caught:
        read(OpenAiWire("m", "CORE_TEST_KEY"), {"error": {"message": words}}, 500)
    assert words[-12:] not in str(caught.value)


def test_the_name_of_the_model_may_be_quoted_however_long():
    wire = OllamaWire("a-model-with-a-long-name:27b-it-qat-q4_0")
    with pytest.raises(ServerError, match="a-model-with-a-long-name:27b-it-qat-q4_0"):
        read(wire, {"error": "model 'a-model-with-a-long-name:27b-it-qat-q4_0' not found"}, 404)


# ---- preload and survey


def test_a_preload_is_read():
    request = OLLAMA.preload()
    loaded = ollama_answer(done_reason="load", message={"role": "assistant", "content": ""})
    assert OLLAMA.read_preload(200, json.dumps(loaded).encode(), request).finish == "load"
    assert OPENAI.read_preload(200, b'{"data": [{"id": "m"}]}', OPENAI.preload()).finish == "load"


@pytest.mark.parametrize(
    ("wire", "reply", "cause"),
    [
        (OLLAMA, ollama_answer(done_reason="unload"), "unfinished"),
        (OLLAMA, ollama_answer(done=False), "unfinished"),
        (OLLAMA, ollama_answer(done_reason="load", remote_host="https://models.example.org"), "not_local"),
        (OPENAI, {"data": []}, "model_missing"),
        (OPENAI, {"error": "x"}, "http_5xx"),
    ],
)
def test_a_preload_that_loads_nothing_here_is_an_error(wire, reply, cause):
    with pytest.raises(ServerError) as caught:
        wire.read_preload(200, json.dumps(reply).encode(), wire.preload())
    assert caught.value.cause == cause


@pytest.mark.parametrize(
    ("model", "passed_on"),
    [
        ("x:cloud", True),
        ("x:27b-cloud", True),
        ("x:27B-Cloud", True),
        ("x", False),
        ("cloud", False),
        ("x-cloud", False),
    ],
)
def test_the_tag_of_a_model_tells_that_it_is_passed_on(model, passed_on):
    assert is_passed_on(model) is passed_on


def test_the_list_of_models_tells_what_they_can_do():
    listed = {
        "models": [
            {"name": "a:1", "capabilities": ["completion", "vision"]},
            {"name": "b:1", "capabilities": ["completion"]},
            {"name": "c:1"},
            {"name": "d:1", "capabilities": ["vision"], "remote_host": "https://models.example.org"},
            {"name": "e:cloud", "capabilities": ["vision"]},
        ]
    }
    models = read_tags(200, json.dumps(listed).encode(), tags_request())
    assert [m.sees for m in models] == [True, False, None, True, True]
    assert [m.is_remote for m in models] == [False, False, False, True, True]
    assert read_show(200, b'{"capabilities": ["vision"], "remote_model": "x"}', show_request("m"), "m").is_remote


@pytest.mark.parametrize("reply", [{}, {"models": {}}, {"models": [1]}, {"models": [{"name": 3}]}])
def test_another_list_is_a_bad_reply(reply):
    with pytest.raises(ServerError, match="bad_reply"):
        read_tags(200, json.dumps(reply).encode(), tags_request())


def test_every_cause_that_is_raised_is_in_the_list_and_the_other_way_round():
    package = Path(__file__).resolve().parents[1] / "src" / "core_perception"
    names = [
        "http_exchange",
        "reasoners/server_words",
        "reasoners/wire",
        "reasoners/vlm_client",
        "reasoners/ollama_models",
        "reasoners/recording",
    ]
    text = "".join((package / (name + ".py")).read_text() for name in names)
    raised = set(re.findall(r'ServerError\(\s*"(\w+)"', text))
    raised |= {cause for _, cause in CAUSES_BY_WORDS} | set(CAUSES_BY_STATUS.values())
    raised |= {"redirect", "http_4xx", "http_5xx"}  # by status, each tested above
    assert raised == set(SERVER_CAUSES)
