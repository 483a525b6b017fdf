# SPDX-License-Identifier: BSD-3-Clause
"""Has a model loaded before it is asked: Ollama gives up loading when a client with a short deadline hangs up."""

from __future__ import annotations

import time
from dataclasses import replace

from core_perception.exceptions import ServerError
from core_perception.reasoners.vlm_client import VlmClient
from core_perception.reasoners.wire import ModelReply


class LoadingClient:
    """Has ask() and close() of VlmClient; what loading takes is part of the latency."""

    def __init__(self, client: VlmClient):
        """Keep the client."""
        self._client = client

    def ask(self, system, user, image_rgb, schema, seed=None, temperature=None) -> ModelReply:
        """Load the model if it may not be loaded, then ask.

        Raises:
            ServerError: as VlmClient; a server that does not answer at all is not waited for.
        """
        begun_s = time.monotonic()
        try:
            # A model that is there but does not answer is not waited for as long as one that has to be loaded.
            if not self._client.is_loaded and not self._client.probe():
                self._client.preload()
            reply = self._client.ask(system, user, image_rgb, schema, seed, temperature)
        except ServerError as error:
            error.latency_s = time.monotonic() - begun_s
            raise
        return replace(reply, latency_s=time.monotonic() - begun_s)

    def close(self) -> None:
        """As VlmClient."""
        self._client.close()
