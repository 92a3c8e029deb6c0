# SPDX-License-Identifier: GPL-3.0-or-later
"""What Ray's own errors do to a run; no cluster is started."""

import pytest

from physhdr.backend.jobs.pools import RayPool

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
