# SPDX-License-Identifier: BSD-3-Clause
import collections
import contextlib
import json
import os
import random
import shutil
import socket
import ssl
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from fakes.fake_model_server import FakeModelServer, control
from fakes.ollama_protocol import SAID_BY_COLOUR

from core_perception import http_exchange
from core_perception.endpoint import Endpoint
from core_perception.exceptions import EndpointError, EvidenceError, ReplyError, ServerError
from core_perception.picture_file import write_picture
from core_perception.predicates import parse_predicate
from core_perception.reasoners.loading_client import LoadingClient
from core_perception.reasoners.vlm_client import SERVER_CAUSES, BackOff, VlmClient
from core_perception.reasoners.wire import OllamaWire, OpenAiWire
from core_perception.reply_parser import parse_reply

FAKE = Path(__file__).resolve().parent / "fakes" / "fake_model_server.py"
SECRET_PROMPT = "The vault in corridor seven is guarded by nobody at night."
SCHEMA = {
    "type": "object",
    "properties": {
        "safety_logic": {"type": "string"},
        "classes": {"type": "array"},
        "unsafe_regions": {"type": "array"},
        "safe_regions": {"type": "array"},
    },
}
SLACK_S = 0.3
WIRES = [OllamaWire("gemma3:27b"), OpenAiWire("gemma3:27b")]
both_wires = pytest.mark.parametrize("wire", WIRES, ids=["ollama", "openai"])


def picture(red=0, green=0, blue=0, shape=(48, 64)):
    return np.full(shape + (3,), (red, green, blue), np.uint8)


def client_of(url, wire=WIRES[0], deadline_s=5.0, **settings):
    return VlmClient(wire, Endpoint.parse(url), deadline_s, settings.pop("load_timeout_s", 20.0), **settings)


def ask(client, image=None, user="What is safe here?", **more):
    return client.ask(SECRET_PROMPT, user, picture(red=200) if image is None else image, SCHEMA, **more)


def cause_of(client, **more):
    with pytest.raises(ServerError) as caught:
        ask(client, **more)
    assert caught.value.cause in SERVER_CAUSES
    return caught.value.cause


@pytest.fixture
def server():
    with FakeModelServer() as running:
        yield running


class RawServer:
    """Answers every connection with the same bytes after it has read the head of a request, then hangs up.

    reads: False never reads and answers at once. drains: False hangs up with the rest of the request unread.
    """

    def __init__(self, *parts, pause_s=0.0, reads=True, drains=True):
        self._parts, self._pause_s, self._reads, self._drains = parts, pause_s, reads, drains
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=64)
        self.url = "http://127.0.0.1:%d" % self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                connection = self._listener.accept()[0]
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection):
        with contextlib.suppress(OSError), connection:
            if self._reads:
                connection.recv(1 << 20)
            for part in self._parts:
                connection.sendall(part)
                time.sleep(self._pause_s)
            if not self._drains:
                time.sleep(0.2)
            elif self._reads:
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(1 << 20):
                    pass
            else:
                time.sleep(30.0)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._listener.close()


# ---- answers


@both_wires
def test_the_answer_depends_on_the_picture(server, wire):
    client = client_of(server.url, wire)
    colours = {"red": picture(red=200), "blue": picture(blue=200), "grey": picture(90, 90, 90)}
    texts = {name: json.loads(ask(client, image).text) for name, image in colours.items()}
    assert texts["red"]["unsafe_regions"] == ["NEAR(traffic_cone)"]
    assert texts["blue"]["unsafe_regions"] == ["NEAR(wet_floor_sign)"]
    assert texts["grey"]["unsafe_regions"] == []


@both_wires
def test_prompt_schema_seed_and_temperature_arrive(server, wire):
    ask(client_of(server.url, wire), user="Line 1\n\u00e4 \u4e2d", seed=7, temperature=0.7)
    (seen,) = server.chats()
    assert (seen["system"], seen["user"], seen["schema"]) == (SECRET_PROMPT, "Line 1\n\u00e4 \u4e2d", SCHEMA)
    assert (seen["options"]["seed"], seen["options"]["temperature"]) == (7, 0.7)
    assert list(seen["schema"]["properties"]) == list(SCHEMA["properties"])


@both_wires
def test_a_question_without_picture_is_answered(server, wire):
    assert "absent" in client_of(server.url, wire).ask("s", "u", None, SCHEMA).text
    assert server.chats()[0]["images"] == []


