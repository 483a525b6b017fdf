# SPDX-License-Identifier: BSD-3-Clause
"""Reads what a model server sent: an object in JSON, or an error and its cause. Bytes of a server are not trusted."""

from __future__ import annotations

import json
import re
from typing import Any, Dict, Tuple

from core_perception.exceptions import ServerError
from core_perception.http_exchange import HttpRequest

LONGEST_INTEGER = 20
LONGEST_QUOTE = 160
KEY_PART = 6
PROMPT_PART = 16
#: What the words of an error mean, where the status alone does not say it; first match counts.
CAUSES_BY_WORDS: Tuple[Tuple[str, str], ...] = (
    (r"exceed_context_size|context (size|length|window)", "context"),
    (r"does not match the expected .* format", "length"),  # llama.cpp's server, for an answer cut under a grammar
    (r"illegal base64|load image|image input|decode image|invalid image|image_url", "image_refused"),
    (r"model .*(not found|not exist)", "model_missing"),
)
CAUSES_BY_STATUS = {401: "denied", 403: "denied", 429: "overloaded", 503: "overloaded"}


def read_object(status: int, body: bytes, request: HttpRequest, model: str) -> Dict[str, Any]:
    """Return the JSON object of a reply.

    Args:
        status: of HTTP.
        body: bytes of the reply, already capped.
        request: what was asked; no part of it is quoted in an error.
        model: name of the model, which may be quoted.

    Raises:
        ServerError: redirect, denied, overloaded, model_missing, context, image_refused, length, http_4xx, http_5xx,
            or bad_reply.
    """
    content = _parse(body)
    if status == 200 and isinstance(content, dict) and not content.get("error"):
        return content
    if status == 200 and not isinstance(content, dict):
        raise ServerError("bad_reply", f"{len(body)} bytes that are not one JSON object")
    kind, words = _error_words(content, body)
    cause = _cause(status, f"{kind} {words}")
    quoted = _quote(words, request, model)
    raise ServerError(cause, f"status {status}" + (f", {quoted}" if quoted else ""))


def text_of(value: Any) -> str:
    """A string that can be encoded: null is empty, a half of a surrogate pair becomes a question mark.

    Raises:
        ServerError: bad_reply, anything but a string or null.
    """
    if value is None:
        return ""
    if not isinstance(value, str):
        raise ServerError("bad_reply", "the text of the answer is not a string")
    return value.encode("utf-8", "replace").decode("utf-8")


def logprobs_of(tokens: Any):
    """Tuple of the ``logprob`` of each token; None unless each is a finite number <= 0."""
    if not isinstance(tokens, list) or not tokens:
        return None
    values = [token.get("logprob") if isinstance(token, dict) else None for token in tokens]
    if not all(isinstance(value, (int, float)) and -1e9 < value <= 0.0 for value in values):
        return None
    return tuple(float(value) for value in values)


def check_finish(reason: Any) -> None:
    """Accept an answer that ended by itself.

    Raises:
        ServerError: length, it was cut at the limit of tokens; unfinished, it ended otherwise.
    """
    if reason == "length":
        raise ServerError("length", "the answer was cut at max_tokens")
    if reason != "stop":
        raise ServerError("unfinished", "the server ended the answer early")


def _short_integer(digits: str) -> int:
    if len(digits) > LONGEST_INTEGER:
        raise ValueError("too many digits")
    return int(digits)


def _parse(body: bytes):
    try:
        return json.loads(body.decode("utf-8"), parse_int=_short_integer)
    except (ValueError, RecursionError):
        return None


def _error_words(content, body: bytes) -> Tuple[str, str]:
    """Kind and message of an error: a string, an object, or an object written inside the string."""
    error = content.get("error", content) if isinstance(content, dict) else None
    if isinstance(error, str):
        inner = _parse(error.encode("utf-8", "replace"))
        if not isinstance(inner, dict):
            return "", error
        error = inner.get("error", inner)
    if isinstance(error, dict):
        kind, message = error.get("type"), error.get("message")
        return kind if isinstance(kind, str) else "", message if isinstance(message, str) else ""
    return "", "" if content is not None else body[: 4 * LONGEST_QUOTE].decode("utf-8", "replace")


def _cause(status: int, words: str) -> str:
    if 300 <= status < 400:
        return "redirect"
    if status in CAUSES_BY_STATUS:
        return CAUSES_BY_STATUS[status]
    for pattern, cause in CAUSES_BY_WORDS:
        if re.search(pattern, words[:1000], re.IGNORECASE):
            return cause
    if 400 <= status < 500:
        return "http_4xx"
    return "http_5xx" if status >= 500 or status == 200 else "bad_reply"


def _quote(words: str, request: HttpRequest, model: str) -> str:
    """The server's words in one short line, withheld where they repeat a part of the request."""
    line = " ".join("".join(c if c.isprintable() else " " for c in words[: 4 * LONGEST_QUOTE]).split())[:LONGEST_QUOTE]
    sent = request.body.decode("utf-8", "replace").replace(model, "")
    key = request.headers.get("Authorization", "").replace("Bearer ", "")
    if _shares(line, key, min(KEY_PART, len(key))) or _shares(line, sent, PROMPT_PART):
        return "the server's words repeat the request and are withheld"
    return f"the server says: {line}" if line else ""


def _shares(line: str, private: str, length: int) -> bool:
    """Whether any part of the line, of this many characters, is a part of the private text."""
    return length > 0 and any(line[start : start + length] in private for start in range(len(line) - length + 1))
