# SPDX-License-Identifier: BSD-3-Clause
"""Ollama's and llama.cpp's side of a chat: what a request is refused for and how replies look. No sockets here."""

import base64
import binascii
import datetime
import json
import math
import re
from dataclasses import dataclass
from typing import Optional, Tuple

import cv2
import numpy as np

VERSION = "0.33.0"
DEFAULT_CONTEXT = 4096
IMAGE_TOKENS = 256
SCHEMA_TYPES = {"object", "array", "string", "number", "integer", "boolean", "null"}
INTEGER_OPTIONS = ("num_ctx", "num_predict", "seed", "top_k")
NUMBER_OPTIONS = ("temperature", "top_p", "min_p", "repeat_penalty")
DURATION_UNITS_S = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
SAID_BY_COLOUR = {"red": "traffic_cone", "green": "plant", "blue": "wet_floor_sign"}


class RefusalError(Exception):
    """A reply other than 200."""

    def __init__(self, status, body):
        super().__init__(status)
        self.status = status
        self.body = body if isinstance(body, bytes) else json.dumps(body).encode()


@dataclass(frozen=True)
class Chat:
    """A chat request of either protocol, read."""

    model: str
    system: str
    user: str
    images: Tuple[np.ndarray, ...]  # bgr
    has_messages: bool
    schema: Optional[dict]
    stream: bool
    think: Optional[bool]
    logprobs: bool
    context: int
    max_tokens: int
    keep_alive_s: float
    options: dict


def full_name(model):
    return model if ":" in model.rpartition("/")[2] else model + ":latest"


def seconds(keep_alive):
    """A Go duration or a number of seconds; negative is for ever, absent is five minutes."""
    if keep_alive is None:
        return 300.0
    if isinstance(keep_alive, bool) or not isinstance(keep_alive, (int, float, str)):
        raise RefusalError(400, {"error": "Unsupported type: '%s'" % type(keep_alive).__name__})
    if isinstance(keep_alive, str):
        parts = re.findall(r"(\d+(?:\.\d*)?)(ns|us|ms|s|m|h)", keep_alive)
        if not parts or "".join(a + b for a, b in parts) != keep_alive.lstrip("+-"):
            reason = "missing unit in duration" if re.fullmatch(r"-?\d+", keep_alive) else "invalid duration"
            raise RefusalError(400, {"error": 'time: %s "%s"' % (reason, keep_alive)})
        keep_alive = sum(float(a) * DURATION_UNITS_S[b] for a, b in parts) * (-1 if keep_alive[0] == "-" else 1)
    return math.inf if keep_alive < 0 else float(keep_alive)


def read_json(body):
    if not body:
        raise RefusalError(400, {"error": "missing request body"})
    try:
        value = json.loads(body.decode())
    except ValueError:
        raise RefusalError(400, {"error": "invalid character in JSON: unexpected end or token"}) from None
    if not isinstance(value, dict):
        raise RefusalError(400, {"error": "json: cannot unmarshal value into Go value of type api.ChatRequest"})
    return value


def read_image(encoded):
    """Raw base64 of a picture, as Ollama wants it; a data URL is refused."""
    good = re.match(r"[A-Za-z0-9+/]*", encoded).end()
    if good < len(encoded.rstrip("=")):
        raise RefusalError(400, {"error": "illegal base64 data at input byte %d" % good})
    try:
        data = base64.b64decode(encoded, validate=True)
    except binascii.Error:
        raise RefusalError(400, {"error": "illegal base64 data at input byte %d" % len(encoded)}) from None
    return decode_image(data, nested=True)


def decode_image(data, nested):
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if image is None:
        error = {
            "error": {"code": 400, "message": "Failed to load image or audio file", "type": "invalid_request_error"}
        }
        raise RefusalError(400, {"error": json.dumps(error)} if nested else error)
    return image


def check_schema(schema):
    """Refuse what llama.cpp cannot turn into a grammar."""
    kind = schema.get("type")
    if kind is not None and kind not in SCHEMA_TYPES:
        raise RefusalError(400, {"error": "failed to parse grammar: unrecognized schema"})
    children = list(schema.get("properties", {}).values()) + [schema.get("items")]
    for child in children:
        if isinstance(child, dict):
            check_schema(child)