@both_wires
def test_latency_is_that_of_the_whole_call(server, wire):
    server.latency_s = 0.2
    begun_s = time.monotonic()
    reply = ask(client_of(server.url, wire))
    took_s = time.monotonic() - begun_s
    assert 0.2 <= reply.latency_s <= took_s < 0.2 + SLACK_S
    assert reply.latency_s > took_s - 0.02


@both_wires
def test_token_probabilities_are_read_where_asked_for(server, wire):
    with_them = type(wire)(wire.model, logprobs=True)
    assert len(ask(client_of(server.url, with_them)).token_logprobs) > 3
    assert ask(client_of(server.url, wire)).token_logprobs is None


def test_a_picture_keeps_its_colours_and_its_shape_and_is_scaled_to_the_longest_edge():
    image = picture(200, 40, 10, shape=(300, 1200))
    image[:, 600:] = (10, 40, 200)
    decoded = cv2.imdecode(np.frombuffer(write_picture(image, 600)[0], np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    assert decoded.shape == (150, 600, 3)
    assert np.abs(decoded[:, :280].astype(int) - (200, 40, 10)).max() < 12
    assert np.abs(decoded[:, 320:].astype(int) - (10, 40, 200)).max() < 12


def test_a_small_picture_is_not_scaled_and_a_thin_one_keeps_a_pixel():
    small = cv2.imdecode(np.frombuffer(write_picture(picture(shape=(7, 9)), 600)[0], np.uint8), cv2.IMREAD_COLOR)
    thin = cv2.imdecode(np.frombuffer(write_picture(picture(shape=(1, 3000)), 600)[0], np.uint8), cv2.IMREAD_COLOR)
    assert (small.shape, thin.shape) == ((7, 9, 3), (1, 600, 3))


@pytest.mark.parametrize(
    "image",
    [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)],
)
def test_a_picture_of_another_kind_is_refused_and_leaves_the_client_free(server, image):
    client = client_of(server.url)
    with pytest.raises(EvidenceError):
        ask(client, image)
    assert ask(client).text


def test_a_view_of_a_picture_can_be_sent(server):
    ask(client_of(server.url), picture(red=200, shape=(96, 128))[::2, ::-2])
    assert server.chats()[0]["images"][0]["shape"] == [48, 64, 3]


# ---- faults


@both_wires
@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("500", "http_5xx"),
        ("garbage", "bad_reply"),
        ("huge", "too_large"),
        ("nothing", "bad_reply"),
        ("close", "disconnected"),
        ("midway", "disconnected"),
        ("length", "length"),
        ("unfinished", "unfinished"),
        ("redirect", "redirect"),
        ("overloaded", "overloaded"),
    ],
)
def test_a_fault_has_its_cause_and_the_next_question_is_answered(server, wire, fault, cause):
    client = client_of(server.url, wire)
    server.set_fault(fault, count=1)
    assert cause_of(client) == cause
    assert ask(client).text


@both_wires
@pytest.mark.parametrize("fault", ["hang", "drip", "drip_headers"])
def test_the_deadline_holds_against_a_server_that_hangs_or_drips(server, wire, fault):
    client = client_of(server.url, wire, deadline_s=0.6)
    ask(client)
    server.set_fault(fault, count=1, bytes_per_s=50)
    begun_s = time.monotonic()
    with pytest.raises(ServerError, match="timeout") as caught:
        ask(client)
    took_s = time.monotonic() - begun_s
    assert 0.6 <= took_s < 0.6 + SLACK_S
    assert 0.6 <= caught.value.latency_s <= took_s
    assert ask(client).text


def drips(count, *head):
    return [*head, *([b"x"] * count)]


