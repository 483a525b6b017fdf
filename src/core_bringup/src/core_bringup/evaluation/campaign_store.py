# SPDX-License-Identifier: BSD-3-Clause
"""The files of a campaign: trials.jsonl, which loses nothing, and what is computed from it.

DIR/campaign.json   what is asked for
DIR/trials.jsonl    one line per finished trial, in the order they ended; the newest line of an id counts
DIR/trials/<id>/    files of a finished trial
DIR/running/        trials under way; what a killed campaign left there is deleted
DIR/summary.json    counts and rates, DIR/trials.csv the same trials as a table: both rewritten now and then
"""

from __future__ import annotations

import csv
import errno
import fcntl
import json
import os
import shutil
import uuid
from pathlib import Path
from typing import Container, Dict, List, Mapping, Optional, Tuple

from core_bringup.evaluation.results import atomic_path, write_json
from core_bringup.evaluation.summary import summarize
from core_bringup.exceptions import ConfigError

TRIALS_NAME, SETTINGS_NAME, LOCK_NAME = "trials.jsonl", "campaign.json", ".lock"
# The first columns of trials.csv; the others follow in the order in which trials bring them.
FIRST_COLUMNS = ("id", "method", "profile", "world", "task", "trial", "seed", "outcome", "success", "attribution")


def read_trials(folder: Path) -> List[dict]:
    """The finished trials of a campaign, one record per id, in the order of the campaign's plan.

    A last line without its line end is what a killed campaign was writing: it is left out.

    Raises:
        ConfigError: there is no trials.jsonl, or a whole line of it is no record.
    """
    path = Path(folder) / TRIALS_NAME
    if not path.is_file():
        raise ConfigError(str(path), "file", "no such file", "the folder of a campaign")
    return _newest(_read_lines(path)[0])


def _read_lines(path: Path) -> Tuple[List[dict], int]:
    """All records of whole lines, and how many bytes these lines take."""
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    records = []
    for number, line in enumerate(data[:whole].splitlines(), start=1):
        try:
            record = json.loads(line.decode("utf-8"))
        except ValueError:
            record = None
        if not isinstance(record, dict) or not _is_record(record):
            raise ConfigError(str(path), f"line {number}", "no record of a trial", "a JSON object with an id per line")
        records.append(record)
    return records, whole


def _is_record(record: Mapping[str, object]) -> bool:
    """Whether a line says what counting and sorting need."""
    texts = all(isinstance(record.get(key), str) for key in ("id", "method", "profile"))
    return texts and isinstance(record.get("index", 0), int)


def _newest(records: List[dict]) -> List[dict]:
    by_id = {record["id"]: record for record in records}
    return sorted(by_id.values(), key=lambda record: (int(record.get("index") or 0), record["id"]))


def flatten(record: Mapping[str, object], prefix: str = "") -> Dict[str, object]:
    """Nested mappings as ``outer.inner`` keys; lists of plain values joined by ``;``, other lists left out."""
    flat: Dict[str, object] = {}
    for key, value in record.items():
        if isinstance(value, Mapping):
            flat.update(flatten(value, f"{prefix}{key}."))
        elif not isinstance(value, (list, tuple)):
            flat[f"{prefix}{key}"] = value
        elif not any(isinstance(item, (Mapping, list, tuple)) for item in value):
            flat[f"{prefix}{key}"] = ";".join(str(item) for item in value)
    return flat


