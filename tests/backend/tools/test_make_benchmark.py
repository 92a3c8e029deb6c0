# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``make benchmark`` measures can be measured: its trainings, its plain alternative, its stopwatch."""

import inspect
from functools import partial
from pathlib import Path

import pytest
import torch

from physhdr.backend.methods.physhdr_common import PhysHDRMethod
from physhdr.backend.train import trainer

COUNT, SIZE = 300, 48


@pytest.fixture(autouse=True)
def benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_an_iteration_can_be_timed_beside_plain_torch(preset):
    from iteration import plain_step
    from synthetic import steady_state

    state = steady_state(preset, COUNT, SIZE)
    first = state.method.gaussians.means.detach().clone()
    assert len(first) == COUNT
    for step in (partial(trainer.step, state), plain_step(state)):
        step()
    after = state.method.gaussians.means
    assert len(after) == COUNT and torch.allclose(first, after, atol=1e-6)  # every step does the same work


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_where_an_iteration_s_time_goes(preset):
    from shares import REST, shares

    watched = [(trainer, "step"), (PhysHDRMethod, "training_outcome"), (torch.Tensor, "backward")]
    before = [inspect.getattr_static(owner, name) for owner, name in watched]
    parts = shares(preset, COUNT, steps=1, size=SIZE, learned=3)
    assert before == [inspect.getattr_static(owner, name) for owner, name in watched]
    compared = "SSIM" if preset == "paper" else "developed and compared"
    for part in ("tiles", "projection and binning", compared, REST):
        assert parts[part]["forward"] > 0 and parts[part]["backward"] > 0, part
    assert ("blur" in parts) == (preset == "paper")
    assert parts["optimiser"]["forward"] > 0


def test_memory_is_measured_of_a_real_training(monkeypatch):
    import synthetic
    import workers

    def small(config, count, views):
        return whole(config, COUNT, 3, SIZE)

    whole = synthetic.untrained_state
    monkeypatch.setattr(synthetic, "untrained_state", small)
    result = workers.memory("default", str(torch.get_num_threads()))
    assert result["gaussians"] > COUNT  # it has grown
    assert result["pictures_mb"] == pytest.approx(3 * 5 * SIZE * SIZE * 3 / 1e6)
    assert result["peak_mb"] > 100