@pytest.mark.parametrize(
    "parts",
    [
        drips(500),
        drips(500, b"HTTP/1.1 200 OK\r\nX: "),
        drips(500, b"HTTP/1.1 200 OK\r\n\r\n"),
        drips(500, b"HTTP/1.1 200 OK\r\nContent-Length: 5000\r\n\r\n"),
        [b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"] + [b"1\r\nx\r\n"] * 500,
        [b"HTTP/1.1 100 Continue\r\n\r\n"] * 500,
        [b"HTTP/1.1 200 OK\r\n"] + [b"X: y\r\n"] * 90 + [b""] * 500,
    ],
    ids=["status", "header", "body", "long_body", "chunks", "continues", "headers"],
)
def test_the_deadline_holds_against_every_drip_of_single_bytes(parts):
    with RawServer(*parts, pause_s=0.02) as drip:
        begun_s = time.monotonic()
        assert cause_of(client_of(drip.url, WIRES[1], deadline_s=0.5)) == "timeout"
        assert 0.5 <= time.monotonic() - begun_s < 0.5 + SLACK_S


def test_the_deadline_holds_while_the_server_does_not_read_a_long_request():
    with RawServer(reads=False) as deaf:
        client = client_of(deaf.url, WIRES[1], deadline_s=0.5)
        begun_s = time.monotonic()
        with pytest.raises(ServerError) as caught:
            client.ask("s" * 16_000_000, "u", None, None)
        assert caught.value.cause == "timeout"
        assert time.monotonic() - begun_s < 0.5 + 2 * SLACK_S


def test_the_deadline_holds_while_the_name_server_hangs(monkeypatch):
    release = threading.Event()
    monkeypatch.setattr(http_exchange.socket, "getaddrinfo", lambda *_, **__: release.wait(20.0) and [])
    begun_s = time.monotonic()
    assert cause_of(client_of("http://localhost:9", deadline_s=0.4)) == "timeout"
    assert time.monotonic() - begun_s < 0.4 + SLACK_S
    release.set()


def test_the_deadline_holds_in_the_hand_shake_of_tls():
    with RawServer(reads=False) as mute:
        begun_s = time.monotonic()
        assert cause_of(client_of(mute.url.replace("http:", "https:"), deadline_s=0.4)) == "timeout"
        assert time.monotonic() - begun_s < 0.4 + SLACK_S


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_close_hangs_up_even_in_the_hand_shake_of_tls(scheme):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = client_of("%s://127.0.0.1:%d" % (scheme, listener.getsockname()[1]), WIRES[1], deadline_s=20.0)
        thread, outcome = in_background(lambda: ask(client))
        with listener.accept()[0] as connection:
            connection.settimeout(3.0)
            assert connection.recv(1)
            client.close()
            begun_s = time.monotonic()
            while connection.recv(1 << 16):
                pass
            assert time.monotonic() - begun_s < SLACK_S
        thread.join(3.0)
        assert outcome[0].cause == "closed"


def test_ten_megabytes_are_not_read_to_the_end(server):
    server.set_fault("huge")
    begun_s = time.monotonic()
    assert cause_of(client_of(server.url)) == "too_large"
    assert time.monotonic() - begun_s < 2.0
    endless = [b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"] + [b"10000\r\n" + b"x" * 65536 + b"\r\n"] * 400
    with RawServer(*endless) as raw:
        assert cause_of(client_of(raw.url, WIRES[1])) == "too_large"


def test_a_reply_of_exactly_the_cap_is_read_and_one_byte_more_is_not():
    body = json.dumps({"choices": [{"finish_reason": "stop", "message": {"content": "a" * 500}}]}).encode()
    head = b"HTTP/1.1 200 OK\r\n\r\n"
    with RawServer(head + body) as raw:
        assert len(ask(client_of(raw.url, WIRES[1], max_reply_bytes=len(body))).text) == 500
        assert cause_of(client_of(raw.url, WIRES[1], max_reply_bytes=len(body) - 1)) == "too_large"


def test_a_redirect_is_not_followed(server):
    with FakeModelServer() as other:
        server.set_fault("redirect", scope="all")
        head = b"HTTP/1.1 307 Temporary Redirect\r\nLocation: %s/v1/chat/completions\r\n" % other.url.encode()
        with RawServer(head + b"Content-Length: 0\r\n\r\n") as raw:
            assert cause_of(client_of(raw.url, WIRES[1])) == "redirect"
        assert other.log() == []


def test_no_proxy_is_used(server, monkeypatch):
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    monkeypatch.setenv("no_proxy", "")
    assert ask(client_of(server.url)).text


def test_a_compressed_reply_is_refused():
    body = b'{"choices": [{"finish_reason": "stop", "message": {"content": "a"}}]}'
    with RawServer(b"HTTP/1.1 200 OK\r\nContent-Encoding: gzip\r\n\r\n" + body) as raw:
        assert cause_of(client_of(raw.url, WIRES[1])) == "bad_reply"


def test_an_error_that_comes_before_the_request_was_read_is_told():
    reply = b"HTTP/1.1 503 Busy\r\nContent-Length: 0\r\n\r\n"
    with RawServer(reply, drains=False) as raw:
        client = client_of(raw.url, WIRES[1])
        with pytest.raises(ServerError) as caught:
            client.ask("s" * 12_000_000, "u", None, None)
        assert caught.value.cause == "overloaded"


def test_fuzz_of_replies_in_http_never_raises_anything_else():
    draw = random.Random(int(os.environ.get("CORE_SEED", "0")))
    parts = b'{"choices":[{"finish_reason":"stop","messag', b'e":{"content":"abc"}}]}', b""
    whole = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"
    whole += b"".join(b"%x\r\n%s\r\n" % (len(part), part) for part in parts)
    outcomes = collections.Counter()
    for _ in range(300):
        data = bytearray(whole)
        for _ in range(draw.choice((0, 1, 1, 2, 5, 30))):
            spot = draw.randrange(len(data))
            if draw.random() < 0.5:
                data[spot] = draw.randrange(256)
            elif draw.random() < 0.5:
                del data[spot : spot + draw.randrange(1, 20)]
            else:
                data[spot:spot] = bytes(draw.choice(b"-0f\r\n: \xff") for _ in range(draw.randrange(1, 30)))
            data = data or bytearray(b"H")
        with RawServer(bytes(data)) as raw:
            try:
                assert isinstance(ask(client_of(raw.url, WIRES[1], deadline_s=3.0)).text, str)
                outcomes["answered"] += 1
            except ServerError as error:
                assert error.cause in SERVER_CAUSES
                outcomes[error.cause] += 1
    assert outcomes["answered"] > 20
    assert outcomes["bad_reply"] + outcomes["disconnected"] > 50
    assert outcomes["timeout"] == 0, outcomes


@both_wires
def test_200_frames_with_faults_in_between_leave_nothing_unhandled(server, wire):
    draw = random.Random(int(os.environ.get("CORE_SEED", "0")))
    client = client_of(server.url, wire, deadline_s=0.25)
    kinds = "ok hang drip drip_headers 500 garbage huge other_schema nothing close length unfinished thinking redirect "
    colours = [(picture(red=200), "red"), (picture(green=200), "green"), (picture(blue=200), "blue")]
    causes, expected = collections.Counter(), collections.Counter()
    for frame in range(200):
        fault = draw.choice((kinds + "midway").split()) if frame % 3 == 0 else "ok"
        image, colour = colours[frame % 3]
        server.set_fault(fault, count=1)
        expected[fault in ("ok", "other_schema", "thinking")] += 1
        begun_s = time.monotonic()
        try:
            reply = ask(client, image)
            causes["answered"] += 1
            stated = parse_reply(reply.text, reply.thinking).predicates
            assert parse_predicate(f"NEAR({SAID_BY_COLOUR[colour]})=unsafe") in stated
        except ReplyError:
            assert fault == "other_schema"
            causes["void"] += 1
        except ServerError as error:
            causes[error.cause] += 1
        assert time.monotonic() - begun_s < 0.25 + SLACK_S
    assert causes["answered"] == expected[True], causes
    assert sum(causes.values()) == 200 + causes["void"]
    assert causes["void"] > 0
    assert set(causes) >= {"timeout", "disconnected", "bad_reply", "too_large", "length", "redirect", "http_5xx"}


# ---- loading


def test_a_context_other_than_the_loaded_one_loads_anew_and_constant_options_do_not():
    with FakeModelServer(load_s=0.1) as server:
        client = client_of(server.url)
        client.preload()
        for seed in range(3):
            ask(client, seed=seed, temperature=0.1 * seed)
        assert server.models.loads == 1
        ask(client_of(server.url, OllamaWire("gemma3:27b", context_tokens=4096)))
        assert server.models.loads == 2


def test_a_deadline_shorter_than_the_load_never_succeeds_but_a_preload_does():
    with FakeModelServer(load_s=0.6) as server:
        client = client_of(server.url, deadline_s=0.3)
        assert [cause_of(client) for _ in range(2)] == ["timeout", "timeout"]
        assert server.models.loads == 0
        assert not client.is_loaded
        reply = client.preload()
        assert reply.finish == "load"
        assert 0.6 <= reply.latency_s < 0.6 + SLACK_S
        assert client.is_loaded
        assert ask(client).text


def test_a_model_is_held_to_be_loaded_until_the_server_gives_reason_to_doubt_it(server):
    client = client_of(server.url, deadline_s=0.3)
    assert not client.is_loaded
    ask(client)
    assert client.is_loaded
    server.set_fault("length", count=1)
    assert cause_of(client) == "length"
    assert client.is_loaded
    for fault in ("hang", "500", "close", "overloaded"):
        ask(client)
        server.set_fault(fault, count=1)
        cause_of(client)
        assert not client.is_loaded


def test_a_probe_tells_within_two_seconds_whether_the_model_is_loaded_and_loads_nothing(server):
    client = client_of(server.url)
    assert not client.probe()
    assert not client.is_loaded
    assert server.models.loads == 0
    ask(client)
    assert client.probe()
    # Another context means that the next question loads the model anew.
    wire = OllamaWire(client._wire.model, context_tokens=client._wire.context_tokens * 2)
    assert not client_of(server.url, wire).probe()
    assert not client_of(server.url, OllamaWire("absent")).probe()
    server.set_fault("hang", scope="all")
    begun_s = time.monotonic()
    with pytest.raises(ServerError, match="timeout") as caught:
        client.probe()
    assert 2.0 <= caught.value.latency_s <= time.monotonic() - begun_s < 2.0 + SLACK_S


def test_a_server_that_does_not_tell_is_taken_to_have_nothing_loaded():
    with RawServer(b"HTTP/1.1 404 Not Found\r\n\r\n") as raw:
        assert not client_of(raw.url).probe()


def test_a_model_that_is_loaded_and_hangs_is_waited_for_no_longer_than_an_answer(server):
    client = client_of(server.url)
    loading = LoadingClient(client)
    loading.ask("s", "u", None, None)
    server.set_fault("hang")
    begun_s = time.monotonic()
    for _ in range(2):
        with pytest.raises(ServerError, match="timeout"):
            loading.ask("s", "u", None, None)
    assert time.monotonic() - begun_s < 2.0 * (client._deadline_s + SLACK_S)
    server.set_fault("ok")
    assert loading.ask("s", "u", None, None).finish == "stop"


def test_a_model_that_is_not_loaded_is_loaded_first_and_that_counts_as_latency():
    with FakeModelServer(load_s=1.2) as server:
        client = VlmClient(OllamaWire("gemma3:27b"), Endpoint.parse(server.url), 0.8, 10.0)
        assert LoadingClient(client).ask("s", "u", None, None).latency_s >= 1.2
        assert server.models.loads == 1


@both_wires
def test_a_preload_loads_and_sends_no_prompt_and_no_picture(server, wire):
    assert client_of(server.url, wire).preload().finish == "load"
    assert server.chats() == []
    assert bool(server.models.loads) == (wire.name == "ollama")


@pytest.mark.parametrize(
    ("wire", "cause"),
    [
        (OllamaWire("absent"), "model_missing"),
        (OllamaWire("gemma3:27b", context_tokens=800, max_tokens=10), "context"),
        (OllamaWire("gemma3:27b", max_tokens=5), "length"),
        (OpenAiWire("gemma3:27b", max_tokens=5), "length"),
        (OllamaWire("gemma3:27b", think=True), "http_4xx"),
    ],
)
def test_a_question_the_model_cannot_answer_has_its_cause(server, wire, cause):
    client = client_of(server.url, wire)
    with pytest.raises(ServerError) as caught:
        client.ask("s" * 4000, "u", picture(), SCHEMA)
    assert caught.value.cause == cause


# ---- where images may go


def test_a_model_that_ollama_passes_on_is_refused_before_a_picture_is_sent():
    models = {"alias:1": {"capabilities": ("vision",), "remote_host": "https://models.example.org"}}
    with FakeModelServer(models=models) as server:
        client = client_of(server.url, OllamaWire("alias:1"))
        assert cause_of(client) == "not_local"
        with pytest.raises(ServerError, match="not_local"):
            client.preload()
        assert server.chats() == []
        allowed = VlmClient(OllamaWire("alias:1"), Endpoint.parse(server.url, (), True), 5.0, 5.0)
        assert ask(allowed).text


def test_a_model_whose_tag_says_cloud_is_refused_at_the_start():
    with pytest.raises(EndpointError, match="another machine"):
        client_of("http://127.0.0.1:1", OllamaWire("gemma3:27b-cloud"))


def test_where_the_model_runs_is_asked_once_and_again_after_a_failure(server):
    client = client_of(server.url)
    for _ in range(3):
        ask(client)
    assert [entry["path"] for entry in server.log()].count("/api/show") == 1
    server.set_fault("close", count=1)
    cause_of(client)
    ask(client)
    assert [entry["path"] for entry in server.log()].count("/api/show") == 2


def test_a_local_name_that_resolves_elsewhere_is_refused(monkeypatch):
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("192.0.2.7", 80))]
    monkeypatch.setattr(http_exchange.socket, "getaddrinfo", lambda *_, **__: found)
    assert cause_of(client_of("http://localhost:80", WIRES[1])) == "not_local"


