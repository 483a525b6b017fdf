# SPDX-License-Identifier: BSD-3-Clause
"""Records what a model server answered, and answers from a recording without server, key or weights.

``replies.jsonl`` in a folder, one JSON object a line, in the order of the asks:

    format_version   1
    image_sha256     of data type, shape and pixels; null where no image was sent
    prompt_sha256    of system text, user text, schema, seed and temperature; none of them is kept
    model, wire      which model, by which protocol
    latency_s        of the reply or of the failure, as the client measured it [s]
    text, thinking, finish, token_logprobs      of a reply
    error_cause, error_detail                   of a failure, instead of those

Only with ``keep_images`` the pixels are kept, as ``images/<image_sha256>.png``.
"""

from __future__ import annotations

import hashlib
import json
import math
import threading
from collections import defaultdict
from pathlib import Path
from typing import Dict, List, Optional, Tuple, Union

import cv2
import numpy as np

from core_perception.exceptions import ServerError
from core_perception.reasoners.wire import ModelReply
from core_perception.record_file import RecordFile, load_lines

FORMAT_VERSION = 1
FILE_NAME = "replies.jsonl"
_COMMON = {"format_version", "image_sha256", "prompt_sha256", "model", "wire", "latency_s"}
_REPLY = _COMMON | {"text", "thinking", "finish", "token_logprobs"}
_FAILURE = _COMMON | {"error_cause", "error_detail"}

Key = Tuple[Optional[str], str]


def hash_image(image_rgb: Optional[np.ndarray]) -> Optional[str]:
    """SHA-256 of an image's data type, shape and pixels, in hexadecimal; None for no image."""
    if image_rgb is None:
        return None
    header = f"{image_rgb.dtype.str} {image_rgb.shape} ".encode()
    return hashlib.sha256(header + np.ascontiguousarray(image_rgb).tobytes()).hexdigest()


def hash_prompt(system: str, user: str, schema: Optional[dict], seed: Optional[int], temperature) -> str:
    """SHA-256 of all that is asked besides the image, in hexadecimal.

    The order of the schema's properties counts, since models write them in that order.
    """
    parts = [system, user, schema, seed, None if temperature is None else float(temperature)]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


class RecordingClient:
    """Hands every ask to a client and writes down what comes of it; has ask() and close() of VlmClient."""

    def __init__(self, client, directory, model: str, wire: str, keep_images: bool = False):
        """Open the folder's file, or make both; a line that an earlier run left unfinished is cut off.

        Args:
            client: a VlmClient.
            directory: folder of the recording; further replies are added to one that is there.
            model: name of the model, for the reader of the file.
            wire: its protocol, the same.
            keep_images: keep the pixels too.

        Raises:
            PerceptionError: the folder or file cannot be written, is being recorded into, or is no recording.
        """
        self._client, self._directory = client, Path(directory)
        self._names = {"model": model, "wire": wire}
        self._keep_images = keep_images
        self._lock = threading.Lock()
        self._record = RecordFile(self._directory / FILE_NAME, _read_line)

    def ask(self, system, user, image_rgb, schema, seed=None, temperature=None) -> ModelReply:
        """Ask the client and write its reply or failure down before handing it on.

        Raises:
            ServerError: as the client; record_failed, the reply could not be written: a run with a gap in its recording
                would not repeat.
        """
        key = hash_image(image_rgb), hash_prompt(system, user, schema, seed, temperature)
        try:
            reply = self._client.ask(system, user, image_rgb, schema, seed, temperature)
        except ServerError as error:
            detail = str(error)[len(error.cause) + 2 :]
            entry = {"error_cause": error.cause, "error_detail": detail}
            self._write(key, image_rgb, entry, error.latency_s)
            raise
        entry = {"text": reply.text, "thinking": reply.thinking, "finish": reply.finish}
        self._write(key, image_rgb, {**entry, "token_logprobs": reply.token_logprobs}, reply.latency_s)
        return reply

    def close(self) -> None:
        """Abort the client's running ask, which is then not recorded, and end the recording."""
        with self._lock:
            self._record.close()
        self._client.close()

    def _write(self, key: Key, image_rgb, entry, latency_s) -> None:
        common = {"format_version": FORMAT_VERSION, "image_sha256": key[0], "prompt_sha256": key[1], **self._names}
        line = json.dumps({**common, "latency_s": latency_s, **entry}).encode()
        with self._lock:
            if not self._record.is_open:
                return
            try:
                _read_line(line)  # one line that cannot be read would make the whole recording useless
                if self._keep_images and image_rgb is not None:
                    _keep_image(self._directory / "images" / f"{key[0]}.png", image_rgb)
                self._record.append(line)
            except (OSError, ValueError, cv2.error) as error:
                raise ServerError("record_failed", f"{self._directory}: {error}", latency_s) from error


