# SPDX-License-Identifier: BSD-3-Clause
"""Errors a user can cause, each with one line that says what is wrong and what is allowed."""


class BringupError(Exception):
    """Root of every error of this package."""


class ConfigError(BringupError, ValueError):
    """A world, task, robot or parameter is wrong.

    Args:
        source: file or node the value stands in.
        key: path of the key, for example ``objects[2].pose``.
        problem: what is wrong, with the value.
        allowed: what would be right.
    """

    def __init__(self, source: str, key: str, problem: str, allowed: str):
        """Keep the four parts and compose the one line."""
        self.source, self.key, self.problem, self.allowed = str(source), key, problem, allowed
        super().__init__(f"{source}: {key}: {problem}; allowed: {allowed}")


class StallError(BringupError):
    """A lock-step run waited longer than its wall-clock limit; the message names the node awaited."""
