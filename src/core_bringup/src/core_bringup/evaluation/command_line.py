# SPDX-License-Identifier: BSD-3-Clause
"""What the programs of this package share on the command line: one line for what is wrong, and the exit status."""

from __future__ import annotations

import argparse
import signal
import sys
from dataclasses import dataclass
from typing import Callable, Optional, Sequence, Tuple

from core_bringup.exceptions import BringupError, ConfigError


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


@dataclass(frozen=True)
class Program:
    """One program.

    Attributes:
        name: put before what went wrong.
        help_text: printed for --help, an option that read must know.
        read: command line -> options; ConfigError for what is wrong.
        run: options -> exit status.
        interrupted: what is said of a run that a signal has ended.
    """

    name: str
    help_text: str
    read: Callable[[Sequence[str]], argparse.Namespace]
    run: Callable[[argparse.Namespace], int]
    interrupted: str


def run_program(program: Program, arguments: Optional[Sequence[str]] = None) -> int:
    """Run a program on a command line, its own when None, and tell in one line what ended it.

    Returns:
        Exit status: that of the program, 2 bad input, 1 something failed, 130 interrupted.
    """
    interrupt_on_signals()
    try:
        options = program.read(sys.argv[1:] if arguments is None else arguments)
        if options.help:
            print(program.help_text, end="")
            return 0
        return program.run(options)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except (BringupError, OSError) as error:
        print(f"{program.name}: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"interrupted; {program.interrupted}", file=sys.stderr)
        return 130
