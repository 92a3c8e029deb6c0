# SPDX-License-Identifier: GPL-3.0-or-later
"""One run from beginning to end: search if needed, train, evaluate, put into place.

A job is data, so that another machine of a cluster can do it; files in a shared folder are all it needs.
"""

import json
import os
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ...backend.jobs.pools import Outcome
from ...backend.jobs.process import THREAD_VARIABLES, StoppedError, run_to_end
from ...backend.runs.log import LOG_FILE
from ...backend.train.config import CONFIG_FILE
from ...bridge.atomic import patiently
from ...bridge.errors import PhysHDRError
from .external import read_cost
from .runs import (
    FAILED_FILE,
    RUN_FILE,
    RUN_LOG,
    SEARCH_FILE,
    Failure,
    Record,
    Search,
    differences,
    has_gaussians,
    holds_training,
    put_in_place,
    write_json,
)
from .search import Measurement, nearest, next_trial, note_on

USAGE_FILE = "usage.json"
#: Folders of trainings from which one will be chosen.
TRIAL = "trial_"
#: Starts the command ``physhdr`` with a number of threads and a file for its usage.
PROGRAM = (sys.executable, "-m", "physhdr.lab.benchmark.child")
LINES_KEPT = 15
ANSI = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@dataclass(frozen=True, kw_only=True)
class Job:
    """``work``: a folder beside ``final``, which it becomes. If it vanishes, the job ends without a result.

    ``train``: arguments of ``physhdr train``, without folder and iterations; ``config``: what they amount to.
    ``iterations``: None if they have to be found for ``seconds`` of CPU time, from ``known`` if not None.
    ``record``: the run's record, without what training reports. ``only_evaluate``: ``final`` is trained.
    ``trained``: ``work`` is, by a command that could not put it in place; ``record`` is complete.
    ``pictures``: another program's pictures, which are evaluated; nothing is trained.
    ``alone``: no other command can work on this run, so that the next one reuses a training in ``work``.
    """

    final: Path
    work: Path
    data: Path
    train: tuple[str, ...]
    evaluate: tuple[str, ...]
    config: dict[str, Any]
    iterations: int | None
    seconds: float = 0.0
    known: Measurement | None = None
    record: Record
    only_evaluate: bool = False
    trained: bool = False
    pictures: Path | None = None
    alone: bool = False
    program: tuple[str, ...] = PROGRAM


class _FailedError(Exception):
    """A process failed: at which stage, with which status, and why if it did not report that itself."""

    def __init__(self, stage: str, status: int, why: str = "") -> None:
        super().__init__(stage, status, why)
        self.stage, self.status, self.why = stage, status, why


def execute(job: Job, should_stop: Callable[[], bool] = lambda: False) -> Outcome:
    """Do the job; its processes have ended afterwards, whatever happens.

    If results cannot be written (a full disk, a file in the way), it fails without a ``failed.json``.
    A training that has ended by then stays in ``work`` if the job is ``alone``.
    """
    try:
        job.work.mkdir(parents=True, exist_ok=True)
        try:
            return _done(job, should_stop)
        except _FailedError as error:
            return _failed(job, error)
    except StoppedError:
        outcome = Outcome("stopped")
    except (OSError, PhysHDRError) as error:
        gone = isinstance(error, FileNotFoundError) and not job.work.exists()
        outcome = Outcome("stopped") if gone else Outcome("failed", _why(job, error))
    remove_work(job)
    return outcome


def remove_work(job: Job) -> None:
    """Remove its working folder, unless that holds a training that the next command can reuse."""
    if not _is_reusable(job):
        shutil.rmtree(job.work, ignore_errors=True)


def _is_reusable(job: Job) -> bool:
    """Whether ``work`` holds a training that the next command can reuse."""
    return job.alone and holds_training(job.work)