def read_ollama_chat(body):
    """Read POST /api/chat."""
    value = read_json(body)
    model, messages = value.get("model", ""), value.get("messages") or []
    options, schema = value.get("options") or {}, value.get("format")
    stream, think = value.get("stream", True), value.get("think")
    if not isinstance(messages, list) or not all(isinstance(message, dict) for message in messages):
        raise RefusalError(400, {"error": "json: cannot unmarshal into Go struct field ChatRequest.messages"})
    if not isinstance(model, str) or not isinstance(stream, bool):
        raise RefusalError(400, {"error": "json: cannot unmarshal into Go struct field ChatRequest"})
    images = tuple(read_image(image) for message in messages for image in message.get("images") or [])
    if not model:
        raise RefusalError(400, {"error": "model is required"})
    keep_alive_s = seconds(value.get("keep_alive"))
    if messages and schema not in (None, "", "json") and not isinstance(schema, dict):
        raise RefusalError(500, {"error": 'invalid format: "%s"; expected "json" or a JSON schema' % schema})
    for names, kinds in ((INTEGER_OPTIONS, int), (NUMBER_OPTIONS, (int, float))):
        for name in names:
            if name in options and (isinstance(options[name], bool) or not isinstance(options[name], kinds)):
                raise RefusalError(500, {"error": 'option "%s" must be of type %s' % (name, "number")})
    if isinstance(schema, dict):
        check_schema(schema)
    text = {
        role: "".join(m.get("content", "") for m in messages if m.get("role") == role) for role in ("system", "user")
    }
    return Chat(
        model=model,
        system=text["system"],
        user=text["user"],
        images=images,
        has_messages=bool(messages),
        schema=schema if isinstance(schema, dict) else None,
        stream=stream,
        think=think,
        logprobs=bool(value.get("logprobs")),
        context=options.get("num_ctx", DEFAULT_CONTEXT),
        max_tokens=options.get("num_predict", -1),
        keep_alive_s=keep_alive_s,
        options=options,
    )


def read_openai_chat(body):
    """Read POST /v1/chat/completions as llama.cpp's server does."""
    try:
        value = read_json(body)
        messages = value["messages"]
        form = (value.get("response_format") or {}).get("json_schema", {}).get("schema")
        text, images = {"system": "", "user": ""}, []
        for message in messages:
            content = message["content"]
            for part in content if isinstance(content, list) else [{"type": "text", "text": content}]:
                if part["type"] == "text":
                    text[message["role"]] = text.get(message["role"], "") + part["text"]
                else:
                    url = part["image_url"]["url"]
                    found = re.fullmatch(r"data:image/\w+;base64,([A-Za-z0-9+/=]+)", url)
                    if not found:
                        raise RefusalError(400, openai_error(400, "Invalid url value", "invalid_request_error"))
                    images.append(decode_image(base64.b64decode(found.group(1)), nested=False))
    except RefusalError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError):
        raise RefusalError(500, openai_error(500, "malformed request", "server_error")) from None
    return Chat(
        model=value.get("model", ""),
        system=text["system"],
        user=text["user"],
        images=tuple(images),
        has_messages=bool(messages),
        schema=form,
        stream=bool(value.get("stream", False)),
        think=None,
        logprobs=bool(value.get("logprobs")),
        context=DEFAULT_CONTEXT * 2,
        max_tokens=value.get("max_tokens", -1),
        keep_alive_s=math.inf,
        options={key: value[key] for key in ("temperature", "seed", "max_tokens") if key in value},
    )


def openai_error(code, message, kind, **more):
    return {"error": {"code": code, "message": message, "type": kind, **more}}


def prompt_tokens(chat):
    return (len(chat.system) + len(chat.user)) // 4 + IMAGE_TOKENS * len(chat.images) + 8


def check_context(chat, nested):
    """Refuse a prompt longer than the context: Ollama hands on llama.cpp's error as a string."""
    if prompt_tokens(chat) < chat.context:
        return
    message = "request (%d tokens) exceeds the available context size (%d tokens), try increasing it"
    error = openai_error(
        400,
        message % (prompt_tokens(chat), chat.context),
        "exceed_context_size_error",
        n_prompt_tokens=prompt_tokens(chat),
        n_ctx=chat.context,
    )
    raise RefusalError(400, {"error": json.dumps(error)} if nested else error)


