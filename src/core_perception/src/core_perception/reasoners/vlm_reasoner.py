# SPDX-License-Identifier: BSD-3-Clause
"""A vision-language model as reasoner: image and prompt to a server, its reply through the strict reader.

Source: [CORE] contextual safety reasoning. Differs: the reply is bound by a JSON schema and read strictly; a reply that
    fails changes nothing; an answer can carry a confidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import FrozenSet, Optional, Sequence, Tuple

from core_perception.exceptions import ReplyError, ServerError
from core_perception.ontology import Ontology
from core_perception.predicates import Constraints, Predicate, Verdict
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.base import Answer, Evidence, Reasoner
from core_perception.reasoners.vlm_client import BackOff
from core_perception.reply_parser import Reply, parse_reply, reply_schema

SAMPLE_TEMPERATURE = 0.7


@dataclass(frozen=True)
class Sampling:
    """How often a model is asked about one image, and what its confidence is taken from.

    Attributes:
        confidence: ``none``; ``samples``, agreement of further answers drawn at temperature 0.7 with the first one;
            ``logprobs``, geometric mean of the probabilities of the answer's tokens.
        samples: number of answers in all with ``samples``, >= 2.
        seed: of the sampler; the further answers take the seeds that follow.
    """

    confidence: str = "none"
    samples: int = 3
    seed: int = 0


class VlmReasoner(Reasoner):
    """Asks a server about one image at a time."""

    reads_image = True
    is_guarded = True
    reads_guidelines = True
    forgets = True

    def __init__(
        self,
        source: str,
        client,
        template: PromptTemplate,
        ontology: Ontology,
        sampling: Sampling = Sampling(),  # noqa: B008 - frozen
        is_slow: bool = True,
        back_off: Optional[BackOff] = None,
    ):
        """Keep the parts.

        Args:
            source: name in the statements, for example ``ollama``.
            client: has ``ask`` and ``close`` as VlmClient.
            template: the prompt.
            ontology: canonical names, and which classes are objects.
            sampling: seed, and how a confidence is found.
            is_slow: the client may take seconds of wall time.
            back_off: pause after failures of the server; None for none.
        """
        self.source, self.is_slow = source, is_slow
        self._client, self._template, self._ontology = client, template, ontology
        self._sampling, self._back_off = sampling, back_off
        self._schema = reply_schema(template.chain_of_thought)

    def close(self) -> None:
        """Abort the request under way."""
        self._client.close()

    def reason(self, evidence: Evidence) -> Answer:
        """Ask about evidence.image; a failure of the server or a malformed reply gives a void answer."""
        prompt = self._template.compose(evidence.guidelines)
        latency_s = 0.0
        try:
            first = self._client.ask(
                prompt.system, prompt.user, evidence.image, self._schema, self._sampling.seed, None
            )
            latency_s += first.latency_s
            reply = self._read(first)
        except ServerError as error:
            pause_s = self._back_off.failed() if self._back_off else 0.0
            return _void(error.cause, error, latency_s + error.latency_s, pause_s)
        except ReplyError as error:
            return _void(error.cause, error, latency_s)
        if self._back_off:
            self._back_off.succeeded()
        confidence, further_s = self._rate(first, reply, prompt, evidence.image)
        constraints = Constraints(
            tuple(p for p in reply.predicates if not self._is_unfounded(p)),
            reply.classes,
            reply.justification,
            self.source,
            evidence.stamp_ns,
            confidence=confidence,
        )
        return Answer(constraints, round((latency_s + further_s) * 1e9))

    def _read(self, model_reply) -> Reply:
        reply = parse_reply(model_reply.text, model_reply.thinking, self._is_object, self._ontology.canonical)
        if not reply.predicates:
            # Under a schema, a server closes a justification that would never have ended with lists that are empty.
            raise ReplyError("says_nothing", "the reply names no region")
        return reply

    def _is_unfounded(self, predicate: Predicate) -> bool:
        """Whether it would make ground safe by a class that nobody knows."""
        return predicate.verdict == Verdict.SAFE and not self._ontology.look_up(predicate.class_name).listed

    def _is_object(self, name: str) -> bool:
        return self._ontology.look_up(name).is_object

    def _rate(self, first, reply, prompt, image) -> Tuple[float, float]:
        """Confidence of the answer, NaN for none, and the time that took [s]."""
        sampling = self._sampling
        if sampling.confidence == "samples":
            further = [self._sample(prompt, image, sampling.seed + k) for k in range(1, sampling.samples)]
            return agreement(frozenset(reply.predicates), [f[0] for f in further]), sum(f[1] for f in further)
        if sampling.confidence == "logprobs" and first.token_logprobs:
            return math.exp(sum(first.token_logprobs) / len(first.token_logprobs)), 0.0
        return math.nan, 0.0

    def _sample(self, prompt, image, seed) -> Tuple[Optional[FrozenSet[Predicate]], float]:
        try:
            reply = self._client.ask(prompt.system, prompt.user, image, self._schema, seed, SAMPLE_TEMPERATURE)
        except ServerError as error:
            return None, error.latency_s
        try:
            return frozenset(self._read(reply).predicates), reply.latency_s
        except ReplyError:
            return None, reply.latency_s


def agreement(first: FrozenSet[Predicate], others: Sequence[Optional[FrozenSet[Predicate]]]) -> float:
    """Mean overlap of further answers with the first.

        c = 1/n sum_i |A intersect B_i| / |A union B_i|     (1 where both are empty, 0 for a B_i that failed)

    Args:
        first: predicates of the answer.
        others: predicates of the further ones, None for one that failed; at least one.

    Returns:
        0 (no answer shares a predicate) to 1 (all are equal).
    """
    overlaps = [
        0.0 if other is None else len(first & other) / len(first | other) if first | other else 1.0 for other in others
    ]
    return sum(overlaps) / len(overlaps)


def _void(cause: str, error: Exception, latency_s: float, pause_s: float = 0.0) -> Answer:
    return Answer(None, round(latency_s * 1e9), cause, str(error), round(pause_s * 1e9))