class ReplayClient:
    """Answers from a recording; has ask() and close() of VlmClient. One caller at a time.

    The same question gets its recorded outcomes in their order, failures too, and then the last one again. Nothing
    waits: the recorded latency is in the reply, for the caller to charge.
    """

    def __init__(self, directory):
        """Read the whole recording.

        Raises:
            PerceptionError: no recording there, or a line that is damaged; the message names file and line.
        """
        recorded, self._torn_lines = load_lines(Path(directory) / FILE_NAME, _read_line)
        self._outcomes: Dict[Key, List[Outcome]] = defaultdict(list)
        for key, outcome in recorded:
            self._outcomes[key].append(outcome)
        self._images = {key[0] for key in self._outcomes}
        self._asked: Dict[Key, int] = defaultdict(int)

    @property
    def torn_lines(self) -> int:
        """Number of lines that were ignored: 1 if the recording broke off within its last line, else 0."""
        return self._torn_lines

    def ask(self, system, user, image_rgb, schema, seed=None, temperature=None) -> ModelReply:
        """Return what was recorded.

        Raises:
            ServerError: the recorded failure; not_recorded, this image and prompt were never asked together.
        """
        key = hash_image(image_rgb), hash_prompt(system, user, schema, seed, temperature)
        if key not in self._outcomes:
            image = f"image {key[0][:12]}" if key[0] else "no image"
            known = "with other prompts or seeds only" if key[0] in self._images else "nowhere"
            raise ServerError("not_recorded", f"{image} with prompt {key[1][:12]}; that image is recorded {known}")
        outcomes = self._outcomes[key]
        outcome = outcomes[min(self._asked[key], len(outcomes) - 1)]
        self._asked[key] += 1
        if isinstance(outcome, ModelReply):
            return outcome
        raise ServerError(*outcome)

    def close(self) -> None:
        """Do nothing: nothing is held."""


#: A reply, or cause, detail and latency [s] of a failure.
Outcome = Union[ModelReply, Tuple[str, str, float]]


def _keep_image(path: Path, image_rgb) -> None:
    if image_rgb.dtype != np.uint8 or image_rgb.ndim != 3 or image_rgb.shape[2] != 3:
        raise ValueError(f"image: got {image_rgb.dtype} {image_rgb.shape}, allowed uint8 (h, w, 3)")
    if path.exists():
        return
    path.parent.mkdir(exist_ok=True)
    partial = path.with_suffix(".part")
    partial.write_bytes(cv2.imencode(".png", cv2.cvtColor(image_rgb, cv2.COLOR_RGB2BGR))[1].tobytes())
    partial.replace(path)


def _read_line(line: bytes) -> Tuple[Key, Outcome]:
    entry = json.loads(line.decode("ascii"))
    if not isinstance(entry, dict) or set(entry) not in (_REPLY, _FAILURE):
        raise ValueError(f"allowed exactly {', '.join(sorted(_REPLY))} or {', '.join(sorted(_FAILURE))}")
    if entry["format_version"] != FORMAT_VERSION:
        raise ValueError(f"format_version: got {entry['format_version']!r}, allowed {FORMAT_VERSION}")
    for name in set(entry) - {"format_version", "image_sha256", "latency_s", "token_logprobs"}:
        if not isinstance(entry[name], str):
            raise ValueError(f"{name}: got {entry[name]!r}, allowed text")
    if not isinstance(entry["image_sha256"], (str, type(None))):
        raise ValueError(f"image_sha256: got {entry['image_sha256']!r}, allowed text or null")
    if not _is_number(entry["latency_s"]) or entry["latency_s"] < 0.0:
        raise ValueError(f"latency_s: got {entry['latency_s']!r}, allowed a number >= 0")
    key = entry["image_sha256"], entry["prompt_sha256"]
    if "error_cause" in entry:
        return key, (entry["error_cause"], entry["error_detail"], entry["latency_s"])
    logprobs = entry["token_logprobs"]
    if logprobs is not None and not (isinstance(logprobs, list) and all(map(_is_number, logprobs))):
        raise ValueError("token_logprobs: allowed null or a list of numbers")
    logprobs = None if logprobs is None else tuple(logprobs)
    return key, ModelReply(entry["text"], entry["thinking"], logprobs, entry["finish"], entry["latency_s"])


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
