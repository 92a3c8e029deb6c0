# SPDX-License-Identifier: GPL-3.0-or-later
"""Does every run of a plan that has no result: which next, who is working on it, how it ended."""

import contextlib
import json
import math
import secrets
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

from ...backend.jobs.pools import Outcome, Pool
from ...backend.runs.log import LOG_FILE
from ...bridge.lock import Claims
from .job import PROGRAM, TRIAL, Job, execute, remove_work
from .plan import CPU_SECONDS, TUNE
from .runs import Record, Run, Store, holds_training, runs_of
from .search import Measurement

CLAIMS_FOLDER = ".claims"
#: Seconds between looks at the jobs here, and at those of other commands.
LOOK_EVERY, LOOK_AROUND_EVERY = 0.25, 2.0
#: Bytes at a log's end that contain its last event.
TAIL = 4096

StatusKind = Literal["waiting", "running", "elsewhere", "done", "failed", "blocked", "absent"]
SETTLED = ("done", "failed", "blocked", "absent")


@dataclass(frozen=True)
class Status:
    """A run's status as shown. ``text``: why it failed or waits; ``psnr``: LDR-OE in dB when done.

    ``absent``: another program's pictures are missing.
    """

    kind: StatusKind
    text: str = ""
    iteration: int = 0
    iterations: int = 0
    psnr: float | None = None