class CampaignStore:
    """The folder of one campaign, held by one process; use as a context manager.

    Args:
        folder: DIR.
        settings: what is asked for; any JSON object.
        resume: go on with what is there.

    Raises:
        ConfigError: DIR holds something and resume is false, it holds another campaign, or somebody writes it now.
    """

    def __init__(self, folder: Path, settings: Mapping[str, object], resume: bool):
        """Check and prepare the folder."""
        self.folder = Path(folder)
        self._settings = json.loads(json.dumps(settings))
        self._records: Dict[str, dict] = {}
        self._lock = None
        self._stream: Optional[int] = None
        names = {entry.name for entry in _entries(self.folder)} - {LOCK_NAME}
        nothing_run = names <= {SETTINGS_NAME, TRIALS_NAME} and _is_empty(self.folder / TRIALS_NAME)
        if not resume and not nothing_run:
            raise ConfigError("evaluate", "--out", f"{self.folder} is not empty", "--resume, or another folder")
        if resume and names:
            path = self.folder / SETTINGS_NAME
            if not path.is_file():
                raise ConfigError("evaluate", "--resume", f"{path} is missing", "the folder of a campaign")
            _refuse_other_settings(path, self._settings)
        self.folder.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> CampaignStore:
        """Take the lock, drop a torn last line and what was under way, and open trials.jsonl for appending."""
        self._lock = (self.folder / LOCK_NAME).open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._lock.close()
            raise ConfigError("evaluate", "--out", f"{self.folder} is in use", "one campaign at a time") from error
        try:
            self._open()
        except BaseException:
            self._lock.close()
            raise
        return self

    def _open(self) -> None:
        write_json(self.folder / SETTINGS_NAME, self._settings)
        shutil.rmtree(str(self.folder / "running"), ignore_errors=True)
        path = self.folder / TRIALS_NAME
        path.touch()
        records, whole = _read_lines(path)
        self._records = {record["id"]: record for record in records}
        self._stream = os.open(str(path), os.O_WRONLY | os.O_APPEND)
        os.ftruncate(self._stream, whole)

    def __exit__(self, *_error) -> None:
        """Close; the lock ends with it."""
        os.close(self._stream)
        shutil.rmtree(str(self.folder / "running"), ignore_errors=True)
        self._lock.close()

    @property
    def records(self) -> List[dict]:
        """The finished trials, as read_trials gives them."""
        return _newest(list(self._records.values()))

    def refuse_strangers(self, planned: Container[str]) -> None:
        """Refuse records of trials that are not of this campaign.

        Args:
            planned: ids of all its trials.

        Raises:
            ConfigError: a record of another campaign is among ours.
        """
        for name in self._records:
            if name not in planned:
                source, allowed = str(self.folder / TRIALS_NAME), "trials of this campaign only"
                raise ConfigError(source, "id", f"{name!r} is no trial of this campaign", allowed)

    def find(self, trial_id: str) -> Optional[dict]:
        """The newest record of a trial, None when it has not been run."""
        return self._records.get(trial_id)

    def new_folder(self) -> Path:
        """A new folder for a trial under way; ``append`` moves it, and what is left of it ends with the campaign."""
        folder = self.folder / "running" / uuid.uuid4().hex[:12]
        folder.mkdir(parents=True)
        return folder

    def append(self, record: Mapping[str, object], files: Path) -> None:
        """Move a trial's files to their place, then write its line, which is on the disk when this returns.

        Args:
            record: JSON object with ``id`` and ``folder``, the place of the files relative to DIR.
            files: folder with the files.

        Raises:
            ValueError: the record holds NaN or infinity.
            OSError: the disk is full, or somebody has removed trials.jsonl.
        """
        line = json.dumps(record, allow_nan=False) + "\n"
        if os.fstat(self._stream).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "removed while the campaign ran", str(self.folder / TRIALS_NAME))
        place = self.folder / str(record["folder"])
        shutil.rmtree(str(place), ignore_errors=True)
        place.parent.mkdir(parents=True, exist_ok=True)
        Path(files).replace(place)
        data = line.encode("utf-8")
        while data:
            data = data[os.write(self._stream, data) :]
        os.fsync(self._stream)
        self._records[str(record["id"])] = dict(record)

    def write_summary(self, planned: int) -> dict:
        """Rewrite summary.json and trials.csv; returns the summary."""
        records = self.records
        summary = {**summarize(records, planned), "settings": self._settings}
        write_json(self.folder / "summary.json", summary)
        rows = [flatten(record) for record in records]
        columns = dict.fromkeys(FIRST_COLUMNS)
        for row in rows:
            columns.update(dict.fromkeys(row))
        path = self.folder / "trials.csv"
        with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, list(columns), restval="")
            writer.writeheader()
            writer.writerows(rows)
        return summary


def _entries(folder: Path) -> List[Path]:
    return list(folder.iterdir()) if folder.is_dir() else []


def _is_empty(path: Path) -> bool:
    return not path.exists() or path.stat().st_size == 0


def _refuse_other_settings(path: Path, wanted: Mapping[str, object]) -> None:
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(str(path), "file", "no JSON document", "what evaluate wrote") from error
    if not isinstance(kept, dict):
        raise ConfigError(str(path), "file", f"got {type(kept).__name__}", "a JSON object, as evaluate wrote it")
    for key in sorted({*kept, *wanted}):
        if kept.get(key) != wanted.get(key):
            problem = f"{key}: got {json.dumps(wanted.get(key))}"
            raise ConfigError(str(path), "--resume", problem, f"{json.dumps(kept.get(key))}, or another --out")
