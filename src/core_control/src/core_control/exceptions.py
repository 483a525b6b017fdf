# SPDX-License-Identifier: BSD-3-Clause
"""Errors of this package; every one has CoreControlError as its root."""


class CoreControlError(Exception):
    """Root of every error of this package."""


class ParameterError(CoreControlError, ValueError):
    """A parameter is wrong or unknown.

    Args:
        key: name of the parameter, for example ``footprint/length_m``.
        value: what was given.
        allowed: what would be right.
    """

    def __init__(self, key: str, value: object, allowed: str):
        """Keep the three parts and compose the one line."""
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(f"{key}: got {value!r}, allowed {allowed}")


class GridError(CoreControlError, ValueError):
    """A safety grid contradicts itself: array lengths, cell size or an unknown state value."""


class SolverError(CoreControlError, RuntimeError):
    """The quadratic program gave no answer that passes its check; the message says which check failed."""


class OverrideError(CoreControlError, ValueError):
    """An override that was asked for is not granted; the message says why."""