def test_every_address_of_a_name_is_tried(server, monkeypatch):
    closed = socket.create_server(("127.0.0.1", 0))
    dead = closed.getsockname()
    closed.close()
    found = [
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", dead),
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", server.port)),
    ]
    monkeypatch.setattr(http_exchange.socket, "getaddrinfo", lambda *_, **__: found)
    assert ask(client_of("http://localhost:80", WIRES[1])).text


def test_a_name_that_does_not_resolve_is_unreachable(monkeypatch):
    def fail(*_, **__):
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(http_exchange.socket, "getaddrinfo", fail)
    assert cause_of(client_of("http://localhost:80", WIRES[1])) == "unreachable"


def make_certificate(folder, name):
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=" + name]
    command += [
        "-addext",
        "subjectAltName=DNS:" + name,
        "-keyout",
        str(folder / "key.pem"),
        "-out",
        str(folder / "c.pem"),
    ]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
    return folder / "c.pem", folder / "key.pem"


class SaysYes(BaseHTTPRequestHandler):
    def do_POST(self):
        self.rfile.read(int(self.headers["Content-Length"]))
        body = json.dumps({"choices": [{"finish_reason": "stop", "message": {"content": "yes"}}]}).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.mark.skipif(not shutil.which("openssl"), reason="makes a certificate with openssl")
