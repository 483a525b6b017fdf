# SPDX-License-Identifier: BSD-3-Clause
"""Errors a user can cause, each with one line that says what is wrong and what is allowed."""


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
        super().__init__(f"{key}: got {value!r}, allowed {allowed}")


class PredicateError(PerceptionError, ValueError):
    """A predicate, a class name or a set of constraints breaks the grammar."""


class OntologyError(PerceptionError, ValueError):
    """The ontology file is missing, unreadable or contradicts itself."""


class EvidenceError(PerceptionError, ValueError):
    """Images or messages of one frame do not fit each other."""
