# SPDX-License-Identifier: BSD-3-Clause
"""Runs the trials of a plan until all are recorded, the time is up or the user has had enough; loses none."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections import deque
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Deque, Dict, Iterator, Optional, Sequence

from core_bringup.evaluation.campaign_progress import CampaignProgress
from core_bringup.evaluation.campaign_store import CampaignStore
from core_bringup.evaluation.command_line import signals_to_note
from core_bringup.evaluation.demo_run import RunReport
from core_bringup.evaluation.trial_runner import make_record
from core_bringup.evaluation.trial_spec import TrialSpec

POLL_S = 0.5
SUMMARY_PERIOD_S = 60.0
MAX_LOST = 2  # a trial whose executor failed under it this often is an error


class Campaign:
    """One run over what is left of a plan.

    Args:
        plan: all trials in their order.
        store: where finished trials go; open.
        executor: LocalExecutor or DaskExecutor.
        retry_errors: run trials again that are recorded as errors.
        limit_s: wall time after which no trial is begun any more [s]; None: no limit.
    """

    def __init__(
        self,
        plan: Sequence[TrialSpec],
        store: CampaignStore,
        executor,
        retry_errors: bool = False,
        limit_s: Optional[float] = None,
    ):
        """Find out what is left."""
        self._plan, self._store, self._executor = plan, store, executor
        self._limit_s = limit_s
        store.refuse_strangers({spec.id for spec in plan})
        self._queue: Deque[TrialSpec] = deque(spec for spec in plan if self._is_open(spec, retry_errors))
        self._running: Dict[Future, TrialSpec] = {}
        self._lost: Dict[str, int] = {}
        self._interrupted = threading.Event()
        self.progress = CampaignProgress(plan, store.records)

    def _is_open(self, spec: TrialSpec, retry_errors: bool) -> bool:
        record = self._store.find(spec.id)
        return record is None or (retry_errors and record.get("outcome") == "error")

    @property
    def interrupted(self) -> bool:
        """The user has asked to stop."""
        return self._interrupted.is_set()

    def run(self) -> dict:
        """Run what is left; returns the summary.

        Ctrl-C, SIGTERM and SIGHUP (but under nohup) end it: what is running is given up, what has finished is recorded.

        Raises:
            BringupError: the executor has gone.
            OSError: the files of the campaign cannot be written.
        """
        with self._signals_noted():
            try:
                self._loop()
            finally:
                self._executor.close()
                self._take_last()
                self.progress.close()
                summary = self._store.write_summary(len(self._plan))
        return summary

    def _loop(self) -> None:
        begun_at = written_at = time.monotonic()
        while (self._queue or self._running) and not self.interrupted:
            if self._limit_s is not None and time.monotonic() - begun_at >= self._limit_s and self._queue:
                self.progress.say(f"{self._limit_s:g} s are over: {len(self._queue)} trials are not begun any more")
                self._queue.clear()
            room = self._executor.capacity() - len(self._running) if self._queue else 0
            for _ in range(min(room, len(self._queue))):
                spec = self._queue.popleft()
                self._running[self._executor.submit(spec)] = spec
            if not self._running:
                continue
            for future in wait(self._running, POLL_S, FIRST_COMPLETED).done:
                self._take(future, self._running.pop(future))
            if time.monotonic() - written_at >= SUMMARY_PERIOD_S:
                self._store.write_summary(len(self._plan))
                written_at = time.monotonic()

    def _take_last(self) -> None:
        """Record what has finished between the signal and the end of the executor."""
        for future, spec in self._running.items():
            if self.interrupted and future.done() and not future.cancelled() and future.exception() is None:
                self._take(future, spec)

    def _take(self, future: Future, spec: TrialSpec) -> None:
        try:
            record, folder = self._executor.collect(future)
        except BaseException as error:  # a worker that died, a pickle that failed, a cancelled future: all are counted
            failure = f"{type(error).__name__}: {' '.join(str(error).split())}"
            self._lost[spec.id] = self._lost.get(spec.id, 0) + 1
            if self._lost[spec.id] < MAX_LOST:
                self.progress.say(f"{spec.id} is run again: {failure}")
                self._queue.appendleft(spec)
                return
            record, folder = make_record(spec, RunReport(1, None, failure), 0.0), self._store.new_folder()
        if record is None:  # given up
            return
        if spec.id in self._lost:
            record["lost_runs"] = self._lost[spec.id]
        renewed = self._store.find(spec.id) is not None
        try:
            self._store.append(record, folder)
        except ValueError as error:  # not a number in it: as an error it is told, and not run again for ever
            record = make_record(spec, RunReport(1, None, f"a result that is no JSON: {error}"), 0.0)
            self._store.append(record, folder)
        self.progress.add(record, renewed)

    @contextlib.contextmanager
    def _signals_noted(self) -> Iterator[None]:
        """Inside the block a signal to stop is only noted: it tears nothing that is written, and no clean-up."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        kept = {number: signal.signal(number, lambda *_: self._interrupted.set()) for number in signals_to_note()}
        try:
            yield
        finally:
            for number, handler in kept.items():
                signal.signal(number, handler)