@pytest.mark.parametrize(
    ("name", "is_trusted", "cause"),
    [("localhost", True, None), ("localhost", False, "tls"), ("else.where", True, "tls")],
)
def test_tls_wants_a_trusted_certificate_of_that_name(tmp_path, monkeypatch, name, is_trusted, cause):
    certificate, key = make_certificate(tmp_path, name)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(str(certificate), str(key))
    server = HTTPServer(("127.0.0.1", 0), SaysYes)
    server.socket = context.wrap_socket(server.socket, server_side=True)
    server.handle_error = lambda *_: None
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    if is_trusted:
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    client = client_of("https://localhost:%d" % server.server_port, WIRES[1])
    try:
        if cause:
            assert cause_of(client) == cause
        else:
            assert ask(client).text == "yes"
    finally:
        server.shutdown()
        server.server_close()


# ---- one at a time, several robots


def in_background(call):
    outcome = []

    def run():
        try:
            outcome.append(call())
        except ServerError as error:
            outcome.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread, outcome


def wait_for(condition, limit_s=3.0):
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "the condition did not come about"
        time.sleep(0.005)


def test_a_second_question_while_one_is_in_flight_is_refused_and_does_not_harm_the_first(server):
    client = client_of(server.url)
    server.latency_s = 0.3
    thread, outcome = in_background(lambda: ask(client))
    wait_for(server.chats)
    assert cause_of(client) == "busy"
    with pytest.raises(ServerError, match="busy"):
        client.preload()
    thread.join(3.0)
    assert outcome[0].text
    assert len(server.chats()) == 1


