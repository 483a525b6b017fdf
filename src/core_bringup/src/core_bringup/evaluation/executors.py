# SPDX-License-Identifier: BSD-3-Clause
"""Where trials run: threads of this process, or the workers of a Dask cluster; both give standard futures."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Callable, Dict, List, Optional, Tuple

from core_bringup.evaluation.results import read_versions
from core_bringup.evaluation.trial_runner import RunRules, run_packed, run_trial, unpack
from core_bringup.evaluation.trial_spec import TrialSpec
from core_bringup.exceptions import BringupError, ConfigError

Finished = Tuple[Optional[dict], Path]  # record (None: given up) and the folder with the files
CONNECT_TIMEOUT_S = 10.0
ALLOWED_ADDRESS = "the address of a Dask scheduler, such as tcp://127.0.0.1:8786"


class LocalExecutor:
    """Trials on this machine, each followed by a thread of this process.

    Args:
        jobs: trials at the same time.
        rules: how trials are run.
        new_folder: makes an empty folder for the files of a trial.
    """

    def __init__(self, jobs: int, rules: RunRules, new_folder: Callable[[], Path]):
        """Start no thread yet."""
        self._jobs, self._rules, self._new_folder = jobs, rules, new_folder
        self._pool = ThreadPoolExecutor(max_workers=jobs)
        self._stop = threading.Event()

    def capacity(self) -> int:
        """Trials that can run at the same time."""
        return self._jobs

    def submit(self, spec: TrialSpec) -> Future:
        """Begin a trial; ``collect`` takes the future."""
        return self._pool.submit(self._run, spec)

    def collect(self, future: Future) -> Finished:
        """The outcome of a trial that is done; raises what it raised."""
        return future.result()

    def _run(self, spec: TrialSpec) -> Finished:
        folder = self._new_folder()
        return run_trial(spec, folder, self._rules, self._stop.is_set), folder

    def close(self) -> None:
        """Give up what is running, and wait until nothing of it is left."""
        self._stop.set()
        self._pool.shutdown(wait=True)


class DaskExecutor:
    """Trials on the workers of a Dask cluster that is there already.

    A worker needs the same workspace, not the same file system: it sends the files of a trial back. A trial whose
    worker dies is given to another by Dask.

    Args:
        address: of the scheduler.
        rules: how trials are run.
        new_folder: makes an empty folder for the files of a trial.

    Raises:
        ConfigError: nobody answers at the address, no worker is there, or one lacks the workspace.
    """

    def __init__(self, address: str, rules: RunRules, new_folder: Callable[[], Path]):
        """Connect and ask every worker for its versions."""
        try:
            import distributed
        except ImportError as error:
            raise ConfigError("evaluate", "--dask", str(error), "an environment with distributed installed") from error
        self._rules, self._new_folder = rules, new_folder
        try:
            self._client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            problem = f"{address}: {' '.join(str(error).split())}"
            raise ConfigError("evaluate", "--dask", problem, ALLOWED_ADDRESS) from error
        try:
            self.differences = self._check_workers()
        except BaseException:
            self._client.close()
            raise
        self._pool = self._client.get_executor(pure=False)

    def _check_workers(self) -> List[str]:
        """One line for every worker that computes with other versions than this process."""
        if not self._client.nthreads():
            raise ConfigError("evaluate", "--dask", "the cluster has no worker", "dask worker, at least one")
        try:
            found: Dict[str, dict] = self._client.run(read_versions)
        except Exception as error:  # whatever a worker raises on importing the workspace arrives here
            problem = f"a worker cannot run a trial: {' '.join(str(error).split())}"
            raise ConfigError("evaluate", "--dask", problem, "workers started by ./core.sh run dask worker") from error
        own, lines = read_versions(), []
        for address, versions in sorted(found.items()):
            other = [f"{k} {versions.get(k)} (here {own.get(k)})" for k in own if versions.get(k) != own.get(k)]
            if other:
                lines.append(f"worker {address} has other versions: {', '.join(other)}")
        return lines

    def capacity(self) -> int:
        """Threads of all workers, each of which runs one trial at a time; 1 while there is none, to wait for one.

        Raises:
            BringupError: the scheduler has gone.
        """
        try:
            return max(1, sum(self._client.nthreads().values()))
        except Exception as error:  # Dask raises many kinds, some of them only by name
            raise BringupError(f"the Dask scheduler has gone: {' '.join(str(error).split())}") from error

    def submit(self, spec: TrialSpec) -> Future:
        """Begin a trial; ``collect`` takes the future."""
        return self._pool.submit(run_on_worker, spec, self._rules)

    def collect(self, future: Future) -> Finished:
        """The outcome of a trial that is done; raises what the worker raised."""
        record, files = future.result()
        folder = self._new_folder()
        unpack(files, folder)
        return record, folder

    def close(self) -> None:
        """Give up what is running; the workers end it within seconds, and stay."""
        self._pool.shutdown(wait=False)
        self._client.close()


def run_on_worker(spec: TrialSpec, rules: RunRules) -> Tuple[Optional[dict], bytes]:
    """What a Dask worker runs; its process may be killed at any moment, which takes the graph with it."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def unwanted() -> bool:
        # The client has cancelled the trial, or has gone.
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    return run_packed(spec, rules, unwanted, worker.local_directory)
