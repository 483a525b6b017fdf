# SPDX-License-Identifier: BSD-3-Clause
"""Errors a user can cause, each with one line that says what is wrong and what is allowed."""

LONGEST_QUOTE = 200


def quote(value) -> str:
    """What somebody wrote, in a message: the beginning is enough, and all of it might be a whole file."""
    text = repr(value)
    return text if len(text) <= LONGEST_QUOTE else text[: LONGEST_QUOTE - 1] + "\u2026"


class PerceptionError(Exception):
    """Root of every error of this package."""


class ParameterError(PerceptionError, ValueError):
    """A parameter is wrong or unknown.

    Args:
        key: name of the parameter.
        value: what it was set to.
        allowed: what it may be.
    """

    def __init__(self, key: str, value, allowed: str):
        """Keep the three parts and compose the one line."""
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(f"{key}: got {quote(value)}, allowed {allowed}")


class PredicateError(PerceptionError, ValueError):
    """A predicate, a class name or a set of constraints breaks the grammar."""


class OntologyError(PerceptionError, ValueError):
    """The ontology file is missing, unreadable or contradicts itself."""


class EvidenceError(PerceptionError, ValueError):
    """Images or messages of one frame do not fit each other."""


class ReplyError(PerceptionError, ValueError):
    """A model's reply is malformed; it is void as a whole.

    Args:
        cause: one word of reply_parser.VOID_CAUSES, to count by.
        detail: what is wrong, in one line.
    """

    def __init__(self, cause: str, detail: str):
        """Keep both."""
        self.cause = cause
        super().__init__(f"{cause}: {detail}")


class ServerError(PerceptionError):
    """A model server did not give a reply.

    Args:
        cause: one word of vlm_client.SERVER_CAUSES, to count by.
        detail: what happened, in one line, without secrets.
        latency_s: time until it was known [s].
    """

    def __init__(self, cause: str, detail: str, latency_s: float = 0.0):
        """Keep the three."""
        self.cause, self.latency_s = cause, latency_s
        super().__init__(f"{cause}: {detail}")


class EndpointError(PerceptionError, ValueError):
    """A server address is malformed or not allowed."""


class RuleError(PerceptionError, ValueError):
    """An operator rule is malformed, or its file cannot be read or written."""
