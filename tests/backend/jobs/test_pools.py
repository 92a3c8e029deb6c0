# SPDX-License-Identifier: GPL-3.0-or-later
"""What Ray's own errors do to a run, and what fits on its machines; no cluster is started."""

import pytest

from physhdr.backend.jobs.pools import RayPool
from physhdr.bridge.errors import BadValueError

ray = pytest.importorskip("ray")
from ray import exceptions  # noqa: E402


def outcome(monkeypatch, error):
    def get(_):
        raise error

    monkeypatch.setattr(ray, "get", get)
    return RayPool("local", 1)._outcome("reference")


@pytest.mark.parametrize(
    "error",
    [
        exceptions.OutOfMemoryError("the worker took 3 GB\nand more"),
        exceptions.LocalRayletDiedError(),
        exceptions.TaskUnschedulableError("no node has 64 CPUs"),
        exceptions.WorkerCrashedError(),
        exceptions.NodeDiedError("gone"),
        exceptions.OutOfDiskError("full"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_ray_could_not_do_is_one_failed_run(monkeypatch, error):
    found = outcome(monkeypatch, error)
    assert found.kind == "failed" and found.message.startswith(f"Ray: {type(error).__name__}: ")
    assert "\n" not in found.message


def test_an_error_of_ours_is_raised(monkeypatch):
    with pytest.raises(exceptions.RayTaskError):
        outcome(monkeypatch, exceptions.RayTaskError("execute", "a traceback", KeyError("ours")))


@pytest.fixture
def machines(monkeypatch):
    """A cluster of machines with so many CPUs each, and the list of what ends it."""

    def make(*cpus):
        nodes = [{"Alive": True, "Resources": {"CPU": float(each), "memory": 1e9}} for each in cpus]
        nodes += [{"Alive": False, "Resources": {"CPU": 64.0}}, {"Alive": True, "Resources": {"GPU": 1.0}}]
        ended = []
        monkeypatch.setattr(ray, "init", lambda **_: None)
        monkeypatch.setattr(ray, "nodes", lambda: nodes)
        monkeypatch.setattr(ray, "cluster_resources", lambda: {"CPU": float(sum(cpus))})
        monkeypatch.setattr(ray, "shutdown", lambda: ended.append("shutdown"))
        return ended

    return make


@pytest.mark.parametrize("cpus", [(8,), (8, 8), ()])
def test_jobs_that_fit_on_no_machine_are_refused(machines, cpus):
    ended = machines(*cpus)
    with pytest.raises(
        BadValueError, match=rf"has the 16 CPUs .* largest has {max(cpus, default=0)}"
    ) as told:
        RayPool("auto", 16).__enter__()
    assert "--threads-per-job" in told.value.hint and ended == ["shutdown"]


def test_no_job_is_shared_by_two_machines(machines):
    machines(6, 6, 3)
    with RayPool("auto", 4) as pool:
        assert pool.free() == 2  # of 15 CPUs
