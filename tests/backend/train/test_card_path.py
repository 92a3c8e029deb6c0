# SPDX-License-Identifier: GPL-3.0-or-later
"""What a card without a compiler trains by (Warp and plain torch), on the CPU, against the CPU's own kernels.

The gradients of an iteration, and whole short trainings.
"""

import dataclasses
import statistics
from pathlib import Path

import pytest
import torch

from physhdr.backend.train.trainer import step

TOOLS = Path(__file__).resolve().parents[3] / "tools"
SIZE, GAUSSIANS, ITERATIONS, SEEDS = 24, 80, 300, 3

pytest.importorskip("warp", reason="warp-lang is not installed")


@pytest.fixture(autouse=True)
def one_thread():
    """Of torch's: pictures this small are done before a second thread has woken."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def sides(monkeypatch):
    """By Warp, and by the CPU's kernels; and the tools that compare them."""
    monkeypatch.syspath_prepend(str(TOOLS))
    from card import parity, truth
    from card.side import Side

    cpu = torch.device("cpu")
    return Side("Warp", cpu, "warp"), Side("the CPU's kernels", cpu, "cpu"), parity, truth


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_an_iteration_has_the_same_gradients(sides, preset):
    by_warp, oracle, parity, _ = sides
    findings = list(parity.iteration(by_warp, oracle, preset, SIZE, GAUSSIANS))
    assert len(findings) >= 12
    for finding in findings:
        assert finding.error < 1e-4, finding
    assert any(finding.error > 0 for finding in findings)  # two implementations


@pytest.mark.long
@pytest.mark.parametrize("preset", ["default", "paper"])
def test_a_training_comes_out_as_good(sides, preset):
    """After 300 iterations the means over seeds differ by no more than the seeds' own spread explains.

    Rounding grows into different Gaussians: single trainings differ by half a decibel whoever computes them.
    """
    by_warp, oracle, _, truth = sides
    scene = truth.scene(SIZE, GAUSSIANS)

    def trained(side, seed: int) -> float:
        config = dataclasses.replace(truth.short(preset, ITERATIONS), seed=seed)
        with side.computing():
            state = truth.begin_on(scene, config, side)
            before = truth.psnr_of_test_views(state)
            for _ in range(ITERATIONS):
                step(state)
            after = truth.psnr_of_test_views(state)
        assert after > before + 3.0  # it learns
        return after

    ours, theirs = ([trained(side, seed) for seed in range(SEEDS)] for side in (by_warp, oracle))
    spread = (statistics.variance(ours) / SEEDS + statistics.variance(theirs) / SEEDS) ** 0.5
    difference = statistics.mean(ours) - statistics.mean(theirs)
    assert abs(difference) <= 3.0 * spread + 0.1, (ours, theirs)