def _why(job: Job, error: OSError | PhysHDRError) -> str:
    """Why the job failed, in one line, and where its training is if that can be reused."""
    line = str(error).splitlines()[0]
    if not _is_reusable(job):
        return line
    return (
        f"{line}; its training is in {job.work}: close what uses the folder or free some space, then repeat "
        "the command, which will only evaluate it"
    )


def _failed(job: Job, error: _FailedError) -> Outcome:
    log = [*_last_lines(job.work / RUN_LOG), *([error.why] if error.why else [])]
    failure = Failure(
        stage=error.stage,
        status=error.status,
        log=log,
        training=job.record.training,
        evaluation=job.record.evaluation,
    )
    if job.only_evaluate:  # the training already in place is good
        patiently(partial(_add_log, job.work, job.final))
        write_json(job.final / FAILED_FILE, failure)
        shutil.rmtree(job.work, ignore_errors=True)
    else:
        write_json(job.work / FAILED_FILE, failure)
        put_in_place(job.work, job.final)
    return Outcome("failed", log[-1] if log else f"{error.stage} ended with status {error.status}")


def _done(job: Job, should_stop: Callable[[], bool]) -> Outcome:
    if job.pictures is not None:
        _measure(job, job.pictures, should_stop)
        (job.work / USAGE_FILE).unlink(missing_ok=True)  # evaluating them is not part of their cost
        put_in_place(job.work, job.final)
        return Outcome("done")
    if job.only_evaluate:
        _physhdr(job, ["evaluate", job.final, "--out", job.work, *job.evaluate], should_stop)
        patiently(partial(_add_log, job.work, job.final))
        for path in [path for path in job.work.iterdir() if path.name not in (USAGE_FILE, RUN_LOG)]:
            patiently(partial(os.replace, path, job.final / path.name))
        write_json(job.final / RUN_FILE, job.record)
        (job.final / FAILED_FILE).unlink(missing_ok=True)
        shutil.rmtree(job.work, ignore_errors=True)
        return Outcome("done")
    record, search = (job.record, None) if job.trained else _trained(job, should_stop)
    # Before the record, which is valid only with the search that found its iterations.
    if search is not None:
        write_json(job.final.parent / SEARCH_FILE, search)
    # Before the evaluation: if that fails, the training need not be repeated.
    write_json(job.work / RUN_FILE, record)
    (job.work / FAILED_FILE).unlink(missing_ok=True)  # of the evaluation that is now repeated
    _physhdr(job, ["evaluate", job.work, *job.evaluate], should_stop)
    (job.work / USAGE_FILE).unlink(missing_ok=True)
    put_in_place(job.work, job.final)
    return Outcome("done")


def _add_log(work: Path, final: Path) -> None:
    """Append what an evaluation printed to what its training printed."""
    with open(final / RUN_LOG, "ab") as log:
        log.write((work / RUN_LOG).read_bytes())


def _measure(job: Job, pictures: Path, should_stop: Callable[[], bool]) -> None:
    """Evaluate another program's pictures; their cost is read from the file beside them."""
    try:
        cost = read_cost(pictures)
    except PhysHDRError as error:
        raise _FailedError("evaluate", 1, error.message) from error
    write_json(job.work / RUN_FILE, replace(job.record, **cost))
    arguments = ["evaluate", "--pictures", pictures, "--data", job.data, "--out", job.work, *job.evaluate]
    _physhdr(job, arguments, should_stop)