@both_wires
def test_close_ends_a_question_at_once_and_the_server_stops_working_on_it(server, wire):
    client = client_of(server.url, wire, deadline_s=20.0)
    server.latency_s = 10.0
    thread, outcome = in_background(lambda: ask(client))
    wait_for(server.chats)
    begun_s = time.monotonic()
    client.close()
    thread.join(3.0)
    assert time.monotonic() - begun_s < 0.2
    assert outcome[0].cause == "closed"
    wait_for(lambda: server.chats()[0]["outcome"] == "cancelled", 1.0)
    assert cause_of(client) == "closed"
    with pytest.raises(ServerError, match="closed"):
        client.preload()


def test_a_deadline_that_passes_cancels_the_work_on_the_server(server):
    client = client_of(server.url, deadline_s=0.3)
    server.latency_s = 10.0
    assert cause_of(client) == "timeout"
    wait_for(lambda: server.chats()[0]["outcome"] == "cancelled", 1.0)
    server.latency_s = 0.0
    assert ask(client).text


def test_robots_share_a_server_fairly(server):
    server.latency_s = 0.02
    stop = threading.Event()
    counts = collections.Counter()

    def drive(name):
        client = client_of(server.url)
        while not stop.is_set():
            ask(client, user=name)
            counts[name] += 1

    threads = [threading.Thread(target=drive, args=("robot %d" % k,), daemon=True) for k in range(4)]
    for thread in threads:
        thread.start()
    wait_for(lambda: sum(counts.values()) >= 60, 20.0)
    stop.set()
    for thread in threads:
        thread.join(3.0)
    order = [entry["user"] for entry in server.chats()]
    begun = order[8:56]  # once all have begun
    assert len(set(order)) == 4
    shares = [begun.count(name) for name in set(order)]
    assert max(shares) - min(shares) <= 1, shares


