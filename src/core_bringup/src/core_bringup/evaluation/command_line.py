# SPDX-License-Identifier: BSD-3-Clause
"""What the programs of this package share on the command line: options refused in one line, signals that end them."""

from __future__ import annotations

import argparse
import signal
from typing import Tuple

from core_bringup.exceptions import ConfigError


class OneLineParser(argparse.ArgumentParser):
    """A parser whose complaint is one line.

    Args:
        prog: name of the program.
        allowed: what the line says is allowed.
    """

    def __init__(self, prog: str, allowed: str):
        """No abbreviated options, and no help of its own."""
        super().__init__(prog=prog, add_help=False, allow_abbrev=False)
        self._allowed = allowed

    def error(self, message: str) -> None:
        """Refuse the options; ConfigError."""
        raise ConfigError(self.prog, "options", message, self._allowed)


def signals_to_note() -> Tuple[signal.Signals, ...]:
    """Signals that ask for an end: SIGINT, SIGTERM and SIGHUP, but no SIGHUP that is ignored, as under nohup."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    return tuple(n for n in numbers if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN)


def interrupt_on_signals() -> None:
    """Turn each of them into KeyboardInterrupt."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    for number in signals_to_note():
        signal.signal(number, interrupt)