def _trained(job: Job, should_stop: Callable[[], bool]) -> tuple[Record, Search | None]:
    """Train as often as the budget requires; the training nearest to it stays in ``job.work``."""
    if job.iterations is not None:
        return _train(job, job.work, job.iterations, should_stop), None
    known, measurements = job.known, []
    if known:
        measurements.append({"iterations": known.iterations, "cpu_seconds": known.cpu_seconds, "known": 1})
    tried: dict[Measurement, tuple[Path, Record]] = {}
    while (iterations := next_trial(job.seconds, known, list(tried))) is not None:
        folder = job.work / f"{TRIAL}{len(measurements)}"
        record = _train(job, folder, iterations, should_stop)
        assert record.cpu_seconds is not None
        measured = Measurement(iterations, record.cpu_seconds)
        measurements.append({"iterations": iterations, "cpu_seconds": record.cpu_seconds})
        if known is None:
            known = measured  # the pilot
        else:
            tried[measured] = folder, record
    best = nearest(job.seconds, list(tried))
    folder, record = tried[best]
    for path in list(folder.iterdir()):
        patiently(partial(os.replace, path, job.work / path.name))
    for folder in job.work.glob(f"{TRIAL}*"):
        patiently(partial(shutil.rmtree, folder))
    note = note_on(best.iterations)
    search = Search(
        iterations=best.iterations,
        training=record.training,
        threads=record.threads,
        device=job.record.device,
        measurements=measurements,
        note=note,
    )
    return replace(record, note=note), search


def _train(job: Job, folder: Path, iterations: int, should_stop: Callable[[], bool]) -> Record:
    arguments = ["train", job.data, "--out", folder, "--overwrite", *job.train, "--iterations", iterations]
    compared = False

    def look() -> bool:
        """Compare the configuration as soon as it is written, not only after training."""
        nonlocal compared
        if not compared and _json(folder / CONFIG_FILE):
            compared = True
            _require_config(job, folder, iterations)
        return should_stop()

    _physhdr(job, arguments, look)
    finished, gaussians = _events(folder / LOG_FILE)
    if finished is None or finished["stopped"]:
        raise _FailedError("train", 0, "training ended before its last iteration")
    _require_config(job, folder, iterations)
    usage = _json(job.work / USAGE_FILE)
    return replace(
        job.record,
        iterations=int(finished["iteration"]),
        cpu_seconds=float(finished["cpu_seconds"]),
        seconds=float(finished["seconds"]),
        gaussians=gaussians if has_gaussians(job.config) else 0,
        peak_memory=usage.get("peak_memory"),
        machine=usage.get("machine", {}),
    )


def _require_config(job: Job, folder: Path, iterations: int) -> None:
    """Fail unless ``job.config`` was trained, because the fingerprint stands for it."""
    written = _json(folder / CONFIG_FILE).get("config", {})
    if found := differences(job.config | {"iterations": iterations}, written):
        why = f"the code or the data changed meanwhile: {CONFIG_FILE} differs from the plan's: "
        why += "; ".join(found)
        raise _FailedError("train", 0, why)


def _events(path: Path) -> tuple[dict[str, Any] | None, int]:
    """The last ``finished`` event, and the last number of Gaussians that was reported."""
    finished, gaussians = None, 0
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        event = json.loads(line)
        gaussians = event.get("gaussians", gaussians)
        if event["event"] == "finished":
            finished = event
    return finished, gaussians


# ---- processes -------------------------------------------------------------------------------------------


def _physhdr(job: Job, arguments: list[Any], should_stop: Callable[[], bool]) -> None:
    """Run one command to its end; raises ``_FailedError`` or ``StoppedError``."""
    command = [*job.program, job.record.threads, job.work / USAGE_FILE, *arguments]
    count = str(job.record.threads)
    with open(job.work / RUN_LOG, "ab") as log:
        log.write(f"$ physhdr {' '.join(str(word) for word in arguments)}\n".encode())
    status = run_to_end(
        [str(word) for word in command],
        job.work / RUN_LOG,
        lambda: should_stop() or not job.work.exists(),
        {name: count for name in THREAD_VARIABLES} | {"PYTHONUNBUFFERED": "1"},
    )
    if status:
        raise _FailedError(str(arguments[0]), status)


def _last_lines(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    return [line.rstrip() for line in ANSI.sub("", text).splitlines() if line.strip()][-LINES_KEPT:]


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