class Schedule:
    """The runs of ``store.plan`` and the status of each.

    ``log``: shows a line to the user. ``retry``: what failed is tried again. ``as_evaluated``: nothing will
    be run, so that a run which was evaluated with other LPIPS weights, or without, counts as done.
    ``program``: starts the command ``physhdr``; tests use another one.
    """

    def __init__(
        self,
        store: Store,
        *,
        log: Callable[[str], None],
        retry: bool = False,
        evaluate_again: bool = False,
        as_evaluated: bool = False,
        program: tuple[str, ...] = PROGRAM,
    ) -> None:
        self.store, self.log, self.program = store, log, program
        self.runs = runs_of(store.plan)
        self.status: dict[Run, Status] = {}
        self._jobs: dict[Run, Job] = {}
        self._retry = set(self.runs) if retry else set()
        self._evaluate_again = set(self.runs) if evaluate_again else set()
        self._good = ("done", "evaluate") if as_evaluated else ("done",)
        self._by_claim = {run.claim: run for run in self.runs}
        for run in self.runs:
            self.status[run] = self._on_disk(run)
            if changes := store.changes(run):
                log(f"{run.folder}: to be done again; changed: {_listed(changes)}")

    # -- status ------------------------------------------------------------------------------------------

    def _on_disk(self, run: Run) -> Status:
        state = self.store.state(run)
        if state == "absent":
            return Status("absent", f"there is no folder {run.pictures}")
        if state in self._good and run not in self._evaluate_again:
            evaluation = self.store.evaluation(run)
            if evaluation is not None:
                return Status("done", psnr=(evaluation["means"].get("LDR-OE") or {}).get("psnr"))
        failure = self.store.failure(run) if state == "failed" and run not in self._retry else None
        if failure:
            return Status("failed", failure.log[-1] if failure.log else f"status {failure.status}")
        return Status("waiting")

    def unsettled(self) -> list[Run]:
        return [run for run in self.runs if self.status[run].kind not in SETTLED]

    # -- the loop ----------------------------------------------------------------------------------------

    def do_all(self, pool: Pool, show: Callable[[], None] = lambda: None) -> None:
        """Until every run is done, failed or blocked by one that failed. ``show`` is called regularly."""
        with Claims(self.store.out / CLAIMS_FOLDER, self.log) as claims:
            try:
                with pool:
                    looked = 0.0
                    while self.unsettled():
                        for name, outcome in pool.finished():
                            self._settle(self._by_claim[name], outcome)
                            claims.release(name)
                        if time.monotonic() - looked > LOOK_AROUND_EVERY:
                            looked = time.monotonic()
                            self._look_around(claims)
                        self._begin(pool, claims)
                        self._watch()
                        show()
                        time.sleep(LOOK_EVERY)
                    show()
            finally:
                for job in self._jobs.values():
                    remove_work(job)

    def _begin(self, pool: Pool, claims: Claims) -> None:
        free = pool.free()
        for run in self.runs if free else []:
            if not free:
                return
            if self.status[run].kind != "waiting" or not self._may_begin(run):
                continue
            if not claims.take(run.claim):
                self.status[run] = Status("elsewhere")
                continue
            self.status[run] = self._on_disk(run)  # another command may have done it meanwhile
            if self.status[run].kind == "waiting":
                job = self._job(run, alone=claims.keep_others_out)
                self._jobs[run] = job
                self.status[run] = Status("running")
                pool.submit(run.claim, partial(execute, job))
                free -= 1
            else:
                claims.release(run.claim)

    def _may_begin(self, run: Run) -> bool:
        """Whether it has what it needs; sets it to blocked if it never will."""
        if run.pictures or run.budget.kind != CPU_SECONDS or self.store.search(run):
            return True
        searcher = replace(run, seed=self.store.plan.seeds[0])
        if run == searcher:  # a run at equal iterations, if one is planned, shows what they cost
            like = (run.setting, run.scene, run.method, run.seed)
            return all(
                self.status[other].kind in SETTLED
                for other in self.runs
                if other.budget.kind != CPU_SECONDS
                and (other.setting, other.scene, other.method, other.seed) == like
            )
        if self.status[searcher].kind in SETTLED:
            text = f"seed {searcher.seed}, which searches for the iterations, {self.status[searcher].kind}"
            self.status[run] = Status("blocked", text)
        return False

    def _look_around(self, claims: Claims) -> None:
        """What other commands worked on: done by now, or abandoned."""
        for run in self.runs:
            if self.status[run].kind == "elsewhere" and not claims.is_taken(run.claim):
                self.status[run] = self._on_disk(run)

    def _watch(self) -> None:
        """The progress of running jobs, from their logs."""
        for run, job in self._jobs.items():
            logs = _logs(job.work)
            iteration, iterations = _progress(max(logs, key=_changed)) if logs else (0, 0)
            if iterations:
                self.status[run] = Status("running", "", iteration, iterations)

    def _settle(self, run: Run, outcome: Outcome) -> None:
        remove_work(self._jobs.pop(run))  # exists only if the job's machine died, or if not yet put in place
        if outcome.kind == "stopped":  # not by us, as we settle nothing then: somebody removed its folder
            self.status[run] = self._on_disk(run)
            self.log(f"{run.folder}: another command took over")
            return
        self._retry.discard(run)
        self._evaluate_again.discard(run)
        self.status[run] = self._on_disk(run)
        status = self.status[run]
        record = self.store.record(run)
        if outcome.kind == "done" and status.kind == "done" and record:
            psnr = "" if status.psnr is None else f", LDR-OE {status.psnr:.2f} dB"
            cost = f"{record.iterations} iterations in {record.cpu_seconds or 0.0:.1f} CPU seconds"
            self.log(f"{run.folder}: done, {'evaluated' if run.pictures else cost}{psnr}")
        else:
            self.status[run] = Status("failed", outcome.message or "its results are not those of the plan")
            self.log(f"{run.folder}: {outcome.kind}: {self.status[run].text}")

    # -- one job -----------------------------------------------------------------------------------------

    def _job(self, run: Run, alone: bool) -> Job:
        """``alone``: nobody else can be working on this run, so that what is left is a dead process's."""
        store, plan = self.store, self.store.plan
        final = store.out / run.folder
        ended = self._ended_training(run) if alone else None
        evaluate = (
            *("--device", plan.device),
            *(("--split", plan.split) if plan.kind == TUNE else ()),
            *(("--lpips-weights", str(plan.lpips_weights)) if plan.lpips_weights else ()),
        )
        in_place = store.is_trained(run) and not run.pictures
        done = store.record(run, ended) if ended or in_place else None
        search = None if run.pictures else store.search(run)
        blank = Record(
            iterations=None,
            cpu_seconds=None,
            seconds=None,
            gaussians=None,
            peak_memory=None,
            training=store.training_fingerprint(run),
            evaluation=store.evaluation_fingerprint,
            threads=plan.threads_per_job,
            device=plan.device,
            note=search.note if search and run.budget.kind == CPU_SECONDS else "",
        )
        record = replace(done, evaluation=store.evaluation_fingerprint) if done else blank
        work = ended or final.with_name(f".{final.name}-{secrets.token_hex(4)}")
        data = store.data_folder(run.scene)
        if run.pictures is not None:
            return Job(
                final=final,
                work=work,
                data=data,
                train=(),
                evaluate=("--exposure-mode", run.setting, *plan.picture_options, *evaluate),
                config={},
                iterations=None,
                record=record,
                pictures=run.pictures,
                alone=alone,
                program=self.program,
            )
        iterations = store.iterations(run)
        return Job(
            final=final,
            work=work,
            data=data,
            train=(
                *plan.training_options(run.method),
                *("--seed", str(run.seed), "--exposure-mode", run.setting),
                *("--threads", str(plan.threads_per_job), "--device", plan.device),
            ),
            evaluate=evaluate,
            config=store.config(run, iterations or 0),
            iterations=iterations,
            seconds=run.budget.amount if run.budget.kind == CPU_SECONDS else 0.0,
            known=None if iterations else self._known(run),
            record=record,
            only_evaluate=done is not None and ended is None,
            trained=ended is not None,
            alone=alone,
            program=self.program,
        )

    def _ended_training(self, run: Run) -> Path | None:
        """The folder of a training that ended and could not be put in place; None if it is still to be done,
        or done. Removes whatever else dead processes left of the run.
        """
        final = self.store.out / run.folder
        wanted = run.pictures is None and not self.store.is_trained(run)
        ended = None
        for left in sorted(final.parent.glob(f".{final.name}-*")):
            if wanted and ended is None and holds_training(left) and self.store.is_trained(run, left):
                ended = left
            else:
                shutil.rmtree(left, ignore_errors=True)
        return ended

    def _known(self, run: Run) -> Measurement | None:
        """The cost of a finished run of the same method on the same scene, the one nearest to the budget."""
        found = []
        for other in self.runs:
            if (other.scene, other.method) != (run.scene, run.method) or self.status[other].kind != "done":
                continue
            record = self.store.record(other)
            if record is None or record.threads != self.store.plan.threads_per_job:
                continue
            if record.iterations and record.cpu_seconds:
                apart = abs(math.log(record.cpu_seconds / run.budget.amount))
                known = Measurement(record.iterations, record.cpu_seconds)
                found.append((other.setting != run.setting, apart, known))
        return min(found, key=lambda each: each[:2])[2] if found else None


def _logs(work: Path) -> list[Path]:
    """The logs in a job's folder and its trials'; none once its process has moved the folder away."""
    try:
        folders = [work, *(path for path in work.iterdir() if path.name.startswith(TRIAL))]
    except OSError:  # it can vanish at any moment, which Path.glob does not tolerate either
        return []
    return [log for folder in folders if (log := folder / LOG_FILE).exists()]


def _changed(path: Path) -> float:
    """When, on the file's clock; 0 if it has vanished meanwhile."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _progress(log: Path) -> tuple[int, int]:
    """(iteration, iterations) of a run's last event; (0, 0) if there is none."""
    with contextlib.suppress(OSError, ValueError, KeyError, IndexError):
        with open(log, "rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - TAIL))
            lines = file.read().decode("utf-8", "replace").splitlines()
        events = [json.loads(line) for line in lines[-3:] if line.startswith("{")]
        progress = [event for event in events if "iterations" in event]
        return int(progress[-1]["iteration"]), int(progress[-1]["iterations"])
    return 0, 0


def _listed(changes: list[str]) -> str:
    shown = "; ".join(changes[:3])
    return shown + (f"; and {len(changes) - 3} more" if len(changes) > 3 else "")
