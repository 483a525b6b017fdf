# SPDX-License-Identifier: BSD-3-Clause
"""What a campaign shows while it runs: a bar with the time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from typing import Dict, List, Mapping, Sequence

from tqdm import tqdm

from core_bringup.evaluation.summary import method_heading
from core_bringup.evaluation.trial_spec import TrialSpec

COUNT_PERIOD = 20  # finished trials between two plain lines of counts


class CampaignProgress:
    """Counts trials per method and shows them on stderr.

    Args:
        plan: all trials.
        done: records of those that are there already.
    """

    def __init__(self, plan: Sequence[TrialSpec], done: Sequence[Mapping[str, object]]):
        """Show the start."""
        self._total = len(plan)
        self._finished, self._begun_at = len(done), time.monotonic()
        self._new = 0
        self._counts: Dict[str, List[int]] = {method_heading(s.method.name, s.method.profile): [0, 0, 0] for s in plan}
        for record in done:
            self._count(record)
        self._bar = None
        if sys.stderr.isatty():
            self._bar = tqdm(
                total=self._total, initial=self._finished, desc="evaluate", unit="trial", file=sys.stderr,
                dynamic_ncols=True, smoothing=0.05,
            )  # fmt: skip

    def add(self, record: Mapping[str, object], renewed: bool = False) -> None:
        """Show one more finished trial; a renewed one replaces an error that was counted before."""
        self._new += 1
        self._finished += 0 if renewed else 1
        if renewed:
            self._uncount_error(record)
        self._count(record)
        line = f"[{self._finished}/{self._total}] {format_trial(record)}"
        if self._bar is None:
            print(f"{line}  {self._time_left()}", file=sys.stderr, flush=True)
            if self._new % COUNT_PERIOD == 0:
                print(self.counts(), file=sys.stderr, flush=True)
            return
        if record.get("outcome") == "error" or not record.get("success"):
            self._bar.write(line, file=sys.stderr)
        self._bar.set_postfix_str(self.counts(), refresh=False)
        self._bar.update(0 if renewed else 1)

    def say(self, text: str) -> None:
        """One line that stays."""
        if self._bar is None:
            print(text, file=sys.stderr, flush=True)
        else:
            self._bar.write(text, file=sys.stderr)

    def counts(self) -> str:
        """Successes of trials so far, for every method."""
        return ", ".join(
            f"{name} {good}/{n}" + (f" ({errors} errors)" if errors else "")
            for name, (good, n, errors) in self._counts.items()
        )

    def close(self) -> None:
        """Leave the bar as it is."""
        if self._bar is not None:
            self._bar.close()

    def _count(self, record: Mapping[str, object]) -> None:
        count = self._counts[method_heading(record["method"], record["profile"])]
        count[0] += bool(record.get("success"))
        count[1] += 1
        count[2] += record.get("outcome") == "error"

    def _uncount_error(self, record: Mapping[str, object]) -> None:
        count = self._counts[method_heading(record["method"], record["profile"])]
        count[1] -= 1
        count[2] -= 1

    def _time_left(self) -> str:
        left_s = (time.monotonic() - self._begun_at) / self._new * max(0, self._total - self._finished)
        return f"about {left_s / 60.0:.0f} min left" if left_s >= 60.0 else f"about {left_s:.0f} s left"


def format_trial(record: Mapping[str, object]) -> str:
    """One trial in one line: id, outcome, wall time, and why when it is an error."""
    text = f"{record['id']}  {record.get('outcome')}"
    if not record.get("success") and record.get("outcome") != "error":
        cause = record.get("attribution")
        text += " (failure" + (f": {cause})" if cause else ")")
    text += f"  {float(record.get('wall_s') or 0.0):.1f} s"
    if int(record.get("attempt") or 1) > 1:
        text += f", attempt {record['attempt']}"
    return text + (f"  {record['failure']}" if record.get("failure") else "")
