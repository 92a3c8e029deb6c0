# SPDX-License-Identifier: GPL-3.0-or-later
"""Where jobs are done: in threads that watch processes here, or on the machines of a Ray cluster."""

import contextlib
import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from ...bridge.errors import BadValueError
from ...bridge.limits import THREADS_MAX, whole
from ..shell import pip_install

#: Ray gives a cluster that it starts half a minute, which a busy machine may need to read it from the disk.
STARTS = 3


@dataclass(frozen=True)
class Outcome:
    """``message``: of a failure, its last line."""

    kind: Literal["done", "failed", "stopped"]
    message: str = ""


#: Does a job to its end, or until what it is given says that it should stop; its processes have ended then.
#: Another machine must be able to take it: a ``functools.partial`` of a module's function and data.
Work = Callable[[Callable[[], bool]], Outcome]


class Pool(Protocol):
    """Does jobs at the same time. A context manager: at its end every job's processes have ended."""

    def __enter__(self) -> "Pool": ...

    def __exit__(self, *_: object) -> None: ...

    def free(self) -> int:
        """How many more jobs could begin at once."""
        ...

    def submit(self, name: str, work: Work) -> None: ...

    def finished(self) -> list[tuple[str, Outcome]]:
        """Those that ended since the last call; an error of ours is raised."""
        ...


class LocalPool:
    """``jobs`` processes on this machine."""

    def __init__(self, jobs: int) -> None:
        self._jobs = whole("--jobs", jobs, 1, THREADS_MAX)
        self._stop = threading.Event()
        self._running: dict[str, Future[Outcome]] = {}

    def __enter__(self) -> "LocalPool":
        self._threads = ThreadPoolExecutor(self._jobs, "jobs")
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._threads.shutdown(wait=True)

    def free(self) -> int:
        return self._jobs - len(self._running)

    def submit(self, name: str, work: Work) -> None:
        self._running[name] = self._threads.submit(work, self._stop.is_set)

    def finished(self) -> list[tuple[str, Outcome]]:
        names = [name for name, future in self._running.items() if future.done()]
        return [(name, self._running.pop(name).result()) for name in names]


class RayPool:
    """A Ray cluster: ``address`` as ``ray.init`` takes it, or ``local`` to start one here.

    Every machine needs PhysHDR in the same environment, and what jobs read and write at the same path (a
    shared file system). A job takes ``threads`` CPUs of one machine. Raises ``BadValueError`` where Ray is
    not installed, the cluster does not answer, or none of its machines has so many CPUs.
    """

    def __init__(self, address: str, threads: int) -> None:
        try:
            import ray
        except ModuleNotFoundError as error:
            raise BadValueError(
                "--ray needs Ray, which is not installed", f"Install it: {pip_install('ray')}"
            ) from error
        self._ray, self._address, self._threads = ray, address, threads
        self._running: dict[str, Any] = {}

    def __enter__(self) -> "RayPool":
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent to anybody
        local = self._address == "local"
        options: dict[str, Any] = {"include_dashboard": False} if local else {"address": self._address}
        for attempt in range(STARTS if local else 1):
            try:
                self._ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
                break
            except Exception as error:
                self._ray.shutdown()
                if local and attempt + 1 < STARTS:
                    continue
                raise BadValueError(
                    f"the Ray cluster at {self._address} does not answer: {error}",
                    "Start one by `ray start --head`, or give --ray local.",
                ) from error
        if not self._slots():
            most = max(self._cpus(), default=0)
            self._ray.shutdown()
            raise BadValueError(
                f"no machine of the Ray cluster at {self._address} has the {self._threads} CPUs that a job "
                f"takes: the largest has {most}",
                "Give fewer --threads-per-job, or add a machine to the cluster first.",
            )
        self._work_off = self._ray.remote(num_cpus=self._threads, max_retries=0)(_work_off)
        return self

    def __exit__(self, *_: object) -> None:
        for reference in self._running.values():
            with contextlib.suppress(Exception):  # it may have ended, or its machine may be gone
                self._ray.cancel(reference)
        if self._running:  # cancelled jobs end their processes before they end
            self._ray.wait(list(self._running.values()), num_returns=len(self._running), timeout=15)
        self._ray.shutdown()

    def free(self) -> int:
        """Of the cluster as it is now: machines may come and go."""
        return max(0, self._slots() - len(self._running))

    def _slots(self) -> int:
        """How many jobs fit at the same time. None is shared by two machines."""
        return sum(cpus // self._threads for cpus in self._cpus())

    def _cpus(self) -> list[int]:
        """Of each machine that is there."""
        return [int(node["Resources"].get("CPU", 0)) for node in self._ray.nodes() if node["Alive"]]

    def submit(self, name: str, work: Work) -> None:
        self._running[name] = self._work_off.remote(work)

    def finished(self) -> list[tuple[str, Outcome]]:
        if not self._running:
            return []
        references = list(self._running.values())
        ready, _ = self._ray.wait(references, num_returns=len(references), timeout=0)
        done = [name for name, reference in self._running.items() if reference in ready]
        return [(name, self._outcome(self._running.pop(name))) for name in done]

    def _outcome(self, reference: Any) -> Outcome:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError:
            raise  # an error of ours
        except self._ray.exceptions.RayError as error:  # its machine was lost, its memory was too little
            return Outcome("failed", f"Ray: {type(error).__name__}: {error}".splitlines()[0])


def _work_off(work: Work) -> Outcome:
    """On a machine of the cluster: whoever wants it to end cancels Ray's task."""
    return work(lambda: False)