def pieces(text):
    """A stand-in of tokens: four characters each."""
    return [text[start : start + 4] for start in range(0, len(text), 4)]


def colour_of(image):
    """red, green or blue where the mean of the picture has that hue, else grey."""
    blue, green, red = (float(v) for v in image.reshape(-1, 3).mean(axis=0))
    values = {"red": red, "green": green, "blue": blue}
    best = max(values, key=values.get)
    return best if values[best] > 1.2 * sorted(values.values())[1] + 8 else "grey"


def answer_by_colour(chat):
    """The default answer, in the format the prompt asks for; it depends on the picture."""
    colour = colour_of(chat.images[0]) if chat.images else "absent"
    thing = SAID_BY_COLOUR.get(colour)
    answer = {
        "safety_logic": "The picture is mostly %s." % colour,
        "classes": ["floor"] + ([thing] if thing else []),
        "unsafe_regions": ["NEAR(%s)" % thing] if thing else [],
        "safe_regions": ["ON(floor)"],
    }
    if chat.schema is None:
        return "Here is the result:\n```json\n%s\n```" % json.dumps(answer, indent=1)
    wanted = chat.schema.get("properties", answer)
    return json.dumps({key: answer[key] for key in wanted if key in answer})


def now_text():
    return datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def ollama_reply(chat, text, thinking, reason, duration_s):
    """The object of a whole answer; reason None is the abort after a repeated token: done false and no counts."""
    message = {"role": "assistant", "content": text}
    if thinking:
        message["thinking"] = thinking
    reply = {"model": chat.model, "created_at": now_text(), "message": message, "done": reason is not None}
    if reason is None:
        return reply
    reply["done_reason"] = reason
    if reason in ("load", "unload"):
        return reply
    tokens = pieces(text)
    total_ns = int(duration_s * 1e9)
    reply.update(total_duration=total_ns, load_duration=1000, prompt_eval_count=prompt_tokens(chat))
    reply.update(prompt_eval_duration=total_ns // 2, eval_count=len(tokens), eval_duration=total_ns // 2)
    if chat.logprobs:
        reply["logprobs"] = [{"token": t, "logprob": -0.01 * (1 + k % 5)} for k, t in enumerate(tokens)]
    return reply


def ollama_stream(chat, reply):
    """The same answer in lines of ndjson."""
    lines = []
    for token in pieces(reply["message"]["content"]):
        part = {"role": "assistant", "content": token}
        lines.append({"model": chat.model, "created_at": now_text(), "message": part, "done": False})
    if reply["done"]:
        lines.append({**reply, "message": {**reply["message"], "content": ""}})
    return [json.dumps(line).encode() + b"\n" for line in lines]


def openai_reply(chat, text, thinking, reason, duration_s):
    """The object of a whole answer of llama.cpp's server."""
    tokens = pieces(text)
    message = {"role": "assistant", "content": text}
    if thinking:
        message["reasoning_content"] = thinking
    choice = {"finish_reason": reason, "index": 0, "message": message}
    if chat.logprobs:
        content = [{"id": k, "token": t, "logprob": -0.01 * (1 + k % 5)} for k, t in enumerate(tokens)]
        choice["logprobs"] = {"content": content}
    usage = {"completion_tokens": len(tokens), "prompt_tokens": prompt_tokens(chat)}
    usage["total_tokens"] = usage["completion_tokens"] + usage["prompt_tokens"]
    return {
        "choices": [choice],
        "created": 0,
        "id": "chatcmpl-fake",
        "model": chat.model,
        "object": "chat.completion",
        "system_fingerprint": "b10488",
        "timings": {"predicted_ms": duration_s * 1e3, "predicted_n": len(tokens)},
        "usage": usage,
    }


def openai_stream(chat, reply):
    """The same answer as server-sent events."""
    choice = reply["choices"][0]
    events = []
    for token in pieces(choice["message"]["content"]):
        part = {"choices": [{"delta": {"content": token}, "index": 0, "finish_reason": None}]}
        events.append({**part, "object": "chat.completion.chunk", "model": chat.model})
    last = {"choices": [{"delta": {}, "index": 0, "finish_reason": choice["finish_reason"]}]}
    events.append({**last, "object": "chat.completion.chunk", "model": chat.model})
    return [b"data: " + json.dumps(event).encode() + b"\n\n" for event in events] + [b"data: [DONE]\n\n"]