@contextlib.contextmanager
def process(*arguments):
    running = subprocess.Popen([sys.executable, str(FAKE), *arguments], stdout=subprocess.PIPE, text=True)
    try:
        yield running, "http://127.0.0.1:%d" % int(running.stdout.readline())
    finally:
        running.kill()
        running.wait()
        running.stdout.close()


def test_a_server_that_is_killed_and_comes_back_answers_again():
    with process() as (running, url):
        client = client_of(url)
        assert ask(client).text
        control(url, "/_latency", {"seconds": 30.0})
        thread, outcome = in_background(lambda: ask(client))
        wait_for(lambda: len([e for e in control(url, "/_log") if e.get("has_messages")]) == 2)
        running.kill()
        running.wait()  # until then its socket may still listen
        thread.join(3.0)
        assert outcome[0].cause == "disconnected"
        assert cause_of(client) == "refused"
        assert not client.is_loaded
    with process("--port", url.rpartition(":")[2]) as (_, again):
        assert again == url
        assert ask(client).text


# ---- secrets


@both_wires
@pytest.mark.parametrize(
    "fault",
    ["hang", "drip", "500", "garbage", "huge", "nothing", "close", "length", "unfinished", "redirect", "overloaded"],
)
def test_no_text_of_an_exception_holds_key_prompt_or_picture(monkeypatch, server, wire, fault):
    monkeypatch.setenv("CORE_TEST_KEY", "sk-7h15-15-53cr37")
    if wire.name == "openai":
        wire = OpenAiWire("gemma3:27b", "CORE_TEST_KEY")
        server.api_key = "sk-7h15-15-53cr37"
    server.set_fault(fault)
    client = client_of(server.url, wire, deadline_s=0.3)
    with pytest.raises(ServerError) as caught:
        ask(client)
    error, texts = caught.value, []
    while error is not None:
        texts += [str(error), repr(error)]
        error = error.__cause__ or error.__context__
    texts.append(repr(client) + repr(wire))
    assert not any(secret in " ".join(texts) for secret in ("53cr37", "vault", "corridor", "/9j/"))


def test_a_wrong_key_is_denied(monkeypatch, server):
    server.api_key = "right"
    monkeypatch.setenv("CORE_TEST_KEY", "wrong")
    assert cause_of(client_of(server.url, OpenAiWire("gemma3:27b", "CORE_TEST_KEY"))) == "denied"
    monkeypatch.setenv("CORE_TEST_KEY", "right")
    assert ask(client_of(server.url, OpenAiWire("gemma3:27b", "CORE_TEST_KEY"))).text


# ---- back-off


def test_pauses_double_up_to_the_longest_and_begin_anew_after_a_success():
    back_off = BackOff("robot_1", 0.5, 10.0)
    for _ in range(2):
        pauses = [back_off.failed() for _ in range(10)]
        ceilings = [1.0, 2.0, 4.0, 8.0] + [10.0] * 6
        assert all(max(0.5, c / 2) <= pause <= c for pause, c in zip(pauses, ceilings))
        back_off.succeeded()


def test_pauses_differ_between_robots_and_repeat_for_one():
    def pauses(name):
        back_off = BackOff(name)
        return [back_off.failed() for _ in range(5)]

    assert pauses("robot_1") == pauses("robot_1")
    firsts = {round(pauses("robot_%d" % k)[0], 2) for k in range(40)}
    assert len(firsts) > 15
